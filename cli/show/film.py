"""Episodes of ManiSkill, drawn by SAPIEN with the camera that the environment has for people."""

from pathlib import Path
from typing import TYPE_CHECKING

from .playing import Shown, no_such_env_step, player

if TYPE_CHECKING:
    from collections.abc import Iterator

    from vitac.envs.drawing.files import Destination, Frame
    from vitac.envs.maniskill.film import Moment

    from .playing import EpisodeStart, ShownEpisode


_WIDTH_PX = 640


def film(
    start: "EpisodeStart",
    sources: tuple[Path | None, Path | None],
    destination: "Destination",
    *,
    step: int | None,
    each_step: bool,
    width_px: int | None,
) -> Shown:
    """Play an episode of ManiSkill and write its pictures.

    Args:
        start: of the episode.
        sources: policy and actions; at most one of them.
        destination: where the pictures go.
        step: env step that a PNG shows; None: the last one.
        each_step: whether an animation has a picture for every env step, however many there are.
        width_px: of the pictures [px]; None: the default.

    Raises:
        ManiSkillMissing: a package or the driver that draws is missing.
        NothingToShow: there is no such episode or env step.
    """
    from vitac.envs.drawing.files import Frame
    from vitac.envs.maniskill.env import ManiSkillEnv
    from vitac.envs.maniskill.film import END_MS, ENV_STEP_MS, captioned, play, select_env_steps, shots

    assert start.listed is not None  # noqa: S101 - the ids of ManiSkill are no starts of their own
    task, _ = start.listed
    env = ManiSkillEnv(task.env_id, max_steps=task.max_steps, settings=dict(task.settings), draws=True)
    is_one = destination.format is destination.format.PNG
    every = select_env_steps(task.max_steps) if destination.format.is_animated and not each_step else 1
    n_digits = max(2, len(str(task.max_steps)))
    last: Moment

    def frames(played: "ShownEpisode") -> "Iterator[Frame]":
        nonlocal last
        title = f"{played.start.title}; actions: {played.actions}"
        moments = play(env, options=played.start.options, next_action=played.next_action)
        taken = shots(env, moments, lambda env_step: env_step == step if is_one else env_step % every == 0)
        for shot in taken:
            last = shot.moment
            if is_one and step not in {None, last.env_step}:  # the last moment, which is drawn in any case
                continue
            name = f"step-{last.env_step:0{n_digits}}"
            yield Frame(picture=captioned(shot, title, width_px or _WIDTH_PX), name=name, duration_ms=ENV_STEP_MS)

    with player(start, *sources) as played:
        written = destination.write(frames(played), end_ms=END_MS)
    if not written:
        raise no_such_env_step(step, last.env_step)
    return Shown(
        title=played.start.title,
        actions=played.actions,
        end_reason=last.end_reason,
        env_steps=last.env_step,
        files=tuple(written),
    )
