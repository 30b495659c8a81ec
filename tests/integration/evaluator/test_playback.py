"""An episode played in our physics, made into files by the process that a worker starts."""

from pathlib import Path

import numpy as np
import pytest
from evaluation_records import make_record
from unpacked_files import unpack
from vitac.evaluator.episodes.episode import make_environment, resimulate
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome
from vitac.evaluator.playback import SCENE_FILE, STILL_FILE, PlaybackOrder, making
from vitac.evaluator.tracks import find_task


@pytest.mark.slow
def test_a_played_episode_becomes_a_playback_of_the_same_states(tmp_path: Path) -> None:
    track, task = find_task("lock-opening")
    actions = np.zeros((2, len(task.actions)), dtype=np.float32)
    actions[:, 0] = 0.2
    episode = task.episodes[4]
    played = resimulate(make_environment(task), episode, actions)
    record = make_record(
        episode.number,
        played.outcome or EpisodeOutcome.ACTIONS_ENDED,
        2,
        task=task.name,
        shape=episode.shape,
        initial_offset=episode.offset,
        actions=ActionSequence.from_array(actions),
        state_hashes=played.state_hashes,
        infos=played.infos,
    )
    with making(PlaybackOrder(track=track.name, record=record, folder=tmp_path)) as process:
        assert list(process.played()) == [0, 1, 2]
    found = unpack((tmp_path / SCENE_FILE).read_bytes())
    assert found.header["pressure_unit_kpa"] > 0.01
    assert np.abs(found.arrays["displacements"]).max() > 100
    assert (tmp_path / STILL_FILE).read_bytes()[8:12] == b"WEBP"
