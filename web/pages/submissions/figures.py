"""The plots of a submission's page. Called by `submissions`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.server.database.states import EvaluationState
from vitac.server.views.leaderboards import PastResultView
from vitac.server.views.scores import TaskScoreView
from vitac.server.views.submissions import EpisodeView, SubmissionView

from ...plots.axis import Figure
from ...plots.dates import DatedValue, values_by_date
from ...plots.draws import peak_forces, success_by_draw
from ...plots.episodes import count_outcomes, offset_maps, steps_histogram, success_by_shape
from ...site import Site


@dataclass(frozen=True, kw_only=True)
class TaskFigures:
    """The plots of one task.

    Attributes:
        title: of the task.
        maps: outcomes by start offset, one for each shape.
        outcomes: those in the maps.
        draws: success against each drawn quantity.
        figures: the others.
    """

    title: str
    maps: Sequence[Figure]
    outcomes: Sequence[EpisodeOutcome]
    draws: Sequence[Figure]
    figures: Sequence[Figure]


def figures(
    site: Site,
    view: SubmissionView,
    titles: dict[str, str],
    episodes: Sequence[EpisodeView],
    past: Sequence[PastResultView],
) -> dict[str, Any]:
    """Return the plots of a complete evaluation, and those of the team's submissions until now.

    The first never change for somebody who sees the same episodes; the others change with the next result of the team.
    """
    if view.evaluation.state is not EvaluationState.COMPLETED:
        return {"plots": (), "history": ()}
    reached = tuple((result.task, result.submission_id, result.value) for result in past)
    return {
        "plots": site.plots.get(
            (view.evaluation.id, len(episodes)),
            lambda: [_draw_task(view, score, titles[score.task], episodes) for score in view.evaluation.scores],
        ),
        "history": site.plots.get((view.id, reached), lambda: _histories(view, titles, past)),
    }


def list_figures(drawn: Mapping[str, Any]) -> list[Figure]:
    """Return all plots that `figures` has made."""
    tasks: Sequence[TaskFigures] = drawn["plots"]
    return [*(each for task in tasks for each in (*task.maps, *task.figures, *task.draws)), *drawn["history"]]


def _draw_task(view: SubmissionView, score: TaskScoreView, title: str, episodes: Sequence[EpisodeView]) -> TaskFigures:
    ends = [end for end in episodes if end.task == score.task]
    # A stage's own list has other starts than the track file, from which the map takes them.
    known = view.evaluation.commitment is None
    return TaskFigures(
        title=title,
        maps=offset_maps(view.track, score.task, {end.episode: end for end in ends}) if known else (),
        outcomes=count_outcomes(ends),
        draws=success_by_draw(view.track, score.task, ends),
        figures=(success_by_shape(score), *_figures_of_episodes(score.task, ends)),
    )


def _figures_of_episodes(task: str, ends: Sequence[EpisodeView]) -> list[Figure]:
    forces = peak_forces(task, ends)
    return [*([steps_histogram(task, ends)] if ends else []), *([forces] if forces else [])]


def _histories(view: SubmissionView, titles: dict[str, str], past: Sequence[PastResultView]) -> list[Figure]:
    """Return the history of the team in each task in which it has more than one result."""
    shown = []
    for task in view.tasks:
        results = [(result, result.value) for result in past if result.task == task and result.value is not None]
        points = [
            DatedValue(
                name=result.submission_name,
                at=result.submitted_at,
                value=value,
                own=result.submission_id == view.id,
            )
            for result, value in results
        ]
        if len(points) > 1:
            shown.append(values_by_date(f"history-{task}", titles[task], points, results[0][0].ranked_by))
    return shown
