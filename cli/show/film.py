"""Episodes of ManiSkill, drawn by SAPIEN with the camera that the environment has for people."""

from pathlib import Path
from typing import TYPE_CHECKING

from .playing import Shown, no_such_env_step, player

if TYPE_CHECKING:
    from vitac.envs.drawing.files import Destination
    from vitac.envs.maniskill.film import Moment, Picture

    from .playing import Start

_WIDTH_PX = 640


def film(
    start: "Start",
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
    from vitac.envs.maniskill.env import ManiSkillEnv
    from vitac.envs.maniskill.film import END_MS, ENV_STEP_MS, captioned, env_steps_between, play, shots

    assert start.listed is not None  # noqa: S101 - the ids of ManiSkill are no starts of their own
    task, _ = start.listed
    env = ManiSkillEnv(task.env_id, max_steps=task.max_steps, settings=dict(task.settings), draws=True)
    is_one = destination.kind is destination.kind.PNG
    every = env_steps_between(task.max_steps) if destination.kind.is_animated and not each_step else 1
    if is_one:  # the reset and the last one are drawn in any case
        every = step or task.max_steps + 1
    written: list[Path] = []
    kept: list[tuple[Moment, Picture]] = []
    with player(start, *sources) as played:
        title = f"{played.start.title}; actions: {played.actions}"
        moments = play(env, options=played.start.options, next_action=played.next_action)
        for shot in shots(env, moments, every):
            last, picture = shot.moment, captioned(shot, title, width_px or _WIDTH_PX)
            if destination.kind is destination.kind.FOLDER:  # a long episode is more than memory holds
                name = f"step-{last.env_step:02}"
                written += destination.write([picture], names=[name], durations_ms=[ENV_STEP_MS])
            elif not is_one or last.env_step == step or step is None:
                kept.append((last, picture))
    if is_one:
        kept = kept[-1:]
    if kept:
        written = destination.write(
            [picture for _, picture in kept],
            names=[destination.path.stem] * len(kept),
            durations_ms=[END_MS if moment is last else ENV_STEP_MS for moment, _ in kept],
        )
    if not written:
        raise no_such_env_step(step, last.env_step)
    return Shown(
        title=played.start.title,
        actions=played.actions,
        end_reason=last.end_reason,
        env_steps=last.env_step,
        files=tuple(written),
    )
