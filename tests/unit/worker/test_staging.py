import hashlib
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from images import config_bytes, docker_archive, entry, tar_bytes
from service_client import make_archive
from service_factories import sha256
from submissions import FILES, submission_zip, wheel_bytes
from vitac.evaluator.agent.isolation.memory_files import is_in_memory
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.errors import ServiceError
from vitac.server.services import Services
from vitac.worker.staging import KEPT_IDLE, SubmissionStage

MODEL = SubmissionKind.MODEL


@pytest.fixture
def stage(services: Services) -> Iterator[SubmissionStage]:
    stage = SubmissionStage(services.blobs, services.settings.scratch_dir, services.settings.limits)
    yield stage
    stage.close()


def put(services: Services, folder: Path, policy: str) -> str:
    path = folder / f"{sha256(policy)}.zip"
    path.write_bytes(make_archive(policy=policy))
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    services.blobs.put(path, digest)
    return digest


def test_submission_is_unpacked_once_for_shards_at_the_same_time(
    services: Services, stage: SubmissionStage, archive_sha256: str
) -> None:
    folders: list[Path] = []
    barrier = threading.Barrier(4)

    def use() -> None:
        barrier.wait()
        with stage.submission(MODEL, archive_sha256) as folder:
            folders.append(folder)
            barrier.wait()

    threads = [threading.Thread(target=use) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(folders) == 4
    assert len(set(folders)) == 1
    assert (folders[0] / "submission.yaml").is_file()


def test_image_is_unpacked_into_memory_once_and_leaves_nothing_there(
    services: Services, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    layer = tar_bytes([entry("submission.yaml", b"track: track_1\ntasks: [peg-insertion]\nname: boxed\n")])
    tar = tmp_path / "image.tar"
    tar.write_bytes(docker_archive([layer], config_bytes([layer], ["/policy"])))
    digest = hashlib.sha256(tar.read_bytes()).hexdigest()
    services.blobs.put(tar, digest)
    with TemporaryDirectory(dir="/dev/shm") as memory:
        monkeypatch.setenv("VITAC_SANDBOX_FILES", "memory")
        monkeypatch.setenv("VITAC_MEMORY_DIR", memory)
        stage = SubmissionStage(services.blobs, services.settings.scratch_dir, services.settings.limits)
        with stage.submission(SubmissionKind.IMAGE, digest) as folder:
            assert folder.is_relative_to(memory)
            assert is_in_memory(folder / "root")
            assert (folder / "root/submission.yaml").is_file()
        with stage.submission(SubmissionKind.IMAGE, digest) as again:
            assert again == folder
        other = SubmissionStage(services.blobs, services.settings.scratch_dir, services.settings.limits)
        with monkeypatch.context() as patch:  # another process of the machine has no need to fetch it
            patch.delattr(services.blobs.__class__, "fetch")
            with other.submission(SubmissionKind.IMAGE, digest) as shared:
                assert shared == folder
        assert not any(path.name == "upload" for path in services.settings.scratch_dir.rglob("*"))
        stage.close()
        assert (shared / "root/submission.yaml").is_file()  # the other process uses it
        other.close()
        assert not [path for path in Path(memory).rglob("*") if path.is_file()]


def test_wheels_of_a_submission_are_unpacked(services: Services, stage: SubmissionStage, tmp_path: Path) -> None:
    path = tmp_path / "submission.zip"
    path.write_bytes(submission_zip({**FILES, "wheels/feelings-1.0-py3-none-any.whl": wheel_bytes()}))
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    services.blobs.put(path, digest)
    with stage.submission(MODEL, digest) as folder:
        assert (folder / "site-packages/feelings/__init__.py").is_file()


def test_only_a_few_idle_submissions_stay_on_disk_and_used_ones_always(
    services: Services, stage: SubmissionStage, tmp_path: Path
) -> None:
    digests = [put(services, tmp_path, f"x = {n}") for n in range(KEPT_IDLE + 3)]
    with stage.submission(MODEL, digests[0]) as used:
        for digest in digests[1:]:
            with stage.submission(MODEL, digest):
                pass
        on_disk = {path.name.rpartition("-")[0] for path in services.settings.scratch_dir.glob("worker-*/*")}
        assert on_disk == {f"model-{digest}" for digest in (digests[0], *digests[-KEPT_IDLE:])}
        assert (used / "policy.py").is_file()


def test_what_is_unpacked_anew_lies_elsewhere(services: Services, stage: SubmissionStage, tmp_path: Path) -> None:
    digests = [put(services, tmp_path, f"x = {n}") for n in range(KEPT_IDLE + 1)]
    with stage.submission(MODEL, digests[0]) as before:
        pass
    for digest in digests[1:]:
        with stage.submission(MODEL, digest):
            pass
    assert not before.exists()
    with stage.submission(MODEL, digests[0]) as again:
        assert again != before


def test_the_submission_used_most_recently_stays(services: Services, stage: SubmissionStage, tmp_path: Path) -> None:
    first, second, third = (put(services, tmp_path, f"x = {n}") for n in range(3))
    with stage.submission(MODEL, first) as folder:
        for digest in (second, third):
            with stage.submission(MODEL, digest):
                pass
    assert folder.exists()
    with stage.submission(MODEL, first) as again:
        assert again == folder


def test_missing_file_is_refused_and_can_be_staged_later(
    services: Services, stage: SubmissionStage, archive_sha256: str, tmp_path: Path
) -> None:
    services.blobs.delete(archive_sha256)
    with pytest.raises(ServiceError, match="is gone"), stage.submission(MODEL, archive_sha256):
        pass
    services.blobs.put(tmp_path / "archive.zip", archive_sha256)
    with stage.submission(MODEL, archive_sha256) as folder:
        assert (folder / "policy.py").is_file()


def test_altered_file_is_refused(services: Services, stage: SubmissionStage, archive_sha256: str) -> None:
    stored = next(path for path in (services.settings.state_dir / "blobs").rglob(archive_sha256))
    stored.write_bytes(make_archive(policy="import os"))
    with pytest.raises(ServiceError, match="was altered"), stage.submission(MODEL, archive_sha256):
        pass


def test_folders_of_killed_workers_are_removed_and_those_of_living_ones_kept(
    services: Services, stage: SubmissionStage
) -> None:
    scratch = services.settings.scratch_dir
    leftover = scratch / f"worker-{os.uname().nodename}-x"
    leftover.mkdir()
    SubmissionStage(services.blobs, scratch, services.settings.limits).close()
    assert not leftover.exists()
    assert list(scratch.glob("worker-*")) == [stage.folder]
