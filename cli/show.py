"""`vitac show`: draws an episode, played from its start by recorded actions, a policy or nobody."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import typer
from vitac.envs.extras import require_extra
from vitac.envs.maniskill.definition import is_maniskill
from vitac.errors import VitacError

from .terminal.output import AsJson, Assets, existing_file, warn
from .terminal.own_policy import fall_back_where_nothing_isolates

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from vitac.envs.drawing.camera_view import DrawnQuantity
    from vitac.envs.drawing.files import Destination, Format, Frame, Picture
    from vitac.envs.drawing.picture import Caption
    from vitac.envs.drawing.playback import Belief, EpisodePlayback, NextAction, Pace
    from vitac.envs.maniskill.film import FilmMoment
    from vitac.envs.tasks.task_env import Info, Observation, TactileTaskEnv
    from vitac.envs.vision.camera import Sight
    from vitac.evaluator.agent.session import EpisodePolicy
    from vitac.evaluator.logs.recordings import Recording
    from vitac.evaluator.tracks import Episode, Task


START_ALONE = "none (the start)"


class NothingToShow(VitacError):
    """The episode has no recorded actions, or no such env step."""


@dataclass(frozen=True, kw_only=True)
class EpisodeStart:
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
class ShownEpisode:
    """The start of an episode, its actions, a description of where they come from, and what their policy believes."""

    start: EpisodeStart
    next_action: "NextAction"
    actions: str
    belief: "Belief | None" = None


@dataclass(frozen=True, kw_only=True)
class Shown:
    """What was drawn, and into which files.

    Attributes:
        title: of the episode.
        actions: where they come from.
        end_reason: why the episode has ended; None where the actions did before.
        env_steps: that were played.
        files: that were written.
        beliefs: what the policy believed after env steps, beside what was true.
    """

    title: str
    actions: str
    end_reason: str | None
    env_steps: int
    files: tuple[Path, ...]
    beliefs: Sequence[Mapping[str, Any]] = ()


def no_such_env_step(step: int | None, last: int) -> NothingToShow:
    """Return the refusal of an env step that the episode did not reach."""
    return NothingToShow(f"The episode ended after env step {last}: expected --step 0 to {last}, got {step}.")


def find_start(task: str, number: int) -> EpisodeStart:
    """Return an episode of a task's list, or a random start of an environment with the number as its seed.

    Raises:
        UnknownTask: there is neither such a task nor such an environment.
        UnknownEpisodes: the list does not have that number.
    """
    from vitac.envs import ENVIRONMENTS
    from vitac.evaluator.tracks import find_task
    from vitac.evaluator.tracks.definition import cut

    if task in ENVIRONMENTS:
        return EpisodeStart(env_id=task, title=f"{task}, random start {number}", options={"rng_seed": number})
    _, definition = find_task(task)
    (shard,) = cut(definition, [number])
    return _listed(definition, shard.episodes[0])


def _listed(task: "Task", episode: "Episode") -> EpisodeStart:
    shape = "" if is_maniskill(task.env_id) else f": {episode.shape}"
    title = f"{task.title}, episode {episode.number}{shape}"
    return EpisodeStart(
        env_id=task.env_id,
        title=title,
        options=episode.options,
        settings=task.environment_arguments,
        listed=(task, episode),
    )


@contextmanager
def player(start: EpisodeStart, policy: Path | None, actions: Path | None) -> Iterator[ShownEpisode]:
    """Give the episode that is to be played, with a policy, recorded actions, or a motion that knows the target.

    Raises:
        NothingToShow: nothing is recorded of the episode, or the submission does not play the task.
        NotDrawable: nobody has said what the target of this environment is.
        VitacError: the submission or the log cannot be read, or the policy not be loaded.
    """
    if not policy and not actions:
        yield _skip_observations(start)
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
        yield ShownEpisode(start=start, next_action=_one_by_one(recording.actions), actions=actions.name)


def _skip_observations(start: EpisodeStart) -> ShownEpisode:
    """Return the motion straight to the target; for ManiSkill, where nobody has said what that is, the start alone."""
    from vitac.envs.drawing.drawable import straight_to_target
    from vitac.envs.scene.perspective import DESCRIPTION

    if is_maniskill(start.env_id):
        return ShownEpisode(start=start, next_action=lambda _, __: None, actions=START_ALONE)
    return ShownEpisode(start=start, next_action=straight_to_target(start.env_id), actions=DESCRIPTION)


@contextmanager
def _policy_player(task: "Task", start: EpisodeStart, submission: Path) -> Iterator[ShownEpisode]:
    from vitac.evaluator.agent.session import PolicySession
    from vitac.evaluator.episodes.episode import delayed
    from vitac.evaluator.episodes.records import make_reading
    from vitac.evaluator.submission.image import load_program
    from vitac.evaluator.submission.manifest import load_manifest
    from vitac.evaluator.submission.sources import staged
    from vitac.evaluator.tracks import find_task

    from .evaluate import find_playing_kind

    fall_back_where_nothing_isolates()
    packages = find_task(task.name)[0].packages
    kind = find_playing_kind(submission)
    with staged(submission, kind) as folder:
        manifest = load_manifest(folder)
        if task.name not in manifest.tasks:
            raise NothingToShow(
                f"Expected one of the submission's tasks, {', '.join(manifest.tasks)}, got {task.name}."
            )
        reading = make_reading(task, manifest.observation_keys)
        with (
            PolicySession(
                folder,
                entry_point=manifest.own_entry_point(),
                image=load_program(folder) if kind.form.is_image else None,
                packages=packages,
            ) as session,
            session.episode(task=task.name, action_shape=(len(task.actions),), clouds=reading.clouds) as policy,
        ):
            playing = delayed(policy, task)
            yield ShownEpisode(
                start=start,
                next_action=lambda seen, _: playing.act({key: seen[key] for key in reading.sent}),
                actions=manifest.name,
                belief=_belief_while_it_can_be_used(policy),
            )


def _belief_while_it_can_be_used(policy: "EpisodePolicy") -> "Belief":
    """Return what asks a policy what it believes; after an answer without use it warns once and asks no more."""
    from vitac.evaluator.agent.verdicts import PolicyFailed, VerdictCode

    unusable = {
        VerdictCode.CRASHED,
        VerdictCode.BAD_ACTION_TYPE,
        VerdictCode.BAD_ACTION_SHAPE,
        VerdictCode.NON_FINITE_ACTION,
    }
    is_asked = True

    def belief(size: int) -> "NDArray[np.float32] | None":
        nonlocal is_asked
        if not is_asked:
            return None
        try:
            return policy.belief(size)
        except PolicyFailed as failure:
            if failure.verdict not in unusable:  # a limit: the policy can no longer act either
                raise
            is_asked = False
            warn(f"What the policy believes is not drawn from here on: {failure.message}")
            return None

    return belief


def _recording(task: "Task", number: int, path: Path) -> "Recording":
    from vitac.evaluator.logs.resimulation import read_recordings

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
    last: FilmMoment

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

    from .terminal.compiling import compiling_shown

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
        from .terminal.output import print_json

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
