"""`vitac show`: draws an episode."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import typer
from vitac.envs.errors import VitacError
from vitac.envs.extras import install_command

from .terminal.existing import existing_file
from .terminal.output import AsJson

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from vitac.envs.drawing.colouring import Quantity
    from vitac.envs.drawing.files import Destination, Kind
    from vitac.envs.drawing.picture import Caption
    from vitac.envs.drawing.playback import NextAction, Pace, Playback
    from vitac.envs.tasks.task_env import Info, Observation, TactileTaskEnv
    from vitac.envs.vision.camera import Sight
    from vitac.evaluator.logs.recordings import Recording
    from vitac.evaluator.tracks import Episode, Task

_EXTRA = "show"
_PICTURE_WIDTH_PX, _ANIMATION_WIDTH_PX = 1600, 1000
_BETWEEN_MS, _ENV_STEP_MS, _END_MS = 120, 700, 2500


class ExtraMissing(VitacError):
    """The drawing packages are not installed; the message is the command that installs them."""


class NothingToShow(VitacError):
    """The episode has no recorded actions, or no such env step."""


@dataclass(frozen=True, kw_only=True)
class Start:
    """The start of an episode.

    Attributes:
        env_id: id of the environment.
        title: names the episode.
        options: reset options.
        settings: of the environment that are not its defaults.
        listed: task and episode of the list; None for a random start of an environment.
    """

    env_id: str
    title: str
    options: Mapping[str, object]
    settings: Mapping[str, object] = field(default_factory=dict)
    listed: "tuple[Task, Episode] | None" = None


@dataclass(frozen=True, kw_only=True)
class Played:
    """The start of an episode, its actions, and a description of where they come from."""

    start: Start
    next_action: "NextAction"
    actions: str


_Policy = Annotated[Path | None, typer.Option(help="Submission whose policy acts, in its sandbox.")]
_Actions = Annotated[
    Path | None,
    typer.Option(callback=existing_file, help="Log with the actions: ours, or a 2025 text log as JSON lines."),
]
_Out = Annotated[
    Path | None,
    typer.Option(help="FILE.png, .gif or .webp, or a new folder for a PNG per moment; TASK-EPISODE.png by default."),
]
_Colour = Annotated[Literal["stress", "displacement"], typer.Option(help="Quantity that colours the gels.")]
_Step = Annotated[
    int | None, typer.Option(min=0, help="Env step that a PNG shows, 0 is the reset; the last by default.")
]
_Every = Annotated[
    Literal["env-step", "ipc-step"] | None,
    typer.Option(help="Interval of pictures; ipc-step by default for animations."),
]
_Width = Annotated[
    int | None, typer.Option(min=600, max=4000, help="Width in pixels; 1600 by default, 1000 for animations.")
]
_Assets = Annotated[Path | None, typer.Option(help="Folder with the challenge's own meshes [env: VITAC_ASSETS_DIR].")]
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
    colour: _Colour = "stress",
    step: _Step = None,
    every: _Every = None,
    width: _Width = None,
    assets: _Assets = None,
    view: _View = "episode",
    as_json: AsJson = False,
) -> None:
    """Draw an episode: gels by stress or displacement, the held part, the fixed part cut open, and both marker flows.

    Without --policy and --actions the part moves straight to its target, which a policy cannot do because it does not
    know where the target is.
    """
    require_extra()
    from vitac.envs.drawing.colouring import Quantity

    if policy and actions:
        raise typer.BadParameter("expected one of them, got both.", param_hint="--policy and --actions")
    destination = _destination(out or Path(f"{task.rpartition('/')[2]}-{episode}.png"), step)
    caption, playback = _played(find_start(task, episode), policy, actions, assets, _pace(every, destination))
    width_px = width or (_ANIMATION_WIDTH_PX if destination.kind.is_animated else _PICTURE_WIDTH_PX)
    moments = _chosen(playback, destination.kind, step)
    if view == "cameras":
        pictures = _draw_cameras(playback, caption.title, width_px=width_px, moments=moments)
    elif view != "episode":
        pictures = _render(playback, caption.title, view, width_px=width_px, moments=moments)
    else:
        pictures = _draw(playback, caption, Quantity(colour), width_px=width_px, moments=moments)
    names, durations_ms = zip(*_names_and_durations(playback), strict=True)
    written = destination.write(pictures, names=names[moments], durations_ms=durations_ms[moments])
    _report(caption, playback, written, as_json=as_json)


def _destination(path: Path, step: int | None) -> "Destination":
    """Return where the pictures go.

    Raises:
        typer.BadParameter: one env step cannot be shown there.
    """
    from vitac.envs.drawing.files import Destination

    destination = Destination.at(path)
    if step is not None and destination.kind is not destination.kind.PNG:
        raise typer.BadParameter("expected a single PNG as output for one env step.", param_hint="--step")
    return destination


def _played(
    start: Start, policy: Path | None, actions: Path | None, assets: Path | None, pace: "Pace"
) -> "tuple[Caption, Playback]":
    """Play the episode, and return what is written above its pictures and what is drawn of it."""
    from vitac.envs.drawing.picture import Caption

    from .terminal.compiling import compiling_shown

    with compiling_shown(), _player(start, policy, actions) as played:
        playback = _record(played, assets, pace)
    start = played.start
    title = start.title if start.listed else f"{start.title}: {playback.held.name}"
    return Caption(title=title, actions=played.actions), playback


def require_extra() -> None:
    """Check that the drawing packages are installed.

    Raises:
        ExtraMissing: one is not.
    """
    if find_spec("matplotlib") and find_spec("PIL"):
        return
    raise ExtraMissing(f"Drawing needs the extra {_EXTRA!r}; install it with: {install_command(_EXTRA)}")


def find_start(task: str, number: int) -> Start:
    """Return an episode of a task's list, or a random start of an environment with the number as its seed.

    Raises:
        UnknownTask: there is neither such a task nor such an environment.
        UnknownEpisodes: the list does not have that number.
        NotDrawable: the task is not on the tactile simulation.
    """
    from vitac.envs import ENVIRONMENTS
    from vitac.envs.drawing.drawable import require_tactile
    from vitac.evaluator.tracks import find_task
    from vitac.evaluator.tracks.cut import cut

    if task in ENVIRONMENTS:
        return Start(env_id=task, title=f"{task}, random start {number}", options={"rng_seed": number})
    _, definition = find_task(task)
    require_tactile(definition.definition)
    (shard,) = cut(definition, [number])
    return _listed(definition, shard.episodes[0])


def _listed(task: "Task", episode: "Episode") -> Start:
    title = f"{task.title}, episode {episode.number}: {episode.shape}"
    return Start(
        env_id=task.env_id, title=title, options=episode.options, settings=task.settings, listed=(task, episode)
    )


def _pace(every: str | None, destination: "Destination") -> "Pace":
    from vitac.envs.drawing.playback import Pace

    if every:
        return Pace(every)
    return Pace.IPC_STEP if destination.kind.is_animated else Pace.ENV_STEP


def _record(played: Played, assets: Path | None, pace: "Pace") -> "Playback":
    """Play the episode and keep what is drawn of it."""
    import gymnasium
    from vitac.envs.assets import assets_dir_from_environment
    from vitac.envs.drawing.playback import record

    start = played.start
    arguments: dict[str, Any] = {"assets_dir": assets or assets_dir_from_environment(), **start.settings}
    made = gymnasium.make(start.env_id, disable_env_checker=True, **arguments)
    env = cast("TactileTaskEnv[Any, Any]", made.unwrapped)
    return record(env, options=start.options, next_action=played.next_action, pace=pace)


@contextmanager
def _player(start: Start, policy: Path | None, actions: Path | None) -> Iterator[Played]:
    from vitac.envs.drawing.drawable import straight_to_target
    from vitac.envs.scene.guided_motion import DESCRIPTION

    if not policy and not actions:
        yield Played(start=start, next_action=straight_to_target(start.env_id), actions=DESCRIPTION)
        return
    if start.listed is None:
        raise NothingToShow(f"Expected a task such as peg-insertion for --policy or --actions, got {start.env_id}.")
    task, episode = start.listed
    if policy:
        with _policy_player(task, start, policy) as played:
            yield played
    elif actions:
        recording = _recording(task, episode.number, actions)
        start = _listed(task, recording.episode)
        yield Played(start=start, next_action=_one_by_one(recording.actions), actions=actions.name)


@contextmanager
def _policy_player(task: "Task", start: Start, submission: Path) -> Iterator[Played]:
    from vitac.evaluator.agent.session import PolicySession
    from vitac.evaluator.episodes.episode import open_episode
    from vitac.evaluator.episodes.reading import reading_of
    from vitac.evaluator.submission.manifest import load_manifest, stage

    with TemporaryDirectory(prefix="vitac-show-") as folder:
        Path(folder).chmod(0o755)  # Under root the sandbox has its own user, which must be able to read the submission.
        staged = stage(submission, Path(folder) / "submission")
        manifest = load_manifest(staged)
        if task.name not in manifest.tasks:
            raise NothingToShow(
                f"Expected one of the submission's tasks, {', '.join(manifest.tasks)}, got {task.name}."
            )
        reading = reading_of(task, manifest.observation_keys)
        with (
            PolicySession(staged, entry_point=manifest.entry_point) as session,
            open_episode(session, task, reading) as policy,
        ):
            yield Played(
                start=start,
                next_action=lambda seen, _: policy.act({key: seen[key] for key in reading.sent}),
                actions=manifest.name,
            )


def _recording(task: "Task", number: int, path: Path) -> "Recording":
    from vitac.evaluator.logs.recorded_files import read_recordings

    for recording in read_recordings(path, task):
        if recording.episode.number == number:
            return recording
    raise NothingToShow(
        f"{path} contains no actions for episode {number}; `vitac log show` lists the episodes of a log."
    )


def _one_by_one(actions: "NDArray[np.float32]") -> "NextAction":
    remaining = iter(actions)

    def next_action(_: "Observation", __: "Info") -> "NDArray[np.float32] | None":
        return next(remaining, None)

    return next_action


def _chosen(playback: "Playback", kind: "Kind", step: int | None) -> slice:
    """Return the moments to draw."""
    if kind is not kind.PNG:
        return slice(None)
    ends = playback.last_moments
    if step is not None and step >= len(ends):
        raise NothingToShow(
            f"The episode ended after env step {len(ends) - 1}: expected --step 0 to {len(ends) - 1}, got {step}."
        )
    index = ends[-1 if step is None else step]
    return slice(index, index + 1)


def _names_and_durations(playback: "Playback") -> Iterator[tuple[str, int]]:
    """Yield file name and duration on screen [ms] of every moment."""
    first = 0
    for index, moment in enumerate(playback.moments):
        if index in playback.last_moments:
            yield f"step-{moment.env_step:02}", _END_MS if moment is playback.moments[-1] else _ENV_STEP_MS
            first = index + 1
        else:
            yield f"step-{moment.env_step:02}-ipc-{index - first + 1:02}", _BETWEEN_MS


def _draw(
    playback: "Playback", caption: "Caption", quantity: "Quantity", *, width_px: int, moments: slice
) -> "list[NDArray[np.uint8]]":
    """Return the pictures of these moments, with a progress bar while they are drawn."""
    from rich.console import Console
    from rich.progress import track
    from vitac.envs.drawing.picture import draw

    pictures = draw(playback, caption, quantity=quantity, width_px=width_px, moments=moments)
    total = len(playback.moments[moments])
    return list(track(pictures, description="drawing", total=total, console=Console(stderr=True), transient=True))


def _draw_cameras(playback: "Playback", title: str, *, width_px: int, moments: slice) -> "list[NDArray[np.uint8]]":
    """Return what the camera rig saw at these moments.

    Raises:
        NothingToShow: the task has no camera rig.
    """
    from vitac.envs.drawing.camera_view import camera_sheet

    return [
        camera_sheet(sight, f"{title}, env step {step}", width_px=width_px) for step, sight in _seen(playback, moments)
    ]


def _render(playback: "Playback", title: str, mode: str, *, width_px: int, moments: slice) -> "list[NDArray[np.uint8]]":
    """Return the colour pictures of these moments beside SAPIEN's.

    Raises:
        NothingToShow: the task has no camera rig.
        RendererMissing: SAPIEN or a driver for it is missing.
    """
    from vitac.envs.drawing.camera_view import rendered_sheet
    from vitac.envs.vision.rendering.modes import RenderMode
    from vitac.envs.vision.rendering.renderer import renderer_of

    seen = _seen(playback, moments)
    render = renderer_of(RenderMode(mode)).picture
    return [
        rendered_sheet(sight, render(sight), f"{title}, env step {step}", mode=RenderMode(mode), width_px=width_px)
        for step, sight in seen
    ]


def _seen(playback: "Playback", moments: slice) -> "list[tuple[int, Sight]]":
    """Return env step and sight of these moments.

    Raises:
        NothingToShow: the task has no camera rig.
    """
    chosen = playback.moments[moments]
    seen = [(moment.env_step, moment.sight) for moment in chosen if moment.sight is not None]
    if not seen:
        raise NothingToShow(f"{playback.env_id} has no cameras beside the gripper: expected --view episode.")
    return seen


def _report(caption: "Caption", playback: "Playback", written: list[Path], *, as_json: bool) -> None:
    last = playback.moments[-1]
    outcome = last.end_reason or "not ended"
    if as_json:
        from .terminal.output import print_json

        files = [str(path) for path in written]
        found = {"title": caption.title, "actions": caption.actions, "outcome": outcome, "env_steps": last.env_step}
        print_json(found | {"files": files})
        return
    print(f"{caption.title}: {outcome} after {last.env_step} env steps")
    if last.end_reason:
        from vitac.evaluator.episodes.records import EpisodeOutcome

        print(EpisodeOutcome(last.end_reason).sentence)
    print(f"actions: {caption.actions}")
    for path in written:
        print(path)
