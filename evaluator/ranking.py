"""The one order of scores. Tracks and competitions name keys; boards, histories, receipts and pages follow."""

from collections.abc import Iterable, Mapping
from datetime import datetime
from difflib import get_close_matches
from math import inf, isfinite
from typing import Final, Protocol

from vitac.envs.tasks.definition import Better, Measure

from .strict_model import StrictModel, Word


class RankedScore(Protocol):
    """What a score has to be ranked by: of a task, or of all tasks together."""

    @property
    def success_rate(self) -> float:
        """Successes among episodes."""

    @property
    def mean_steps(self) -> float | None:
        """Mean env steps of the successes; None without one."""

    @property
    def measures(self) -> Mapping[str, float]:
        """Means of what the task measures."""


class RankingKey(StrictModel):
    """A value by which entries are compared.

    Attributes:
        name: of the value in views, receipts and files.
        title: of its column.
        unit: of the value.
        better: whether high or low values come first.
        words: what is in front, in a sentence.
    """

    name: Word
    title: str
    unit: str
    better: Better
    words: str


SUCCESS_RATE: Final = RankingKey(
    name="success_rate", title="Success rate", unit="1", better=Better.HIGH, words="higher success rate"
)
MEAN_STEPS: Final = RankingKey(
    name="mean_steps",
    title="Mean env steps",
    unit="env steps",
    better=Better.LOW,
    words="fewer mean env steps of the successful episodes",
)
SUBMITTED_AT: Final = RankingKey(
    name="submitted_at", title="Submitted", unit="s", better=Better.LOW, words="the earlier submission"
)
EVERY_SCORE_HAS: Final = (SUCCESS_RATE, MEAN_STEPS, SUBMITTED_AT)
DEFAULT_RANKING: Final = tuple(key.name for key in EVERY_SCORE_HAS)
"""Names of the keys where neither track nor competition names others."""


class Ranking(StrictModel):
    """What the entries of a board are compared by, one key after the other; the last one is `submitted_at`."""

    keys: tuple[RankingKey, ...] = EVERY_SCORE_HAS

    def values(self, score: RankedScore, submitted_at: datetime) -> dict[str, float | None]:
        """Return what an entry is ranked by, also by keys that are not of this ranking; times are since 1970 [s]."""
        return {
            **score.measures,
            SUCCESS_RATE.name: score.success_rate,
            MEAN_STEPS.name: score.mean_steps,
            SUBMITTED_AT.name: submitted_at.timestamp(),
        }

    def sort_key(self, values: Mapping[str, float | None]) -> tuple[float, ...]:
        """Return what sorts entries, the best first; a value that is missing or not finite comes last."""
        return tuple(_low_first(key.better, values.get(key.name)) for key in self.keys)

    @property
    def compared_first(self) -> RankingKey:
        """What plots show: the first key, or the success rate where the date comes first."""
        return SUCCESS_RATE if self.keys[0] == SUBMITTED_AT else self.keys[0]

    def describe_first(self, values: Mapping[str, float | None]) -> str:
        """Return what is compared first with its value, such as "success rate: 75.0 %"."""
        key = self.compared_first
        value, title = values.get(key.name), f"{key.title[0].lower()}{key.title[1:]}"
        if value is None:
            return f"{title}: none"
        return f"{title}: {100 * value:.1f} %" if key == SUCCESS_RATE else f"{title}: {value:.3g}"

    @property
    def measures(self) -> tuple[RankingKey, ...]:
        """The keys that not every score has."""
        return tuple(key for key in self.keys if key not in EVERY_SCORE_HAS)

    @property
    def sentence(self) -> str:
        """The order in words."""
        return f"First comes {'; then '.join(key.words for key in self.keys)}."


def make_ranking(names: Iterable[str], measures: Iterable[Measure] = ()) -> Ranking:
    """Return the ranking by keys of these names.

    Args:
        names: of keys that every score has, or of measures that say which values are better.
        measures: of the task; of several tasks, those that all of them have.

    Raises:
        ValueError: there is no such key, one is named twice, or the last one is not `submitted_at`.
    """
    named = tuple(names)
    known = {key.name: key for key in EVERY_SCORE_HAS}
    known |= {measure.name: _make_key(measure, measure.better) for measure in measures if measure.better is not None}
    for number, name in enumerate(named):
        if name not in known:
            meant = "".join(f"; did you mean {near}?" for near in get_close_matches(name, known, n=1))
            raise ValueError(f"ranking has {name!r:.80}, expected some of {', '.join(known)}{meant}")
        if name in named[:number]:
            raise ValueError(f"ranking names {name} twice")
    if not named or named[-1] != SUBMITTED_AT.name:
        raise ValueError("ranking must end with submitted_at, which decides between equal scores")
    return Ranking(keys=tuple(known[name] for name in named))


def _make_key(measure: Measure, better: Better) -> RankingKey:
    words = f"{'higher' if better is Better.HIGH else 'lower'} {measure.meaning}"
    title = measure.label.capitalize() + (f" [{measure.unit}]" if measure.unit != "1" else "")
    return RankingKey(name=measure.name, title=title, unit=measure.unit, better=better, words=words)


def _low_first(better: Better, value: float | None) -> float:
    if value is None or not isfinite(value):
        return inf
    return -value if better is Better.HIGH else value
