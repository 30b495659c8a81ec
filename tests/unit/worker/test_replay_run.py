"""Episodes that are played again for an appeal: asked for, played by a worker, shown beside the result."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest
from service_client import MANIFEST, make_archive
from service_factories import TASK, TRACK, make_principal, make_record, play_all, submit
from sqlalchemy import select, text
from submission_steps import refused
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord
from vitac.evaluator.version import evaluator_version
from vitac.server.audit import newest_entries
from vitac.server.competitions.sealing import seal
from vitac.server.database.models import BoardResult, Evaluation, Submission
from vitac.server.database.states import WorkKind
from vitac.server.errors import ProblemCode
from vitac.server.principals import CONSOLE, Principal
from vitac.server.queue import work
from vitac.server.queue.work import name_requirement
from vitac.server.services import Services
from vitac.server.submissions import appeal_replays, appeals
from vitac.worker.leased_run import RunEnd
from vitac.worker.short_runs import ReplayRun
from vitac.worker.staging import SubmissionStage
from worker_fakes import FakeShards

from competitions import make_competition, put_in_place, stored_stage

HERE = [name_requirement(evaluator_version())]


@pytest.fixture
def appealed(services: Services, archive_sha256: str) -> tuple[Principal, int]:
    """A team, and the number of its appeal."""
    with services.database.transaction() as session:
        content = make_competition(appeal_days=7)
        content["tracks"] = {"mail": content["tracks"]["track_1"] | {"taken_here": False}}
        put_in_place(session, content)
        team = make_principal(session)
        submission = submit(session, team)
    play_all(services.database, submission)
    with services.database.transaction() as session:
        session.get_one(Submission, submission.id).archive_sha256 = archive_sha256
        return team, appeals.open_appeal(session, team, submission.id, "Look again.").id


def archive(folder: Path, content: bytes) -> Path:
    path = folder / f"{hashlib.sha256(content).hexdigest()}.zip"
    path.write_bytes(content)
    return path


def ask(services: Services, by: Principal, number: int, *, task: str = TASK, **given: Any) -> int:
    with services.database.transaction() as session:
        return appeal_replays.ask(session, services.blobs, by, number, task=task, **given).id


def do_next(services: Services, record_of: Callable[[int], EpisodeRecord] = make_record) -> str:
    """Has a worker do the replay that is next; returns what the policy's file held."""
    claimed = work.claim(services.database, services.settings, uuid4(), HERE)
    assert claimed is not None
    assert claimed.kind is WorkKind.REPLAY
    with services.database.transaction() as session:
        lease = appeal_replays.begin(session, claimed)
    stage = SubmissionStage(services.blobs, services.settings.scratch_dir, services.settings.limits)
    shards, policies = FakeShards(record_of), []
    shards.gate = lambda _: policies.append((shards.started[0].order.submission / "policy.py").read_text())
    assert ReplayRun(services, stage, lease, shards).run() is RunEnd.FINISHED
    stage.close()
    assert shards.started[0].order.episodes == (lease.episode,)
    return policies[0]


def results(services: Services) -> list[object]:
    with services.database.transaction() as session:
        return [*session.scalars(select(BoardResult.sort_key)), *session.scalars(select(Evaluation.result_hash))]


def test_the_stored_or_a_corrected_policy_is_played_and_stands_beside_the_result(
    services: Services, appealed: tuple[Principal, int], tmp_path: Path
) -> None:
    team, number = appealed
    before = results(services)
    own = ask(services, CONSOLE, number, episode=3)
    other = archive(tmp_path, make_archive(policy="corrected = 1"))
    corrected = ask(services, CONSOLE, number, episode=4, corrected=other)
    assert "corrected" not in do_next(services)

    def failed(episode: int) -> EpisodeRecord:
        return make_record(episode, EpisodeOutcome.TACTILE, state_hashes=("0" * 64,) * 4)

    assert do_next(services, failed) == "corrected = 1"
    shown = [appeal_replays.wait(services, replay) for replay in (own, corrected)]
    assert [(one.episode, one.corrected, one.same_states, one.old_outcome, one.outcome) for one in shown] == [
        (3, False, True, "success", "success"),
        (4, True, False, "success", "tactile"),
    ]
    assert shown[1].policy_sha256 == other.stem
    assert results(services) == before
    with services.database.transaction() as session:
        (view,) = appeals.visible(session, team)
        assert len(view.replays) == 2
        found = newest_entries(session, 1, action="appeal.replay")[0]
        assert (found.action, found.before) == ("appeal.replay", {"outcome": "success", "env_steps": 3})
        sealed = seal(session, CONSOLE, stored_stage(session, TRACK, "stage1"))
        session.execute(text("UPDATE evaluations SET commitment = :value"), {"value": sealed.commitment})
    with services.database.transaction() as session:
        assert appeals.visible(session, team)[0].replays == [], "of a sealed list nobody but organizers sees episodes"
        assert len(appeals.visible(session, CONSOLE)[0].replays) == 2


def test_only_an_organizer_asks_for_an_episode_that_the_policy_plays(
    services: Services, appealed: tuple[Principal, int], tmp_path: Path
) -> None:
    team, number = appealed
    for task, episode in ((TASK, 10_000), ("nothing", 1)):
        with refused(ProblemCode.NOT_FOUND):
            ask(services, CONSOLE, number, task=task, episode=episode)
    with refused(ProblemCode.FORBIDDEN):
        ask(services, team, number, episode=3)
    elsewhere = archive(tmp_path, make_archive(manifest=MANIFEST.replace(TASK, "lock-opening")))
    with refused(ProblemCode.MANIFEST_REJECTED):
        ask(services, CONSOLE, number, episode=3, corrected=elsewhere)
    with services.database.transaction() as session:
        assert work.count_open(session) == 0
