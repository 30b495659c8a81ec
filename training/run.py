"""A training run: rounds of playing and learning, saved after every round and every file of episodes.

Everything drawn in a round follows from the recipe's seed and the number of the round, so that a run that was stopped,
by Ctrl-C or killed, ends with the same bits as one that was not.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from vitac.envs.tasks.settings import Fidelity
from vitac.errors import VitacError
from vitac.evaluator.scoring.score import Rate, rate
from vitac.evaluator.tracks.registry import differing_parts
from vitac.evaluator.version import evaluator_parts, sources_hash

from .collection import ActorKind, CollectedBatch, Networks, collect
from .episodes import Episodes
from .files import load, remove_leftovers, save, write_text
from .folder_lock import hold_folder
from .learners import Learners
from .log import Charts, Row, extend_log, read_log
from .progress import TrainingProgress
from .recipe import Recipe
from .streams import Use, refuse_official_streams

_ROUND_NUMBERS = 100_000
"""Numbers of episodes that each round has of its own."""
_GUIDED_FIRST = 50_000

Tell = Callable[[str], None]


class OtherRun(VitacError):
    """The folder holds a run of another recipe or version; give another folder."""


@dataclass(frozen=True, kw_only=True)
class Folder:
    """Where a run keeps its files.

    Attributes:
        path: of the folder.
    """

    path: Path

    @property
    def episodes(self) -> Path:
        """Folder of the files of episodes."""
        return self.path / "episodes"

    @property
    def log(self) -> Path:
        """What each round found, a line of JSON each."""
        return self.path / "log.jsonl"

    def networks(self, number: int) -> Path:
        """Return the file with critic and student after a round."""
        return self.path / f"round-{number:03d}.npz"


@dataclass(frozen=True, kw_only=True)
class RoundResult:
    """What a round found.

    Attributes:
        number: of the round, from 1.
        student: successes of the student from the starts by which the best round is chosen.
        critic: successes of the critic from the same starts.
        env_steps: played so far to learn from.
    """

    number: int
    student: Rate
    critic: Rate
    env_steps: int


@dataclass(kw_only=True, eq=False)
class Run:
    """A training run.

    Attributes:
        recipe: what is done.
        folder: where its files are.
        processes: how many play episodes.
        ray: address of a Ray cluster that plays them instead.
        tell: called with each line of progress.
    """

    recipe: Recipe
    folder: Folder
    processes: int = 1
    ray: str | None = None
    tell: Tell = field(default=lambda _: None)

    def __post_init__(self) -> None:
        self._known: list[tuple[ActorKind, Episodes]] = []

    def go(self) -> list[RoundResult]:
        """Do what is left of the run, and return what all rounds found.

        Raises:
            StreamRefused: an official list has the seed of one of its streams.
            OtherRun: the folder is that of another run.
            FolderInUse: another process writes there.
            NotSaved: the disk is full.
            FileDamaged: networks or log are not what was written.
            TrainingDiverged: a loss is no number any more; all rounds before are kept.
        """
        with self._claimed(), Charts(self.folder.path, self.tell) as charts:
            return self._rounds(charts)

    def _rounds(self, charts: Charts) -> list[RoundResult]:
        self._known.clear()
        judged = {result.number: result for result in read_log(self.folder.log, _result)}
        results: list[RoundResult] = []
        networks: Networks | None = None
        numbers = range(1, self.recipe.rounds + 1)
        progress = TrainingProgress()
        progress.left(sum(self.folder.networks(number).exists() for number in numbers), len(numbers))
        for number in numbers:
            self._play(number, networks)
            networks = self._learned(number, charts)
            results.append(judged.get(number) or self._judged(number, networks))
            if number not in judged:  # before the log: a kill in between charts it twice rather than never
                charts.add_row(number, _row(results[-1]))
            extend_log(self.folder.log, [_row(result) for result in results])
            self._tell_round(results[-1], progress.left(number, len(numbers)))
        return results

    def collect_first(self) -> int:
        """Play the episodes of the first round, and return how many there are.

        Raises:
            StreamRefused: an official list has the seed of one of its streams.
            OtherRun: the folder is that of another run.
            FolderInUse: another process writes there.
            NotSaved: the disk is full.
        """
        with self._claimed():
            self._known.clear()
            self._play(1, None)
            return sum(len(played) for _, played in self._known)

    def _claimed(self) -> AbstractContextManager[None]:
        return claimed(self.folder.path, self.recipe.model_dump(mode="json"), self.tell)

    def _play(self, number: int, networks: Networks | None) -> None:
        recipe, first = self.recipe, number * _ROUND_NUMBERS
        if networks is None:
            kinds = ((ActorKind.RANDOM, recipe.random_episodes), (ActorKind.GUIDED, recipe.guided_episodes))
        else:
            kinds = ((ActorKind.STUDENT, recipe.student_episodes), (ActorKind.CRITIC, recipe.critic_episodes))
        for (kind, count), offset in zip(kinds, (0, _GUIDED_FIRST), strict=True):
            batch = self._batch(kind, Use.COLLECT, first + offset, count, recipe.noise)
            self._known.append((kind, self._collected(batch, networks)))

    def _learned(self, number: int, charts: Charts) -> Networks:
        """Learn from all episodes, or read what was learned."""
        path = self.folder.networks(number)
        random = np.random.default_rng((self.recipe.seed, number))
        learners = Learners(self.recipe, random)
        if path.exists():
            learners.restore(load(path))
        else:
            if number > 1:
                learners.restore(load(self.folder.networks(number - 1)))
            learners.learn(self._known, number, random, partial(self._tell_turn, charts, number))
            save(path, learners.state())
        return learners.networks()

    def _judged(self, number: int, networks: Networks) -> RoundResult:
        rates = []
        for kind in (ActorKind.STUDENT, ActorKind.CRITIC):
            played = self._collected(self._batch(kind, Use.CHOOSE, 0, self.recipe.chosen_by, 0.0), networks)
            rates.append(rate(int(played.solved.sum()), len(played)))
        env_steps = sum(len(played.actions) for _, played in self._known)
        return RoundResult(number=number, student=rates[0], critic=rates[1], env_steps=env_steps)

    def _tell_round(self, result: RoundResult, left: str) -> None:
        sentence = (
            f"student {format_rate(result.student)}, critic {format_rate(result.critic)}, {result.env_steps} env steps"
        )
        self.tell(f"round {result.number} of {self.recipe.rounds}: {sentence}{left}")

    def _batch(self, kind: ActorKind, use: Use, first: int, count: int, noise: float) -> CollectedBatch:
        fidelity = self.recipe.fidelity if use is Use.COLLECT else Fidelity.FULL
        return CollectedBatch(
            kind=kind,
            seed=self.recipe.seed,
            use=use,
            first=first,
            count=count,
            noise=noise,
            fidelity=fidelity,
            contact_model=self.recipe.contact_model,
            draws=tuple((name, low, high) for name, (low, high) in sorted(self.recipe.draws.items())),
        )

    def _collected(self, batch: CollectedBatch, networks: Networks | None) -> Episodes:
        progress = TrainingProgress()

        def report_file(done: int, files: int) -> None:
            self.tell(f"{batch.kind} episodes: {done} of {files} files{progress.left(done, files)}")

        return collect(
            batch,
            self.folder.episodes,
            networks=networks,
            processes=self.processes,
            ray=self.ray,
            report_file=report_file,
        )

    def _tell_turn(self, charts: Charts, number: int, who: str, turn: int, loss: float) -> None:
        charts.add_loss(number, who, loss)
        self.tell(f"round {number}, {who}: turn {turn + 1}, loss {loss:.4f}")


@contextmanager
def claimed(folder: Path, recipe: Mapping[str, Any], tell: Tell) -> Iterator[None]:
    """Keep the folder of a run for this process, and say in it what it is for; what a kill left half written goes.

    Args:
        folder: of the run.
        recipe: all that decides the run beside the code, as JSON has it.
        tell: called where the file system has no locks.

    Raises:
        StreamRefused: an official list has the seed of one of its streams.
        FolderInUse: another process writes there.
        OtherRun: it is that of another recipe or version, or does not say which.
        NotSaved: the disk is full.
    """
    refuse_official_streams(recipe["seed"])
    with hold_folder(folder, tell):
        _claim(folder, recipe)
        yield


def _claim(folder: Path, recipe: Mapping[str, Any]) -> None:
    """Write what the folder is for, or make sure that it is for this."""
    now = {
        "recipe": recipe,
        "made_by": evaluator_parts(),
        "trained_by": sources_hash("vitac.training"),
    }
    path = folder / "run.json"
    text = json.dumps(now, indent=1) + "\n"
    if path.exists():
        if path.read_bytes() != text.encode():
            raise OtherRun(f"{folder} holds a run of another {_difference(path, now)}; give another folder.")
    elif any(folder.glob("round-*.npz")) or (folder / "progress.csv").exists():
        raise OtherRun(f"{folder} holds a training but no run.json that says of which recipe; give another folder.")
    else:
        write_text(path, text)
    for written in ("", "checkpoints", "episodes", "submission/Track_1"):
        remove_leftovers(folder / written)


def _difference(path: Path, now: Mapping[str, Any]) -> str:
    """Return in what a run differs from one that would begin now."""
    try:
        then = json.loads(path.read_bytes())
        parts = {**then["made_by"], "vitac.training": then["trained_by"]}
        recipe = then["recipe"]
    except (ValueError, KeyError, TypeError):
        return "version, or its run.json is damaged"
    if recipe != json.loads(json.dumps(now["recipe"])):
        return "recipe"
    return ", ".join(differing_parts({**now["made_by"], "vitac.training": now["trained_by"]}, parts))


def read_results(folder: Folder) -> list[RoundResult]:
    """Read what the rounds of a run found.

    Raises:
        FileDamaged: the log is not what was written.
        OtherRun: no round is finished there, or the folder is that of a search.
    """
    results = read_log(folder.log, _result)
    if not results:
        raise OtherRun(f"{folder.path} holds no finished round; train first.")
    return results


def _row(result: RoundResult) -> Row:
    return {
        "round": result.number,
        "env_steps": result.env_steps,
        "student": result.student.model_dump(),
        "critic": result.critic.model_dump(),
    }


def _result(row: Row) -> RoundResult:
    if "generation" in row:
        raise OtherRun("The folder is that of a search, which writes its submission itself: into `submission` there.")
    return RoundResult(
        number=row["round"],
        student=Rate.model_validate(row["student"]),
        critic=Rate.model_validate(row["critic"]),
        env_steps=row["env_steps"],
    )


def format_rate(counted: Rate) -> str:
    """Return a rate for people."""
    low, high = 100 * counted.interval.low, 100 * counted.interval.high
    return f"{counted.successes} of {counted.episodes} ({100 * counted.success_rate:.1f} % [{low:.1f}, {high:.1f}])"


def best(results: Sequence[RoundResult]) -> RoundResult:
    """Return the round whose student solved the most held-out starts, the latest of equals."""
    return max(results, key=lambda result: (result.student.successes, result.number))
