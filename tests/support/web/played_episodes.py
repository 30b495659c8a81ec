"""Episodes on their pages, with playbacks in any state and real files; imported by page tests."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from types import MappingProxyType
from typing import Any
from uuid import UUID

from vitac.envs.drawing.drawable import straight_to_target
from vitac.envs.drawing.playback import Pace, Playback, record
from vitac.envs.playback_files.scene import pack_scene
from vitac.envs.playback_files.stage import pack_cameras
from vitac.envs.tasks.definition import Family
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.tracks import find_task
from vitac.server.database.states import WorkState
from vitac.server.errors import ProblemCode, ServiceError, not_found
from vitac.server.playbacks.asking import PlaybackFile
from vitac.server.views.comparisons import PlaybackView, ShownEpisodeView, StillView, StoryMomentView
from vitac.web.pages.episodes.page import EpisodeAddress

KEY = "5eed" * 16


def a_playback(state: WorkState = WorkState.DONE, **changes: Any) -> PlaybackView:
    values: dict[str, Any] = {
        "key": KEY,
        "state": state,
        "env_steps": 3,
        "env_steps_played": 3 if state is WorkState.DONE else 0,
        "waits_for": 0,
        "family": Family.TACTILE,
        "workers": None if state in {WorkState.DONE, WorkState.FAILED} else 1,
        "problem": "The states differ." if state is WorkState.FAILED else None,
        "has_cameras": False,
        "has_still": state is WorkState.DONE,
    }
    return PlaybackView(**(values | changes))


def a_shown_episode(
    playback: PlaybackView | None = None, *, task: str = "peg-insertion", number: int = 5, **changes: Any
) -> ShownEpisodeView:
    track, definition = find_task(task)
    listed = definition.episodes[number - 1]
    values: dict[str, Any] = {
        "submission_name": "done",
        "team": "Gelbots",
        "track": track.name,
        "task": task,
        "episode": number,
        "shape": listed.shape,
        "initial_offset": listed.offset,
        "outcome": EpisodeOutcome.SUCCESS,
        "env_steps": 3,
        "total_reward": 10.25,
        "story": "Solved in 3 env steps.",
        "moments": (StoryMomentView(env_step=1, mark="touch", text="the peg touches"),),
        "evaluator_version": "1+0123456789ab",
        "record_digest": "ab" * 32,
        "playback": playback,
    }
    return ShownEpisodeView(**(values | changes))


@cache
def guided(task: str, number: int) -> Playback:
    """The real physics of an episode in which the held part goes straight to its target."""
    _, definition = find_task(task)
    env: Any = make_environment(definition)
    options = definition.episodes[number - 1].options
    return record(env, options=options, next_action=straight_to_target(definition.env_id), pace=Pace.IPC_STEP)


@cache
def real_files(task: str, number: int) -> Mapping[PlaybackFile, bytes]:
    """Files of such an episode, with a white pixel for the still."""
    playback = guided(task, number)
    files = {PlaybackFile.SCENE: pack_scene(playback), PlaybackFile.STILL: WHITE_PIXEL}
    cameras = pack_cameras(playback)
    return MappingProxyType(files if cameras is None else files | {PlaybackFile.CAMERAS: cameras})


WHITE_PIXEL = bytes.fromhex(
    "89504e470d0a1a0a0000000d4948445200000001000000010802000000907753de0000000c49444154789c63f8ffff3f0005fe02fe0def46b8"
    "0000000049454e44ae426082"
)


@dataclass(kw_only=True)
class FixedPlaybacks:
    """The episodes of a service with fixed content; `asked` holds whatever a playback was asked of."""

    episodes: dict[EpisodeAddress, ShownEpisodeView] = field(default_factory=dict)
    files: dict[EpisodeAddress, Mapping[PlaybackFile, bytes]] = field(default_factory=dict)
    asked: list[EpisodeAddress] = field(default_factory=list)
    refuses_playbacks: bool = False
    stills: list[StillView] = field(default_factory=list)

    def show(self, submission_id: UUID, shown: ShownEpisodeView) -> str:
        """Adds an episode, with real files if it is made; the path of its page."""
        place = EpisodeAddress(submission_id=submission_id, task=shown.task, number=shown.episode)
        self.episodes[place] = shown
        if shown.playback is not None and shown.playback.state is WorkState.DONE:
            self.files[place] = real_files(shown.task, shown.episode)
        return f"/submissions/{submission_id}/episodes/{shown.task}/{shown.episode}"

    def shown_at(self, place: EpisodeAddress) -> ShownEpisodeView:
        if place not in self.episodes:
            raise not_found("episode", place.number)
        return self.episodes[place]

    def ask_at(self, place: EpisodeAddress) -> PlaybackView:
        if self.refuses_playbacks:
            raise ServiceError(ProblemCode.TOO_MANY_REQUESTS, "At most 4 playbacks are possible.")
        playback = a_playback(WorkState.QUEUED, waits_for=2)
        self.asked.append(place)
        self.episodes[place] = self.shown_at(place).model_copy(update={"playback": playback})
        return playback

    def file_at(self, place: EpisodeAddress, file: PlaybackFile) -> bytes:
        if file not in self.files.get(place, {}):
            raise not_found("playback file", file.value)
        return self.files[place][file]
