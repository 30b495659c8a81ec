"""`vitac admin appeal replay` with the real simulation in the real sandbox, on a list of one episode."""

import hashlib
import json
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest
from cli_service import CliService, cli_service
from honest_policy import HONEST
from service_client import MANIFEST, make_archive
from service_factories import (
    LOCK,
    TASK,
    TRACK,
    claim,
    finish,
    make_principal,
    make_settings,
    make_upload,
    play_public_list,
    store,
)
from sqlalchemy import select
from sqlalchemy.orm import Session
from vitac.evaluator.evaluation.local import evaluate
from vitac.evaluator.shards.process import ShardProcesses
from vitac.evaluator.submission.sources import staged
from vitac.evaluator.tracks import Task, load_track
from vitac.evaluator.tracks.definition import ShardEpisodes, cut
from vitac.evaluator.tracks.sealed import new_secret, sealed_track
from vitac.server.competitions.sealing import seal
from vitac.server.database.models import Appeal, BoardResult, EpisodeResult, Evaluation
from vitac.server.database.states import Role
from vitac.server.evaluations import lifecycle
from vitac.server.principals import CONSOLE, Principal
from vitac.server.queue import work
from vitac.server.services import Services
from vitac.server.storage.blobs import BlobStore
from vitac.server.submissions import appeals, creation
from vitac.worker.staging import SubmissionStage
from vitac.worker.worker import QueueWorker

from competitions import open_now, put_in_place, sealed_competition, stored_stage

NEVER_LOADS = "raise ImportError('no such library')\n"


def one_episode(task: Task) -> Sequence[ShardEpisodes]:
    return cut(task, (1,))


def archive(folder: Path, content: bytes) -> Path:
    path = folder / f"{hashlib.sha256(content).hexdigest()}.zip"
    path.write_bytes(content)
    return path


def appealed(service: CliService, tmp_path: Path) -> int:
    """Number of an appeal against what a sealed list of one episode gave, played as a worker plays it."""
    stored = archive(tmp_path, HONEST)
    settings = make_settings(state_dir=tmp_path / "state")
    BlobStore.from_settings(settings).put(stored, stored.stem)
    secret_file = tmp_path / "secret"
    secret = new_secret(secret_file)
    with service.database.transaction() as session:
        put_in_place(session, open_now(sealed_competition() | {"appeal_days": 7}))
        seal(session, CONSOLE, stored_stage(session, TRACK, "stage1"), secret)
        team = make_principal(session, "Ants")
        submission, _ = creation.create(session, team, make_upload(archive_sha256=stored.stem))
    track = sealed_track(load_track(TRACK), secret)
    with staged(stored) as folder:
        played = evaluate(submission_dir=folder, track=track, task=track.tasks[TASK], episodes=(1,), secret=secret_file)
    secret_file.unlink()
    (sealed,) = play_public_list(service.database, submission)
    lease = claim(service.database, sealed)
    store(service.database, lease, played.records)
    finish(service.database, lease)
    with service.database.transaction() as session:
        return appeals.open_appeal(session, team, submission.id, "Look again.", task=TASK, episode=1).id


@contextmanager
def working(service: CliService, state_dir: Path) -> Iterator[None]:
    """A worker with real processes while the block runs."""
    settings = make_settings(state_dir=state_dir)
    services = Services(
        settings=settings, database=service.database, blobs=BlobStore.from_settings(settings), postgres=None
    )
    stage = SubmissionStage(services.blobs, settings.scratch_dir, settings.limits)
    with ShardProcesses() as processes:
        worker = QueueWorker(services, stage, uuid4(), processes.running_shard)
        thread = threading.Thread(target=worker.run)
        thread.start()
        try:
            yield
        finally:
            worker.stop()
            thread.join(60.0)
            stage.close()


def team_of(session: Session, number: int) -> Principal:
    team = session.get_one(Appeal, number).team
    return Principal(role=Role.TEAM, team_id=team.id, team_name=team.name)


def kept(service: CliService) -> list[object]:
    """All that records and boards say."""
    with service.database.transaction() as session:
        columns = EpisodeResult.record_digest, EpisodeResult.outcome, EpisodeResult.env_steps
        return [
            *session.execute(select(*columns).order_by(EpisodeResult.id)),
            *session.execute(
                select(BoardResult.ranked_by["success_rate"].as_float(), BoardResult.board).order_by(BoardResult.board)
            ),
            *session.scalars(select(Evaluation.result_hash)),
        ]


@pytest.mark.slow
def test_an_episode_of_a_sealed_list_is_played_again_beside_its_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lifecycle, "cut", one_episode)
    monkeypatch.setattr(lifecycle, "store_practice_scores", lambda *_, **__: None)  # which compares whole lists
    monkeypatch.setattr(work, "RETRY_DELAY_S", 0.01)
    monkeypatch.setenv("VITAC_SANDBOX_FILES", "memory")  # without which no worker plays a sealed list
    with cli_service(tmp_path / "state") as service, ExitStack() as exits:
        number = appealed(service, tmp_path)
        exits.enter_context(working(service, tmp_path / "state"))
        before = kept(service)

        def replayed(*options: str, exit_code: int = 0) -> Any:
            result = service.run("admin", "appeal", "replay", str(number), TASK, "1", "--json", *options)
            assert result.exit_code == exit_code, result.output
            if exit_code:
                return str(result.exception)
            # The worker is a thread of this process and may log where the command prints.
            return json.JSONDecoder().raw_decode(result.stdout, result.stdout.index("{"))[0]

        assert replayed("--dry-run")["outcome"] is None, "it is not played"
        own = replayed()
        assert own["same_states"], "the same policy on the same start of the sealed list"
        assert (own["outcome"], own["env_steps"]) == (own["old_outcome"], own["old_env_steps"])
        assert own["failure"] is None
        broken = archive(tmp_path, make_archive(policy=NEVER_LOADS))
        failed = replayed("--corrected", str(broken))
        assert (failed["outcome"], failed["same_states"], failed["corrected"]) == ("policy_failed", False, True)
        assert failed["policy_sha256"] == broken.stem != own["policy_sha256"]
        assert "no such library" in failed["failure"]
        other_task = archive(tmp_path, make_archive(manifest=MANIFEST.replace(TASK, LOCK)))
        assert f"submission that plays {TASK}" in replayed("--corrected", str(other_task), exit_code=1)
        no_zip = archive(tmp_path, b"no zip")
        assert "zip" in replayed("--corrected", str(no_zip), exit_code=1)
        assert list((tmp_path / "state" / "scratch").rglob("secret")) == [], "the secret of the list does not stay"
        assert kept(service) == before
        with service.database.transaction() as session:
            shown = appeals.appeal_view(appeals.find(session, CONSOLE, number), CONSOLE).replays
            assert [one.policy_sha256 for one in shown] == [own["policy_sha256"], broken.stem]
            (seen,) = appeals.visible(session, team_of(session, number))
            assert seen.replays == [], "of a sealed list the team sees no episode"
    assert list((tmp_path / "state" / "scratch").iterdir()) == []
