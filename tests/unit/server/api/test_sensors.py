import hashlib
import subprocess
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from uuid import uuid4

import drawn_gels
import pytest
from httpx import Response
from measured_figures import GRASP, TOUCH, start
from own_sensors import write_sensor
from sensor_checks import check_sensors
from service_client import POLICY, Service, make_archive, problem_of
from service_factories import claim, make_record, play_all, shard_ids, store, take
from sqlalchemy import delete, select, text, update
from vitac.errors import VitacError
from vitac.evaluator.agent.verdicts import SandboxFailed
from vitac.evaluator.figures.figures import FigureChoice, FiguresPart, SensorFigures, Variation
from vitac.evaluator.playback import SCENE_FILE, PlaybackOrder
from vitac.evaluator.regression import Coefficients
from vitac.evaluator.sensors.made import MadeSensor, read_design, read_made_sensor
from vitac.evaluator.sensors.manifest import SensorRejected
from vitac.evaluator.shards.order import ShardOrder
from vitac.evaluator.submission.sensor import SensorNotMade
from vitac.evaluator.version import evaluator_version
from vitac.server.competitions import sealing
from vitac.server.database.models import EpisodeResult, Evaluation, SensorCheck, Shard, Submission, SubmissionFile
from vitac.server.database.states import FileRole, WorkKind, WorkState
from vitac.server.evaluations import lifecycle
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.operations import housekeeping
from vitac.server.playbacks import asking
from vitac.server.playbacks import work as playbacks
from vitac.server.principals import CONSOLE
from vitac.server.queue import leases, work
from vitac.server.queue.leases import Lease
from vitac.server.queue.work import KINDS, name_requirement
from vitac.server.submissions.files import add_files, stored_digests
from vitac.server.submissions.intake import UploadedFile
from vitac.server.submissions.sensors import coefficients_digest, has_part
from vitac.worker import leased_run
from vitac.worker.leased_run import RunEnd
from vitac.worker.shard_run import ShardRun
from vitac.worker.short_runs import PlaybackRun, SensorCheckRun
from vitac.worker.staging import SubmissionStage
from worker_fakes import FakeShards

from competitions import stored_stage

PDF = b"%PDF-1.7\n1 0 obj << /OpenAction << /S /JavaScript /JS (app.alert(1)) >> >> endobj\n"
HERE = name_requirement(evaluator_version())
NO_CHANGES: Mapping[str, str | bytes | None] = {}
MANIFEST = "track: track_3\ntasks: [{tasks}]\nname: flat\n"


def package(files: Mapping[str, str | bytes | None] = NO_CHANGES, tasks: str = "sensor-standard") -> bytes:
    """A zip of a sensor with these files changed; None leaves a file away."""
    content: dict[str, str | bytes | None] = {
        "submission.yaml": MANIFEST.format(tasks=tasks),
        "sensor.yaml": "{}",
        "gel.stl": drawn_gels.stl_bytes(drawn_gels.flat()),
        "design.pdf": PDF,
        "policy.py": POLICY,
        **files,
    }
    return make_archive({f"Track_3/{name}": data for name, data in content.items() if data is not None})


def upload(service: Service, archive: bytes, **options: Any) -> Response:
    """Uploads a sensor and has a worker check it."""
    answer = service.upload(archive, **options)
    check_sensors(service.services)
    return answer


def verdict(service: Service, identity: str) -> tuple[str, str]:
    """Code and message with which its evaluation has failed."""
    evaluation = service.get(f"/submissions/{identity}").json()["evaluation"]
    assert evaluation["state"] == "failed"
    return evaluation["verdict"]["code"], evaluation["verdict"]["message"]


def stored(service: Service) -> list[str]:
    with service.database.transaction() as session:
        return stored_digests(session)


def test_sensor_is_made_stored_by_digest_and_shown(service: Service, tmp_path: Path) -> None:
    answer = upload(service, package())
    assert answer.status_code == 202, answer.text
    body = answer.json()
    assert (body["track"], body["tasks"]) == ("track_3", ["sensor-standard", "sensor-blind"])
    sensor = service.get(f"/submissions/{body['id']}/sensor").json()
    assert (sensor["thickness_mm"], sensor["markers"], sensor["is_own_mesh"]) == (4.0, 63, False)
    assert (sensor["gain"], sensor["coefficients_sha256"]) == (None, None)
    made = read_made_sensor(service.services.blobs.read(sensor["digest"]))
    assert made.mesh_digest == sensor["mesh_digest"]
    folder = tmp_path / "local"
    folder.mkdir()
    local = read_design(write_sensor(folder, drawn_gels.flat()))
    assert made.design().as_bytes() == local.as_bytes()
    with_policy = upload(service, package(tasks="sensor-design")).json()
    assert with_policy["tasks"] == ["sensor-design", "sensor-standard", "sensor-blind"], "beside the estimator"


def test_document_is_handed_out_and_never_shown(service: Service) -> None:
    identity = upload(service, package()).json()["id"]
    answer = service.get(f"/submissions/{identity}/document")
    assert answer.content == PDF
    assert answer.headers["content-type"] == "application/octet-stream"
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert answer.headers["content-disposition"] == f'attachment; filename="{identity}-design-document.pdf"'
    assert "sandbox" in answer.headers["content-security-policy"]


def test_submission_without_a_sensor_has_none_to_show(service: Service) -> None:
    identity = service.upload(make_archive()).json()["id"]
    for what in ("sensor", "document"):
        problem_of(service.get(f"/submissions/{identity}/{what}"), 404, "not_found")


def test_sensor_that_breaks_a_rule_gets_its_sentence_as_a_verdict(service: Service) -> None:
    thin = package({"gel.stl": drawn_gels.stl_bytes(drawn_gels.flat(1.0))})
    identity = upload(service, thin).json()["id"]
    code, message = verdict(service, identity)
    assert (code, "thickness: 1.000 mm, expected 2 to 8 mm" in message) == ("sensor_rejected", True), message
    problem_of(service.get(f"/submissions/{identity}/sensor"), 404, "not_found")
    assert service.upload(thin).status_code == 200, "the same files would break the same rule"


def test_submission_without_one_of_its_files_is_refused_at_once(service: Service) -> None:
    rows = [("design.pdf", "Expected one design document (a .pdf or .md file"), ("gel.stl", "gel.stl is missing")]
    for name, says in rows:
        problem = problem_of(service.upload(package({name: None})), 422, "sensor_rejected")
        assert says in problem["detail"]
        service.assert_nothing_left()


def test_upload_of_a_sensor_is_answered_at_once_and_shows_its_check(service: Service) -> None:
    answer = service.upload(package())
    assert answer.status_code == 202
    body = answer.json()
    assert (body["evaluation"]["state"], body["evaluation"]["sensor_check"]) == ("queued", "queued")
    assert body["evaluation"]["progress"]["episodes_done"] == 0
    with service.database.transaction() as session:
        submission = session.get_one(Submission, body["id"])
        assert shard_ids(session, submission) == []
        (check,) = session.scalars(select(SensorCheck.id))
        take(session, check)
    shown = service.get(f"/submissions/{body['id']}").json()["evaluation"]
    assert shown["sensor_check"] == "running"
    with service.database.transaction() as session:
        session.execute(text("UPDATE work SET state = 'queued', worker_id = NULL, lease_expires_at = NULL"))
    assert check_sensors(service.services) == [RunEnd.FINISHED]
    with service.database.transaction() as session:
        assert len(shard_ids(session, session.get_one(Submission, body["id"]))) == 20
    assert service.get(f"/submissions/{body['id']}").json()["evaluation"]["sensor_check"] is None


def test_a_check_that_never_ends_is_ended_costs_an_attempt_and_gets_a_verdict(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a gel whose surface is divided for ever; another team's sensor does not wait for it."""
    monkeypatch.setattr("vitac.worker.short_runs.make_sensor", never_ends)
    limited = replace(KINDS[WorkKind.SENSOR_CHECK], limit_s=0.3)
    monkeypatch.setattr(leased_run, "KINDS", {**KINDS, WorkKind.SENSOR_CHECK: limited})
    identity = service.upload(package()).json()["id"]
    other = service.upload(package(), token=service.other_token)
    assert other.status_code == 202
    claims = [work.claim(service.database, service.services.settings, uuid4(), [HERE]) for _ in range(2)]
    assert [claimed and claimed.kind for claimed in claims] == [WorkKind.SENSOR_CHECK] * 2
    with service.database.transaction() as session:
        for claimed in claims:
            assert claimed is not None
            work.hand_back(session, claimed)
    assert check_sensors(service.services) == [RunEnd.BROKE, RunEnd.BROKE]
    code, message = verdict(service, identity)
    assert (code, message) == (
        "sensor_too_slow",
        "Checking and meshing the sensor took longer than 0.3 s, and was ended.",
    )
    with service.database.transaction() as session:
        evaluation = newest_evaluation(session, session.get_one(Submission, identity))
        assert evaluation.charged_at is not None, "it counts for the attempts of the day"
        assert work.count_open(session) == 0


def never_ends(_: Path, *, watch: Callable[[subprocess.Popen[bytes]], object]) -> MadeSensor:
    """A check in a process that only a kill ends."""
    with subprocess.Popen(["sleep", "600"]) as process:
        watch(process)
        process.wait()
    raise SensorRejected("Checking and meshing the gel took too much time or memory; simplify it.")


def test_stopped_worker_gives_its_check_back(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vitac.worker.short_runs.make_sensor", never_ends)
    service.upload(package())
    with service.database.transaction() as session:
        (check,) = session.scalars(select(SensorCheck.id))
        lease = leases.begin_check(session, take(session, check))
    settings = service.services.settings
    stage = SubmissionStage(service.services.blobs, settings.scratch_dir, settings.limits)
    run = SensorCheckRun(service.services, stage, lease)
    threading.Timer(0.3, run.stop).start()
    assert run.run() is RunEnd.HANDED_BACK
    stage.close()
    with service.database.transaction() as session:
        found = session.get_one(SensorCheck, check)
        assert (found.state, found.attempts) == (WorkState.QUEUED, 0)


def test_file_that_unpacks_to_far_more_than_was_sent_is_refused(service: Service) -> None:
    for name in ["gel.stl", "design.pdf", "tet.msh"]:
        problem = problem_of(service.upload(package({name: bytes(17 * 2**20)})), 422, "archive_rejected")
        assert problem["reason"] == "compressed_too_much"
        service.assert_nothing_left()


def test_large_document_is_refused(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vitac.evaluator.sensors.package.MAX_DOCUMENT_BYTES", len(PDF) - 1)
    problem = problem_of(upload(service, package()), 422, "sensor_rejected")
    assert f"has {len(PDF)} bytes, expected 1 to {len(PDF) - 1}" in problem["detail"]
    service.assert_nothing_left()


def test_same_sensor_twice_is_one_submission_with_its_files_once(service: Service) -> None:
    first, again = upload(service, package()), upload(service, package())
    assert (again.status_code, again.json()["id"]) == (200, first.json()["id"])
    with service.database.transaction() as session:
        roles = session.scalars(select(SubmissionFile.role).order_by(SubmissionFile.role)).all()
    assert list(roles) == [FileRole.DOCUMENT, FileRole.SENSOR]


def test_sensor_stays_that_of_its_run_until_another_begins(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    """After an upgrade another mesher makes another sensor of the same archive."""
    identity = upload(service, package()).json()["id"]
    digest = service.get(f"/submissions/{identity}/sensor").json()["digest"]
    made = read_made_sensor(service.services.blobs.read(digest))
    other = made.model_copy(update={"markers_mm": made.markers_mm[1:]})
    monkeypatch.setattr("vitac.worker.short_runs.make_sensor", lambda _, **__: other)
    again = upload(service, package())
    assert (again.status_code, again.json()["id"]) == (200, identity)
    assert service.get(f"/submissions/{identity}/sensor").json()["digest"] == digest
    service.post(f"/submissions/{identity}/cancel")
    assert upload(service, package()).status_code == 202
    assert service.get(f"/submissions/{identity}/sensor").json()["digest"] == other.digest


def test_housekeeping_keeps_the_files_of_submissions(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    upload(service, package())
    kept = stored(service)
    assert len(kept) == 3
    monkeypatch.setattr(service.services.blobs, "list_older_than", lambda _: [*kept, "0" * 64])
    monkeypatch.setattr(service.services.blobs, "is_older_than", lambda *_: True)
    removed: list[str] = []
    monkeypatch.setattr(service.services.blobs, "delete", removed.append)
    housekeeping.prune(service.services)
    assert removed == ["0" * 64]


def test_gain_is_shown_once_both_runs_are_complete(service: Service) -> None:
    identity = upload(service, package()).json()["id"]
    with service.database.transaction() as session:
        submission = session.get_one(Submission, identity)
    play_all(service.database, submission)
    gain = service.get(f"/submissions/{identity}/sensor").json()["gain"]
    assert (gain["episodes"], gain["standard_successes"], gain["blind_successes"]) == (270, 270, 270)
    assert (gain["gain"], gain["p_value"]) == (0.0, 1.0)
    shown = service.get(f"/submissions/{identity}").json()
    assert shown["rank"] is None
    assert shown["task_ranks"]["sensor-standard"] == {"rank": 1, "of": 1}


def test_gain_is_not_shown_on_a_sealed_list_nor_of_one_run(service: Service) -> None:
    sealed, single = (upload(service, package(files)).json()["id"] for files in (NO_CHANGES, {"policy.py": "x = 1"}))
    with service.database.transaction() as session:
        submissions = [session.get_one(Submission, identity) for identity in (sealed, single)]
    for submission in submissions:
        play_all(service.database, submission)
    with service.database.transaction() as session:
        session.execute(delete(EpisodeResult).where(EpisodeResult.task == "sensor-blind"))
        made = sealing.seal(session, CONSOLE, stored_stage(session, "track_3", "final"))
        session.execute(update(Evaluation).where(Evaluation.submission_id == sealed).values(commitment=made.commitment))
    for identity in (sealed, single):
        answer = service.get(f"/submissions/{identity}/sensor")
        assert (answer.status_code, answer.json()["gain"]) == (200, None)


@pytest.mark.parametrize("failure", [SensorNotMade, SandboxFailed])
def test_sandbox_that_does_not_work_is_no_fault_of_the_team(
    service: Service, monkeypatch: pytest.MonkeyPatch, failure: type[VitacError]
) -> None:
    def fail(_: Path, **__: object) -> MadeSensor:
        raise failure("bwrap in /srv/secret is missing")

    monkeypatch.setattr("vitac.worker.short_runs.make_sensor", fail)
    identity = service.upload(package()).json()["id"]
    for _ in range(service.services.settings.shard_attempts):
        assert check_sensors(service.services) == [RunEnd.BROKE]
    code, message = verdict(service, identity)
    assert (code, "Tried 3 times" in message) == ("machine_failed", True)
    with service.database.transaction() as session:
        assert newest_evaluation(session, session.get_one(Submission, identity)).charged_at is None


def test_a_cancelled_check_is_not_begun(service: Service) -> None:
    identity = service.upload(package()).json()["id"]
    service.post(f"/submissions/{identity}/cancel")
    assert check_sensors(service.services) == []
    assert upload(service, package()).status_code == 202
    assert service.get(f"/submissions/{identity}/sensor").status_code == 200


def measuring(asked: list[ShardOrder]) -> FakeShards:
    """Fake shards that measure at the start of one episode where they are asked to, and remember their orders."""

    def figures_of(order: ShardOrder) -> FiguresPart | None:
        asked.append(order)
        if order.figures is FigureChoice.NONE:
            return None
        return FiguresPart(starts=(start(27 * order.shard + 1, won=True),), touch=TOUCH, grasp=GRASP)

    return FakeShards(figures_of=figures_of)


def run_shard(service: Service, lease: Lease, shards: FakeShards) -> None:
    settings = service.services.settings
    shards.record_of = partial(make_record, task=lease.task)
    stage = SubmissionStage(service.services.blobs, settings.scratch_dir, settings.limits)
    assert ShardRun(service.services, stage, lease, shards).run() is RunEnd.FINISHED
    stage.close()


def test_figures_are_put_together_of_what_the_shards_of_the_blind_run_measured(service: Service) -> None:
    identity = upload(service, package()).json()["id"]
    with service.database.transaction() as session:
        shards = shard_ids(session, session.get_one(Submission, identity))
    asked: list[ShardOrder] = []
    run_shard(service, claim(service.database, shards[0]), measuring(asked))
    assert service.get(f"/submissions/{identity}/sensor").json()["figures"] is None
    for shard in shards[10:12]:
        run_shard(service, claim(service.database, shard), measuring(asked))
    assert [(order.task, order.shard, order.figures) for order in asked] == [
        ("sensor-standard", 0, FigureChoice.NONE),
        ("sensor-blind", 0, FigureChoice.ALL),
        ("sensor-blind", 1, FigureChoice.ALL),
    ]
    shown = SensorFigures.model_validate(service.get(f"/submissions/{identity}/sensor").json()["figures"])
    assert (shown.starts, shown.touch) == (2, TOUCH)
    assert [(row.variation, row.successes) for row in shown.robustness] == [(Variation.NONE, 2), (Variation.NOISE, 2)]
    with service.database.transaction() as session:
        evaluation = newest_evaluation(session, session.get_one(Submission, identity))
        evaluation.evaluator_version = "0+old"
    assert service.get(f"/submissions/{identity}/sensor").json()["figures"] is None


def measured_with(service: Service, identity: str, shard: int, shards: FakeShards) -> FigureChoice:
    """Run a shard of the blind run; return which figures it was asked for."""
    with service.database.transaction() as session:
        lease = claim(service.database, shard_ids(session, session.get_one(Submission, identity))[10 + shard])
    run_shard(service, lease, shards)
    return shards.started[-1].order.figures


def test_figures_of_the_same_sensor_are_measured_once_for_its_team(service: Service) -> None:
    """Nothing else of the archive plays a part in them; another sensor, shard or team has its own."""
    other_text, other_markers = {"design.pdf": b"%PDF-1.7 again"}, {"sensor.yaml": "markers: {points_mm: [[0, 0]]}"}
    first, again, drawn_anew = (upload(service, package(it)).json()["id"] for it in ({}, other_text, other_markers))
    elsewhere = upload(service, package(other_text), token=service.other_token).json()["id"]
    shards = measuring([])
    asked = [measured_with(service, first, 0, shards)]
    asked += [measured_with(service, it, 0, shards) for it in (again, drawn_anew, elsewhere)]
    asked += [measured_with(service, it, 1, shards) for it in (again, first)]
    assert asked == [FigureChoice.ALL, FigureChoice.NONE, *[FigureChoice.ALL] * 3, FigureChoice.NONE]
    shown = [service.get(f"/submissions/{it}/sensor").json()["figures"] for it in (first, again)]
    assert shown[0] == shown[1]
    assert shown[0]["starts"] == 2


def test_figures_are_not_taken_from_a_shard_that_could_not_measure_all_or_played_another_list(
    service: Service,
) -> None:
    first, again = (upload(service, package({"design.pdf": text})).json()["id"] for text in (PDF, b"%PDF-1.7 again"))
    failing = FakeShards(figures_of=lambda _: FiguresPart(starts=(), touch=TOUCH, grasp=GRASP, problem="no room"))
    assert measured_with(service, first, 0, failing) is FigureChoice.ALL
    assert measured_with(service, again, 0, measuring([])) is FigureChoice.ALL
    assert measured_with(service, first, 1, measuring([])) is FigureChoice.ALL
    with service.database.transaction() as session:
        made = sealing.seal(session, CONSOLE, stored_stage(session, "track_3", "final"))
        evaluation = newest_evaluation(session, session.get_one(Submission, again))
        evaluation.commitment = made.commitment
        for shard in evaluation.shards:
            shard.commitment = made.commitment
    assert measured_with(service, again, 1, measuring([])) is FigureChoice.ALL


def test_figures_are_not_taken_from_another_track(service: Service) -> None:
    """All tracks number their shards from the start, and all public lists have no commitment."""
    first, again = (upload(service, package({"design.pdf": text})).json()["id"] for text in (PDF, b"%PDF-1.7 again"))
    measured_with(service, first, 0, measuring([]))
    with service.database.transaction() as session:
        session.get_one(Submission, first).track = "track_of_our_own"
    assert measured_with(service, again, 0, measuring([])) is FigureChoice.ALL


def test_what_the_estimator_has_learned_goes_with_later_shards_of_the_same_evaluation(
    service: Service, tmp_path: Path
) -> None:
    """After a worker was killed, and on other machines, no sensor is calibrated anew."""
    identity = upload(service, package(tasks="sensor-design")).json()["id"]
    with service.database.transaction() as session:
        ids = shard_ids(session, session.get_one(Submission, identity))
    own, first, second, blind = (ids[n] for n in (0, 10, 11, 20))
    learned = Coefficients(mesh_hash="a" * 64, starts=180, regressions=())
    shards = FakeShards(coefficients=learned)
    for shard in (first, second, blind):
        run_shard(service, claim(service.database, shard), shards)
    shards.coefficients = None
    run_shard(service, claim(service.database, own), shards)
    assert [(it.order.task, it.order.coefficients) for it in shards.started] == [
        ("sensor-standard", None),
        ("sensor-standard", learned),
        ("sensor-blind", learned),
        ("sensor-design", None),
    ]
    address = f"/submissions/{identity}/sensor"
    assert service.get(address).json()["coefficients_sha256"] == learned.digest
    with service.database.transaction() as session:
        submission = session.get_one(Submission, identity)
        ended = newest_evaluation(session, submission)
        lifecycle.cancel(session, ended)
        session.flush()
        evaluations = [ended.id, lifecycle.start(session, submission, 2).id]
        again, another = shard_ids(session, submission)[11:13]
    shards = FakeShards(coefficients=learned)
    lease = claim(service.database, again)
    run_shard(service, lease, shards)
    assert [it.order.coefficients for it in shards.started] == [None], "another run learns anew"
    content = b"of the same archive by another mesher"
    replaced = UploadedFile(
        role=FileRole.SENSOR,
        path=tmp_path / "made",
        sha256=hashlib.sha256(content).hexdigest(),
        n_bytes=len(content),
        name="made",
    )
    replaced.path.write_bytes(content)
    service.services.blobs.put(replaced.path, replaced.sha256)
    with service.database.transaction() as session:
        found = [coefficients_digest(session, submission.id, run, lease.sensor_sha256 or "") for run in evaluations]
        assert found == [learned.digest] * 2, "and takes nothing off the first one"
        add_files(session, submission.id, [replaced])
        known = [coefficients_digest(session, submission.id, run, replaced.sha256) for run in evaluations]
        assert known == [None, None], "nothing is known of the new sensor"
    learned = learned.model_copy(update={"mesh_hash": "d" * 64})
    shards = FakeShards(coefficients=learned)
    run_shard(service, claim(service.database, another), shards)
    assert [it.order.coefficients for it in shards.started] == [None], "those of the sensor before are not played with"
    with service.database.transaction() as session:
        assert coefficients_digest(session, submission.id, evaluations[1], replaced.sha256) == learned.digest


def test_coefficients_that_the_storage_has_lost_are_learned_anew(service: Service) -> None:
    identity = upload(service, package()).json()["id"]
    with service.database.transaction() as session:
        first, second = shard_ids(session, session.get_one(Submission, identity))[:2]
    shards = FakeShards(coefficients=Coefficients(mesh_hash="b" * 64, starts=180, regressions=()))
    run_shard(service, claim(service.database, first), shards)
    assert shards.coefficients is not None
    service.services.blobs.delete(shards.coefficients.digest)
    run_shard(service, claim(service.database, second), shards)
    assert [it.order.coefficients for it in shards.started] == [None, None]


def test_figures_on_a_sealed_list_are_its_own_and_those_of_starts_only_for_organizers(service: Service) -> None:
    identity = upload(service, package()).json()["id"]
    address = f"/submissions/{identity}/sensor"
    with service.database.transaction() as session:
        first, second = shard_ids(session, session.get_one(Submission, identity))[10:12]
    lease = claim(service.database, first)
    run_shard(service, lease, measuring([]))
    public = SensorFigures.model_validate(service.get(address).json()["figures"])
    with service.database.transaction() as session:
        made = sealing.seal(session, CONSOLE, stored_stage(session, "track_3", "final"))
        for table in (Evaluation, Shard):
            session.execute(update(table).values(commitment=made.commitment))
        assert has_part(session, lease)
        assert not has_part(session, replace(lease, commitment=made.commitment))
    assert service.get(address).json()["figures"] is None
    run_shard(service, claim(service.database, second), measuring([]))
    shown = SensorFigures.model_validate(service.get(address).json()["figures"])
    assert (shown.touch, shown.grasp, shown.starts, shown.information) == (TOUCH, GRASP, 0, None)
    assert (shown.robustness, shown.cpu_s) == ((), None)
    organizers = SensorFigures.model_validate(service.get(address, token=service.organizer_token).json()["figures"])
    assert (organizers.starts, [row.successes for row in organizers.robustness]) == (1, [1, 1])
    assert organizers.information is not None
    assert public.information is not None
    assert organizers.information.prior != public.information.prior  # that of the starts that were played
    with service.database.transaction() as session:
        session.execute(update(Evaluation).values(commitment=None))
    assert SensorFigures.model_validate(service.get(address).json()["figures"]) == public


def test_shards_that_could_measure_nothing_each_keep_that_they_tried(service: Service) -> None:
    identity = upload(service, package()).json()["id"]
    with service.database.transaction() as session:
        shards = shard_ids(session, session.get_one(Submission, identity))[10:12]
    problem = "Touch and grasp could not be measured: ValueError: nothing senses"
    for shard in shards:
        lease = claim(service.database, shard)
        run_shard(service, lease, FakeShards(figures_of=lambda _: FiguresPart(starts=(), problem=problem)))
        with service.database.transaction() as session:
            assert has_part(session, lease)
    assert service.get(f"/submissions/{identity}/sensor").json()["figures"] is None


def test_shard_whose_episodes_are_stored_still_measures_its_figures(service: Service) -> None:
    """Its worker was killed between the last episode and the figures."""
    identity = upload(service, package()).json()["id"]
    with service.database.transaction() as session:
        first, second = shard_ids(session, session.get_one(Submission, identity))[10:12]
    asked: list[ShardOrder] = []
    run_shard(service, claim(service.database, first), measuring(asked))
    lease = claim(service.database, second)
    store(service.database, lease, [make_record(number, task=lease.task) for number in lease.episodes])
    run_shard(service, lease, measuring(asked))
    assert asked[1].skip == lease.episodes
    with service.database.transaction() as session:
        assert has_part(session, lease)


def test_playback_of_an_episode_is_made_with_the_sensor_of_its_submission(service: Service) -> None:
    """Two sensors with the same records, such as blind runs with other markers, have playbacks of their own."""
    other_markers = {"sensor.yaml": "markers: {points_mm: [[0, 0], [1, 2]]}"}
    identities = [upload(service, package(files)).json()["id"] for files in (NO_CHANGES, other_markers)]
    making = PlaybackOrders()
    for identity in identities:
        with service.database.transaction() as session:
            shard = shard_ids(session, session.get_one(Submission, identity))[10]
        lease = claim(service.database, shard)
        store(service.database, lease, [make_record(lease.episodes[0], task=lease.task)])
        with service.database.transaction() as session:
            episode = asking.find_episode(session, CONSOLE, identity, lease.task, lease.episodes[0])
            asked = asking.ask(session, service.services.settings, CONSOLE, episode)
            claimed = playbacks.begin(session, take(session, asked.id))
        assert claimed is not None
        assert PlaybackRun(service.services, claimed, making).run() is RunEnd.FINISHED
    made = [order.sensor for order in making.orders]
    assert [None if it is None else it.digest for it in made] == [
        service.get(f"/submissions/{identity}/sensor").json()["digest"] for identity in identities
    ]


class PlaybackOrders:
    """Makes playbacks of nothing, and remembers the orders."""

    def __init__(self) -> None:
        self.orders: list[PlaybackOrder] = []

    @contextmanager
    def __call__(self, order: PlaybackOrder) -> Iterator["PlaybackOrders"]:
        self.orders.append(order)
        yield self

    def played(self) -> Iterator[int]:
        (self.orders[-1].folder / SCENE_FILE).write_bytes(b"scene")
        yield self.orders[-1].record.env_steps

    def kill(self) -> None:
        """Nothing runs."""
