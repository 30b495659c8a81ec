"""Makes the playback files of an episode, in a process of its own: `python -m vitac.evaluator.playback.making`.

No policy runs: the recorded actions go through the physics again, and every state must be the recorded one.
"""

import os
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import IO, TYPE_CHECKING

from vitac.envs.errors import VitacError
from vitac.envs.maniskill.definition import is_maniskill

from ..episodes.episode import make_environment
from ..episodes.records import EpisodeRecord
from ..tracks import Task, load_track
from .film import make_film
from .order import CAMERAS_FILE, SCENE_FILE, STILL_FILE, NotPlayable, PlaybackMessage, PlaybackOrder
from .recorded import find_start, require_same_end, require_same_state

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from vitac.envs.drawing.playback import Playback
    from vitac.envs.tactile.design import SensorDesign

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
    from vitac.envs.playback_files.cameras import pack_cameras
    from vitac.envs.playback_files.scene import pack_scene

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
) -> "Playback":
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


def _write_still(playback: "Playback", path: Path) -> None:
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
    """Read the order from standard input and answer on standard output, to which nobody else may write."""
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as answers:
        os.dup2(2, 1)
        serve(sys.stdin.buffer.read(), answers)


if __name__ == "__main__":
    main()
