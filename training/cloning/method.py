"""Clones an expert by dataset aggregation (DAgger: Ross, Gordon and Bagnell 2011), and a blind policy beside it.

The expert plays first. Then each round plays the policy of the round before, asks the expert what it would have done in
every state, and learns from all that was played so far. The blind policy is made in the same way, without touch and
sight; what both solve of the same fresh starts says what sensing is worth. All that is drawn follows from the seed and
the number of the round, so that a run that was stopped ends with the same bits as one that was not.
"""

import io
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import prod
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from vitac.evaluator.scoring.comparison import SensingGain, sensing_gain
from vitac.evaluator.scoring.score import Rate, rate
from vitac.evaluator.strict_model import StrictModel
from vitac.evaluator.tracks import find_task
from vitac.evaluator.tracks.definition import DRAWN

from ..files import load, remove_leftovers, save, write_bytes, write_text
from ..log import Charts, Row, extend_log, read_log
from ..pool import map_in_order
from ..progress import TrainingProgress
from ..run import Folder, Tell, claimed, format_rate
from ..sensor import make_sensor
from ..streams import Use, stream
from . import policy
from .playing import ClonedEpisodes, ClonedTask, Network, join
from .policy import MARKERS, PICTURE, FloatArray, make_windows

FILE_EPISODES = 25
"""Episodes of a file: a kill loses at most those of one for each process."""
_ROUND_NUMBERS = 100_000
"""Numbers of episodes that each round has of its own."""

Count = Annotated[int, Field(ge=1, le=100_000)]


class ClonePlan(StrictModel):
    """What is cloned, and how."""

    task: str
    seed: Annotated[int, Field(ge=0, le=10_000)] = 0
    sensor: str | None = None
    """Digest of the sensor, in Track 3."""
    rounds: Count = 6
    """How often the policy is learned; the expert plays before the first."""
    episodes: Count = 300
    """Episodes before each round."""
    chosen_by: Count = 60
    """Held-out episodes by which the best round is chosen."""
    reported: Count = 300
    """Fresh starts by which the policy is compared with the blind one."""
    hidden: Count = 192
    """Units of both layers."""
    gradient_steps: Count = 5000
    """Of each round."""
    weight_decay: Annotated[float, Field(ge=0, le=10)] = 1.0
    """Part of the learning rate by which weights get smaller; without it the policy learns the markers' noise."""
    batch: Count = 256
    """Moments of a gradient step."""
    learning_rate: Annotated[float, Field(gt=0, le=0.1)] = 1e-3
    """At the start of a round; it falls to a tenth."""


FEW_NUMBERS = 16
"""What has no more is observed as it is, by the blind policy, too: it feels and sees nothing else."""


@dataclass(frozen=True, kw_only=True)
class Round:
    """What a round found.

    Attributes:
        number: of the round, from 1.
        solved: successes of its policy from the starts by which the best is chosen.
        env_steps: played so far to learn from.
    """

    number: int
    solved: Rate
    env_steps: int


@dataclass(frozen=True, kw_only=True)
class PolicyEpisode:
    """How an episode ended, as comparisons read it."""

    task: str
    episode: int
    success: bool
    env_steps: int
    shape: str = DRAWN
    initial_offset: tuple[float, ...] = ()

    @property
    def outcome(self) -> str:
        """How it ended."""
        return "success" if self.success else "failure"


@dataclass(kw_only=True, eq=False)
class Cloning:
    """A policy that is cloned.

    Attributes:
        plan: what is done.
        folder: where its files are.
        keys: what the policy observes.
        design: of both sensors, where the task has one.
        processes: how many play episodes.
        tell: called with each line of progress.
        before: rounds of another policy that were learned before.
        progress: of both policies.
    """

    plan: ClonePlan
    folder: Folder
    keys: Sequence[str]
    design: Any = None
    processes: int = 1
    tell: Tell = field(default=lambda _: None)
    before: int = 0
    progress: TrainingProgress = field(default_factory=TrainingProgress)

    def __post_init__(self) -> None:
        self._stage = ClonedTask(find_task(self.plan.task)[1], self.keys, self.design)

    def go(self) -> list[Round]:
        """Do what is left, and return what all rounds found.

        Raises:
            NotSaved: the disk is full.
            FileDamaged: networks or log are not what was written.
            TrainingDiverged: a loss is no number; all rounds before are kept.
        """
        judged = {each.number: each for each in read_log(self.folder.log, _round)}
        rounds: list[Round] = []
        played: list[ClonedEpisodes] = []
        weights: Mapping[str, FloatArray] | None = None
        remove_leftovers(self.folder.episodes)
        self.progress.begin(self.before)
        with Charts(self.folder.path, self.tell) as charts:
            for number in range(1, self.plan.rounds + 1):
                first = number * _ROUND_NUMBERS
                played.append(self._played(f"round-{number:03d}", Use.COLLECT, first, self.plan.episodes, weights))
                weights = self._learned(number, join(played))
                rounds.append(judged.get(number) or self._judged(number, weights, played))
                if number in judged:
                    self.progress.begin(self.before + number)
                else:
                    charts.add_row(number, _row(rounds[-1]))
                extend_log(self.folder.log, [_row(each) for each in rounds])
                left = self.progress.left(self.before + number, 2 * self.plan.rounds)
                self.tell(f"round {number} of {self.plan.rounds}: {format_rate(rounds[-1].solved)}{left}")
        return rounds

    def report(self, number: int) -> list[PolicyEpisode]:
        """Play the fresh starts with the policy of a round, and return how they ended."""
        played = self._played("reported", Use.REPORT, 0, self.plan.reported, load(self.folder.networks(number)))
        rows = zip(played.solved, played.lengths, strict=True)
        return [
            PolicyEpisode(task=self.plan.task, episode=start, success=bool(solved), env_steps=int(length))
            for start, (solved, length) in enumerate(rows)
        ]

    def _judged(self, number: int, weights: Mapping[str, FloatArray], played: Sequence[ClonedEpisodes]) -> Round:
        solved = self._played(f"chosen-{number:03d}", Use.CHOOSE, 0, self.plan.chosen_by, weights).solved
        return Round(
            number=number,
            solved=rate(int(solved.sum()), len(solved)),
            env_steps=sum(len(each.rows) for each in played),
        )

    def _played(
        self, name: str, use: Use, first: int, count: int, weights: Mapping[str, FloatArray] | None
    ) -> ClonedEpisodes:
        """Return episodes of a stream: those in files already, and the others after making their files."""
        seed, end = stream(self.plan.seed, use), first + count
        files = {
            self.folder.episodes / f"{name}-{start - first:05d}.npz": range(start, min(start + FILE_EPISODES, end))
            for start in range(first, end, FILE_EPISODES)
        }
        missing = [path for path in files if not path.exists()]
        play = partial(_play, self._stage, seed, weights)
        made = map_in_order(play, [(path, files[path]) for path in missing], self.processes)
        for done, _ in enumerate(made, start=1):
            self.tell(f"{name}: {done} of {len(missing)} files")
        return join([ClonedEpisodes(**load(path)) for path in files])

    def _learned(self, number: int, played: ClonedEpisodes) -> Mapping[str, FloatArray]:
        """Return the weights that were learned from all episodes, or read what was learned."""
        path = self.folder.networks(number)
        if not path.exists():
            save(path, self._learn(np.random.default_rng((self.plan.seed, number)), played))
        return load(path)

    def _learn(self, random: np.random.Generator, played: ClonedEpisodes) -> Mapping[str, FloatArray]:
        plan = self.plan
        mean, scale = played.rows.mean(axis=0), played.rows.std(axis=0) + np.float32(1e-3)
        rows = np.split((played.rows - mean) / scale, np.cumsum(played.lengths)[:-1])
        inputs = np.concatenate([make_windows(each) for each in rows])
        network = Network((inputs.shape[1], plan.hidden, plan.hidden, played.actions.shape[1]), random)
        for step in range(plan.gradient_steps):
            chosen = random.integers(len(inputs), size=plan.batch)
            learning_rate = plan.learning_rate * 0.1 ** (step / plan.gradient_steps)
            network.learn(
                inputs[chosen],
                played.actions[chosen],
                rate=learning_rate,
                decay=plan.weight_decay,
                loss=self._stage.loss,
            )
        return {**network.parameters, "mean": mean, "scale": scale}

    def export(self, number: int, sensor: Path | None) -> Path:
        """Write the submission of a round, with the sensor that it plays with, and return its folder.

        Raises:
            NotSaved: it cannot be written.
        """
        track, _ = find_task(self.plan.task)
        folder = self.folder.path / "submission" / track.folder
        if sensor is not None:
            shutil.copytree(sensor, folder, dirs_exist_ok=True)
        packed = io.BytesIO()
        np.savez_compressed(packed, **load(self.folder.networks(number)))  # type: ignore[arg-type]
        write_bytes(folder / "weights.npz", packed.getvalue())
        write_text(
            folder / "submission.yaml",
            f"track: {track.name}\ntasks: [{self.plan.task}]\nname: clone of the expert\nentry_point: policy:Policy\n"
            f"observation_keys: [{', '.join(self.keys)}]\n",
        )
        shutil.copyfile(str(policy.__file__), folder / "policy.py")
        return folder


def clone(
    plan: ClonePlan, folder: Path, *, sensor: Path | None = None, processes: int = 1, tell: Tell = lambda _: None
) -> SensingGain:
    """Clone the expert of a task, with senses and without, and return what sensing gains on the same fresh starts.

    Args:
        plan: what is done; the digest of its sensor is filled in.
        folder: of the policy that senses; that of the blind one is in it.
        sensor: folder of the sensor that a task of Track 3 is played with.
        processes: that play episodes.
        tell: called with each line of progress.

    Raises:
        NoExpert: the task has none.
        SensorMismatch: the task needs a sensor, or plays with the challenge's.
        SensorRejected: the sensor breaks a rule.
        FolderInUse: another process writes there.
        OtherRun: the folder is that of another plan or version.
        NotSaved: the disk is full.
    """
    track, task = find_task(plan.task)
    made = make_sensor(track, task.name, sensor)
    plan = plan.model_copy(update={"sensor": made.digest if made else None})
    known = [entry.name for entry in task.observables if prod(entry.shape) <= FEW_NUMBERS]
    sensed = [entry.name for entry in task.observables if entry.name in (MARKERS, PICTURE)]
    ended, progress = [], TrainingProgress()
    policies = ((folder, [*sensed, *known], 0), (folder / "blind", known, plan.rounds))
    with claimed(folder, plan.model_dump(mode="json"), tell):
        for path, keys, before in policies:
            cloning = Cloning(
                plan=plan,
                folder=Folder(path=path),
                keys=keys,
                design=made.design() if made else None,
                processes=processes,
                tell=partial(_tell_whose, tell, path.name),
                before=before,
                progress=progress,
            )
            chosen = best(cloning.go())
            cloning.export(chosen.number, sensor)
            ended.append(cloning.report(chosen.number))
    gain = sensing_gain(*ended)
    write_text(folder / "gain.json", gain.model_dump_json(indent=1) + "\n")
    return gain


def best(rounds: Sequence[Round]) -> Round:
    """Return the round whose policy solved the most held-out starts, the latest of equals."""
    return max(rounds, key=lambda each: (each.solved.successes, each.number))


def _tell_whose(tell: Tell, name: str, line: str) -> None:
    tell(f"{name}: {line}")


def _row(each: Round) -> Row:
    return {"round": each.number, "env_steps": each.env_steps, "solved": each.solved.model_dump()}


def _round(row: Row) -> Round:
    return Round(number=row["round"], env_steps=row["env_steps"], solved=Rate.model_validate(row["solved"]))


def _play(
    stage: ClonedTask, seed: int, weights: Mapping[str, FloatArray] | None, work: tuple[Path, Sequence[int]]
) -> None:
    """Play the episodes of a file, and write it."""
    path, numbers = work
    save(path, stage.play(seed, numbers, weights).arrays())
