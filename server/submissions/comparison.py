"""Results beside each other; called by the API and the pages.

Of a submission that somebody may not see, what a leaderboard shows of it is compared: its scores, no episodes.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from math import hypot
from uuid import UUID

from sqlalchemy.orm import Session
from vitac.envs.tasks.definition import Family
from vitac.evaluator.scoring.comparison import Comparison, NothingToCompare, adjust_p_values, compare_tasks
from vitac.evaluator.scoring.score import rate_by_start
from vitac.evaluator.scoring.starts import find_start

from ..database.models import Submission
from ..errors import ProblemCode, ServiceError
from ..evaluations.history import newest_evaluation
from ..leaderboards.public_pages import readable
from ..leaderboards.reading import shown_leaderboard
from ..principals import Principal
from ..settings import Settings
from ..tracks import find_family, known_task
from ..views.comparisons import (
    ComparedEndView,
    ComparedEpisodeView,
    ComparedGroupView,
    ComparedPairView,
    ComparedResultView,
    ComparisonView,
)
from ..views.leaderboards import LeaderboardEntryView
from ..views.scores import RateView, ShapeScoreView, TaskScoreView
from ..views.submissions import EpisodeView, SubmissionView
from . import listing

MAX_COMPARED = 8
QUARTERS = ("nearest starts", "near starts", "far starts", "farthest starts")
"""Episodes by the distance of their start from the target, as names of four groups of starts."""


@dataclass(frozen=True, kw_only=True)
class ComparedResult:
    """One of the results, with the episodes that are shown of it.

    Attributes:
        view: the result.
        episodes: how they ended; empty where single episodes are not shown.
        commitment: of the list that it played; None: the track file's own.
    """

    view: ComparedResultView
    episodes: Sequence[EpisodeView] = ()
    commitment: str | None = None

    def plays_same_list(self, other: "ComparedResult") -> bool:
        """Return whether an episode of both with one number is the same one."""
        return (self.view.track, self.commitment) == (other.view.track, other.commitment)


def compare_results(session: Session, settings: Settings, by: Principal, ids: Sequence[UUID]) -> ComparisonView:
    """Return some results beside each other, in their order.

    Args:
        session: of the transaction.
        settings: of this process.
        by: who reads it.
        ids: of the submissions.

    Raises:
        ServiceError: there is a submission that they may not see and that is on no leaderboard, or there are too many.
    """
    wanted = tuple(dict.fromkeys(ids))
    if len(wanted) > MAX_COMPARED:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"Expected at most {MAX_COMPARED} submissions to compare, got {len(wanted)}. Leave some out.",
        )
    return make_comparison([_read_side(session, settings, by, submission_id) for submission_id in wanted])


def _read_side(session: Session, settings: Settings, by: Principal, submission_id: UUID) -> ComparedResult:
    try:
        submission = readable(session, by, submission_id)
    except ServiceError:
        hidden = session.get(Submission, submission_id)
        entry = _find_entry(session, by, hidden) if hidden else None
        if hidden is None or entry is None:
            raise
        return ComparedResult(view=ComparedResultView.from_row(entry, track=hidden.track, has_page=False, episodes=0))
    view = listing.get(session, settings, by, submission.id)
    return make_side(view, listing.list_episodes(session, by, newest_evaluation(session, submission)))


def make_side(submission: SubmissionView, episodes: Sequence[EpisodeView]) -> ComparedResult:
    """Return a submission that the reader may see."""
    view = ComparedResultView.from_row(
        submission.evaluation,
        submission_id=submission.id,
        submission_name=submission.name,
        team=submission.team.name,
        track=submission.track,
        submitted_at=submission.submitted_at,
        has_page=True,
        episodes=len(episodes),
    )
    return ComparedResult(view=view, episodes=episodes, commitment=submission.evaluation.commitment)


def _find_entry(session: Session, by: Principal, submission: Submission) -> LeaderboardEntryView | None:
    """Return the entry of a submission on a leaderboard that everybody sees; None where it is on none."""
    for task in (None, *submission.tasks):
        if task is None or known_task(submission.track, task):
            board = shown_leaderboard(
                session,
                by,
                submission.track,
                task=task,
                stage=submission.stage or None,
                competition=submission.competition or None,
            ).view
            own = next((entry for entry in board.entries if entry.submission_id == submission.id), None)
            if own is not None:
                return own
    return None


def make_comparison(sides: Sequence[ComparedResult]) -> ComparisonView:
    """Return some results beside each other."""
    return ComparisonView(
        results=[side.view for side in sides],
        groups=[*_group_by_shape(sides), *_group_by_difficulty(sides)],
        pairs=list(_pairs(sides)),
        differing=list(_differing(sides)),
    )


def _group_by_shape(sides: Sequence[ComparedResult]) -> Iterator[ComparedGroupView]:
    scores = [{score.task: score for score in side.view.scores} for side in sides]
    for task in dict.fromkeys(task for by_task in scores for task in by_task):
        shapes = [_shapes(by_task.get(task)) for by_task in scores]
        for shape in dict.fromkeys(name for by_shape in shapes for name in by_shape):
            rates = [RateView.from_row(by_shape[shape]) if shape in by_shape else None for by_shape in shapes]
            yield ComparedGroupView(task=task, name=shape, is_shape=True, rates=rates)


def _shapes(score: TaskScoreView | None) -> Mapping[str, ShapeScoreView]:
    return {part.shape: part for part in score.shapes} if score else {}


def _group_by_difficulty(sides: Sequence[ComparedResult]) -> Iterator[ComparedGroupView]:
    """Yield the rates among four groups of starts, where these are the track file's, and known."""
    known = [side for side in sides if side.episodes and side.commitment is None]
    named = dict.fromkeys((side.view.track, end.task) for side in known for end in side.episodes)
    for track, task in named:
        quarters = quarters_of_starts(track, task)
        for quarter, name in enumerate(QUARTERS if quarters else ()):
            rates = [
                _rate_among(side, task, quarters, quarter) if side in known and side.view.track == track else None
                for side in sides
            ]
            if any(rates):
                yield ComparedGroupView(task=task, name=name, is_shape=False, rates=rates)


def _rate_among(side: ComparedResult, task: str, quarters: Mapping[int, int], quarter: int) -> RateView | None:
    ends = [end for end in side.episodes if end.task == task and quarters.get(end.episode) == quarter]
    if not ends:
        return None
    counted = rate_by_start((find_start(end), end.success) for end in ends)
    return RateView.from_row(counted, success_rate_interval=(counted.interval.low, counted.interval.high))


@cache
def quarters_of_starts(track: str, task: str) -> Mapping[int, int]:
    """Return in which quarter of the starts each episode is, by number: 0 for those nearest to their targets.

    The distance is that of the offset, each component relative to the largest in the list. Empty for tasks whose starts
    are no offsets.
    """
    definition = known_task(track, task)
    if definition is None or find_family(track, task) is not Family.TACTILE:
        return {}
    starts = {episode.offset for episode in definition.episodes}
    largest = [max(abs(start[place]) for start in starts) or 1.0 for place in range(len(next(iter(starts))))]
    distances = {start: hypot(*(value / most for value, most in zip(start, largest, strict=True))) for start in starts}
    ordered = sorted(starts, key=lambda start: (distances[start], start))
    quarter = {start: len(QUARTERS) * place // len(ordered) for place, start in enumerate(ordered)}
    return {episode.number: quarter[episode.offset] for episode in definition.episodes}


def _pairs(sides: Sequence[ComparedResult]) -> Iterator[ComparedPairView]:
    """Yield the pairs of each task, whose p-values are adjusted for their number."""
    by_task: dict[str, list[tuple[int, int, Comparison]]] = {}
    for (first, ours), (second, theirs) in combinations(enumerate(sides), 2):
        if not ours.plays_same_list(theirs):
            continue
        try:
            compared = compare_tasks(ours.episodes, theirs.episodes)
        except NothingToCompare:
            continue
        for task, comparison in compared.items():
            by_task.setdefault(task, []).append((first, second, comparison))
    for task, pairs in by_task.items():
        adjusted = adjust_p_values([comparison.p_value for _, _, comparison in pairs])
        for (first, second, comparison), p_value in zip(pairs, adjusted, strict=True):
            yield ComparedPairView.from_row(
                comparison,
                task=task,
                first=first,
                second=second,
                starts=len(comparison.by_start),
                difference_interval=comparison.interval,
                adjusted_p_value=p_value,
            )


def _differing(sides: Sequence[ComparedResult]) -> Iterator[ComparedEpisodeView]:
    """Yield the episodes that some solve and others do not, of those on the list of the first that shows any."""
    first = next((side for side in sides if side.episodes), None)
    if first is None:
        return
    ends = [
        {(end.task, end.episode): end for end in side.episodes} if side.plays_same_list(first) else {} for side in sides
    ]
    for task, number in sorted({key for by_key in ends for key in by_key}):
        played = [by_key.get((task, number)) for by_key in ends]
        shown = [end for end in played if end is not None]
        if len({end.success for end in shown}) > 1:
            yield ComparedEpisodeView(
                task=task,
                episode=number,
                shape=shown[0].shape,
                ends=[ComparedEndView.from_row(end) if end is not None else None for end in played],
            )
