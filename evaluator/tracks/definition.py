"""Tracks, tasks and episodes as YAML files define them, and how lists are cut into shards."""

import hashlib
import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from functools import cached_property
from itertools import product
from typing import Any, Final, Self

from pydantic import Field, PositiveInt, model_validator
from vitac.envs.maniskill.definition import find_definition, is_maniskill
from vitac.envs.observable import Observable
from vitac.envs.tasks.definition import ActionComponent, Family, TaskDefinition
from vitac.envs.tasks.quantities import Quantity, check_draws
from vitac.envs.tasks.registry import task_definitions
from vitac.envs.tasks.settings import FIDELITY, Fidelity
from vitac.errors import VitacError

from ..package_sets import PackageSet
from ..ranking import DEFAULT_RANKING, Ranking, make_ranking
from ..strict_model import StrictModel, Word
from ..submission_kinds import SubmissionKind


class UnknownEnvironment(VitacError):
    """No environment has this id; the message lists those that there are."""


def environment_definition(env_id: str, settings: Mapping[str, Any]) -> TaskDefinition:
    """Return what is known of an environment, with settings that a track file gives.

    Raises:
        UnknownEnvironment: there is none of that id.
        VitacError: it cannot be a task with these settings.
    """
    if is_maniskill(env_id):
        return find_definition(env_id, settings)
    if env_id not in task_definitions():
        raise UnknownEnvironment(f"env_id is {env_id!r}, expected one of {', '.join(sorted(task_definitions()))}.")
    return task_definitions()[env_id]


TEXT_LOG_PROFILE: Final = "challenge-2025-log"
"""Name of the profile with the settings under which a task's 2025 text logs were made."""


DRAWN: Final = "drawn"
"""Shape of a start that is drawn from the episode's seed, as ManiSkill's are; no two episodes share one."""


class UnknownTask(VitacError):
    """The track has no such task; the message lists those that exist."""


class ListKind(StrEnum):
    """Who can know an episode list."""

    PUBLIC = "public"
    """Everybody; a policy can recognise its episodes by their first observation."""
    SEALED = "sealed"
    """Whoever has its secret."""


class Player(StrEnum):
    """Who chooses the actions in a task."""

    POLICY = "policy"
    """The team's own policy."""
    ESTIMATOR = "estimator"
    """The standard estimator of ours, calibrated to the team's sensor."""
    BLIND = "blind"
    """The standard estimator with all markers at rest."""


_DELAY_STEPS_MAX: Final = 16


class WhileThinking(StrEnum):
    """What the robot does in the env steps that pass while a policy thinks."""

    STOP = "stop"
    """Nothing: an action of zeros."""
    HOLD = "hold"
    """The action before, again; zeros before the first."""


class Start(StrictModel):
    """Where an episode starts: what is played with, and where it stands in the units of the list's `offset_option`."""

    shape: Word
    offset: tuple[float, ...] = Field(min_length=1)


class EpisodeBlock(StrictModel):
    """Starts that are played one after the other, the whole block `repeats` times.

    A file may give `shapes` and `offsets` in place of `starts`: every shape at the first offset, then at the second.
    """

    repeats: PositiveInt = 1
    starts: tuple[Start, ...] = Field(min_length=1)

    @model_validator(mode="before")
    @classmethod
    def _every_shape_at_every_offset(cls, content: Any) -> Any:
        if not isinstance(content, dict) or not {"shapes", "offsets"} <= content.keys() or "starts" in content:
            return content
        shapes, offsets = content["shapes"], content["offsets"]
        if not isinstance(shapes, list) or not isinstance(offsets, list):
            raise ValueError("expected lists of shapes and offsets")
        own = {key: value for key, value in content.items() if key not in {"shapes", "offsets"}}
        return own | {"starts": [{"shape": shape, "offset": offset} for offset, shape in product(offsets, shapes)]}


class EpisodeList(StrictModel):
    """A fixed list of starts: block after block."""

    list_seed: int = Field(ge=0)
    offset_option: Word
    blocks: tuple[EpisodeBlock, ...] = Field(min_length=1)
    commitment: Word | None = Field(default=None, description="Of the secret of a sealed list (`tracks.sealed`).")

    @property
    def kind(self) -> ListKind:
        """Return who can know the list."""
        return ListKind.PUBLIC if self.commitment is None else ListKind.SEALED

    @property
    def starts(self) -> tuple[Start, ...]:
        """All starts in the order of the episodes, repeats included."""
        return tuple(start for block in self.blocks for _ in range(block.repeats) for start in block.starts)

    @property
    def shapes(self) -> tuple[str, ...]:
        """Every shape once, in the order in which they are first played."""
        return tuple(dict.fromkeys(start.shape for start in self.starts))

    @model_validator(mode="after")
    def _offsets_are_alike(self) -> Self:
        lengths = {len(start.offset) for start in self.starts}
        if len(lengths) > 1:
            raise ValueError(f"expected offsets of one length, got {' and '.join(map(str, sorted(lengths)))} numbers")
        return self


@dataclass(frozen=True, kw_only=True)
class Episode:
    """One fixed start of a list. `number` counts from 1; offset in the units of the task's `offset_option`."""

    number: int
    shape: str
    offset: tuple[float, ...]
    offset_option: str
    list_seed: int

    @property
    def options(self) -> Mapping[str, object]:
        """Options for the environment's `reset`: start and the seed of the episode's own random stream."""
        return {
            "shape": self.shape,
            self.offset_option: self.offset,
            "rng_seed": (self.list_seed, self.number),
        }


class Profile(StrictModel):
    """Settings of the environment under which recordings of another evaluation were made; never scored."""

    reason: str
    """Why they differ from the task's own."""
    settings: dict[Word, bool | int | float | str] = Field(min_length=1)


class Task(StrictModel):
    """One task of a track: its environment and its episode list. What is observed and done is the environment's."""

    name: str
    env_id: str
    title: str
    description: str
    success_rule: str
    max_steps: PositiveInt
    shard_size: PositiveInt
    name_2025: Word | None = Field(default=None, description="Its name in the text logs of 2025, if it is in them.")
    notes: tuple[str, ...] = ()
    ranking: tuple[Word, ...] | None = Field(
        default=None, description="What entries of its board are compared by; null: as its track says."
    )
    settings: dict[Word, bool | int | float | str] = Field(
        default={}, description="Settings of the environment that are not its defaults."
    )
    draws: dict[Word, tuple[float, float]] = Field(
        default={}, description="Quantities that every episode has a value of its own of: lowest and highest."
    )
    optional_observables: tuple[Word, ...] = Field(
        default=(), description="Observables that policies get beside those of every task of its environment."
    )
    force_limit_n: float | None = Field(
        default=None,
        gt=0,
        description="Largest force on the held part in an env step; beyond it an episode has failed.",
    )
    delay_steps: int = Field(
        default=0,
        ge=0,
        le=_DELAY_STEPS_MAX,
        description="Env steps that pass between an observation and the action it is answered by.",
    )
    while_thinking: WhileThinking = Field(default=WhileThinking.STOP, description="What is done in them.")
    delay_ms: int | None = Field(
        default=None,
        ge=0,
        description="The same in milliseconds: `delay_steps` is delay_ms / control_period_ms, rounded up.",
    )
    control_period_ms: PositiveInt | None = Field(
        default=None, description="Time that an env step stands for, from one action to the next."
    )
    player: Player = Field(default=Player.POLICY, description="Who chooses the actions.")
    station_of: Word | None = Field(
        default=None, description="Played on a station: the simulated task whose name policies get at a reset."
    )
    profiles: dict[Word, Profile] = Field(default={}, description="Settings for re-simulation only, by name.")
    episode_list: EpisodeList

    @property
    def definition(self) -> TaskDefinition:
        """Return what the task's own folder says of it, or what follows from its settings, with what it observes."""
        return environment_definition(self.env_id, self.settings).with_optional(self.optional_observables)

    @property
    def family(self) -> Family:
        """Return who can play it."""
        return self.definition.family if self.station_of is None else Family.STATION

    @property
    def measures_figures(self) -> bool:
        """Return whether its shards measure the figures of the sensor, too: those of the blind run do."""
        return self.player is Player.BLIND

    @property
    def observables(self) -> tuple[Observable[Any], ...]:
        """Return what a policy observes, nothing privileged."""
        return self.definition.public_observables

    @property
    def actions(self) -> tuple[ActionComponent, ...]:
        """Return the components of an action, in order."""
        return self.definition.actions

    @property
    def environment_arguments(self) -> Mapping[str, object]:
        """Return what its environment is made with: settings, limit of force, draws, optional observables."""
        limit = {} if self.force_limit_n is None else {"force_limit_n": self.force_limit_n}
        named = {"optional_observables": self.optional_observables, "draws": self.draws}
        return {**self.settings, **limit, **{name: value for name, value in named.items() if value}}

    @property
    def contact_model(self) -> str | None:
        """Return the name of the contact model by which its bodies touch; None where ManiSkill's engine decides."""
        return None if is_maniskill(self.env_id) else str(self.settings.get("contact_model", "challenge-2025"))

    @property
    def drawn_quantities(self) -> tuple[Quantity, ...]:
        """Return what is drawn for every episode, in the order of the environment's table."""
        return tuple(quantity for quantity in self.definition.quantities if quantity.name in self.draws)

    @model_validator(mode="after")
    def _delay_is_whole_env_steps(self) -> Self:
        if self.delay_ms is None:
            return self
        if self.control_period_ms is None:
            raise ValueError(
                f"delay_ms is {self.delay_ms}, but control_period_ms is missing; say what an env step takes"
            )
        steps = -(-self.delay_ms // self.control_period_ms)
        if "delay_steps" in self.model_fields_set and self.delay_steps != steps:
            raise ValueError(f"delay_steps is {self.delay_steps}, but delay_ms gives {steps}; leave one of them out")
        if steps > _DELAY_STEPS_MAX:
            raise ValueError(
                f"delay_ms is {self.delay_ms}, which is {steps} env steps, expected at most {_DELAY_STEPS_MAX}"
            )
        object.__setattr__(self, "delay_steps", steps)
        return self

    @model_validator(mode="after")
    def _environment_is_known(self) -> Self:
        try:
            _ = self.definition
        except VitacError as error:
            raise ValueError(str(error)) from error
        return self

    @model_validator(mode="after")
    def _is_ranked_at_full_fidelity(self) -> Self:
        for settings in (self.settings, *(profile.settings for profile in self.profiles.values())):
            named = settings.get(FIDELITY, Fidelity.FULL)
            if named != Fidelity.FULL:
                raise ValueError(f"settings.fidelity is {named!r}, which is for training only; leave it out")
        return self

    @model_validator(mode="after")
    def _maniskill_draws_its_starts(self) -> Self:
        shapes = self.episode_list.shapes
        if is_maniskill(self.env_id) and shapes != (DRAWN,):
            raise ValueError(
                f"expected starts of shape {DRAWN}, got {', '.join(shapes)}; {self.env_id} draws them from the seed"
            )
        return self

    @model_validator(mode="after")
    def _force_is_known(self) -> Self:
        if self.force_limit_n is not None and self.definition.family is not Family.TACTILE:
            raise ValueError(
                f"force_limit_n is {self.force_limit_n:g}, but {self.env_id} measures no contact force; leave it out"
            )
        return self

    @model_validator(mode="after")
    def _draws_are_known(self) -> Self:
        try:
            check_draws(self.env_id, self.draws, self.definition.quantities)
        except VitacError as error:
            raise ValueError(str(error)) from error
        return self

    @model_validator(mode="after")
    def _shards_fill_batches(self) -> Self:
        least = self.definition.batch_size
        if self.shard_size < least:
            raise ValueError(f"shard_size is {self.shard_size}, expected at least batch_size {least}")
        return self

    @cached_property
    def episodes(self) -> tuple[Episode, ...]:
        """All starts in order, numbered from 1."""
        listed = self.episode_list
        return tuple(
            Episode(
                number=number,
                shape=start.shape,
                offset=start.offset,
                offset_option=listed.offset_option,
                list_seed=listed.list_seed,
            )
            for number, start in enumerate(listed.starts, start=1)
        )

    def apply_text_log_settings(self) -> Self:
        """Return the task with the settings under which its 2025 text logs were made, where they are others."""
        profile = self.profiles.get(TEXT_LOG_PROFILE)
        return self if profile is None else self.model_copy(update={"settings": self.settings | profile.settings})

    def digest(self) -> str:
        """Return the SHA-256 [hex] of the whole definition.

        It changes with the list, the limits, the settings, the tables and the methods of measurement.
        """
        observed = [(row.name, row.shape, row.dtype, row.unit, row.meaning) for row in self.observables]
        done = [(row.name, row.scale, row.unit, row.meaning) for row in self.actions]
        measured = [asdict(method) for method in self.definition.methods]
        # A task without settings, methods or a sealed list keeps the digest that it had before there were any.
        tables = [observed, done, *([measured] if measured else [])]
        absent: dict[str, Any] = {"profiles": True}  # never scored
        absent |= {"delay_ms": True, "control_period_ms": True}  # other words for delay_steps
        absent |= {name: True for name in ("settings", "draws", "optional_observables") if not getattr(self, name)}
        absent |= {"ranking": True}  # another order of the same scores
        absent |= {"force_limit_n": True} if self.force_limit_n is None else {}
        absent |= {"delay_steps": True, "while_thinking": True} if self.delay_steps == 0 else {}
        absent |= {"player": True} if self.player is Player.POLICY else {}
        absent |= {"station_of": True} if self.station_of is None else {}
        absent |= {"episode_list": {"commitment"}} if self.episode_list.commitment is None else {}
        own = self.model_dump_json(exclude=absent)
        return hashlib.sha256((own + json.dumps(tables)).encode()).hexdigest()


def _under_delays(name: str, task: Mapping[str, Any]) -> dict[str, Any]:
    """Return copies of a task of a file by name, one for each of its `delays_ms`.

    Raises:
        ValueError: they are no list of different whole numbers.
    """
    delays = task["delays_ms"]
    if not isinstance(delays, list) or any(type(each) is not int for each in delays) or len({*delays}) != len(delays):
        raise ValueError(f"tasks.{name}.delays_ms is {delays!r:.80}, expected different whole numbers: [0, 50, 100]")
    rest = {key: value for key, value in task.items() if key != "delays_ms"}
    return {
        (key := f"{name}-{delay}ms" if delay else name): {
            **rest,
            "name": key,
            **({"title": f"{task.get('title', name)}, {delay} ms"} if delay else {}),
            "delay_ms": delay,
        }
        for delay in delays
    }


class Track(StrictModel):
    """One track: what is scored, how it is ranked, what may be submitted, and its tasks by name.

    `ranking` names what entries are compared by; `combination_rule` says how all tasks are combined, or those of
    `combined_tasks` where these are given. `folder` is the one folder that the archive of a submission holds, and the
    challenge's own name of the track. With `has_sensor`, every submission brings a sensor of its own. `packages` are
    the sets of packages that its policies see beside the base.
    """

    name: Word
    folder: Word
    title: str
    summary: str
    ranking: tuple[Word, ...] = DEFAULT_RANKING
    combination_rule: str | None = None
    combined_tasks: tuple[Word, ...] = ()
    has_sensor: bool = False
    accepts: tuple[SubmissionKind, ...] = Field(min_length=1)
    packages: tuple[PackageSet, ...] = ()
    image_bytes: PositiveInt | None = Field(
        default=None, description="Largest container image, packed and unpacked; null: as the service limits it."
    )
    scoring_notes: tuple[str, ...] = ()
    tasks: dict[str, Task] = Field(min_length=1)

    @model_validator(mode="before")
    @classmethod
    def _play_tasks_under_their_delays(cls, data: Any) -> Any:
        """Make a task for each of the `delays_ms` of one: that of 0 has its name, the others theirs with the delay."""
        tasks = data.get("tasks") if isinstance(data, dict) else None
        if not isinstance(tasks, dict) or not any(
            isinstance(task, dict) and "delays_ms" in task for task in tasks.values()
        ):
            return data
        each: dict[str, Any] = {}
        for name, task in tasks.items():
            each |= _under_delays(name, task) if isinstance(task, dict) and "delays_ms" in task else {name: task}
        return data | {"tasks": each}

    @model_validator(mode="after")
    def _tasks_carry_their_names(self) -> Self:
        wrong = [key for key, task in self.tasks.items() if task.name != key]
        if wrong:
            raise ValueError(f"tasks.{wrong[0]}.name is {self.tasks[wrong[0]].name!r}; it must be {wrong[0]!r}")
        return self

    @property
    def tasks_that_count(self) -> tuple[str, ...]:
        """Return the tasks that the board of the whole track combines."""
        return self.combined_tasks or tuple(self.tasks)

    def find_ranking(self, task: str | None = None, names: Sequence[str] | None = None) -> Ranking:
        """Return what the entries of a board are compared by.

        Args:
            task: whose board; None: that of all tasks together.
            names: of the keys; None: those of the file.

        Raises:
            ValueError: there is no such key.
        """
        tasks = [self.tasks[name] for name in ((task,) if task else self.tasks_that_count)]
        shared = [
            measure
            for measure in tasks[0].definition.measures
            if all(measure in other.definition.measures for other in tasks)
        ]
        own = (self.tasks[task].ranking if task else None) or self.ranking
        return make_ranking(own if names is None else names, shared)

    @property
    def ranking_rule(self) -> str:
        """Return the order on the board of a task, in words; that of each task where they differ."""
        rules = {name: self.find_ranking(name).sentence for name in self.tasks}
        if len(set(rules.values())) > 1:
            return " ".join(f"{self.tasks[name].title}: {rule}" for name, rule in rules.items())
        return next(iter(rules.values()))

    def task(self, name: str) -> Task:
        """Return the task of that name.

        Raises:
            UnknownTask: the track does not have it, or no longer.
        """
        if name not in self.tasks:
            raise UnknownTask(f"Track {self.name!r} has no task {name!r}; its tasks are {', '.join(self.tasks)}.")
        return self.tasks[name]

    def list_delays(self) -> list[list[Task]]:
        """Return the tasks that are the same but for their delay, in its order: of each several."""
        alike: dict[tuple[str, WhileThinking], list[Task]] = {}
        same = {"name": "", "title": "", "description": "", "delay_steps": 0}
        for task in self.tasks.values():
            alike.setdefault((task.model_copy(update=same).digest(), task.while_thinking), []).append(task)
        ordered = (sorted(tasks, key=lambda task: (task.delay_steps, task.delay_ms or 0)) for tasks in alike.values())
        return [tasks for tasks in ordered if len(tasks) > 1]

    @property
    def has_maniskill(self) -> bool:
        """Return whether a worker needs ManiSkill to play the track, or a part of it."""
        return any(is_maniskill(task.env_id) for task in self.tasks.values())

    def list_played_tasks(self, named: Collection[str]) -> tuple[str, ...]:
        """Return what a submission plays that names these tasks: them, and what our own estimator plays of each."""
        return tuple(name for name, task in self.tasks.items() if name in named or task.player is not Player.POLICY)

    @model_validator(mode="after")
    def _combined_tasks_are_there(self) -> Self:
        for name in self.combined_tasks:
            if name not in self.tasks:
                raise ValueError(f"combined_tasks has {name!r}; the tasks are {', '.join(self.tasks)}")
        return self

    @model_validator(mode="after")
    def _one_board_has_one_physics(self) -> Self:
        if len({self.tasks[name].definition.repeats for name in self.tasks_that_count}) > 1:
            raise ValueError(
                "the board of all tasks would mix physics on a CPU and on a GPU; name the tasks of one of them in "
                "combined_tasks"
            )
        return self

    @model_validator(mode="after")
    def _several_tasks_need_a_combination(self) -> Self:
        if (self.combination_rule is not None) != (len(self.tasks) > 1):
            raise ValueError("combination_rule must be given where there are several tasks, and only there")
        return self

    @model_validator(mode="after")
    def _ranking_keys_are_known(self) -> Self:
        for task in (None, *self.tasks):
            self.find_ranking(task)
        return self


class UnknownEpisodes(VitacError):
    """Episodes were asked for that the list does not have."""


@dataclass(frozen=True, kw_only=True)
class ShardEpisodes:
    """Neighbouring episodes of a list. `index` counts from 0 in the cut of the whole list."""

    index: int
    episodes: tuple[Episode, ...]

    @property
    def numbers(self) -> frozenset[int]:
        """Numbers of its episodes."""
        return frozenset(episode.number for episode in self.episodes)


def cut(task: Task, episodes: Iterable[int] | None = None) -> tuple[ShardEpisodes, ...]:
    """Cut the task's list into shards of `task.shard_size`, always at the same places.

    Args:
        task: whose list.
        episodes: numbers to keep; all by default. A shard without any of them is omitted.

    Raises:
        UnknownEpisodes: a number is not in the list, or none is asked for.
    """
    listed = frozenset(episode.number for episode in task.episodes)
    wanted = listed if episodes is None else frozenset(episodes)
    if not wanted or not wanted <= listed:
        got = ", ".join(map(str, sorted(wanted - listed)[:5])) or "none"
        raise UnknownEpisodes(f"Expected episodes of {task.name} from 1 to {len(listed)}, got {got}.")
    starts = range(0, len(task.episodes), task.shard_size)
    pieces = (task.episodes[start : start + task.shard_size] for start in starts)
    kept = (tuple(episode for episode in piece if episode.number in wanted) for piece in pieces)
    return tuple(ShardEpisodes(index=index, episodes=piece) for index, piece in enumerate(kept) if piece)
