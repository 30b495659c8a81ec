"""Several episodes of a ManiSkill environment in one simulation."""

import argparse
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from threading import Condition
from time import process_time
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..tasks.settings import RNG_SEED, read_task_settings
from .definition import PREFIX, ManiSkillSettings, catalogue
from .env import ManiSkillEnv, made

Result = TypeVar("Result")
Player = Callable[[ManiSkillEnv], Result]
"""Plays episodes in one of the environments, in a thread of its own."""


@dataclass(frozen=True, kw_only=True)
class _Start:
    """Asks for the start of an episode."""

    seed: int


class GivenUp(Exception):
    """The thread that simulates a batch has ended before those that play; what it raised says why."""


class Batch:
    """Environments of one task whose scenes one simulation moves together: an env step is one of all that play.

    Episodes start together, too, for ManiSkill builds all scenes at once. A scene whose episode is over rests until
    the others are over as well.

    Args:
        env_id: as in the track file.
        max_steps: env steps after which an episode ends.
        observation_keys: what is returned of the observation; all by default.
        settings: fields of `ManiSkillSettings` that are not the defaults; they say how many scenes there are.

    Raises:
        ManiSkillMissing: a package, a driver or a GPU is missing.
        ManiSkillFailed: it is not the environment that the catalogue describes.
    """

    def __init__(
        self,
        env_id: str,
        *,
        max_steps: int,
        observation_keys: Sequence[str] | None = None,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        chosen = read_task_settings(ManiSkillSettings, dict(settings or {}))
        self._env = made(env_id.removeprefix(PREFIX), chosen, n_scenes=chosen.batch_size)
        self._changed = Condition()
        self._playing: set[int] = set()
        self._given_up = False
        self._asked: dict[int, _Start | NDArray[np.float32]] = {}
        self._answers: dict[int, Any] = {}
        """For each scene the values of its `reset` or `step`, or the error that the simulation raised."""
        self._states: Any = None
        self._scenes = [_Scene(self, index) for index in range(chosen.batch_size)]
        self.environments = tuple(
            ManiSkillEnv(
                env_id,
                max_steps=max_steps,
                observation_keys=observation_keys,
                settings=settings,
                scene=scene,
                clock=scene.cpu_s,
            )
            for scene in self._scenes
        )

    @property
    def single_action_space(self) -> Any:
        """The action space of one scene."""
        return self._env.single_action_space

    def play(self, players: Sequence[Player[Result]]) -> list[Result]:
        """Let players play at once, each in an environment of its own, and simulate in this thread meanwhile.

        Returns:
            What each player returned, in their order.

        Raises:
            Exception: what the first of them raised, after all have come to their end.
            RuntimeError: the machine has no thread left for a player.
        """
        self._playing, self._given_up = set(range(len(players))), False
        self._asked.clear()
        with ThreadPoolExecutor(len(players)) as threads:
            try:
                ends = [threads.submit(self._played, index, player) for index, player in enumerate(players)]
                self._simulate()
            except BaseException:  # such as Ctrl-C: those that play would wait for ever, and this thread for them
                with self._changed:
                    self._given_up = True
                    self._changed.notify_all()
                raise
        return [end.result() for end in ends]

    def _simulate(self) -> None:
        """Answer what the players ask for until all have come to their end."""
        with self._changed:
            while self._playing:
                self._changed.wait_for(lambda: self._asked.keys() == self._playing)
                if self._asked:
                    self._answer()
                    self._changed.notify_all()

    def ask(self, index: int, asked: "_Start | NDArray[np.float32]") -> Any:
        """Return the values for a scene once all others that play have asked for theirs, too.

        Raises:
            GivenUp: the simulation has ended before.
        """
        with self._changed:
            self._asked[index] = asked
            self._changed.notify_all()
            self._changed.wait_for(lambda: index in self._answers or self._given_up)
            answer = self._answers.pop(index, GivenUp("the simulation of the batch has ended"))
        if isinstance(answer, Exception):
            raise answer
        return answer

    def state(self, index: int) -> Any:
        """Return the state of a scene, with a batch dimension of 1."""
        return self._states[index : index + 1]

    def _played(self, index: int, player: Player[Result]) -> Result:
        try:
            return player(self.environments[index])
        finally:
            with self._changed:
                self._playing.discard(index)
                self._changed.notify_all()

    def _answer(self) -> None:
        """Play an env step of the scenes that ask for one; where none does, start the episodes that are asked for."""
        actions = {index: asked for index, asked in self._asked.items() if not isinstance(asked, _Start)}
        seeds = {index: asked.seed for index, asked in self._asked.items() if isinstance(asked, _Start)}
        answered = actions or seeds
        started = process_time()
        try:
            values = _fetched(self._stepped(actions) if actions else self._started(seeds))
            self._states = _fetched(self._env.get_state())
            answers = {index: _row(values, index) for index in answered}
        except Exception as error:  # noqa: BLE001 - each environment names it as ManiSkill's
            answers = dict.fromkeys(answered, error)
        for index in answered:
            del self._asked[index]
            self._scenes[index].count((process_time() - started) / len(answered))
        self._answers |= answers

    def _stepped(self, actions: Mapping[int, NDArray[np.float32]]) -> Any:
        """Play an env step; scenes that rest get an action of zeros."""
        commands = np.zeros((len(self._scenes), *self.single_action_space.shape), np.float32)
        for index, action in actions.items():
            commands[index] = action
        return self._env.step(commands)

    def _started(self, seeds: Mapping[int, int]) -> Any:
        """Build all scenes again and start each by itself; scenes without an episode rest in the start of another one.

        ManiSkill draws the starts of all scenes from the seed of the first. A scene that is started alone gets what
        its own seed gives, whichever others there are. It does so before any scene has moved, for ManiSkill forgets the
        commanded poses of all when it starts one.
        """
        import torch

        another = seeds[min(seeds)]
        of_scenes = [seeds.get(index, another) for index in range(len(self._scenes))]
        self._env.reset(seed=of_scenes, options={"reconfigure": True})
        for index, seed in enumerate(of_scenes):
            alone = {"env_idx": torch.tensor([index], device=self._env.device)}
            values = self._env.reset(seed=[seed] * len(of_scenes), options=alone)
        return values


class _Scene:
    """One scene, with what `ManiSkillEnv` needs of an environment of ManiSkill."""

    def __init__(self, batch: Batch, index: int) -> None:
        self._batch = batch
        self._index = index
        self._cpu_s = 0.0
        self.single_action_space = batch.single_action_space

    def reset(self, *, seed: int, options: Mapping[str, object]) -> Any:
        """Start an episode, which always builds a new scene."""
        del options
        return self._batch.ask(self._index, _Start(seed=seed))

    def step(self, action: NDArray[np.float32]) -> Any:
        """Play one env step."""
        return self._batch.ask(self._index, action)

    def get_state(self) -> Any:
        """Return the state of its bodies and joints."""
        return self._batch.state(self._index)

    def cpu_s(self) -> float:
        """Return its part of the CPU time of the simulation so far."""
        return self._cpu_s

    def count(self, cpu_s: float) -> None:
        """Add CPU time [s] of the simulation."""
        self._cpu_s += cpu_s


def _fetched(values: Any) -> Any:
    """Return the values in the memory of the CPU."""
    return _leaf_by_leaf(values, lambda value: value.cpu() if hasattr(value, "cpu") else value)


def _row(values: Any, index: int) -> Any:
    """Return the values of one scene, with a batch dimension of 1."""
    return _leaf_by_leaf(values, lambda value: value[index : index + 1] if getattr(value, "ndim", 0) else value)


def _leaf_by_leaf(values: Any, change: Callable[[Any], Any]) -> Any:
    if isinstance(values, Mapping):
        return {key: _leaf_by_leaf(value, change) for key, value in values.items()}
    if isinstance(values, tuple):
        return tuple(_leaf_by_leaf(value, change) for value in values)
    return change(values)


WIDTH, HEIGHT = 480, 360
"""Size of a picture [px]."""
_LEAST_CONTRAST = 8.0
"""Standard deviation of the brightness [of 255] of a picture that shows something."""
_TIME_LIMIT_S = 300.0


class NothingDrawn(VitacError):
    """A picture shows nothing, as of a scene that was not drawn; it is not kept."""


def file_name(env_id: str) -> str:
    """Return the name of the picture of an environment, by ManiSkill's id."""
    return f"scene-{env_id}.jpg"


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw the named environments, or all that can be tasks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("ids", nargs="*")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args(arguments)
    if chosen.one:
        write(_drawn(chosen.ids[0]), chosen.folder / file_name(chosen.ids[0]))
        return
    for env_id in chosen.ids or catalogue().environments:
        command = [sys.executable, "-P", "-m", __spec__.name, str(chosen.folder), env_id, "--one"]
        done = subprocess.run(  # noqa: S603 - our own interpreter and module
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False, timeout=_TIME_LIMIT_S
        )
        sys.stderr.write(f"{env_id}: {'drawn' if done.returncode == 0 else done.stderr.strip().splitlines()[-1]}\n")


def write(picture: NDArray[np.uint8], file: Path) -> None:
    """Write a picture, shape [h, w, 3], cut and scaled to the size of all.

    Raises:
        NothingDrawn: it is of one colour, or nearly.
    """
    from PIL import Image, ImageOps

    contrast = float(picture.mean(axis=2).std())
    if contrast < _LEAST_CONTRAST:
        raise NothingDrawn(f"{file.name} has a contrast of {contrast:.1f}, expected at least {_LEAST_CONTRAST}.")
    ImageOps.fit(Image.fromarray(picture), (WIDTH, HEIGHT)).save(file, quality=70, optimize=True)


def _drawn(env_id: str) -> NDArray[np.uint8]:
    mode = next(iter(catalogue().environments[env_id].control_modes))
    env = ManiSkillEnv(PREFIX + env_id, max_steps=1, settings={"control_mode": mode}, draws=True)
    env.reset(options={RNG_SEED: 0})
    return env.picture()


if __name__ == "__main__":
    main()
