"""Episodes on their pages, with playbacks in any state and real files; imported by page tests."""

from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np
from seeded_site import SeededSite
from service_factories import LEASE_S, TASK, make_record, take
from sqlalchemy import update
from vitac.envs.drawing.drawable import straight_to_target
from vitac.envs.drawing.playback import EpisodePlayback, Pace, record
from vitac.envs.playback_files.scene import pack_scene
from vitac.envs.playback_files.stage import pack_cameras
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.episodes.records import ActionSequence
from vitac.evaluator.tracks import find_task
from vitac.server.database.models import EpisodeResult
from vitac.server.database.models import Playback as PlaybackRow
from vitac.server.database.states import WorkState
from vitac.server.playbacks import work
from vitac.server.playbacks.asking import PlaybackFile, ask, find_episode
from vitac.server.principals import CONSOLE
from vitac.server.queue.work import Claim, end


@cache
def guided(task: str, number: int) -> EpisodePlayback:
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


def path_of_episode(site: SeededSite, name: str, number: int = 5, task: str = TASK) -> str:
    """The page of an episode of a submission."""
    return f"{site.path_of(name)}/episodes/{task}/{number}"


def ask_for_playback(
    site: SeededSite,
    name: str,
    number: int = 5,
    task: str = TASK,
    *,
    state: WorkState = WorkState.QUEUED,
    files: Mapping[PlaybackFile, bytes] | None = None,
    env_steps_played: int = 0,
) -> str:
    """Ask for the playback of an episode as an organizer does, and bring it to a state as a worker does.

    Without `files` a playback that is made has those of real physics, of as many env steps. The path of its page.
    """
    if state is WorkState.DONE and files is None:
        files = real_files(task, number)
        _set_env_steps(site, name, task, number, len(guided(task, number).rewards))
    with site.database.transaction() as session:
        episode = find_episode(session, CONSOLE, site.id_of(name), task, number)
        playback = ask(session, site.services.settings, CONSOLE, episode)
        if state is not WorkState.QUEUED:
            is_claimed = playback.state is WorkState.RUNNING
            lease = work.begin(session, _claim(playback) if is_claimed else take(session, playback.id))
            if state is WorkState.RUNNING:
                work.renew(session, lease, LEASE_S, env_steps_played=env_steps_played)
            elif state is WorkState.FAILED:
                end(session, lease, WorkState.FAILED, problem="The states differ.")
            elif state is WorkState.DONE:
                digests = {f"{file}_sha256": site.store(content) for file, content in (files or {}).items()}
                work.end_made(session, lease, digests)
    return path_of_episode(site, name, number, task)


def _claim(playback: PlaybackRow) -> Claim:
    return Claim(work_id=playback.id, kind=playback.kind, token=playback.token, attempt=playback.attempts, waited_s=0.0)


def _set_env_steps(site: SeededSite, name: str, task: str, number: int, steps: int) -> None:
    played = make_record(
        number,
        task=task,
        env_steps=steps,
        actions=ActionSequence.from_array(np.zeros((steps, 3), np.float32)),
        state_hashes=("00" * 32,) * (steps + 1),
        infos=({},) * steps,
    )
    with site.database.transaction() as session:
        episode = find_episode(session, CONSOLE, site.id_of(name), task, number)
        values = {"env_steps": steps, "record": played.model_dump(mode="json"), "outcome": "success", "success": True}
        session.execute(update(EpisodeResult).where(EpisodeResult.id == episode.id).values(**values))
