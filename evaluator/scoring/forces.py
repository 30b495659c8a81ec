"""Contact forces of an evaluation: medians over its episodes; part of its score, but never of a ranking."""

from collections.abc import Iterable, Sequence
from statistics import median

from pydantic import NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt

from ..episodes.records import ContactForces, ForceFigures
from ..strict_model import StrictModel


class ForceSummary(StrictModel):
    """Medians over the episodes whose records have forces, of the gel by its more loaded side in each episode.

    `over_force_events` is the sum over all of them, `over_force_episodes` the number of those that have any.
    """

    episodes: PositiveInt
    part: ForceFigures
    gel: ForceFigures
    over_force_n: PositiveFloat
    over_force_events: NonNegativeInt
    over_force_episodes: NonNegativeInt
    largest_stretch: NonNegativeFloat
    high_stretch: NonNegativeFloat


def summarize_forces(forces: Iterable[ContactForces | None]) -> ForceSummary | None:
    """Return the forces of an evaluation; None where no record has any."""
    found = [each for each in forces if each is not None]
    if not found:
        return None
    events = [each.over_force_events for each in found]
    return ForceSummary(
        episodes=len(found),
        part=_medians([[each.part] for each in found]),
        gel=_medians([each.gels for each in found]),
        over_force_n=found[0].over_force_n,
        over_force_events=sum(events),
        over_force_episodes=sum(map(bool, events)),
        largest_stretch=median(each.largest_stretch for each in found),
        high_stretch=median(each.high_stretch for each in found),
    )


def _medians(figures: Sequence[Sequence[ForceFigures]]) -> ForceFigures:
    """Return the median over episodes of each figure, of the largest where an episode has several."""
    return ForceFigures(
        **{
            name: median(max(getattr(each, name) for each in of_episode) for of_episode in figures)
            for name in ForceFigures.model_fields
        }
    )
