from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from databases import opened_database
from service_client import make_archive
from service_factories import TASK, make_principal, make_record, make_settings, play_all, submit
from submission_steps import refused
from vitac.server.appeals import appeals
from vitac.server.database.models import Submission
from vitac.server.errors import ProblemCode
from vitac.server.principals import CONSOLE
from vitac.server.services import Services
from vitac.server.storage.blobs import BlobStore
from vitac.worker import appeal_replay

from competitions import make_competition, put_in_place


@pytest.fixture
def services(tmp_path: Path) -> Iterator[Services]:
    settings = make_settings(state_dir=tmp_path / "state")
    settings.scratch_dir.mkdir(parents=True)
    with opened_database() as database:
        yield Services(settings=settings, database=database, blobs=BlobStore.from_settings(settings), postgres=None)


def appealed(services: Services, archive: bytes, tmp_path: Path) -> int:
    """Number of an appeal against a submission with this archive."""
    with services.database.transaction() as session:
        content = make_competition(appeal_days=7)
        content["tracks"] = {"mail": content["tracks"]["track_1"] | {"taken_here": False}}
        put_in_place(session, content)
        team = make_principal(session)
        submission = submit(session, team)
    play_all(services.database, submission)
    stored = tmp_path / "stored.zip"
    stored.write_bytes(archive)
    digest = appeal_replay._sha256(stored)
    services.blobs.put(stored, digest)
    with services.database.transaction() as session:
        session.get_one(Submission, submission.id).archive_sha256 = digest
        return appeals.open_appeal(session, team, submission.id, "Look again.").id


def test_plays_the_stored_or_a_corrected_policy(
    services: Services, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[dict[str, Any]] = []

    def fake(**arguments: Any) -> SimpleNamespace:
        asked.append(arguments | {"policy": (arguments["submission_dir"] / "policy.py").read_text()})
        return SimpleNamespace(records=(make_record(arguments["episodes"][0]),))

    monkeypatch.setattr(appeal_replay, "evaluate", fake)
    stored, other = make_archive(policy="stored = 1"), make_archive(policy="corrected = 1")
    number = appealed(services, stored, tmp_path)
    own = appeal_replay.replay(services, CONSOLE, number, task=TASK, episode=3, corrected=None)
    path = tmp_path / "corrected.zip"
    path.write_bytes(other)
    corrected = appeal_replay.replay(services, CONSOLE, number, task=TASK, episode=4, corrected=path)
    assert [one["policy"] for one in asked] == ["stored = 1", "corrected = 1"]
    assert [one["episodes"] for one in asked] == [[3], [4]]
    assert [one["secret"] for one in asked] == [None, None]
    assert (own.corrected, corrected.corrected, own.record.episode) == (False, True, 3)
    assert own.policy_sha256 != corrected.policy_sha256 == appeal_replay._sha256(path)
    assert list(services.settings.scratch_dir.iterdir()) == []
    for task, episode in ((TASK, 10_000), ("nothing", 1)):
        with refused(ProblemCode.NOT_FOUND):
            appeal_replay.replay(services, CONSOLE, number, task=task, episode=episode, corrected=None)
    with services.database.transaction() as session:
        by = make_principal(session, "Bees")
    with refused(ProblemCode.FORBIDDEN):
        appeal_replay.replay(services, by, number, task=TASK, episode=3, corrected=None)
    elsewhere = tmp_path / "elsewhere.zip"
    manifest = "track: track_2\ntasks: [fusion-insertion]\nname: zero\n"
    elsewhere.write_bytes(
        make_archive({"Track_2/submission.yaml": manifest, "Track_2/policy.py": "class Policy: ...\n"})
    )
    with refused(ProblemCode.MANIFEST_REJECTED):
        appeal_replay.replay(services, CONSOLE, number, task=TASK, episode=3, corrected=elsewhere)
