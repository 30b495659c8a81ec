"""Every refusal of the service: a stable code, an HTTP status and a sentence.

The service layer raises `ServiceError`; `server.api.problems` turns it into RFC 9457 problem JSON, the CLI prints it.
"""

from collections.abc import Mapping
from enum import StrEnum
from http import HTTPStatus
from types import MappingProxyType

from vitac.errors import VitacError


class ProblemCode(StrEnum):
    """Stable names of refusals; clients may rely on them, so a code is never renamed or reused."""

    APPEAL_TOO_LATE = "appeal_too_late"
    ARCHIVE_REJECTED = "archive_rejected"
    BODY_TOO_LARGE = "body_too_large"
    CHANGED_MEANWHILE = "changed_meanwhile"
    CHECKSUM_MISMATCH = "checksum_mismatch"
    COMPETITION_FINAL = "competition_final"
    CONFIRMATION_NEEDED = "confirmation_needed"
    COMPETITION_REQUIRED = "competition_required"
    DATABASE_UNAVAILABLE = "database_unavailable"
    DIGEST_MISMATCH = "digest_mismatch"
    FILE_NAME_MISMATCH = "file_name_mismatch"
    FORBIDDEN = "forbidden"
    INTERNAL_ERROR = "internal_error"
    INVALID_CREDENTIALS = "invalid_credentials"
    INVITE_REQUIRED = "invite_required"
    INVALID_REQUEST = "invalid_request"
    LENGTH_INVALID = "length_invalid"
    LIST_SEALED = "list_sealed"
    LOG_IMPOSSIBLE = "log_impossible"
    LOG_REJECTED = "log_rejected"
    LOG_REWRITTEN = "log_rewritten"
    LOG_TEAM_MISMATCH = "log_team_mismatch"
    MANIFEST_REJECTED = "manifest_rejected"
    METHOD_NOT_ALLOWED = "method_not_allowed"
    MISSING_CREDENTIALS = "missing_credentials"
    NAME_TAKEN = "name_taken"
    NOT_CANCELLABLE = "not_cancellable"
    NOT_FOUND = "not_found"
    NOT_QUALIFIED = "not_qualified"
    NOT_REQUEUABLE = "not_requeuable"
    NOT_WITNESSED = "not_witnessed"
    NO_LOG = "no_log"
    QUOTA_EXCEEDED = "quota_exceeded"
    REGISTRATION_CLOSED = "registration_closed"
    RESULTS_OUTDATED = "results_outdated"
    SENSOR_REJECTED = "sensor_rejected"
    SERVICE_STOPPING = "service_stopping"
    STAGE_CLOSED = "stage_closed"
    STAGE_IN_USE = "stage_in_use"
    STAGE_NOT_OVER = "stage_not_over"
    STORAGE_FULL = "storage_full"
    STORAGE_UNAVAILABLE = "storage_unavailable"
    SUBMISSION_DISQUALIFIED = "submission_disqualified"
    TEAM_DISQUALIFIED = "team_disqualified"
    TEAM_EXISTS = "team_exists"
    TEAM_NOT_ACCEPTED = "team_not_accepted"
    TEAM_REQUIRED = "team_required"
    TOO_MANY_REQUESTS = "too_many_requests"
    TOO_MANY_UPLOADS = "too_many_uploads"
    TRACK_REMOVED = "track_removed"
    UNKNOWN_STAGE = "unknown_stage"
    UNKNOWN_TASK = "unknown_task"
    UNKNOWN_TEAM = "unknown_team"
    UNKNOWN_TRACK = "unknown_track"
    UNKNOWN_WITNESS = "unknown_witness"
    UNSUPPORTED_CONTENT_TYPE = "unsupported_content_type"
    UNSUPPORTED_SUBMISSION_KIND = "unsupported_submission_kind"
    UPLOAD_CONFLICT = "upload_conflict"
    UPLOAD_INCOMPLETE = "upload_incomplete"
    UPLOAD_TOO_LARGE = "upload_too_large"
    UPLOAD_TRUNCATED = "upload_truncated"
    WRONG_PROTOCOL_VERSION = "wrong_protocol_version"


TRACK_REMOVED = "This belongs to a track or task that this service no longer has."
"""What every answer of `ProblemCode.TRACK_REMOVED` begins with."""
STATUS_OF_CODE: Mapping[ProblemCode, HTTPStatus] = MappingProxyType(
    {
        ProblemCode.APPEAL_TOO_LATE: HTTPStatus.CONFLICT,
        ProblemCode.ARCHIVE_REJECTED: HTTPStatus.UNPROCESSABLE_ENTITY,
        ProblemCode.BODY_TOO_LARGE: HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
        ProblemCode.CHANGED_MEANWHILE: HTTPStatus.CONFLICT,
        ProblemCode.CHECKSUM_MISMATCH: HTTPStatus.BAD_REQUEST,
        ProblemCode.COMPETITION_FINAL: HTTPStatus.CONFLICT,
        ProblemCode.CONFIRMATION_NEEDED: HTTPStatus.CONFLICT,
        ProblemCode.COMPETITION_REQUIRED: HTTPStatus.UNPROCESSABLE_ENTITY,
        ProblemCode.DATABASE_UNAVAILABLE: HTTPStatus.SERVICE_UNAVAILABLE,
        ProblemCode.DIGEST_MISMATCH: HTTPStatus.BAD_REQUEST,
        ProblemCode.FILE_NAME_MISMATCH: HTTPStatus.UNPROCESSABLE_ENTITY,
        ProblemCode.FORBIDDEN: HTTPStatus.FORBIDDEN,
        ProblemCode.INTERNAL_ERROR: HTTPStatus.INTERNAL_SERVER_ERROR,
        ProblemCode.INVALID_CREDENTIALS: HTTPStatus.UNAUTHORIZED,
        ProblemCode.INVITE_REQUIRED: HTTPStatus.FORBIDDEN,
        ProblemCode.INVALID_REQUEST: HTTPStatus.UNPROCESSABLE_ENTITY,
        ProblemCode.LENGTH_INVALID: HTTPStatus.BAD_REQUEST,
        ProblemCode.LIST_SEALED: HTTPStatus.FORBIDDEN,
        ProblemCode.LOG_IMPOSSIBLE: HTTPStatus.UNPROCESSABLE_ENTITY,
        ProblemCode.LOG_REJECTED: HTTPStatus.UNPROCESSABLE_ENTITY,
        ProblemCode.LOG_REWRITTEN: HTTPStatus.CONFLICT,
        ProblemCode.LOG_TEAM_MISMATCH: HTTPStatus.UNPROCESSABLE_ENTITY,
        ProblemCode.MANIFEST_REJECTED: HTTPStatus.UNPROCESSABLE_ENTITY,
        ProblemCode.METHOD_NOT_ALLOWED: HTTPStatus.METHOD_NOT_ALLOWED,
        ProblemCode.MISSING_CREDENTIALS: HTTPStatus.UNAUTHORIZED,
        ProblemCode.NAME_TAKEN: HTTPStatus.CONFLICT,
        ProblemCode.NOT_CANCELLABLE: HTTPStatus.CONFLICT,
        ProblemCode.NOT_FOUND: HTTPStatus.NOT_FOUND,
        ProblemCode.NOT_QUALIFIED: HTTPStatus.FORBIDDEN,
        ProblemCode.NOT_REQUEUABLE: HTTPStatus.CONFLICT,
        ProblemCode.NOT_WITNESSED: HTTPStatus.CONFLICT,
        ProblemCode.NO_LOG: HTTPStatus.CONFLICT,
        ProblemCode.QUOTA_EXCEEDED: HTTPStatus.TOO_MANY_REQUESTS,
        ProblemCode.REGISTRATION_CLOSED: HTTPStatus.FORBIDDEN,
        ProblemCode.RESULTS_OUTDATED: HTTPStatus.CONFLICT,
        ProblemCode.SENSOR_REJECTED: HTTPStatus.UNPROCESSABLE_ENTITY,
        ProblemCode.SERVICE_STOPPING: HTTPStatus.SERVICE_UNAVAILABLE,
        ProblemCode.STAGE_CLOSED: HTTPStatus.FORBIDDEN,
        ProblemCode.STAGE_IN_USE: HTTPStatus.CONFLICT,
        ProblemCode.STAGE_NOT_OVER: HTTPStatus.CONFLICT,
        ProblemCode.STORAGE_FULL: HTTPStatus.INSUFFICIENT_STORAGE,
        ProblemCode.STORAGE_UNAVAILABLE: HTTPStatus.SERVICE_UNAVAILABLE,
        ProblemCode.SUBMISSION_DISQUALIFIED: HTTPStatus.FORBIDDEN,
        ProblemCode.TEAM_DISQUALIFIED: HTTPStatus.FORBIDDEN,
        ProblemCode.TEAM_EXISTS: HTTPStatus.CONFLICT,
        ProblemCode.TEAM_NOT_ACCEPTED: HTTPStatus.FORBIDDEN,
        ProblemCode.TEAM_REQUIRED: HTTPStatus.UNPROCESSABLE_ENTITY,
        ProblemCode.TOO_MANY_REQUESTS: HTTPStatus.TOO_MANY_REQUESTS,
        ProblemCode.TOO_MANY_UPLOADS: HTTPStatus.TOO_MANY_REQUESTS,
        ProblemCode.TRACK_REMOVED: HTTPStatus.GONE,
        ProblemCode.UNKNOWN_STAGE: HTTPStatus.NOT_FOUND,
        ProblemCode.UNKNOWN_TASK: HTTPStatus.NOT_FOUND,
        ProblemCode.UNKNOWN_TEAM: HTTPStatus.NOT_FOUND,
        ProblemCode.UNKNOWN_TRACK: HTTPStatus.NOT_FOUND,
        ProblemCode.UNKNOWN_WITNESS: HTTPStatus.FORBIDDEN,
        ProblemCode.UNSUPPORTED_CONTENT_TYPE: HTTPStatus.UNSUPPORTED_MEDIA_TYPE,
        ProblemCode.UNSUPPORTED_SUBMISSION_KIND: HTTPStatus.UNPROCESSABLE_ENTITY,
        ProblemCode.UPLOAD_CONFLICT: HTTPStatus.CONFLICT,
        ProblemCode.UPLOAD_INCOMPLETE: HTTPStatus.CONFLICT,
        ProblemCode.UPLOAD_TOO_LARGE: HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
        ProblemCode.UPLOAD_TRUNCATED: HTTPStatus.BAD_REQUEST,
        ProblemCode.WRONG_PROTOCOL_VERSION: HTTPStatus.PRECONDITION_FAILED,
    }
)


class ServiceError(VitacError):
    """A request that the service refuses; `detail` says what was expected, what was given and what to do."""

    def __init__(self, code: ProblemCode, detail: str, **extras: object) -> None:
        super().__init__(detail)
        self.code = code
        self.detail = detail
        self.extras = extras

    @property
    def status(self) -> HTTPStatus:
        """HTTP status that belongs to the code."""
        return STATUS_OF_CODE[self.code]


class ServiceSettingsError(VitacError):
    """A `VITAC_` setting cannot be used; the message names it and says what to set."""


def not_found(noun: str, name: object) -> ServiceError:
    """Return the refusal for a thing that is missing or belongs to somebody else: both look alike from outside."""
    return ServiceError(
        ProblemCode.NOT_FOUND, f"There is no {noun} {name} that you may see. Check the id and the token."
    )


def token_missing() -> ServiceError:
    """Return the refusal of what only somebody with a token may do."""
    return ServiceError(
        ProblemCode.MISSING_CREDENTIALS, "This needs a token; send the header `Authorization: Bearer vitac_...`."
    )


def storage_full() -> ServiceError:
    """Return the refusal of a request for which the service has no disk space left."""
    return ServiceError(
        ProblemCode.STORAGE_FULL,
        "The disk of the service is full. Nothing of this request was stored. Tell the organizers; try again later.",
    )
