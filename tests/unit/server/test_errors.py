"""Every refusal has a stable code with one status, and a sentence."""

from http import HTTPStatus

import pytest
from vitac.errors import VitacError
from vitac.server.errors import STATUS_OF_CODE, ProblemCode, ServiceError, not_found, storage_full

# Clients rely on them: a code keeps its name and its status for ever; new ones are added.
PROMISED = {
    "archive_rejected": 422,
    "body_too_large": 413,
    "checksum_mismatch": 400,
    "database_unavailable": 503,
    "digest_mismatch": 400,
    "forbidden": 403,
    "internal_error": 500,
    "invalid_credentials": 401,
    "invalid_request": 422,
    "invite_required": 403,
    "length_invalid": 400,
    "log_impossible": 422,
    "log_rejected": 422,
    "log_team_mismatch": 422,
    "manifest_rejected": 422,
    "method_not_allowed": 405,
    "missing_credentials": 401,
    "no_log": 409,
    "not_cancellable": 409,
    "not_found": 404,
    "not_requeuable": 409,
    "quota_exceeded": 429,
    "registration_closed": 403,
    "service_stopping": 503,
    "storage_full": 507,
    "storage_unavailable": 503,
    "team_exists": 409,
    "team_required": 422,
    "too_many_requests": 429,
    "too_many_uploads": 429,
    "unknown_task": 404,
    "unknown_team": 404,
    "unknown_track": 404,
    "unsupported_content_type": 415,
    "unsupported_submission_kind": 422,
    "upload_conflict": 409,
    "upload_incomplete": 409,
    "upload_too_large": 413,
    "upload_truncated": 400,
    "wrong_protocol_version": 412,
}


@pytest.mark.parametrize(("code", "status"), PROMISED.items())
def test_promised_codes_keep_their_name_and_status(code: str, status: int) -> None:
    assert STATUS_OF_CODE[ProblemCode(code)] == status
    assert ServiceError(ProblemCode(code), "no").status == status


@pytest.mark.parametrize("code", ProblemCode)
def test_every_code_is_named_after_itself_and_is_an_error(code: ProblemCode) -> None:
    assert code.value == code.name.lower()
    assert STATUS_OF_CODE[code] >= HTTPStatus.BAD_REQUEST


def test_a_refusal_carries_its_sentence_and_what_belongs_to_it() -> None:
    error = ServiceError(ProblemCode.UNKNOWN_TRACK, "There is no track 'x'.", nearest="track_1", count=2)
    assert str(error) == error.detail == "There is no track 'x'."
    assert (error.code, error.extras) == (ProblemCode.UNKNOWN_TRACK, {"nearest": "track_1", "count": 2})
    assert isinstance(error, VitacError)


def test_what_is_missing_and_what_is_anothers_look_alike() -> None:
    error = not_found("submission", 17)
    assert error.code is ProblemCode.NOT_FOUND
    assert error.detail == "There is no submission 17 that you may see. Check the id and the token."


def test_a_full_disk_is_told_with_what_to_do() -> None:
    error = storage_full()
    assert (error.code, error.status) == (ProblemCode.STORAGE_FULL, HTTPStatus.INSUFFICIENT_STORAGE)
    assert error.detail == (
        "The disk of the service is full. Nothing of this request was stored. Tell the organizers; try again later."
    )
