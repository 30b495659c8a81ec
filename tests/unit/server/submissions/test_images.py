"""A container image as a submission: checked when it arrives, run by workers, ranked with the models."""

import hashlib
import tarfile
from pathlib import Path

import pytest
from images import config_bytes, docker_archive, entry, gzipped, oci_layout, tar_bytes
from service_client import problem_of, running_service
from service_factories import TASK, TRACK, claim, play_all, shard_ids
from sqlalchemy import update
from vitac.evaluator.submission.image import load_program
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.database.engine import Database
from vitac.server.database.models import Submission
from vitac.server.storage import stored_files
from vitac.worker.shard_run import ShardRun
from vitac.worker.staging import SubmissionStage
from worker_fakes import FakeShards

LAYER = tar_bytes(
    [
        entry("submission.yaml", f"track: {TRACK}\ntasks: [{TASK}]\nname: in a box\n".encode()),
        entry("policy", b"run", mode=0o755),
    ]
)
CONFIG = config_bytes([LAYER], ["/policy"], WorkingDir="")
IMAGE = docker_archive([LAYER], CONFIG)
TAR_TYPE = "application/x-tar"


def test_image_is_queued_and_ranked_with_models(database: Database, tmp_path: Path) -> None:
    with running_service(database, tmp_path) as service:
        answer = service.upload(IMAGE, query="?kind=image", Content_Type=TAR_TYPE)
        assert answer.status_code == 202, answer.text
        assert answer.json()["kind"] == "image"
        repacked = service.upload(oci_layout([LAYER], CONFIG, gzipped), query="?kind=image", Content_Type=TAR_TYPE)
        assert repacked.json()["id"] == answer.json()["id"]  # the same files, packed another way
        with service.database.transaction() as session:
            submission = session.get_one(Submission, answer.json()["id"])
        play_all(service.database, submission)
        (ranked,) = service.get(f"/leaderboards/{TRACK}").json()["entries"]
        assert (ranked["submission_id"], ranked["kind"]) == (answer.json()["id"], "image")


def test_a_layer_that_two_images_share_is_stored_once_and_goes_with_the_last(
    database: Database, tmp_path: Path
) -> None:
    base = tar_bytes([entry("base", bytes(range(256)) * 4096)])
    images = {}
    for name in ("one", "two"):
        layers = [base, LAYER, tar_bytes([entry(name, name.encode())])]
        images[name] = docker_archive(layers, config_bytes(layers, ["/policy"]))
    with running_service(database, tmp_path) as service:
        blobs = service.services.blobs
        for image in images.values():
            answer = service.upload(image, query="?kind=image", Content_Type=TAR_TYPE)
            assert answer.status_code == 202, answer.text
            assert blobs.read(hashlib.sha256(image).hexdigest()) == image
        files = [path for path in (tmp_path / "blobs").rglob("*") if path.is_file()]
        assert len(base) < sum(path.stat().st_size for path in files) < 1.2 * len(base)
        digests = [hashlib.sha256(image).hexdigest() for image in images.values()]
        with database.transaction() as session:
            session.execute(update(Submission).values(archive_sha256="0" * 64))
        stored_files.remove_unnamed(database, blobs, digests[:1])
        assert blobs.read(digests[1]) == images["two"]
        stored_files.remove_unnamed(database, blobs, digests)
        assert not [path for path in (tmp_path / "blobs").rglob("*") if path.is_file()]


def test_worker_unpacks_an_image_and_runs_it_as_one(database: Database, tmp_path: Path) -> None:
    with running_service(database, tmp_path) as service:
        answer = service.upload(IMAGE, query="?kind=image", Content_Type=TAR_TYPE)
        with service.database.transaction() as session:
            submission = session.get_one(Submission, answer.json()["id"])
            shard = shard_ids(session, submission)[0]
        services, shards = service.services, FakeShards()
        stage = SubmissionStage(services.blobs, services.settings.scratch_dir, services.settings.limits)
        try:
            ShardRun(services, stage, claim(services.database, shard), shards).run()
            (started,) = shards.started
            assert started.order.kind is SubmissionKind.IMAGE
            assert load_program(started.order.submission).arguments == ("/policy",)
        finally:
            stage.close()


@pytest.mark.parametrize(
    ("layer", "code", "reason", "words"),
    [
        (tar_bytes([entry("../x")]), "archive_rejected", "parent_path", "leads out of the image"),
        (
            tar_bytes([entry("disk", type=tarfile.BLKTYPE)]),
            "archive_rejected",
            "special_file",
            "not a regular file",
        ),
        (tar_bytes([entry(".wh.submission.yaml")]), "manifest_rejected", None, "COPY submission.yaml /"),
    ],
)
def test_hostile_image_is_refused_and_nothing_is_kept(
    database: Database, tmp_path: Path, layer: bytes, code: str, reason: str | None, words: str
) -> None:
    layers = [LAYER, layer]
    with running_service(database, tmp_path) as service:
        image = docker_archive(layers, config_bytes(layers, ["/policy"]))
        answer = service.upload(image, query="?kind=image", Content_Type=TAR_TYPE)
        problem = problem_of(answer, 422, code)
        assert words in problem["detail"]
        assert problem.get("reason") == reason
        service.assert_nothing_left()
