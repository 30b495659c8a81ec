"""Names of uploaded files in the challenge's form, checked against the upload; any other name is fine."""

import re
import unicodedata

from vitac.evaluator.tracks import load_track

from ..competitions.stages import Stage
from ..errors import ProblemCode, ServiceError

MAX_CHARACTERS = 255
"""A longer name is none that a file can have."""
_FORM = re.compile(
    r"(?P<team>.+)-Track_(?P<track>\d+)-(?P<stage>stage\d+)-result(?![^\W_]).*", re.IGNORECASE | re.DOTALL
)
"""`teamname-Track_1-stage1-result` and whatever follows, as the organizers of 2025 asked for it."""


def check_file_name(name: str | None, *, team: str, stage: Stage | None = None) -> None:
    """Refuse a file whose name says another team, track or stage than it is uploaded for.

    Args:
        name: of the file; None if the client did not send it.
        team: whose submission it becomes.
        stage: to which it is submitted; None: not known yet.

    Raises:
        ServiceError: file_name_mismatch.
    """
    found = _FORM.fullmatch(name[:MAX_CHARACTERS]) if name is not None else None
    if found is None:
        return
    _require(name, "team", found["team"], team, agrees=_folded(found["team"]) == _folded(team))
    if stage is None:
        return
    named, folder = f"Track_{found['track']}", load_track(stage.track).folder
    _require(name, "track", named, folder, agrees=named.casefold() == folder.casefold())
    if not stage.is_practice:
        _require(name, "stage", found["stage"], stage.name, agrees=found["stage"].casefold() == stage.name.casefold())


def _require(name: str | None, what: str, named: str, expected: str, *, agrees: bool) -> None:
    if not agrees:
        raise ServiceError(
            ProblemCode.FILE_NAME_MISMATCH,
            f"The file's name {name!r:.120} says the {what} {named!r:.80}, expected {expected!r}. Rename the file, or "
            f"upload it as that {what}'s.",
            part=what,
        )


def _folded(name: str) -> str:
    """Return a team's name as it may be written in a file's name: blanks, _ and - are alike, and so are all cases."""
    return re.sub(r"[\s_-]+", " ", unicodedata.normalize("NFKC", name)).strip().casefold()
