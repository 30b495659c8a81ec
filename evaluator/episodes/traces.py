"""What is followed while an episode is played: its contact forces, and the env step whose pictures its record names.

A record holds forces beside what its result hash covers: they follow from the same states.

The step of the pictures is the one with the smallest ticket, the SHA-256 of the list's seed, the episode's number and
the state hash. Every state thus has the same chance, nobody knows the step before the episode is over, and another step
means other states.
"""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from math import ceil, fsum, sqrt
from typing import TYPE_CHECKING, Any, Final, Protocol

from ..tracks import Episode
from .records import ContactForces, ForceFigures, SampledPicture

if TYPE_CHECKING:
    from vitac.envs.fem.scene.report import StepReport

OVER_FORCE_N: Final = 40.0
"""Force on the held part above which an event counts where the task has no limit: about 1.5 times the median peak of
the heuristic for the peg."""
_HIGH = 0.95
"""Part of the IPC steps whose force is no higher than the 95th percentile."""


@dataclass(kw_only=True)
class ForceTrace:
    """The solved IPC steps of the env steps of an episode so far."""

    over_force_n: float = OVER_FORCE_N
    reports: "list[StepReport]" = field(default_factory=list)

    def add(self, info: Mapping[str, Any]) -> None:
        """Take the info of an env step into account; one of other physics reports no IPC steps."""
        self.over_force_n = info.get("force_limit_n", OVER_FORCE_N)
        self.reports += [report for report in info.get("step_reports", ()) if report.status != "not_converged"]

    def figures(self) -> ContactForces | None:
        """Return what a record holds of the episode; None where no IPC step was reported."""
        if not self.reports:
            return None
        part_n = [report.part_force_n for report in self.reports]
        times_s = [report.time_step_s for report in self.reports]
        left_n, right_n = ([_size(report.gel_forces_n[side]) for report in self.reports] for side in (0, 1))
        return ContactForces(
            part=summarize_force(part_n, times_s),
            gels=(summarize_force(left_n, times_s), summarize_force(right_n, times_s)),
            over_force_n=self.over_force_n,
            over_force_events=count_over_force(part_n, self.over_force_n),
            largest_stretch=max(report.largest_stretch for report in self.reports),
            high_stretch=max(report.high_stretch for report in self.reports),
        )


def count_over_force(forces_n: Iterable[float], limit_n: float) -> int:
    """Return in how many runs of consecutive sizes [N] a force is above a limit [N]."""
    return sum(is_over for is_over, _ in groupby(force > limit_n for force in forces_n))


def summarize_force(forces_n: Sequence[float], times_s: Iterable[float]) -> ForceFigures:
    """Return the figures of a force from its sizes [N], each of which lasts for a time [s]; at least one."""
    ordered = sorted(forces_n)
    impulse_n_s = fsum(force * time for force, time in zip(forces_n, times_s, strict=True))
    return ForceFigures(peak_n=ordered[-1], p95_n=ordered[ceil(_HIGH * len(ordered)) - 1], impulse_n_s=impulse_n_s)


def _size(force_n: Sequence[float]) -> float:
    x, y, z = force_n
    return sqrt(x * x + y * y + z * z)


class HasPictures(Protocol):
    """What pictures are taken of: an environment."""

    def state_hash(self) -> str:
        """Return the SHA-256 [hex] of the physical state."""

    def picture_hash(self) -> str | None:
        """Return the SHA-256 [hex] of what the task's cameras see now; None where it has none."""


class PictureSample:
    """Follows an episode; hashes pictures only where a ticket is smaller than all before: about 4 times in 25 steps.

    Attributes:
        picture: those of the env step with the smallest ticket so far; None where the task has no cameras.
    """

    def __init__(self, env: HasPictures, episode: Episode) -> None:
        self._env = env
        self._episode = f"{episode.list_seed} {episode.number}"
        self._smallest: str | None = None
        self.picture: SampledPicture | None = None

    def look(self, env_step: int) -> str:
        """Take the state after an env step, or after the reset (0), into account, and return its hash."""
        state_hash = self._env.state_hash()
        ticket = hashlib.sha256(f"{self._episode} {state_hash}".encode()).hexdigest()
        if self._smallest is None or ticket < self._smallest:
            self._smallest = ticket
            pictures = self._env.picture_hash()
            self.picture = None if pictures is None else SampledPicture(env_step=env_step, sha256=pictures)
        return state_hash
