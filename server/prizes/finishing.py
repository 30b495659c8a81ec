"""The end of a competition: boards that stand still, winners by the prize table, and the final word."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime

from sqlalchemy.orm import Session

from ..audit import newest_entries, record
from ..contest.definition import CompetitionDefinition, CompetitionTrack, Prize
from ..contest.stages import current
from ..db.competition_row import competition_row, lock_competition, require_not_final
from ..db.models import Competition
from ..errors import ProblemCode, ServiceError
from ..evaluations.readiness import require_current, require_scored
from ..judging.judging import ranked_by_total
from ..leaderboards.standings import leaderboard
from ..principals import Principal
from ..tracks import known_track
from ..views.leaderboards import LeaderboardEntryView, LeaderboardView

FINALIZE_AGAIN = "competition.finalize_again"
"""The action in the audit log; its lines keep the winners and boards that were replaced."""


@dataclass(frozen=True, kw_only=True)
class Winner:
    """A team and what it wins.

    Attributes:
        place: of the prize table.
        amount: of money, in the competition's currency.
        result_hash: of the evaluation by which it won.
        total: by which it won a judged track; None elsewhere.
    """

    track: str
    place: str
    rank: int
    team: str
    amount: int
    currency: str
    note: str | None
    success_rate: float
    mean_steps: float | None
    submission: str
    result_hash: str
    total: float | None = None


def freeze(session: Session, by: Principal) -> None:
    """Let the boards of all stages stand still for everybody but organizers; results go on arriving.

    Raises:
        ServiceError: not an organizer, or there is no competition that goes on.
    """
    row = _lock(session, by)
    if row.frozen_at is None:
        row.frozen_at = datetime.now(UTC)
        record(session, by, "competition.freeze", _subject(row), {"frozen_at": row.frozen_at.isoformat()})


def unfreeze(session: Session, by: Principal) -> None:
    """Show all results again.

    Raises:
        ServiceError: not an organizer, or there is no competition that goes on.
    """
    row = _lock(session, by)
    if row.frozen_at is not None:
        before = {"frozen_at": row.frozen_at.isoformat()}
        row.frozen_at = None
        record(session, by, "competition.unfreeze", _subject(row), {"frozen_at": None}, before=before)


def finalize(session: Session, by: Principal, *, at: datetime | None = None) -> list[Winner]:
    """End the competition and keep winners and boards as they are now; these show all results again.

    Args:
        session: of the transaction.
        by: an organizer.
        at: the moment; None: now.

    Raises:
        ServiceError: not an organizer, there is no competition or it is final already, a stage or an evaluation is not
            over, a board has results of another evaluator version, or a judged track has an entry without a total.
    """
    row = _lock(session, by)
    definition = CompetitionDefinition.model_validate(row.definition)
    now = at or datetime.now(UTC)
    _require_over(session, definition, now)
    found = _winners_now(session, row, definition)
    row.finalized_at, row.frozen_at = now, None
    _keep(session, row, definition, found)
    record(session, by, "competition.finalize", _subject(row), {"winners": row.winners})
    return found


def finalize_again(session: Session, by: Principal) -> list[Winner]:
    """Keep winners and boards of a final competition anew, without the teams that were disqualified since.

    The results stay those of its end, and so does its moment; names of teams, and what the track files say, are
    today's.

    Raises:
        ServiceError: not an organizer, there is no competition or it is not final, a track file is missing, it was
            final before boards were kept and a board has results of another evaluator version, or a judged track has
            an entry without a total.
    """
    by.require_organizer()
    row = lock_competition(session)
    if row is None:
        raise _no_competition()
    if row.finalized_at is None:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, "The competition is not final yet; `vitac admin results finalize` ends it."
        )
    definition = CompetitionDefinition.model_validate(row.definition)
    _require_track_files(definition)
    before = {"winners": row.winners, "boards": row.boards}
    found = _winners_now(session, row, definition)
    _keep(session, row, definition, found)
    record(session, by, FINALIZE_AGAIN, _subject(row), {"winners": row.winners}, before=before)
    return found


def decided_again_at(session: Session, row: Competition) -> datetime | None:
    """Return when winners and boards of a final competition were last kept anew; None: never."""
    lines = newest_entries(session, 1, action=FINALIZE_AGAIN, subject=_subject(row))
    return lines[0].at if lines else None


def winners(session: Session) -> list[Winner]:
    """Return who wins what: as it was finalized, or by today's boards of the last stages.

    Raises:
        ServiceError: there is no competition, a board has results of another evaluator version, or a judged track has
            an entry without a total.
    """
    row = competition_row(session)
    definition = current(session)
    if row is None or definition is None:
        raise _no_competition()
    if row.winners is not None:
        return [Winner(**winner) for winner in row.winners]
    return _winners_now(session, row, definition)


def prizes_without_winner(session: Session, found: Sequence[Winner]) -> list[str]:
    """Return for each track with prizes that nobody wins a sentence that names them, with how many of each."""
    definition = current(session)
    tracks = definition.tracks.items() if definition else ()
    left = {name: _left_over(name, track, found) for name, track in tracks}
    return [
        f"{name}: nobody wins {', '.join(f'{count} x {place}' for place, count in prizes.items())}"
        + ("." if definition and definition.tracks[name].taken_here else "; this service does not hold the track.")
        for name, prizes in left.items()
        if prizes
    ]


def boards_of(session: Session, definition: CompetitionDefinition) -> list[LeaderboardView]:
    """Return the board of every stage that is held here, as organizers see it now."""
    return [
        leaderboard(session, name, stage=stage.name, live=True).view
        for name, track in definition.tracks.items()
        if track.taken_here
        for stage in track.stages
    ]


def _winners_now(session: Session, row: Competition, definition: CompetitionDefinition) -> list[Winner]:
    """Return who wins by the boards of the last stages; kept boards rank by the evaluator version of the end."""
    found = []
    for name, track in definition.tracks.items():
        if track.taken_here:
            if row.boards is None:
                require_current(session, name, track.stages[-1].name)
            found += _winners_of(session, definition, name, track)
    return found


def _keep(session: Session, row: Competition, definition: CompetitionDefinition, found: Sequence[Winner]) -> None:
    """Write winners, and the boards as they are for organizers."""
    row.winners = [asdict(winner) for winner in found]
    row.boards = [board.model_dump(mode="json") for board in boards_of(session, definition)]


def _winners_of(
    session: Session, definition: CompetitionDefinition, name: str, track: CompetitionTrack
) -> list[Winner]:
    """Return the winners of a track; of fewer teams than prizes all win."""
    stage = track.stages[-1].name
    return [
        Winner(
            track=name,
            place=prize.place,
            rank=rank,
            team=entry.team,
            amount=prize.amount,
            currency=definition.currency,
            note=prize.note,
            success_rate=entry.success_rate,
            mean_steps=entry.mean_steps,
            submission=str(entry.submission_id),
            result_hash=entry.result_hash,
            total=total,
        )
        for rank, (prize, (entry, total)) in enumerate(
            zip(_single_prizes(track.prizes), _in_order(session, name, track, stage), strict=False), start=1
        )
    ]


def _in_order(
    session: Session, name: str, track: CompetitionTrack, stage: str
) -> Sequence[tuple[LeaderboardEntryView, float | None]]:
    """Return the ranked entries as prizes go to them: by total where judged, else as on the board."""
    if track.judging is not None:
        return ranked_by_total(session, name, stage)
    board = leaderboard(session, name, stage=stage, live=True).view
    return [(entry, None) for entry in board.entries if entry.rank is not None]


def _left_over(name: str, track: CompetitionTrack, found: Sequence[Winner]) -> Counter[str]:
    given = Counter(winner.place for winner in found if winner.track == name)
    return Counter({prize.place: prize.winners for prize in track.prizes}) - given


def _single_prizes(prizes: Sequence[Prize]) -> list[Prize]:
    return [prize for prize in prizes for _ in range(prize.winners)]


def _lock(session: Session, by: Principal) -> Competition:
    """Return the competition, which goes on."""
    by.require_organizer()
    row = lock_competition(session)
    if row is None:
        raise _no_competition()
    require_not_final(row)
    return row


def _require_over(session: Session, definition: CompetitionDefinition, now: datetime) -> None:
    """Refuse while a stage takes submissions, or one of them is not scored."""
    last = max(track.stages[-1].closes for track in definition.tracks.values())
    if now < last:
        raise ServiceError(ProblemCode.STAGE_NOT_OVER, f"The last stage closes at {last:%F %T} UTC; wait until then.")
    for name, track in definition.tracks.items():
        for stage in track.stages:
            require_scored(session, name, stage.name)


def _require_track_files(definition: CompetitionDefinition) -> None:
    """Refuse to make boards anew while a track that is held here has no file."""
    missing = [name for name, track in definition.tracks.items() if track.taken_here and known_track(name) is None]
    if missing:
        raise ServiceError(
            ProblemCode.UNKNOWN_TRACK,
            f"Expected a track file of each track of the competition, got none of {', '.join(missing)}; put it back as "
            "it was at the end. Nothing was changed.",
        )


def _subject(row: Competition) -> str:
    return f"competition:{row.definition['name']}"


def _no_competition() -> ServiceError:
    return ServiceError(
        ProblemCode.NOT_FOUND, "There is no competition; `vitac admin competition apply FILE` makes one."
    )
