"""What a task says of itself without being run: names, actions, observables, measures, ends, where its parts lie."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from inspect import cleandoc
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..observable import Observable
from ..scene.observables import JOINT_WIDTH, TAXEL_FORCES, WRIST_WRENCH
from ..vision.observables import RGB_IMAGES
from .quantities import Quantity

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

InfoView = Mapping[str, Any]


class Family(StrEnum):
    """Environments that need the same packages; a worker says which families it can run."""

    TACTILE = "tactile"
    """Our own, on the tactile simulation."""
    MANISKILL = "maniskill"
    """ManiSkill's on the CPU, with its extra."""
    MANISKILL_PICTURES = "maniskill-pictures"
    """ManiSkill's on the CPU with cameras, with its extra and a Vulkan driver."""
    MANISKILL_CUDA = "maniskill-cuda"
    """ManiSkill's on a GPU, with its extra, CUDA and a torch that has it."""
    STATION = "station"
    """Tasks that are played on the devices of a laboratory, which has an agent in place of a worker."""


@dataclass(frozen=True, kw_only=True)
class ActionComponent:
    """One number of an action, in [-1, 1].

    Attributes:
        name: of the number.
        scale: motion at 1, in `unit`.
        unit: of the motion.
        meaning: what moves, and which way.
    """

    name: str
    scale: float
    unit: str
    meaning: str


class Better(StrEnum):
    """Which values are in front where entries are compared."""

    HIGH = "high"
    LOW = "low"


@dataclass(frozen=True, kw_only=True)
class Measure:
    """Quantities in an info: reports of re-simulations show them, and boards may rank by them.

    A board compares the mean over all episodes of the largest one after the last env step.

    Attributes:
        name: key in reports, scores and rankings.
        label: short name for a column.
        meaning: what is measured, within a sentence.
        unit: of each quantity.
        needs: entries of the info that it is read from.
        read: gives the quantities from an info that has these entries.
        better: which values are in front; None where no board may rank by it.
        of_no_env_step: quantity of an episode that ended before its first env step; None where there is none to say,
            and then its submission has no mean.
    """

    name: str
    label: str
    meaning: str
    unit: str
    needs: tuple[str, ...]
    read: Callable[[InfoView], tuple[float, ...]]
    better: Better | None = None
    of_no_env_step: float | None = None

    def read_end(self, info: InfoView | None) -> float | None:
        """Return the largest quantity in the info of an episode's last env step; None where it has none.

        Args:
            info: None if the episode ended before its first env step.
        """
        if info is None:
            return self.of_no_env_step
        if not all(key in info for key in self.needs):
            return None
        return max(self.read(info), default=None)


@dataclass(frozen=True, kw_only=True)
class TaskDefinition:
    """A task, as code outside its own folder needs to know it; nothing here imports the simulation.

    Places are given as `package.module:NAME` and imported when they are needed.

    Attributes:
        env_id: registered id of its environment.
        environment: place of the environment's class.
        actions: numbers of an action, in order.
        observables: entries of the observation, in the order in which they are read.
        optional_observables: what a track file or an environment's argument may add to them, by name.
        measures: what reports of re-simulations show of it, and boards may rank by.
        methods: settings of what measures for an observation, as dataclasses; part of a track's digest.
        perspective: place of the `Perspective` it is drawn from; None where it is not drawn.
        guided_motion: place of the `NextAction` that goes to its target; None where there is none.
        can_go_back: whether what went too far can be taken back; where not, a clone of who plays by `guided_motion`
            learns to go short of it.
        guides_exactly: whether the guided motion is what an env step has to do, not the way that is left: then a clone
            learns it as it is, else half as much again.
        family: what it needs to run.
        control_mode: what an action moves, by the environment's own name; None where there is one way only.
        repeats: whether the same actions give the same states to the last bit; a log is verified within tolerance
            where they do not.
        pictures_repeat: whether the pictures of the observation are the same to the last bit on every machine.
        batch_size: number of episodes of a shard that are played at once, in one simulation.
        accepts_start: place of a function that says of a shape and a drawn offset whether an episode may start there;
            None where it may anywhere.
        quantities: what a track file may draw for every episode.
        start_labels: how pages say where an episode starts: a text for each number of a start, with {} in its place. By
            default these are x, y and z [mm] or, where an action turns the part, x, y [mm] and its angle [deg].
        info_lengths: numbers of those entries of an info that have more for some shapes than for others, at most.
    """

    env_id: str
    environment: str
    actions: tuple[ActionComponent, ...]
    observables: tuple[Observable[Any], ...]
    optional_observables: tuple[Observable[Any], ...] = ()
    measures: tuple[Measure, ...] = ()
    methods: tuple["DataclassInstance", ...] = ()
    perspective: str | None = None
    guided_motion: str | None = None
    can_go_back: bool = True
    guides_exactly: bool = False
    family: Family = Family.TACTILE
    control_mode: str | None = None
    repeats: bool = True
    pictures_repeat: bool = True
    batch_size: int = 1
    accepts_start: str | None = None
    quantities: tuple[Quantity, ...] = ()
    start_labels: tuple[str, ...] = ()
    info_lengths: Mapping[str, int] = field(default_factory=dict)

    @property
    def action_scale(self) -> tuple[float, ...]:
        """Motion at an action of 1, in the units of the actions."""
        return tuple(component.scale for component in self.actions)

    @property
    def public_observables(self) -> tuple[Observable[Any], ...]:
        """Return what a policy sees in an evaluation."""
        return tuple(observable for observable in self.observables if not observable.privileged)

    def with_optional(self, keys: Collection[str]) -> "TaskDefinition":
        """Return the task that also observes what is optional and has these keys.

        Raises:
            UnknownObservationKey: it has no such optional observable.
        """
        if not keys:
            return self
        added = chosen_observables(self.optional_observables, keys)
        return replace(self, observables=(*self.observables, *added), optional_observables=())


class UnknownObservationKey(VitacError):
    """A key was asked for that the task does not have, or is privileged; the message lists those that it has."""


def chosen_observables(listed: Sequence[Observable[Any]], keys: Collection[str]) -> tuple[Observable[Any], ...]:
    """Return the observables with these keys, in the order of the list.

    Raises:
        UnknownObservationKey: one is not in the list.
    """
    names = [entry.name for entry in listed]
    unknown = sorted(set(keys) - set(names))
    if unknown:
        expected = ", ".join(names) or "none"
        raise UnknownObservationKey(f"There is no observation key {unknown[0]!r:.80}; expected {expected}.")
    return tuple(entry for entry in listed if entry.name in keys)


def append_tables(docstring: str, task: TaskDefinition) -> str:
    """Return the docstring of an environment with the tables of its actions and observations at the end."""
    actions = [
        f"| {index} | {component.name} | {component.scale:g} {component.unit} | {component.meaning} |"
        for index, component in enumerate(task.actions)
    ]
    observations = [
        f"| {entry.name} | {entry.shape} | {entry.dtype} | {entry.unit} | {_meaning(entry, task)} |"
        for entry in (*task.observables, *task.optional_observables)
    ]
    return "\n".join(
        [
            cleandoc(docstring),
            "",
            f"Action space: `Box(-1, 1, ({len(task.actions)},), float32)`",
            "",
            "| index | name | at 1 | meaning |",
            "|---|---|---|---|",
            *actions,
            "",
            "Observation space: `Dict`",
            "",
            "| key | shape | type | unit | meaning |",
            "|---|---|---|---|---|",
            *observations,
            "",
        ]
    )


def _meaning(observable: Observable[Any], task: TaskDefinition) -> str:
    if observable in task.optional_observables:
        return f"{observable.meaning} **Only where `optional_observables` names it.**"
    return f"{observable.meaning} **Only with `privileged=True`.**" if observable.privileged else observable.meaning


OPTIONAL_SENSORS: tuple[Observable[Any], ...] = (RGB_IMAGES, JOINT_WIDTH, WRIST_WRENCH, TAXEL_FORCES)
"""What any task of a gripper with two gels can observe besides: a track file or an environment's argument names it."""

SURFACE_DIFF = Measure(
    name="surface_diff_mm",
    label="surface",
    meaning="mean motion of a sensing surface since the grasp",
    unit="mm",
    needs=("surface_diff_m",),
    read=lambda info: tuple(1000 * value for value in info["surface_diff_m"]),
    better=Better.LOW,
)
"""Mean motion of the left and the right sensing surface since the grasp [mm]."""


# Mean motion of a sensing surface that raises `tactile_movement_too_large`.
LARGEST_SURFACE_DIFF_M = 1.5e-3


class EndReason(StrEnum):
    """Why an episode ended; where several hold, the first of them in this order is given."""

    NOT_CONVERGED = "not_converged"  # the physics found no solution; nothing moves from then on
    SUCCESS = "success"  # the goal is reached
    FORCE = "force"  # the force on the held part was above the limit, where a task has one
    TACTILE = "tactile"  # a sensing surface moved too far
    ERROR = "error"  # the gripper or the part left its range
    STEPS = "steps"  # the env steps are used up


@dataclass(frozen=True, kw_only=True)
class Flags:
    """Flags of an env step; several can be raised at once. What success asks of the others is the task's to say."""

    force_too_large: bool = False
    tactile_movement_too_large: bool = False
    error_too_large: bool = False
    too_many_steps: bool = False
    is_success: bool = False

    @property
    def failure(self) -> EndReason | None:
        """The flag that cuts the episode off, if any: force before tactile before error before steps."""
        if self.force_too_large:
            return EndReason.FORCE
        if self.tactile_movement_too_large:
            return EndReason.TACTILE
        if self.error_too_large:
            return EndReason.ERROR
        return EndReason.STEPS if self.too_many_steps else None

    @property
    def has_failed(self) -> bool:
        """Whether the episode is cut off by more than the end of its env steps."""
        return self.force_too_large or self.tactile_movement_too_large or self.error_too_large


def surface_moved_too_far(surface_diff_m: NDArray[np.float64]) -> bool:
    """Return whether the mean motion of a sensing surface since the grasp [m], shape [2], is more than allowed."""
    return bool((surface_diff_m > LARGEST_SURFACE_DIFF_M).any())
