"""The end of a competition: what is unsettled before it, who wins, and reopening it."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Any

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from .. import names
from ..accounts.teams import REASON_LENGTH
from ..audit import append_audit_digest, newest_entries, record
from ..competitions.competition import Competition
from ..competitions.definition import TrackRules
from ..competitions.stages import Stage
from ..confirmations import Concern, require_confirmed
from ..database.clock import read_clock
from ..database.models import Evaluation, Rejudgement
from ..errors import ProblemCode, ServiceError
from ..evaluations.history import require_current, require_scored
from ..leaderboards.standings import leaderboard
from ..principals import CONSOLE, Principal
from ..receipts.export import make_final_board
from ..receipts.receipt import End, JudgedEntry, WinningEntry
from ..receipts.witnesses import require_witnessed
from ..submissions.appeals import end_with_competition, open_in_competition
from ..tracks import known_track
from ..transparency.log import append
from ..views.leaderboards import LeaderboardEntryView, LeaderboardView
from . import entered_results
from .judging import judged, ranked_by_total

FINALIZE_AGAIN = "competition.finalize_again"
"""The action in the audit log; its lines keep the winners and boards that were replaced."""


@dataclass(frozen=True, kw_only=True)
class Winner:
    """A team and what it wins.

    Attributes:
        place: of the prize table.
        amount: of money, in the competition's currency.
        won_by: what its board compares first, with its value; None where results are entered.
        success_rate, mean_steps, submission, result_hash: of the submission by which it won; None where results are
            entered.
        total: by which it won a judged track; None elsewhere.
        points, evidence, team_id: of the attempt by which it won, where results are entered; None elsewhere.
    """

    track: str
    place: str
    rank: int
    team: str
    amount: int
    currency: str
    note: str | None
    won_by: str | None = None
    success_rate: float | None = None
    mean_steps: float | None = None
    submission: str | None = None
    result_hash: str | None = None
    total: float | None = None
    points: float | None = None
    evidence: str | None = None
    team_id: str | None = None


def finalize(
    session: Session,
    by: Principal,
    name: str | None = None,
    *,
    at: datetime | None = None,
    confirmed: Collection[str] | None = (),
) -> list[Winner]:
    """End the competition and keep winners and boards as they are now; these show all results again.

    Appeals end with it: those without a ruling are rejected, and no more are taken.

    Args:
        session: of the transaction.
        by: an organizer.
        name: of the competition; None: the only one.
        at: the moment; None: now.
        confirmed: names of what is not settled (`concerns_at_end`) that the organizer confirms; None: the caller asks.

    Raises:
        ServiceError: not an organizer, there is no competition or it is final already, a stage or an evaluation is not
            over, a stage lacks witnesses, a board has results of another evaluator version, a judged track has an entry
            without a total, or something is neither settled nor confirmed.
    """
    competition, now = Competition.lock_to_change(session, by, name), at or read_clock(session)
    _require_over(session, competition, now)
    require_witnessed(session, competition)
    winning = _winners_now(session, competition)
    require_confirmed(unsettled(competition, now), confirmed)
    end_with_competition(session, by, competition)
    competition.row.finalized_at, competition.row.frozen_at = now, None
    _store(session, competition, winning)
    record(session, by, "competition.finalize", competition.subject, {"winners": competition.row.winners})
    _issue_receipt(session, competition)
    return winning


def concerns_at_end(session: Session, name: str | None = None) -> list[Concern]:
    """Return what is not settled, and would be by the end alone."""
    competition = Competition.find(session, name)
    competition.require_held()
    return unsettled(competition, read_clock(session))


def reopen(session: Session, by: Principal, reason: str, name: str | None = None) -> None:
    """Reopen a final competition, to correct what was found after its end; everybody sees when and why.

    The earlier winners and boards stay in the audit log. Results that are made again get receipts of their own.

    Raises:
        ServiceError: not an organizer, there is no competition, it is not final, or the reason cannot be shown.
    """
    competition = Competition.lock_held(session, by, name)
    _require_final(competition)
    shown, row = names.clean(reason, what="A reason", min_length=2, max_length=REASON_LENGTH), competition.row
    before = {"finalized_at": str(row.finalized_at), "winners": row.winners, "boards": row.boards}
    row.reopened = [*row.reopened, {"at": read_clock(session).isoformat(), "reason": shown}]
    row.finalized_at = row.winners = row.boards = None
    record(session, by, "competition.reopen", competition.subject, {"reason": shown}, before=before)
    _issue_receipt(session, competition, reason=shown)


def finalize_again(session: Session, by: Principal, name: str | None = None) -> list[Winner]:
    """Decide winners and boards of a final competition again, without the teams that were disqualified since.

    The results stay those of its end, and so does its moment; names of teams, and what the track files say, are
    today's.

    Raises:
        ServiceError: not an organizer, there is no competition or it is not final, a track file is missing, it was
            final before boards were stored and a board has results of another evaluator version, or a judged track has
            an entry without a total.
    """
    competition = Competition.lock_held(session, by, name)
    _require_final(competition)
    _require_track_files(competition)
    before = {"winners": competition.row.winners, "boards": competition.row.boards}
    winning = _winners_now(session, competition)
    _store(session, competition, winning)
    record(session, by, FINALIZE_AGAIN, competition.subject, {"winners": competition.row.winners}, before=before)
    _issue_receipt(session, competition)
    return winning


def find_last_decision(session: Session, competition: Competition) -> datetime | None:
    """Return when winners and boards of a final competition were last decided again; None: never."""
    lines = newest_entries(session, 1, action=FINALIZE_AGAIN, subject=competition.subject)
    return lines[0].at if lines else None


def winners(session: Session, name: str | None = None) -> list[Winner]:
    """Return who wins what: as it was finalized, or by today's boards of the last stages.

    Raises:
        ServiceError: there is no competition, a board has results of another evaluator version, or a judged track has
            an entry without a total.
    """
    competition = Competition.find(session, name)
    competition.require_held()
    if competition.row.winners is not None:
        return [Winner(**winner) for winner in competition.row.winners]
    return _winners_now(session, competition)


def prizes_without_winner(session: Session, winning: Sequence[Winner], name: str | None = None) -> list[str]:
    """Return for each track with prizes that nobody wins a sentence that names them, with how many of each."""
    tracks = Competition.find(session, name).definition.tracks
    left = {name: _count_unawarded(name, track, winning) for name, track in tracks.items()}
    return [
        f"{name}: nobody wins {', '.join(f'{count} x {place}' for place, count in prizes.items())}"
        + ("." if tracks[name].taken_here else "; this service does not hold the track.")
        for name, prizes in left.items()
        if prizes
    ]


def winning_entries(competition: Competition) -> tuple[WinningEntry, ...]:
    """Return the winners of a final competition as receipts and exports name them; none before its end."""
    names = WinningEntry.model_fields
    return tuple(
        WinningEntry.model_validate({name: winner[name] for name in names}) for winner in competition.row.winners or ()
    )


def judged_entries(session: Session, competition: Competition) -> tuple[JudgedEntry, ...]:
    """Return what the judges think of the entries of the last stages as receipts and exports name it; once final."""
    if competition.row.finalized_at is None:
        return ()
    return tuple(
        JudgedEntry(
            track=stage.track,
            team=team.team,
            submission=team.submission,
            criteria={each.criterion: each.mean for each in team.criteria},
            total=team.total,
        )
        for stage in competition.last_stages
        if stage.track_rules.judging is not None
        for team in judged(session, CONSOLE, stage)
    )


def make_boards(session: Session, competition: Competition) -> list[LeaderboardView]:
    """Return the board of every stage that is held here, as organizers see it now."""
    return [leaderboard(session, stage, live=True).view for stage in competition.stages_held_here]


def _winners_now(session: Session, competition: Competition) -> list[Winner]:
    """Return who wins by the boards of the last stages; stored boards rank by the evaluator version of the end."""
    winning = []
    for stage in competition.last_stages:
        if competition.row.boards is None:
            require_current(session, stage)
        winning += _find_winners(session, stage, competition.definition.currency)
    for stage in competition.last_entered_stages:
        winning += _find_winners_by_points(session, stage, competition.definition.currency)
    return winning


def _store(session: Session, competition: Competition, winning: Sequence[Winner]) -> None:
    """Write winners, and the boards as they are for organizers."""
    competition.row.winners = [asdict(winner) for winner in winning]
    competition.row.boards = [board.model_dump(mode="json") for board in make_boards(session, competition)]


def _issue_receipt(session: Session, competition: Competition, *, reason: str | None = None) -> None:
    """Sign winners and marks, so that nobody changes them later, or the reopening with its reason."""
    finalized_at, judged_now = competition.row.finalized_at, judged_entries(session, competition)
    for board in map(LeaderboardView.model_validate, competition.row.boards or ()):
        append(session, partial(make_final_board, competition.definition.name, board))

    def make(issued_at: datetime) -> End:
        return End(
            issued_at=issued_at,
            competition=competition.definition.name,
            finalized_at=finalized_at and finalized_at.astimezone(UTC),
            reason=reason,
            winners=winning_entries(competition),
            judged=judged_now,
        )

    append_audit_digest(session)
    append(session, make)


def _find_winners(session: Session, stage: Stage, currency: str) -> list[Winner]:
    """Return the winners by the board of a stage; of fewer teams than prizes all win."""
    ranking = stage.find_ranking()
    return _award(
        stage,
        currency,
        [
            {
                "team": entry.team,
                "won_by": ranking.describe_first(ranking.values(entry, entry.submitted_at)),
                "success_rate": entry.success_rate,
                "mean_steps": entry.mean_steps,
                "submission": str(entry.submission_id),
                "result_hash": entry.result_hash,
                "total": total,
            }
            for entry, total in _order_for_prizes(session, stage)
        ],
    )


def _find_winners_by_points(session: Session, stage: Stage, currency: str) -> list[Winner]:
    """Return the winners by the results that operators have entered for a stage."""
    return _award(
        stage,
        currency,
        [
            {
                "team": row.team.name,
                "points": entered_results.total(stage, row),
                "evidence": row.evidence,
                "team_id": str(row.team.id),
            }
            for row, _ in entered_results.best_attempts(session, stage)
            if row.team is not None
        ],
    )


def _award(stage: Stage, currency: str, ranked: Sequence[Mapping[str, Any]]) -> list[Winner]:
    """Return who wins the prizes of a stage's track, the best first."""
    return [
        Winner(
            track=stage.track,
            place=prize.place,
            rank=rank,
            amount=prize.amount,
            currency=currency,
            note=prize.note,
            **entry,
        )
        for rank, (prize, entry) in enumerate(zip(stage.track_rules.single_prizes, ranked, strict=False), start=1)
    ]


def _order_for_prizes(session: Session, stage: Stage) -> Sequence[tuple[LeaderboardEntryView, float | None]]:
    """Return the ranked entries as prizes go to them: by total where judged, else as on the board."""
    if stage.track_rules.judging is not None:
        return ranked_by_total(session, stage)
    board = leaderboard(session, stage, live=True).view
    return [(entry, None) for entry in board.entries if entry.rank is not None]


def _count_unawarded(name: str, track: TrackRules, winning: Sequence[Winner]) -> Counter[str]:
    given = Counter(winner.place for winner in winning if winner.track == name)
    return Counter({prize.place: prize.winners for prize in track.prizes}) - given


def _require_final(competition: Competition) -> None:
    if competition.row.finalized_at is None:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, "The competition is not final yet; `vitac admin results finalize` ends it."
        )


def _require_over(session: Session, competition: Competition, now: datetime) -> None:
    """Refuse while a stage takes submissions, or one of them is not scored."""
    last = max(stage.rules.closes for stage in competition.stages)
    if now < last:
        raise ServiceError(ProblemCode.STAGE_NOT_OVER, f"The last stage closes at {last:%F %T} UTC; wait until then.")
    for stage in competition.stages:
        require_scored(session, stage)


def _require_track_files(competition: Competition) -> None:
    """Refuse to make boards again while a track that is held here has no file."""
    missing = [stage.track for stage in competition.last_stages if known_track(stage.track) is None]
    if missing:
        raise ServiceError(
            ProblemCode.UNKNOWN_TRACK,
            f"Expected a track file of each track of the competition, got none of {', '.join(missing)}; put it back as "
            "it was at the end. Nothing was changed.",
        )


def unsettled(competition: Competition, now: datetime) -> list[Concern]:
    """Return what would be settled by the end alone: appeals, their time, rejudgements, boards without a rank."""
    return [*_appeals(competition), *_appeal_time(competition, now), *_rejudgements(competition), *_boards(competition)]


def _appeals(competition: Competition) -> Iterator[Concern]:
    if waiting := open_in_competition(competition.session, competition):
        listed = ", ".join(f"{one.id} of {one.team.name}" for one in waiting)
        yield Concern(
            name="open_appeals", sentence=f"No ruling was made on appeals {listed}; they are rejected with the end."
        )


def _appeal_time(competition: Competition, now: datetime) -> Iterator[Concern]:
    days = competition.definition.appeal_days
    in_competition = competition.submissions, Evaluation.is_proposed.is_(False)
    query = select(func.max(Evaluation.finished_at)).join(Evaluation.submission).where(*in_competition)
    last = competition.session.scalar(query)
    if days is not None and last is not None and (until := last + timedelta(days=days)) > now:
        yield Concern(
            name="appeal_time", sentence=f"Teams may appeal until {until:%F %T} UTC; with the end they no longer can."
        )


def _rejudgements(competition: Competition) -> Iterator[Concern]:
    waiting = Rejudgement.applied_at.is_(None), Rejudgement.discarded_at.is_(None)
    in_competition = Rejudgement.competition == competition.name, Rejudgement.stage != ""
    rejudgements = competition.session.scalars(
        select(Rejudgement).where(*in_competition, *waiting).order_by(Rejudgement.started_at)
    ).all()
    if rejudgements:
        listed = ", ".join(f"{one.id} of stage {one.stage} of {one.track}" for one in rejudgements)
        yield Concern(name="rejudgements", sentence=f"Rejudgements {listed} are neither applied nor discarded.")


def _boards(competition: Competition) -> Iterator[Concern]:
    boards = [leaderboard(competition.session, stage, live=True).view for stage in competition.stages_held_here]
    unranked = [board for board in boards if board.entries and all(entry.rank is None for entry in board.entries)]
    if unranked:
        listed = ", ".join(f"stage {board.stage} of {board.track}" for board in unranked)
        yield Concern(
            name="boards_without_ranks",
            sentence=f"No entry on the board of {listed} has a rank: another evaluator version made them; rejudge.",
        )
