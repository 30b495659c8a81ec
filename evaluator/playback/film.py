"""Films of ManiSkill's episodes: their recorded actions are played again, and SAPIEN draws what a camera sees."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from ..episodes.records import EpisodeRecord
from ..tracks import Task
from .order import FILM_FILE, STILL_FILE
from .recorded import find_start, require_same_end, require_same_state

if TYPE_CHECKING:
    from vitac.envs.maniskill.env import ManiSkillEnv
    from vitac.envs.maniskill.film import Moment

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
) -> "Iterator[Moment]":
    """Play the recorded actions, and compare every state before it is drawn."""
    from vitac.envs.maniskill.film import play

    remaining = iter(record.actions.to_array())
    options = find_start(task, record, list_seed).options
    for moment in play(env, options=options, next_action=lambda _, __: next(remaining, None)):
        require_same_state(env.state_hash(), record, moment.env_step)
        on_step(moment.env_step)
        yield moment
