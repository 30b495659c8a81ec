"""`vitac show`: draws an episode."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import typer
from vitac.envs.extras import require_extra
from vitac.envs.maniskill.definition import is_maniskill

from ..terminal.output import AsJson, Assets, existing_file
from .playing import EpisodeStart, NothingToShow, Shown, ShownEpisode, film, find_start, no_such_env_step, player

if TYPE_CHECKING:
    from vitac.envs.drawing.camera_view import DrawnQuantity
    from vitac.envs.drawing.files import Destination, Format, Frame, Picture
    from vitac.envs.drawing.picture import Caption
    from vitac.envs.drawing.playback import EpisodePlayback, Pace
    from vitac.envs.tasks.task_env import TactileTaskEnv
    from vitac.envs.vision.camera import Sight

_PICTURE_WIDTH_PX, _ANIMATION_WIDTH_PX = 1600, 1000
_BETWEEN_MS, _ENV_STEP_MS, _END_MS = 120, 700, 2500


_Policy = Annotated[Path | None, typer.Option(help="Submission whose policy acts, in its sandbox.")]
_Actions = Annotated[
    Path | None,
    typer.Option(callback=existing_file, help="Log with the actions: ours, or a 2025 text log."),
]
_Out = Annotated[
    Path | None,
    typer.Option(help="FILE.png, .gif or .webp, or a new folder for a PNG per moment; TASK-EPISODE.png by default."),
]
_Colour = Annotated[
    Literal["stress", "displacement"] | None,
    typer.Option(help="Quantity that colours the gels; stress by default."),
]
_Step = Annotated[
    int | None, typer.Option(min=0, help="Env step that a PNG shows, 0 is the reset; the last by default.")
]
_Every = Annotated[
    Literal["env-step", "ipc-step"] | None,
    typer.Option(help="Interval of pictures; ipc-step by default for animations."),
]
_Width = Annotated[
    int | None,
    typer.Option(min=600, max=4000, help="Width in pixels; 1600 by default, 1000 for animations, 640 for ManiSkill."),
]
_View = Annotated[
    Literal["episode", "cameras", "rast", "rt"],
    typer.Option(
        help="Scene and sensors; or what the camera rig sees: colour, depth, infrared pair, cloud; or its colour "
        "picture beside one by SAPIEN, rasterised or ray-traced (extra vision, unscored)."
    ),
]


def command(
    task: Annotated[str, typer.Argument(help="Task, such as peg-insertion, or the id of an environment.")],
    episode: Annotated[
        int, typer.Option(help="Number in the task's list; for an environment, the seed of a random start.")
    ],
    policy: _Policy = None,
    actions: _Actions = None,
    out: _Out = None,
    colour: _Colour = None,
    step: _Step = None,
    every: _Every = None,
    width: _Width = None,
    assets: Assets = None,
    view: _View = "episode",
    as_json: AsJson = False,
) -> None:
    """Draw an episode: gels by stress or displacement, the held part, the fixed part cut open, and both marker flows.

    Without --policy and --actions the part moves straight to its target, which a policy cannot do because it does not
    know where the target is. Of ManiSkill's environments, SAPIEN draws what a camera beside the robot sees; without
    actions, the start.
    """
    require_extra("show", "matplotlib", "PIL", user="Drawing")
    if policy and actions:
        raise typer.BadParameter("expected one of them, got both.", param_hint="--policy and --actions")
    destination = _destination(out or Path(f"{task.rpartition('/')[2]}-{episode}.png"), step)
    start = find_start(task, episode)
    if is_maniskill(start.env_id):
        tactile = {"--colour": colour, "--assets": assets, "--view": view != "episode", "--every": every == "ipc-step"}
        _refuse_for_maniskill(start.env_id, [name for name, given in tactile.items() if given])
        each_step = every == "env-step"
        shown = film(start, (policy, actions), destination, step=step, each_step=each_step, width_px=width)
        _report(shown, as_json=as_json)
        return
    from vitac.envs.drawing.camera_view import DrawnQuantity

    caption, playback = _played(start, policy, actions, assets, _pace(every, destination))
    width_px = width or (_ANIMATION_WIDTH_PX if destination.format.is_animated else _PICTURE_WIDTH_PX)
    moments = _chosen(playback, destination.format, step)
    if view == "cameras":
        pictures = _draw_cameras(playback, caption.title, width_px=width_px, moments=moments)
    elif view != "episode":
        pictures = _render(playback, caption.title, view, width_px=width_px, moments=moments)
    else:
        pictures = _draw(playback, caption, DrawnQuantity(colour or "stress"), width_px=width_px, moments=moments)
    written = destination.write(_frames(playback, pictures, moments))
    last = playback.moments[-1]
    shown = Shown(
        title=caption.title,
        actions=caption.actions,
        end_reason=last.end_reason,
        env_steps=last.env_step,
        beliefs=_beliefs(playback),
        files=tuple(written),
    )
    _report(shown, as_json=as_json)


def _refuse_for_maniskill(env_id: str, given: list[str]) -> None:
    if given:
        raise typer.BadParameter(
            f"there are no gels and no cameras of ours in {env_id}.", param_hint=" and ".join(given)
        )


def _destination(path: Path, step: int | None) -> "Destination":
    """Return where the pictures go.

    Raises:
        typer.BadParameter: one env step cannot be shown there.
    """
    from vitac.envs.drawing.files import Destination

    destination = Destination.from_path(path)
    if step is not None and destination.format is not destination.format.PNG:
        raise typer.BadParameter("expected a single PNG as output for one env step.", param_hint="--step")
    return destination


def _played(
    start: EpisodeStart, policy: Path | None, actions: Path | None, assets: Path | None, pace: "Pace"
) -> "tuple[Caption, EpisodePlayback]":
    """Play the episode, and return what is written above its pictures and what is drawn of it."""
    from vitac.envs.drawing.picture import Caption

    from ..terminal.compiling import compiling_shown

    with compiling_shown(), player(start, policy, actions) as played:
        playback = _record(played, assets, pace)
    start = played.start
    title = start.title if start.listed else f"{start.title}: {playback.held.name}"
    return Caption(title=title, actions=played.actions), playback


def _pace(every: str | None, destination: "Destination") -> "Pace":
    from vitac.envs.drawing.playback import Pace

    if every:
        return Pace(every)
    return Pace.IPC_STEP if destination.format.is_animated else Pace.ENV_STEP


def _record(played: ShownEpisode, assets: Path | None, pace: "Pace") -> "EpisodePlayback":
    """Play the episode and keep what is drawn of it."""
    import gymnasium
    from vitac.envs.drawing.playback import record

    start = played.start
    arguments: dict[str, Any] = {"assets_dir": assets, **start.settings}
    made = gymnasium.make(start.env_id, disable_env_checker=True, **arguments)
    env = cast("TactileTaskEnv[Any, Any]", made.unwrapped)
    return record(env, options=start.options, next_action=played.next_action, pace=pace, belief=played.belief)


def _chosen(playback: "EpisodePlayback", form: "Format", step: int | None) -> slice:
    """Return the moments to draw."""
    if form is not form.PNG:
        return slice(None)
    ends = playback.last_moments
    if step is not None and step >= len(ends):
        raise no_such_env_step(step, len(ends) - 1)
    index = ends[-1 if step is None else step]
    return slice(index, index + 1)


def _frames(playback: "EpisodePlayback", pictures: "Iterator[Picture]", moments: slice) -> "Iterator[Frame]":
    """Yield the pictures of these moments with their names and durations."""
    from vitac.envs.drawing.files import Frame

    shown = list(_names_and_durations(playback))[moments]
    for picture, (name, duration_ms) in zip(pictures, shown, strict=True):
        yield Frame(picture=picture, name=name, duration_ms=duration_ms)


def _names_and_durations(playback: "EpisodePlayback") -> Iterator[tuple[str, int]]:
    """Yield file name and duration on screen [ms] of every moment."""
    first = 0
    for index, moment in enumerate(playback.moments):
        if index in playback.last_moments:
            yield f"step-{moment.env_step:02}", _END_MS if moment is playback.moments[-1] else _ENV_STEP_MS
            first = index + 1
        else:
            yield f"step-{moment.env_step:02}-ipc-{index - first + 1:02}", _BETWEEN_MS


def _draw(
    playback: "EpisodePlayback", caption: "Caption", quantity: "DrawnQuantity", *, width_px: int, moments: slice
) -> "Iterator[Picture]":
    """Yield the pictures of these moments, with a progress bar while they are drawn."""
    from rich.console import Console
    from rich.progress import track
    from vitac.envs.drawing.picture import draw

    pictures = draw(playback, caption, quantity=quantity, width_px=width_px, moments=moments)
    total = len(playback.moments[moments])
    yield from track(pictures, description="drawing", total=total, console=Console(stderr=True), transient=True)


def _draw_cameras(playback: "EpisodePlayback", title: str, *, width_px: int, moments: slice) -> "Iterator[Picture]":
    """Return pictures of what the camera rig saw at these moments.

    Raises:
        NothingToShow: the task has no camera rig.
    """
    from vitac.envs.drawing.camera_view import camera_sheet

    return (
        camera_sheet(sight, f"{title}, env step {step}", width_px=width_px) for step, sight in _seen(playback, moments)
    )


def _render(
    playback: "EpisodePlayback", title: str, mode: str, *, width_px: int, moments: slice
) -> "Iterator[Picture]":
    """Return the colour pictures of these moments beside SAPIEN's.

    Raises:
        NothingToShow: the task has no camera rig.
        RendererMissing: SAPIEN or a driver for it is missing.
    """
    from vitac.envs.drawing.camera_view import rendered_sheet
    from vitac.envs.vision.renderer import RenderMode, make_renderer

    seen = _seen(playback, moments)
    render = make_renderer(RenderMode(mode)).picture
    return (
        rendered_sheet(sight, render(sight), f"{title}, env step {step}", mode=RenderMode(mode), width_px=width_px)
        for step, sight in seen
    )


def _seen(playback: "EpisodePlayback", moments: slice) -> "list[tuple[int, Sight]]":
    """Return env step and sight of these moments.

    Raises:
        NothingToShow: the task has no camera rig.
    """
    chosen = playback.moments[moments]
    seen = [(moment.env_step, moment.sight) for moment in chosen if moment.sight is not None]
    if not seen:
        raise NothingToShow(f"{playback.env_id} has no cameras beside the gripper: expected --view episode.")
    return seen


def _beliefs(playback: "EpisodePlayback") -> list[dict[str, Any]]:
    """Return what the policy believed of the offset after an env step, beside what was true [mm, deg]."""
    from vitac.envs.drawing.playback import TRUE_OFFSET

    return [
        {"env_step": moment.env_step, "believed": believed.tolist(), "true": moment.info[TRUE_OFFSET].tolist()}
        for moment in playback.looks
        if (believed := moment.believed) is not None
    ]


def _report(shown: Shown, *, as_json: bool) -> None:
    outcome = shown.end_reason or "not ended"
    if as_json:
        from ..terminal.output import print_json

        files = [str(path) for path in shown.files]
        summary = {"title": shown.title, "actions": shown.actions, "outcome": outcome, "env_steps": shown.env_steps}
        print_json(summary | {"beliefs": shown.beliefs, "files": files})
        return
    from vitac.evaluator.episodes.records import EpisodeOutcome, counted_env_steps

    print(f"{shown.title}: {outcome} after {counted_env_steps(shown.env_steps)}")
    if shown.end_reason:
        print(EpisodeOutcome(shown.end_reason).sentence)
    print(f"actions: {shown.actions}")
    for row in shown.beliefs:
        believed, true = (" ".join(f"{value:+.2f}" for value in row[key]) for key in ("believed", "true"))
        print(f"offset [mm, deg] before env step {row['env_step'] + 1}: believed {believed}, true {true}")
    for path in shown.files:
        print(path)
