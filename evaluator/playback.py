"""Makes the playback files of a record; run as a program it makes those that another process asks for."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final

from pydantic import NonNegativeInt, ValidationError
from vitac.envs.maniskill.definition import is_maniskill
from vitac.envs.tasks.definition import Family
from vitac.errors import VitacError

from .episodes.episode import make_environment
from .episodes.records import EpisodeRecord
from .parent_death import end_with_parent
from .sensors.made import MadeSensor
from .strict_model import StrictModel
from .tracks import Episode, Task, load_track

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from vitac.envs.drawing.playback import EpisodePlayback
    from vitac.envs.maniskill.env import ManiSkillEnv
    from vitac.envs.maniskill.film import FilmMoment
    from vitac.envs.tactile.design import SensorDesign


FORMAT: Final = 3
"""Number of the file format; playbacks in an older one are made again."""


SCENE_FILE, CAMERAS_FILE, STILL_FILE, FILM_FILE = "scene.bin.gz", "cameras.bin.gz", "still.webp", "film.webp"


class NotPlayable(VitacError):
    """There are no playbacks of a task's episodes; the message says why."""


def require_playable(task: Task) -> None:
    """Refuse a task of which there are no playbacks, before one is asked for.

    Raises:
        NotPlayable: it is played on a station, or its states do not repeat, so what would be shown is not what was
            scored.
    """
    if task.family is Family.STATION:
        raise NotPlayable(f"There are no playbacks of {task.name}: it is played on a station, not in a simulation.")
    if not task.definition.repeats:
        raise NotPlayable(
            f"There are no playbacks of {task.env_id} with these settings: its states do not repeat, so what would be "
            "shown is not what was scored."
        )


class PlaybackOrder(StrictModel):
    """What is to be made: the files of one finished episode, in a folder.

    `list_seed` is that of a sealed list; None: the one in the track's file. `sensor` is a team's own; None: the
    challenge's.
    """

    track: str
    record: EpisodeRecord
    list_seed: int | None = None
    sensor: MadeSensor | None = None
    folder: Path


class PlaybackMessage(StrictModel):
    """One line from the process: how many env steps are played, or why there is no playback, or that it is made."""

    env_steps: NonNegativeInt | None = None
    error: str | None = None
    is_made: bool = False


class StatesDiffer(VitacError):
    """A re-simulated state is not the recorded one, so what would be shown is not what was scored."""


def find_start(task: Task, record: EpisodeRecord, list_seed: int | None = None) -> Episode:
    """Return where a recorded episode started, in the public list or in one with another seed."""
    listed = task.episode_list
    return Episode(
        number=record.episode,
        shape=record.shape,
        offset=record.initial_offset,
        offset_option=listed.offset_option,
        list_seed=listed.list_seed if list_seed is None else list_seed,
    )


def require_same_state(state_hash: str, record: EpisodeRecord, env_step: int) -> None:
    """Compare a state hash with that of the record.

    Raises:
        StatesDiffer: it is another one, or the record ends before.
    """
    if env_step >= len(record.state_hashes) or state_hash != record.state_hashes[env_step]:
        raise StatesDiffer(
            f"The state after env step {env_step} is not the recorded one: the episode was recorded with another "
            "evaluator or on another platform class, so it cannot be shown here."
        )


def require_same_end(env_steps: int, record: EpisodeRecord) -> None:
    """Compare where an episode has ended with its record.

    Raises:
        StatesDiffer: it ended elsewhere.
    """
    if env_steps != record.env_steps:
        raise StatesDiffer(f"Expected {record.env_steps} env steps as recorded, got {env_steps}.")


WIDTH_PX = 480


def make_film(
    task: Task, record: EpisodeRecord, on_step: Callable[[int], None], folder: Path, list_seed: int | None = None
) -> None:
    """Write the film of an episode and its last picture into a folder.

    Raises:
        ManiSkillMissing: a package or the driver that draws is missing.
        StatesDiffer: a state is not the recorded one.
    """
    from vitac.envs.drawing.files import Destination, Frame
    from vitac.envs.maniskill.env import ManiSkillEnv
    from vitac.envs.maniskill.film import END_MS, ENV_STEP_MS, captioned, select_env_steps, shots

    env = ManiSkillEnv(task.env_id, max_steps=task.max_steps, settings=dict(task.settings), draws=True)
    moments = _as_recorded(env, task, record, on_step, list_seed)
    every = select_env_steps(task.max_steps)
    title = f"{task.title}, episode {record.episode}"
    last: Frame | None = None

    def frames() -> "Iterator[Frame]":
        nonlocal last
        for shot in shots(env, moments, lambda env_step: env_step % every == 0):
            last = Frame(picture=captioned(shot, title, WIDTH_PX), name="still", duration_ms=ENV_STEP_MS)
            yield last
        require_same_end(shot.moment.env_step, record)

    Destination.from_path(folder / FILM_FILE).write(frames(), end_ms=END_MS)
    assert last is not None  # noqa: S101 - the start is drawn in any case
    Destination.from_path(folder / STILL_FILE).write([last])


def _as_recorded(
    env: "ManiSkillEnv", task: Task, record: EpisodeRecord, on_step: Callable[[int], None], list_seed: int | None
) -> "Iterator[FilmMoment]":
    """Play the recorded actions, and compare every state before it is drawn."""
    from vitac.envs.maniskill.film import play

    remaining = iter(record.actions.to_array())
    options = find_start(task, record, list_seed).options
    for moment in play(env, options=options, next_action=lambda _, __: next(remaining, None)):
        require_same_state(env.state_hash(), record, moment.env_step)
        on_step(moment.env_step)
        yield moment


OnStep = Callable[[int], None]
"""Gets the number of env steps that are played."""


STILL_QUALITY = 85


def make(order: PlaybackOrder, on_step: OnStep) -> None:
    """Write the files of an episode into the order's folder; the still only where it can be drawn.

    Raises:
        ManiSkillMissing: a film is wanted, and what draws it is not here.
        StatesDiffer: the record is of another evaluator or platform class, or not true.
        PlaybackTooLarge: the episode does not fit into a file.
    """
    from vitac.envs.playback_files.scene import pack_scene
    from vitac.envs.playback_files.stage import pack_cameras

    task = load_track(order.track).tasks[order.record.task]
    if is_maniskill(task.env_id):
        make_film(task, order.record, on_step, order.folder, order.list_seed)
        return
    sensor = None if order.sensor is None else order.sensor.design()
    playback = replay(task, order.record, on_step, order.list_seed, sensor)
    (order.folder / SCENE_FILE).write_bytes(pack_scene(playback))
    cameras = pack_cameras(playback)
    if cameras is not None:
        (order.folder / CAMERAS_FILE).write_bytes(cameras)
    if can_draw():
        _write_still(playback, order.folder / STILL_FILE)


def replay(
    task: Task,
    record: EpisodeRecord,
    on_step: OnStep,
    list_seed: int | None = None,
    sensor: "SensorDesign | None" = None,
) -> "EpisodePlayback":
    """Return the re-simulated episode of a record.

    Raises:
        NotPlayable: the task has another kind of environment.
        StatesDiffer: a state is not the recorded one.
    """
    from vitac.envs.drawing.playback import Pace
    from vitac.envs.drawing.playback import record as play
    from vitac.envs.tasks.task_env import TactileTaskEnv

    # Where teams bring sensors, only text logs have none.
    env = make_environment(task.apply_text_log_settings() if sensor is None else task, sensor=sensor)
    if not isinstance(env, TactileTaskEnv):
        raise NotPlayable(
            f"Episodes of {task.env_id} are not shown in 3D: a playback shows two gels and what they hold."
        )
    remaining = iter(record.actions.to_array())
    played = 0

    def next_action(_: object, __: object) -> "NDArray[np.float32] | None":
        nonlocal played
        require_same_state(env.state_hash(), record, played)
        on_step(played)
        played += 1
        return next(remaining, None)

    playback = play(
        env, options=find_start(task, record, list_seed).options, next_action=next_action, pace=Pace.IPC_STEP
    )
    last = playback.moments[-1].env_step
    require_same_state(env.state_hash(), record, last)
    require_same_end(last, record)
    if played <= last:  # It ended with its last env step, so nobody asked for another action.
        on_step(last)
    return playback


def can_draw() -> bool:
    """Return whether Pillow is installed, which writes stills (extra `show`)."""
    return find_spec("PIL") is not None


def _write_still(playback: "EpisodePlayback", path: Path) -> None:
    from PIL import Image
    from vitac.envs.playback_files.still import draw_still

    Image.fromarray(draw_still(playback)).save(path, "webp", quality=STILL_QUALITY)


def serve(order: bytes, answers: IO[str]) -> None:
    """Carry out one order and write its messages."""

    def send(message: PlaybackMessage) -> None:
        answers.write(message.model_dump_json(exclude_unset=True) + "\n")
        answers.flush()

    try:
        make(PlaybackOrder.model_validate_json(order), lambda count: send(PlaybackMessage(env_steps=count)))
    except VitacError as error:
        send(PlaybackMessage(error=str(error)))
    else:
        send(PlaybackMessage(is_made=True))


def main() -> None:
    """Read the order from standard input and answer on standard output, to which nobody else may write.

    The argument is the process that started this one, with which it ends.
    """
    end_with_parent(int(sys.argv[1]))
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as answers:
        os.dup2(2, 1)
        serve(sys.stdin.buffer.read(), answers)


COMMAND = (sys.executable, "-P", "-m", "vitac.evaluator.playback")


class PlaybackFailed(VitacError):
    """There is no playback of this episode, and trying again would not make one; the message says why."""


class MakingBroke(VitacError):
    """The process ended without an answer: it was ended, or the machine broke. Run it again."""


class MakingProcess:
    """A running process that makes a playback; see `making`."""

    def __init__(self, process: "subprocess.Popen[bytes]", order: PlaybackOrder) -> None:
        self._process = process
        self._order = order

    def played(self) -> Iterator[int]:
        """Yield the number of played env steps whenever it has grown; at the end, the files are in the order's folder.

        Raises:
            PlaybackFailed: the process says why there will be none.
            MakingBroke: it ended early.
        """
        assert self._process.stdin is not None  # noqa: S101 - both are pipes
        assert self._process.stdout is not None  # noqa: S101
        with suppress(BrokenPipeError), self._process.stdin as stream:
            stream.write(self._order.model_dump_json().encode())
        for line in self._process.stdout:
            message = _read(line)
            if message.error is not None:
                raise PlaybackFailed(message.error)
            if message.is_made:
                return
            if message.env_steps is not None:
                yield message.env_steps
        raise MakingBroke(f"The process of a playback ended with exit code {self._process.wait()} and no answer.")

    def kill(self) -> None:
        """End it at once; `played` then raises. Any thread may call it."""
        self._process.kill()


@contextmanager
def making(order: PlaybackOrder) -> Iterator[MakingProcess]:
    """Start the process of a playback, which has ended when the block is left.

    Raises:
        MakingBroke: it cannot be started.
    """
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    try:
        process = subprocess.Popen(  # noqa: S603 - our own interpreter and module
            (*COMMAND, str(os.getpid())),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | threads,
            start_new_session=True,
        )
    except OSError as error:
        raise MakingBroke(f"The process of a playback could not be started: {error.strerror}.") from error
    with process:
        try:
            yield MakingProcess(process, order)
        finally:
            process.kill()


def _read(line: bytes) -> PlaybackMessage:
    try:
        return PlaybackMessage.model_validate_json(line)
    except ValidationError as error:  # It was killed in the middle of a line.
        raise MakingBroke("The process of a playback ended in the middle of an answer.") from error


if __name__ == "__main__":
    main()
