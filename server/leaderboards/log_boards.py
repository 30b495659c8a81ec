"""Logs and plays of policy servers of a track, apart from its evaluated models, and 2025 text logs beside their claims.

Both prove their actions, not what chose them, so they never rank together with models, nor with one another.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache, partial
from uuid import UUID

from sqlalchemy import Select, bindparam, exists, select
from sqlalchemy.dialects.postgresql import distinct_on
from sqlalchemy.orm import Session
from vitac.evaluator.logs.text_2025 import WHY_RATES_DIFFER
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import Track

from ..accounts import teams
from ..accounts.shown_names import ShownNames
from ..competitions.stages import CountedResults, Stage
from ..database.models import BoardResult, Evaluation, Team
from ..evaluations.copies import find_copies
from ..evaluations.logs import LogClaim, read_verification
from ..evaluations.scores import score_views
from ..principals import VISITOR
from ..tracks import load_known_track
from ..views.evaluations import CopyView
from ..views.leaderboards import LogBoardsView, LogBoardView, LogEntryView, TextLogEntryView
from ..visibility import played_list_kind
from .best_entries import BestEntry, Board, best_entries, takes_part
from .board_cache import MadeBoard, MadeBoards, compute_revision, kept_until_change
from .standings import completed_evaluations, made_entries, unranked

_WHAT_IS_RANKED = (
    "Logs are for practice: they play the public list, and give no prizes and no advancement. "
    "Only verified logs are ranked, the best of each team, task by task, and never together with models. What a policy "
    "server played in our physics is ranked apart from both: what chose the actions is not seen. "
    "A log is not ranked if half of its episodes or more have the states of an earlier submission of another team, "
    "half-way through or to the end."
)
MAX_TEXT_LOGS = 200


_made_boards: MadeBoards[LogBoardsView] = MadeBoards()


def log_boards(session: Session, stage: Stage, *, unfrozen: bool = False) -> MadeBoard[LogBoardsView]:
    """Return the logs of a track.

    Args:
        session: of the transaction.
        stage: to which they were submitted.
        unfrozen: for organizers: with results that frozen boards do not show to others.

    Raises:
        ServiceError: there is no such track.
    """
    track, counted = load_known_track(stage.track), stage.counted_results(live=unfrozen)
    rule = f"{stage.describe_ranking() or track.ranking_rule} {_WHAT_IS_RANKED}"
    shown_names = ShownNames.read(session, VISITOR)
    board = kept_until_change(
        session,
        ("logs", stage.competition, stage.track, stage.name, rule, counted, shown_names),
        lambda: _found(session, track, stage, counted, shown_names, rule),
    )
    made = partial(_view, session, track, board)
    key = (stage.competition, stage.track, stage.name, unfrozen)
    return _made_boards.get(key, board.revision, made, names=board.names)


_Place = tuple[SubmissionKind, str]
"""Kind and task of a board."""


@dataclass(frozen=True, kw_only=True)
class _Shown:
    """What is on the boards of a revision: the best by kind and task, which of them are copies, and text logs."""

    stage: str
    counted: CountedResults
    boards: Mapping[_Place, Board]
    best: Mapping[_Place, list[BestEntry]]
    copies: Mapping[UUID, CopyView]
    text_logs: Sequence[UUID]
    revision: str
    names: str
    shown_names: ShownNames
    ranking_rule: str


def _found(
    session: Session, track: Track, stage: Stage, counted: CountedResults, shown_names: ShownNames, rule: str
) -> _Shown:
    boards = {
        (kind, task): Board.from_results(stage, counted, kind=kind, task=task)
        for kind in track.accepts
        if kind.form.is_verified or (kind.form.is_remote and _was_played(session, stage, kind))
        for task in track.tasks
    }
    best = {place: best_entries(session, board) for place, board in boards.items()}
    until = Board.from_results(stage, counted).until
    named = {"track": stage.track, "stage": stage.name, "until": until, "at_most": MAX_TEXT_LOGS}
    text_logs = session.scalars(_newest_text_logs(), named).all()
    evaluations = [entry.evaluation_id for entries in best.values() for entry in entries]
    copies = find_copies(session, evaluations, shown_names, logs=evaluations)
    ranked = [part for place, entries in best.items() for part in (place, *entries)]
    names = f"{teams.find_last_naming(session)} {shown_names.hidden}"
    revision = compute_revision(
        f"logs of {stage.track} {stage.name} {counted} {names} {rule}", [*ranked, *sorted(copies.items()), *text_logs]
    )
    return _Shown(
        stage=stage.name,
        counted=counted,
        boards=boards,
        best=best,
        copies=copies,
        text_logs=text_logs,
        revision=revision,
        names=names,
        shown_names=shown_names,
        ranking_rule=rule,
    )


def _was_played(session: Session, stage: Stage, kind: SubmissionKind) -> bool:
    """Return whether there is a result of a kind, most tracks having none but of models and logs."""
    place = (BoardResult.track == stage.track, BoardResult.stage == stage.name, BoardResult.kind == kind)
    return bool(session.scalar(select(exists().where(*place))))


def _view(session: Session, track: Track, shown: _Shown, last: LogBoardsView | None) -> LogBoardsView:
    entry_of = partial(_entry, version=shown.counted.evaluator_version, names=shown.shown_names)
    entries_before = {(board.kind, board.task): board.entries for board in last.boards} if last else {}
    return LogBoardsView(
        track=track.name,
        title=track.title,
        stage=shown.stage or None,
        final_since=shown.counted.final_since,
        ranking_rule=shown.ranking_rule,
        evaluator_version=shown.counted.evaluator_version,
        revision=shown.revision,
        generated_at=datetime.now(UTC),
        boards=[
            _board(
                shown,
                place,
                track.tasks[place[1]].title,
                made_entries(session, entries, entries_before.get(place, ()), entry_of),
            )
            for place, entries in shown.best.items()
        ],
        text_logs=_text_logs(session, shown, last.text_logs if last else ()),
        why_rates_differ=WHY_RATES_DIFFER,
    )


def _board(shown: _Shown, place: _Place, title: str, entries: Sequence[LogEntryView]) -> LogBoardView:
    kind, task = place
    return LogBoardView(
        kind=kind,
        label=kind.form.worth,
        task=task,
        title=title,
        unranked=unranked(entries, shown.counted, shown.boards[place]),
        entries=[view.model_copy(update={"copy_of": shown.copies.get(view.evaluation_id)}) for view in entries],
    )


def _text_logs(session: Session, shown: _Shown, last: Iterable[TextLogEntryView]) -> list[TextLogEntryView]:
    """Return the views of text logs by their evaluations; those that were there before, too, are not read again."""
    kept = {view.evaluation_id: view for view in last}
    new = completed_evaluations(session, set(shown.text_logs) - kept.keys())
    return [_text_log(new[entry], shown.shown_names) if entry in new else kept[entry] for entry in shown.text_logs]


@cache  # building it takes longer than running it
def _newest_text_logs() -> Select[UUID]:
    """Return the evaluation of each text log that was completed last; the newest logs, which are shown.

    Their rows in `evaluations` are not looked at: that would read the rows of all.
    """
    newest_of_each = (
        select(BoardResult.evaluation_id, BoardResult.submitted_at)
        .join(Team, Team.id == BoardResult.team_id)
        .where(
            takes_part(),
            BoardResult.track == bindparam("track"),
            BoardResult.stage == bindparam("stage"),
            BoardResult.kind == SubmissionKind.TEXT_LOG,
            BoardResult.finished_at <= bindparam("until"),
            ~BoardResult.is_off_boards,
        )
        .ext(distinct_on(BoardResult.submission_id))
        .order_by(BoardResult.submission_id, BoardResult.finished_at.desc(), BoardResult.evaluation_id)
        .subquery()
    )
    return (
        select(newest_of_each.c.evaluation_id)
        .order_by(newest_of_each.c.submitted_at.desc(), newest_of_each.c.evaluation_id)
        .limit(bindparam("at_most"))
    )


def _entry(entry: BestEntry, evaluation: Evaluation, *, version: str, names: ShownNames) -> LogEntryView:
    submission = evaluation.submission
    score = score_views(evaluation)[0]
    is_log = submission.kind.form.is_verified
    return LogEntryView.from_row(
        score,
        rank=entry.rank,
        stale=evaluation.evaluator_version != version,
        team=names.show_name(submission.team),
        evaluation_id=evaluation.id,
        submission_id=submission.id,
        submission_name=submission.name,
        verdict=read_verification(LogClaim.model_validate(submission.manifest), evaluation) if is_log else None,
        copy_of=None,
        submitted_at=submission.submitted_at,
        success_rate=entry.ranked_by["success_rate"] or 0.0,
        mean_steps=entry.ranked_by["mean_steps"],
        evaluator_version=evaluation.evaluator_version,
        list_kind=played_list_kind(evaluation),
    )


def _text_log(evaluation: Evaluation, names: ShownNames) -> TextLogEntryView:
    submission = evaluation.submission
    claim, score = LogClaim.model_validate(submission.manifest), score_views(evaluation)[0]
    return TextLogEntryView.from_row(
        score,
        team=names.show_name(submission.team),
        evaluation_id=evaluation.id,
        submission_id=submission.id,
        submission_name=submission.name,
        submitted_at=submission.submitted_at,
        claimed_success_rate=claim.success_rate,
        claimed_mean_steps=claim.mean_steps,
        problems=len(claim.problems),
        evaluator_version=evaluation.evaluator_version,
    )
