"""What `vitac show` plays: a start, and what chooses the actions from there."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vitac.envs.maniskill.definition import is_maniskill
from vitac.errors import VitacError

from ..terminal.output import warn
from ..terminal.own_policy import fall_back_where_nothing_isolates

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np
    from numpy.typing import NDArray
    from vitac.envs.drawing.files import Destination, Frame
    from vitac.envs.drawing.playback import Belief, NextAction
    from vitac.envs.maniskill.film import FilmMoment
    from vitac.envs.tasks.task_env import Info, Observation
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
    from vitac.evaluator.tracks.cut import cut

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
    from vitac.evaluator.episodes.reading import make_reading
    from vitac.evaluator.submission.image import load_program
    from vitac.evaluator.submission.manifest import load_manifest
    from vitac.evaluator.submission.sources import staged
    from vitac.evaluator.tracks import find_task

    from ..evaluate import find_playing_kind

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
