"""The plots of a submission's page. Called by `submissions`."""

from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup
from starlette.requests import Request
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.server.views.leaderboards import PastResultView
from vitac.server.views.scores import TaskScoreView
from vitac.server.views.submissions import EpisodeView, SubmissionView

from ...plots.dates import DatedRate, rates_by_date
from ...plots.episodes import count_outcomes, offset_maps, steps_histogram, success_by_shape
from ...plots.figure import Figure
from ...rendering import render
from ...site import site_of


@dataclass(frozen=True, kw_only=True)
class TaskFigures:
    """The plots of one task.

    Attributes:
        title: of the task.
        maps: outcomes by start offset, one for each shape.
        outcomes: those in the maps.
        figures: the others.
    """

    title: str
    maps: Sequence[Figure]
    outcomes: Sequence[EpisodeOutcome]
    figures: Sequence[Figure]


def episode_figures(
    request: Request, found: SubmissionView, titles: dict[str, str], episodes: Sequence[EpisodeView]
) -> Markup:
    """Return the plots of a complete evaluation, which never change for somebody who sees the same episodes of it."""

    def make() -> str:
        tasks = [_of_task(found, score, titles[score.task], episodes) for score in found.evaluation.scores]
        return render("episode_figures.html", request, tasks=tasks)

    return site_of(request).plots.get((found.evaluation.id, len(episodes)), make)


def _of_task(found: SubmissionView, score: TaskScoreView, title: str, episodes: Sequence[EpisodeView]) -> TaskFigures:
    ends = [end for end in episodes if end.task == score.task]
    # A stage's own list has other starts than the track file, from which the map takes them.
    known = found.evaluation.commitment is None
    return TaskFigures(
        title=title,
        maps=offset_maps(found.track, score.task, {end.episode: end for end in ends}) if known else (),
        outcomes=count_outcomes(ends),
        figures=(success_by_shape(score), *([steps_histogram(score.task, ends)] if ends else [])),
    )


def history_figures(
    request: Request, found: SubmissionView, titles: dict[str, str], past: Sequence[PastResultView]
) -> Markup:
    """Return the history of the team in each task in which it has more than one result, cached until it has another."""

    def make() -> str:
        figures = _histories(found, titles, past)
        return render("history_figures.html", request, submission=found, figures=figures) if figures else ""

    reached = tuple((result.task, result.submission_id, result.success_rate) for result in past)
    return site_of(request).plots.get((found.id, reached), make)


def _histories(found: SubmissionView, titles: dict[str, str], past: Sequence[PastResultView]) -> list[Figure]:
    figures = []
    for task in found.tasks:
        rates = [
            DatedRate(
                name=result.submission_name,
                at=result.submitted_at,
                success_rate=result.success_rate,
                own=result.submission_id == found.id,
            )
            for result in past
            if result.task == task
        ]
        if len(rates) > 1:
            figures.append(rates_by_date(f"history-{task}", titles[task], rates))
    return figures
