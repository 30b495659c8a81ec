"""What organizers confirm by name before a change is made, and what they made it against; both are checked here."""

import hashlib
import json
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass

from .errors import ProblemCode, ServiceError

_REVISION_CHARS = 12


@dataclass(frozen=True, kw_only=True)
class Concern:
    """Something that a change touches and cannot take back: what already happened, or what still waits.

    Attributes:
        name: by which it is confirmed.
        sentence: what it is.
    """

    name: str
    sentence: str


def require_confirmed(concerns: Iterable[Concern], confirmed: Collection[str] | None) -> None:
    """Refuse a change of which a concern is not confirmed.

    Args:
        concerns: of the change.
        confirmed: their names; None: the caller shows them and asks about each.

    Raises:
        ServiceError: confirmation_needed, with every concern that is not confirmed.
    """
    missing = [] if confirmed is None else [concern for concern in concerns if concern.name not in confirmed]
    if missing:
        raise ServiceError(
            ProblemCode.CONFIRMATION_NEEDED,
            " ".join(f"{concern.name}: {concern.sentence}" for concern in missing)
            + f" Nothing was changed. If you mean it, repeat with {_options(missing)}.",
            concerns=[concern.name for concern in missing],
        )


def compute_revision(content: object) -> str:
    """Return a short name of a content, by which a change says what it was made against; empty for nothing."""
    if not content:
        return ""
    written = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(written.encode()).hexdigest()[:_REVISION_CHARS]


def require_base(what: str, *, base: str | None, revision: str, difference: Callable[[], str]) -> None:
    """Refuse a change that was made against another revision than the present one.

    Args:
        what: is changed, for the message.
        base: the revision that the change was made against; empty: against nothing; None: the caller looked itself.
        revision: the present one.
        difference: returns sentences that say what differs.

    Raises:
        ServiceError: changed_meanwhile.
    """
    if base in {None, revision}:
        return
    made_against = f"revision {base}" if base else "nothing, as no --base was given"
    repeat = f"--base {revision}" if revision else "no --base"
    raise ServiceError(
        ProblemCode.CHANGED_MEANWHILE,
        f"This change was made against {made_against}, but {what} is at revision {revision or 'none'}. {difference()} "
        f"Nothing was changed. Include that change, and repeat with {repeat}.",
        revision=revision,
    )


def require_shown(what: str, shown: str | None, revision: str) -> None:
    """Refuse a change that would do something else than what was looked at.

    Args:
        what: would be another, for the message.
        shown: revision of what was looked at, as a dry run gave it; None: nothing was.
        revision: of what the change does.

    Raises:
        ServiceError: changed_meanwhile.
    """
    if shown not in {None, revision}:
        raise ServiceError(
            ProblemCode.CHANGED_MEANWHILE,
            f"Since you looked, {what} became others, and nothing was done. Look again, and repeat.",
            revision=revision,
        )


def _options(concerns: Iterable[Concern]) -> str:
    return " ".join(f"--confirm {concern.name}" for concern in concerns)
