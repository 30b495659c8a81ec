"""A competition after its end: what was final then, or when it was decided again."""

from sqlalchemy.orm import Session

from ..competition.competition import Competition
from ..competition.view import competition_view
from ..errors import ProblemCode, ServiceError
from ..prizes.finishing import find_last_decision
from ..transparency.log import ensure_key
from ..views.competition import ArchiveView
from ..views.leaderboards import LeaderboardView


def archive_view(session: Session, name: str | None = None) -> ArchiveView:
    """Return the archive of a competition; `name` None: of the one that opened last.

    Raises:
        ServiceError: this service runs none, or it is not final.
    """
    found, competition = competition_view(session, name), Competition.read(session, name)
    if found.finalized_at is None:
        raise ServiceError(
            ProblemCode.NOT_FOUND,
            f"{found.title} is still running; its archive appears here once the organizers have made it final.",
        )
    return ArchiveView(
        competition=found,
        boards=[LeaderboardView.model_validate(board) for board in competition.row.boards or []],
        public_key=ensure_key(session).public_key,
        decided_again_at=find_last_decision(session, competition),
        citation=_citation(found.name, found.title, found.finalized_at.year, found.website),
    )


def _citation(name: str, title: str, year: int, website: str | None) -> str:
    """Return an entry for BibTeX; what would end a field or begin a command in it is left out."""
    plain = "".join(character for character in title if character not in "{}\\%#$&~^_")
    lines = [f"  title = {{{{{plain}}}}}", f"  year  = {{{year}}}", "  note  = {Final results with result hashes}"]
    lines += [f"  url   = {{{website}}}"] if website else []
    return f"@misc{{{name},\n" + ",\n".join(lines) + "\n}"
