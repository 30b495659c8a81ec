"""Logs of a track, apart from its evaluated models: verified ones ranked by task, 2025 text logs beside their claims.

A log proves its actions, not that a policy chose them, so it never ranks together with models.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache, partial
from typing import Self
from uuid import UUID

from sqlalchemy import Select, bindparam, select
from sqlalchemy.dialects.postgresql import distinct_on
from sqlalchemy.orm import Session
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import Track

from ..contest.definition import DEFAULT_RANKING, CompetitionTrack, RankingKey
from ..contest.stages import CountedResults, counted_results, shown_stage, track_rules
from ..db.models import BoardResult, Evaluation, Team
from ..evaluations.copies import copies_among
from ..evaluations.scores import score_views
from ..logs.claims import LogClaim
from ..logs.view import verification_of
from ..principals import VISITOR
from ..teams import teams
from ..teams.shown_names import ShownNames
from ..tracks import load_known_track
from ..views.leaderboards import LogBoardsView, LogBoardView, LogEntryView, TextLogEntryView
from ..views.logs import LogCopyView
from ..visibility import played_list_kind
from .best_entries import EVER, BestEntry, Board, best_entries, takes_part
from .changes import kept_until_change
from .made_boards import MadeBoard, MadeBoards, revision_of
from .standings import completed_evaluations, made_entries

_USUAL_RANKING = (
    "Higher success rate first; then fewer mean env steps of the successful episodes; then the earlier submission."
)
_WHAT_IS_RANKED = (
    "Only verified logs are ranked, the best of each team, task by task, and never together with models. "
    "A log is not ranked if half of its episodes or more have the states of an earlier submission of another team, "
    "half-way through or to the end."
)
MAX_TEXT_LOGS = 200


_made_boards: MadeBoards[LogBoardsView] = MadeBoards()


def log_boards(session: Session, track_name: str, *, stage: str | None = None) -> MadeBoard[LogBoardsView]:
    """Return the logs of a track.

    Args:
        session: of the transaction.
        track_name: whose logs.
        stage: of the competition; None: the one that opened last.

    Raises:
        ServiceError: there is no such track or stage.
    """
    track, of_stage = load_known_track(track_name), shown_stage(session, track_name, stage)
    rules = track_rules(session, track_name)
    ranking = _Ranking.of(rules)
    counted = counted_results(session, of_stage)
    shown_names = ShownNames.read(session, VISITOR)
    found = kept_until_change(
        session,
        ("logs", track.name, of_stage, counted, shown_names, ranking),
        lambda: _found(session, track, of_stage, counted, shown_names, ranking),
    )
    made = partial(_view, session, track, found)
    return _made_boards.get((track.name, of_stage), found.revision, made, names=found.names)


@dataclass(frozen=True, kw_only=True)
class _Ranking:
    """What logs are compared by, and that as a sentence."""

    keys: tuple[RankingKey, ...]
    rule: str

    @classmethod
    def of(cls, rules: CompetitionTrack | None) -> Self:
        told = (rules.ranking_sentence if rules else None) or _USUAL_RANKING
        return cls(keys=rules.ranking if rules else DEFAULT_RANKING, rule=f"{told} {_WHAT_IS_RANKED}")


@dataclass(frozen=True, kw_only=True)
class _Shown:
    """What is on the boards of a revision: the best logs by task, which of them are copies, and text logs."""

    stage: str
    counted: CountedResults
    best: Mapping[str, list[BestEntry]]
    copies: Mapping[UUID, LogCopyView]
    text_logs: Sequence[UUID]
    revision: str
    names: str
    shown_names: ShownNames
    ranking_rule: str


def _found(
    session: Session,
    track: Track,
    stage: str,
    counted: CountedResults,
    shown_names: ShownNames,
    ranking: _Ranking,
) -> _Shown:
    boards = {
        task: Board(
            track=track.name,
            stage=stage,
            kind=SubmissionKind.LOG,
            task=task,
            ranking=ranking.keys,
            evaluator_version=counted.evaluator_version,
        )
        for task in track.tasks
    }
    until = counted.until or EVER
    best = {task: best_entries(session, board, until=until) for task, board in boards.items()}
    named = {"track": track.name, "stage": stage, "until": until, "at_most": MAX_TEXT_LOGS}
    text_logs = session.scalars(_newest_text_logs(), named).all()
    copies = copies_among(session, [entry.evaluation_id for entries in best.values() for entry in entries], shown_names)
    ranked = [part for task, entries in best.items() for part in (task, *entries)]
    names = f"{teams.last_named_at(session)} {shown_names.hidden}"
    revision = revision_of(
        f"logs of {track.name} {stage} {counted} {names} {ranking.rule}", [*ranked, *sorted(copies.items()), *text_logs]
    )
    return _Shown(
        stage=stage,
        counted=counted,
        best=best,
        copies=copies,
        text_logs=text_logs,
        revision=revision,
        names=names,
        shown_names=shown_names,
        ranking_rule=ranking.rule,
    )


def _view(session: Session, track: Track, shown: _Shown, last: LogBoardsView | None) -> LogBoardsView:
    entry_of = partial(_entry, version=shown.counted.evaluator_version, names=shown.shown_names)
    entries_before = {board.task: board.entries for board in last.boards} if last else {}
    return LogBoardsView(
        track=track.name,
        title=track.title,
        stage=shown.stage or None,
        final_since=shown.counted.final_since,
        label=SubmissionKind.LOG.form.worth,
        ranking_rule=shown.ranking_rule,
        evaluator_version=shown.counted.evaluator_version,
        revision=shown.revision,
        generated_at=datetime.now(UTC),
        boards=[
            LogBoardView(
                task=name,
                title=task.title,
                entries=[
                    view.model_copy(update={"copy_of": shown.copies.get(view.evaluation_id)})
                    for view in made_entries(session, shown.best[name], entries_before.get(name, ()), entry_of)
                ],
            )
            for name, task in track.tasks.items()
        ],
        text_logs=_text_logs(session, shown, last.text_logs if last else ()),
    )


def _text_logs(session: Session, shown: _Shown, last: Iterable[TextLogEntryView]) -> list[TextLogEntryView]:
    """Return the views of text logs by their evaluations; those that were there before, too, are not read again."""
    kept = {view.evaluation_id: view for view in last}
    new = completed_evaluations(session, set(shown.text_logs) - kept.keys())
    return [_text_log(new[found], shown.shown_names) if found in new else kept[found] for found in shown.text_logs]


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
    claim = LogClaim.model_validate(submission.manifest)
    return LogEntryView(
        rank=entry.rank,
        stale=evaluation.evaluator_version != version,
        team=names.name_of(submission.team),
        evaluation_id=evaluation.id,
        submission_id=submission.id,
        submission_name=submission.name,
        verdict=verification_of(claim, evaluation),
        copy_of=None,
        submitted_at=submission.submitted_at,
        episodes=score.episodes,
        successes=score.successes,
        success_rate=score.success_rate,
        success_rate_interval=score.success_rate_interval,
        mean_steps=score.mean_steps,
        result_hash=score.result_hash,
        evaluator_version=evaluation.evaluator_version,
        list_kind=played_list_kind(evaluation),
    )


def _text_log(evaluation: Evaluation, names: ShownNames) -> TextLogEntryView:
    submission = evaluation.submission
    claim, score = LogClaim.model_validate(submission.manifest), score_views(evaluation)[0]
    return TextLogEntryView(
        team=names.name_of(submission.team),
        task=score.task,
        evaluation_id=evaluation.id,
        submission_id=submission.id,
        submission_name=submission.name,
        submitted_at=submission.submitted_at,
        claimed_success_rate=claim.success_rate,
        claimed_mean_steps=claim.mean_steps,
        success_rate=score.success_rate,
        mean_steps=score.mean_steps,
        problems=len(claim.problems),
        evaluator_version=evaluation.evaluator_version,
    )
