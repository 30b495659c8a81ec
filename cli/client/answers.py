"""Answers of a service as its clients read them, refusals too; what a newer service says besides is left alone.

Raised by the client, distinguished by its callers.
"""

import json
from dataclasses import fields
from typing import Any, TypeVar

import httpx
from vitac.errors import VitacError

T = TypeVar("T")
HINTS = {
    "missing_credentials": "Get a token with `vitac register TEAM`, or give yours to `vitac login`.",
    "invalid_credentials": "Give a valid token to `vitac login`; ask an organizer for one if yours was revoked or has "
    "expired.",
    "forbidden": "This token has no permission for that; use the right team's token, or an organizer's.",
    "not_found": "Check the id (`vitac status` lists yours) and the token.",
    "unknown_track": "Check the track's name in submission.yaml and with --track.",
    "log_rejected": "Make the log again with `vitac evaluate --log`, and upload one log at a time, unaltered; "
    "`vitac log import FILE` lists the problems of a 2025 text log.",
    "log_impossible": "Check it locally: `vitac log verify FILE`, or `vitac log import FILE` for a 2025 text log.",
    "log_team_mismatch": "Use the token of the team that the log names, or evaluate with --team.",
    "sensor_rejected": "Run `vitac sensor check` on the submission's folder; it lists every rule.",
    "archive_rejected": "Run `vitac check` on the submission; it lists everything that would be refused.",
    "digest_mismatch": "The upload was corrupted in transit; send it again.",
    "upload_truncated": "The upload was cut off; send it again.",
    "upload_too_large": "Remove files that the policy does not need; a log holds one evaluation of one task.",
    "too_many_requests": "Wait a moment and retry.",
    "too_many_uploads": "Finish or wait; `vitac submit` continues an upload of the same content.",
    "database_unavailable": "The database is starting or down; retry in a minute.",
    "quota_exceeded": "`vitac whoami` shows your quotas; an upload in pieces waits for a day.",
    "registration_closed": "Ask the organizers: they add teams and members; a token from them goes to `vitac login`.",
    "invite_required": "`vitac register --invite` takes the organizers' code, `vitac team join` that of a captain.",
    "storage_full": "Tell the organizers that the disk of the service is full.",
    "storage_unavailable": "The service cannot store files now; retry in a minute.",
}


NO_CODE = "no_code"
"""Stands for the code of an answer that is no problem of ours."""


class RequestRefused(VitacError):
    """The service refused a request; the message has status, code, detail, hint and request id."""

    def __init__(self, *, status: int, code: str, detail: str, request_id: str | None) -> None:
        self.status, self.code, self.detail, self.hint = status, code, detail, HINTS.get(code)
        lines = [f"refused with status {status} ({code}): {detail}"]
        if self.hint is not None:
            lines.append(f"hint: {self.hint}")
        if request_id is not None:
            lines.append(f"request id: {request_id}")
        super().__init__("\n  ".join(lines))


class ServiceUnreachable(VitacError):
    """No service answers at the address; the message names it and says what to check."""


def refusal(answer: httpx.Response) -> RequestRefused:
    """Return what an answer that is no success says."""
    request_id = answer.headers.get("x-request-id")
    try:
        content = answer.json()
    except ValueError:
        content = None
    problem = content if isinstance(content, dict) else {}
    return RequestRefused(
        status=answer.status_code,
        code=str(problem.get("code", NO_CODE)),
        detail=str(problem.get("detail", f"{answer.reason_phrase}; this may not be a ViTac Arena service")),
        request_id=request_id,
    )


class AnswerNotUnderstood(VitacError):
    """What answers is no service of ViTac Arena, or one that says less than this command needs."""


class Answer(dict[str, Any]):
    """An object of an answer, which names a key that it should have and has not."""

    def __missing__(self, key: str) -> Any:
        """Refuse it.

        Raises:
            AnswerNotUnderstood: always.
        """
        raise AnswerNotUnderstood(
            f"Expected {key!r} in the service's answer, got {', '.join(map(repr, self)) or 'nothing'}. The service is "
            "of another release than this command; use the same one for both."
        )


def decode(answer: httpx.Response) -> Any:
    """Return the JSON of an answer, with each of its objects as an `Answer`.

    Raises:
        AnswerNotUnderstood: it is no JSON.
    """
    try:
        return json.loads(answer.content, object_hook=Answer)
    except ValueError as error:
        raise _not_understood(answer, answer.headers.get("content-type", "nothing")) from error


def decode_object(answer: httpx.Response) -> Answer:
    """Return the JSON of an answer that is an object.

    Raises:
        AnswerNotUnderstood: it is none.
    """
    content = decode(answer)
    if not isinstance(content, Answer):
        raise _not_understood(answer, f"a {type(content).__name__}")
    return content


def pick(kind: type[T], content: Answer) -> T:
    """Return a dataclass with those of an answer's fields that it has."""
    return kind(**{field.name: content[field.name] for field in fields(kind)})  # type: ignore[arg-type]


def _not_understood(answer: httpx.Response, got: str) -> AnswerNotUnderstood:
    return AnswerNotUnderstood(
        f"Expected JSON from {answer.url}, got {got}. Something else than a service of ViTac Arena answers there; "
        "check --server or VITAC_SERVER."
    )
