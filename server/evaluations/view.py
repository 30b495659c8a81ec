"""Views of evaluations, one or a list, as everybody or their team may see them."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Self
from uuid import UUID

from sqlalchemy import ColumnElement, select
from sqlalchemy.orm import Session, defer, joinedload
from vitac.evaluator.package_sets import digest_of_packages
from vitac.evaluator.tracks import ListKind

from ..cache import Cache
from ..database.models import EpisodeResult, Evaluation, Shard, Submission
from ..database.states import ACTIVE_EVALUATION_STATES, TERMINAL_EVALUATION_STATES, EvaluationState, WorkState
from ..errors import not_found
from ..principals import CONSOLE, Principal
from ..queue.workers import WorkersAlive, fleet
from ..settings import Settings
from ..tracks import known_task
from ..views.evaluations import (
    DifferingEpisodeView,
    EvaluationDetailView,
    EvaluationRowView,
    EvaluationSummaryView,
    EvaluationView,
    PackagesView,
    ProgressView,
    ShardView,
    VerdictView,
)
from ..views.scores import TaskScoreView
from ..visibility import decide_sight, played_list_kind
from .copies import count_copied_episodes
from .episode_store import EpisodeKey, find_shown_key
from .history import count_differing_episodes, differing_episodes
from .lifecycle import LOG_TAIL_CHARACTERS
from .progress import (
    EpisodeCounts,
    episode_counts,
    episodes_ahead,
    make_progress_view,
    mean_episode_s,
    queue_positions,
    seconds_to_end,
    states_of_checks,
)
from .provenance import isolation_levels
from .scores import (
    bounds,
    combine_scores,
    combined_score,
    counted_tasks,
    played_score,
    practice_score_views,
    read_scores,
    task_views,
)
from .verdicts import SENSOR_VERDICTS, find_sentence

PROGRESS_STEPS = 10
"""Number of steps in which a team sees the progress on a sealed list."""
SEALED_DETAILS = "The list is sealed; the details are shown once its secret is published."


_complete: Cache[tuple[UUID, bool, ListKind], EvaluationView] = Cache(at_most=5000)
"""Completed evaluations as a list shows them: these do not change. By whether episodes are hidden, and kind of list."""


@dataclass(frozen=True, kw_only=True)
class EvaluationRows:
    """What the views of evaluations show out of other tables, by evaluation, read once for all of them.

    Attributes:
        kept: completed evaluations that were shown before.
        isolation: how policies were isolated, of the others.
        differing: episodes that were run again with another record, of evaluations where who asks may see them.
        output: the end of what policies printed; nothing where many are shown.
        packages: what policies could import; nothing where many are shown.
        counts: stored episodes of those without scores.
        hidden: those of which single episodes are not shown.
        positions: places in the queue of those that have not started.
        checks: states of the checks of their sensors, where these are not over.
        ahead: episodes to be played before those that have not ended.
        mean_s: mean time that an episode of some tasks takes of a slot [s], by how many it plays at once.
    """

    kept: Mapping[UUID, EvaluationView]
    isolation: Mapping[UUID, list[str]]
    differing: Mapping[UUID, list[DifferingEpisodeView]]
    output: Mapping[UUID, str]
    packages: Mapping[UUID, list[PackagesView]]
    counts: Mapping[UUID, EpisodeCounts]
    hidden: frozenset[UUID]
    positions: Mapping[UUID, int]
    checks: Mapping[UUID, WorkState]
    ahead: Mapping[UUID, int]
    mean_s: Callable[[tuple[tuple[str, int], ...]], float | None]

    @classmethod
    def read(cls, session: Session, evaluations: Sequence[Evaluation], by: Principal, *, with_output: bool) -> Self:
        """Return what is shown of these evaluations, in as many statements for many as for one.

        Args:
            session: of the transaction.
            evaluations: which ones.
            by: who asks, and gets what may be shown to them.
            with_output: with what the policies printed and could import, which `histories` then reads with the rest.
        """
        sights = {evaluation.id: decide_sight(by, evaluation) for evaluation in evaluations}
        organized = [evaluation for evaluation in evaluations if by.organizes(evaluation.submission.competition)]
        hidden = frozenset(
            evaluation.id for evaluation in evaluations if find_shown_key(session, by, evaluation) is None
        )
        kept = {
            evaluation.id: view
            for evaluation in evaluations
            if evaluation.state is EvaluationState.COMPLETED and (view := _complete.find(_key(evaluation, hidden)))
        }
        return cls(
            kept=kept,
            isolation=isolation_levels(
                session, [evaluation for evaluation in evaluations if evaluation.id not in kept]
            ),
            differing=differing_episodes(session, organized) if organized else {},
            output={
                evaluation.id: _output(session, evaluation)
                for evaluation in evaluations
                if with_output and sights[evaluation.id].output
            },
            packages={evaluation.id: _packages(evaluation) for evaluation in evaluations} if with_output else {},
            counts=episode_counts(session, evaluations),
            hidden=hidden,
            positions=queue_positions(session, evaluations),
            checks=states_of_checks(session, evaluations),
            ahead=episodes_ahead(session, evaluations),
            mean_s=cache(lambda at_once: mean_episode_s(session, dict(at_once))),
        )


def evaluation_view(
    evaluation: Evaluation, workers: Callable[[str], WorkersAlive], rows: EvaluationRows
) -> EvaluationView:
    """Return an evaluation as it is shown.

    Args:
        evaluation: whose view.
        workers: those alive of an evaluator version.
        rows: of this evaluation among others.
    """
    view = rows.kept.get(evaluation.id)
    if view is None:
        view = _view(evaluation, workers, rows)
        if evaluation.state is EvaluationState.COMPLETED:
            _complete.keep(_key(evaluation, rows.hidden), view)
    more: dict[str, object] = {}
    if evaluation.id in rows.packages:
        more |= {"log_tail": rows.output.get(evaluation.id, ""), "packages": rows.packages[evaluation.id]}
    if evaluation.id in rows.differing:
        more["differing_episodes"] = rows.differing[evaluation.id]
    return view.model_copy(update=more) if more else view


def _key(evaluation: Evaluation, hidden: Collection[UUID]) -> tuple[UUID, bool, ListKind]:
    return evaluation.id, evaluation.id in hidden, played_list_kind(evaluation)


def _view(evaluation: Evaluation, workers: Callable[[str], WorkersAlive], rows: EvaluationRows) -> EvaluationView:
    """Return an evaluation as a list shows it to teams."""
    scores = read_scores(evaluation)
    combined, shown_scores = combine_scores(evaluation, scores), task_views(evaluation, scores)
    progress = make_progress_view(evaluation, evaluation.submission, rows.counts.get(evaluation.id, {}))
    verdict, is_hidden = verdict_view(evaluation), evaluation.id in rows.hidden
    if is_hidden:
        progress, verdict = _coarse(progress, shown_scores), _hide_details(verdict)
    return EvaluationView.from_row(
        evaluation,
        queue_position=rows.positions.get(evaluation.id),
        sensor_check=rows.checks.get(evaluation.id),
        eta_s=None if is_hidden else _seconds_to_end(evaluation, progress, workers, rows),
        progress=progress,
        verdict=verdict,
        log_tail="",
        played=played_score(counted_tasks(evaluation), scores),
        success_rate=combined.success_rate if combined else None,
        success_rate_interval=bounds(combined.interval) if combined else None,
        mean_steps=combined.mean_steps if combined else None,
        scores=shown_scores,
        practice_scores=practice_score_views(evaluation),
        counted_tasks=list(counted_tasks(evaluation)),
        isolation=rows.isolation[evaluation.id],
        packages=[],
        list_kind=played_list_kind(evaluation),
        episodes_hidden=is_hidden,
        differing_episodes=None,
    )


def summary_view(evaluation: Evaluation) -> EvaluationSummaryView:
    """Return an evaluation as a line of its submission's history."""
    return EvaluationSummaryView.from_row(evaluation)


def verdict_view(evaluation: Evaluation) -> VerdictView | None:
    """Return why an evaluation has no score; None for one that has, or that is running."""
    if evaluation.verdict_code is None:
        return None
    return VerdictView(
        code=evaluation.verdict_code,
        title=find_sentence(evaluation.verdict_code, evaluation.verdict_message or ""),
        message=evaluation.verdict_message or "",
        task=evaluation.verdict_task,
        episode=evaluation.verdict_episode,
    )


def _coarse(progress: ProgressView, scores: list[TaskScoreView]) -> ProgressView:
    """Return the progress of a sealed list as a team sees it: until the end, without when single episodes end."""
    if scores:
        return progress
    total = progress.episodes_total
    done = PROGRESS_STEPS * progress.episodes_done // total * total // PROGRESS_STEPS
    return progress.model_copy(update={"episodes_done": done, "successes": None, "tasks": []})


def _hide_details(verdict: VerdictView | None) -> VerdictView | None:
    """Return the verdict without what may repeat an observation, or say how a single episode ended."""
    if verdict is None or verdict.code in SENSOR_VERDICTS:
        return verdict
    return verdict.model_copy(update={"message": SEALED_DETAILS, "task": None, "episode": None})


def _seconds_to_end(
    evaluation: Evaluation, progress: ProgressView, workers: Callable[[str], WorkersAlive], rows: EvaluationRows
) -> float | None:
    if evaluation.state not in ACTIVE_EVALUATION_STATES:
        return None
    alive = workers(evaluation.evaluator_version)
    if not alive.slots:
        return None
    known = {task.task: known_task(evaluation.submission.track, task.task) for task in progress.tasks}
    at_once = tuple((name, task.definition.batch_size if task else 1) for name, task in known.items())
    mean_s = rows.mean_s(at_once)
    return seconds_to_end(progress, ahead=rows.ahead.get(evaluation.id, 0), slots=alive.slots, mean_s=mean_s)


def _packages(evaluation: Evaluation) -> list[PackagesView]:
    lists = [dict(sorted(seen.items())) for seen in evaluation.packages]  # the database orders them by their length
    return [PackagesView(digest=digest_of_packages(seen), versions=seen) for seen in lists]


def _output(session: Session, evaluation: Evaluation) -> str:
    """Return the output stored at the end; while it runs, the output of the last episode that the policy failed in."""
    submission = evaluation.submission
    if evaluation.state in TERMINAL_EVALUATION_STATES:
        return evaluation.log_tail
    tail = session.scalar(
        select(EpisodeResult.record["failure"]["output_tail"].astext)
        .where(
            *EpisodeKey.from_evaluation(evaluation, submission).conditions(), EpisodeResult.outcome == "policy_failed"
        )
        .order_by(EpisodeResult.created_at.desc())
        .limit(1)
    )
    return (tail or "")[-LOG_TAIL_CHARACTERS:]


def find(session: Session, evaluation_id: UUID) -> Evaluation:
    """Return the evaluation of that id.

    Raises:
        ServiceError: there is none.
    """
    evaluation = session.get(Evaluation, evaluation_id)
    if evaluation is None:
        raise not_found("evaluation", evaluation_id)
    return evaluation


def list_evaluations(
    session: Session, *conditions: ColumnElement[bool], state: EvaluationState | None = None, limit: int
) -> list[EvaluationRowView]:
    """Return the newest evaluations (in a state, on conditions), newest first."""
    query = (
        select(Evaluation, count_differing_episodes(), count_copied_episodes())
        .options(defer(Evaluation.log_tail), joinedload(Evaluation.submission).joinedload(Submission.team))
        .where(*conditions)
        .order_by(Evaluation.created_at.desc(), Evaluation.id)
        .limit(limit)
    )
    if state is not None:
        query = query.where(Evaluation.state == state)
    return [_row(evaluation, differing, copied) for evaluation, differing, copied in session.execute(query)]


def show_evaluation(session: Session, settings: Settings, evaluation_id: UUID) -> EvaluationDetailView:
    """Return an evaluation with its shards.

    Raises:
        ServiceError: there is none.
    """
    evaluation = find(session, evaluation_id)
    workers = fleet(session, settings).alive
    rows = EvaluationRows.read(session, [evaluation], CONSOLE, with_output=True)
    return EvaluationDetailView(
        **dict(evaluation_view(evaluation, workers, rows)),
        submission_id=evaluation.submission_id,
        team=evaluation.submission.team.name,
        track=evaluation.submission.track,
        shards=[_shard(shard) for shard in evaluation.shards],
    )


def _row(evaluation: Evaluation, differing: int, copied: int) -> EvaluationRowView:
    combined = combined_score(evaluation)
    return EvaluationRowView.from_row(
        evaluation,
        team=evaluation.submission.team.name,
        track=evaluation.submission.track,
        success_rate=combined.success_rate if combined else None,
        mean_steps=combined.mean_steps if combined else None,
        verdict=verdict_view(evaluation),
        differing_episodes=differing,
        copied_episodes=copied,
    )


def _shard(shard: Shard) -> ShardView:
    return ShardView.model_validate(shard, from_attributes=True)
