"""A played episode of a submission: asked for on its page, made by a real worker, and served as files."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

import numpy as np
import pytest
from asked_playbacks import Played
from databases import opened_database
from service_factories import TASK, claim, make_principal, make_record, make_settings, shard_ids, store, submit
from unpacked_files import unpack
from vitac.evaluator.episodes.episode import make_environment, resimulate
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome, EpisodeRecord
from vitac.evaluator.tracks import find_task
from vitac.server.database.states import WorkState
from vitac.server.playbacks.asking import PlaybackFile, find_digest
from vitac.server.playbacks.work import read_file
from vitac.server.services import Services
from vitac.server.storage.blobs import BlobStore
from vitac.worker.staging import SubmissionStage
from vitac.worker.worker import QueueWorker
from worker_fakes import FakeShards, eventually


@pytest.fixture
def services(tmp_path: Path) -> Iterator[Services]:
    with opened_database() as database:
        settings = make_settings(state_dir=tmp_path, database_url=database.address, lease_s=30.0)
        settings.scratch_dir.mkdir()
        yield Services(settings=settings, database=database, blobs=BlobStore.from_settings(settings), postgres=None)


def played_for_real(number: int) -> EpisodeRecord:
    """Two env steps of an episode in our physics."""
    _, task = find_task(TASK)
    episode = task.episodes[number - 1]
    actions = np.full((2, 3), 0.25, dtype=np.float32)
    played = resimulate(make_environment(task), episode, actions)
    return make_record(
        number,
        played.outcome or EpisodeOutcome.ACTIONS_ENDED,
        env_steps=2,
        actions=ActionSequence.from_array(actions),
        state_hashes=played.state_hashes,
        infos=played.infos,
    )


@contextmanager
def working(services: Services) -> Iterator[None]:
    """A worker whose shards are fakes and whose playbacks are real."""
    stage = SubmissionStage(services.blobs, services.settings.scratch_dir, services.settings.limits)
    worker = QueueWorker(services, stage, uuid4(), FakeShards())
    thread = threading.Thread(target=worker.run)
    thread.start()
    try:
        yield
    finally:
        worker.stop()
        thread.join(60.0)
        stage.close()


@pytest.mark.slow
def test_an_episode_becomes_files_that_a_page_plays(services: Services) -> None:
    with services.database.transaction() as session:
        by = make_principal(session)
        submission = submit(session, by)
        first = shard_ids(session, submission)[0]
    team = Played(database=services.database, by=by, submission=submission)
    lease = claim(services.database, first)
    false = make_record(2)  # its states are made up
    store(services.database, lease, [played_for_real(1), false])
    for number in (1, 2):
        team.ask(number)
    ended = {WorkState.DONE, WorkState.FAILED}
    with working(services):
        eventually(lambda: {getattr(team.found(number), "state", None) for number in (1, 2)} == ended, limit_s=180.0)
    made, failed = team.found(1), team.found(2)
    assert made is not None
    assert failed is not None
    assert made.state is WorkState.DONE
    assert "The state after env step 0 is not the recorded one" in (failed.problem or "")
    with services.database.transaction() as session:
        digests = {
            file: find_digest(session, team.episode(1), file) for file in (PlaybackFile.SCENE, PlaybackFile.STILL)
        }
    scene = read_file(services.database, services.blobs, digests[PlaybackFile.SCENE])
    assert unpack(scene).arrays["action_values"].tolist() == [[0.25, 0.25, 0.25]] * 2
    assert read_file(services.database, services.blobs, digests[PlaybackFile.STILL]).startswith(b"RIFF")
