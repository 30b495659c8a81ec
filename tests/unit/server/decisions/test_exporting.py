"""Boards of sensors and of logs are exported with all that their audit needs, and a change of it is found."""

import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest
from audited_boards import complete, environment_of, played_again, sampled
from databases import opened_database
from obstore.store import MemoryStore
from service_factories import (
    TASK,
    TRACK,
    forget_boards,
    make_principal,
    make_record,
    make_upload,
    sha256,
    submit_to,
    take,
)
from shown_sensors import a_made_sensor
from sqlalchemy import select, text
from sqlalchemy.orm import Session
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome, EpisodeRecord
from vitac.evaluator.sensors.made import MAX_BYTES, MadeSensor
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.accounts import teams
from vitac.server.database.engine import Database
from vitac.server.database.models import BoardResult, SensorCheck, SubmissionFile
from vitac.server.database.states import FileRole
from vitac.server.decisions.exporting import export_receipts
from vitac.server.errors import ServiceError
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.evaluations.lifecycle import end_check
from vitac.server.evaluations.logs import LogClaim
from vitac.server.operations import team_data
from vitac.server.principals import CONSOLE
from vitac.server.receipts.audit import Audit, audit
from vitac.server.receipts.export import ExportReader, sensor_name
from vitac.server.storage.blobs import BlobStore, StoredFileLost
from vitac.server.submissions import creation
from vitac.server.submissions.files import add_files
from vitac.server.submissions.intake import UploadedFile

from competitions import shown_stage

SEED = 1
SENSOR_TASK = "sensor-standard"
CLAIM = LogClaim(team=None, episodes=270, successes=270, success_rate=1.0, mean_steps=3.0)
MADE = a_made_sensor()
OTHER = MADE.model_copy(update={"camera": (331.0, *MADE.camera[1:])})


def stored(blobs: BlobStore, made: MadeSensor, folder: Path) -> UploadedFile:
    path = folder / made.digest
    path.write_bytes(made.as_bytes())
    blobs.put(path, made.digest)
    return UploadedFile(
        role=FileRole.SENSOR, path=path, sha256=made.digest, n_bytes=path.stat().st_size, name="sensor.json"
    )


def learned(evaluation: UUID, sensor: str) -> UploadedFile:
    """What a worker stores of the estimator's coefficients."""
    return UploadedFile(
        role=FileRole.COEFFICIENTS,
        path=Path("unread"),
        sha256=sha256("coefficients"),
        n_bytes=1,
        name="coefficients.json",
        facts={str(evaluation): sensor},
    )


@pytest.fixture(scope="module")
def blobs() -> BlobStore:
    return BlobStore(MemoryStore())


@pytest.fixture(scope="module")
def database(blobs: BlobStore, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Database]:
    """A sensor of the Ants; and logs of the Bees and the Cats, of which the Drones have uploaded a copy."""
    folder = tmp_path_factory.mktemp("sensors")
    with opened_database() as database:
        _add_sensor(database, stored(blobs, MADE, folder))
        _add_logs(database)
        yield database


def _add_sensor(database: Database, file: UploadedFile) -> None:
    env = environment_of(SENSOR_TASK, MADE.design())
    real = played_again(SENSOR_TASK, sampled(SEED, 1)[1], env)

    def record_of(task: str, number: int) -> EpisodeRecord:
        return real if number == real.episode else make_record(number, task=task)

    with database.transaction() as session:
        submission = submit_to(session, make_principal(session, "Ants"), track="track_3", task=SENSOR_TASK)
        evaluation = newest_evaluation(session, submission)
        add_files(session, submission.id, [file, learned(evaluation.id, file.sha256)])
        end_check(session, take(session, session.scalars(select(SensorCheck.id)).one()))
    complete(database, submission, env, record_of)


def _add_logs(database: Database) -> None:
    env = environment_of(TASK)
    log, number = sampled(SEED, 3)
    real = {log % 2: played_again(TASK, number, env)}
    for place, team in enumerate(("Bees", "Cats", "Drones")):

        def record_of(task: str, number: int, of: int = place % 2, failing: int = place) -> EpisodeRecord:
            if of in real and real[of].episode == number:
                return real[of]
            outcome = EpisodeOutcome.TACTILE if number == 270 - failing else EpisodeOutcome.SUCCESS
            actions = ActionSequence.from_array(np.full((3, 3), number / 1000 + of / 4, np.float32))
            hashes = tuple(sha256(f"{of} {number} {step}") for step in range(4))
            return make_record(number, outcome, task, actions=actions, state_hashes=hashes)

        with database.transaction() as session:
            upload = make_upload(team, kind=SubmissionKind.LOG, manifest=CLAIM.stored(), name=team)
            submission = creation.create(session, make_principal(session, team), upload)[0]
        complete(database, submission, env, record_of)


Exported = Callable[..., Path]


@pytest.fixture
def exported(database: Database, blobs: BlobStore, tmp_path: Path) -> Exported:
    """Writes a board after changes of somebody who has the database, which are taken back."""

    def write(*changes: str | Callable[[Session], None], of_logs: bool = False) -> Path:
        forget_boards()
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}.zip"
        with Session(database.engine) as session:
            session.execute(text("SET LOCAL session_replication_role = replica"))
            for change in changes:
                if callable(change):
                    change(session)
                else:
                    session.execute(text(change))
            session.expire_all()
            kind = SubmissionKind.LOG if of_logs else SubmissionKind.MODEL
            track, task = (TRACK, TASK) if of_logs else ("track_3", SENSOR_TASK)
            export_receipts(session, blobs, path, shown_stage(session, track), task=task, kind=kind)
        return path

    return write


def one_episode(path: Path) -> Audit:
    return audit(path, episodes=1, seed=SEED)


def with_sensor(export: Path, content: bytes | None) -> Path:
    """The export with another file in place of its sensor; None: without one."""
    changed = export.with_suffix(".changed.zip")
    with zipfile.ZipFile(export) as whole, zipfile.ZipFile(changed, "w", zipfile.ZIP_DEFLATED) as made:
        for name in whole.namelist():
            is_sensor = name.startswith("sensors/")
            if not is_sensor:
                made.writestr(name, whole.read(name))
            elif content is not None:
                made.writestr(name, content)
    return changed


@pytest.mark.slow
def test_an_episode_of_a_teams_sensor_is_run_again(exported: Exported) -> None:
    path = exported()
    found = one_episode(path)
    assert (found.findings, found.unchecked, found.logs) == ([], [], 1)
    assert [(each.task, each.episode) for each in found.resimulated] == [(SENSOR_TASK, sampled(SEED, 1)[1])]
    with zipfile.ZipFile(path) as export:
        assert export.read(sensor_name(found.resimulated[0].evaluation)) == MADE.as_bytes()
    made_up = audit(path, episodes=1, seed=SEED + 1)
    assert len(made_up.findings) == 1, "the other records are made up, which only the physics tells"


def test_a_sensor_that_was_replaced_after_the_evaluation_is_not_exported(exported: Exported) -> None:
    def replace(session: Session) -> None:
        owner = session.scalars(select(SubmissionFile.submission_id)).first()
        assert owner is not None
        file = UploadedFile(
            role=FileRole.SENSOR, path=Path("unread"), sha256=OTHER.digest, n_bytes=1, name="sensor.json"
        )
        add_files(session, owner, [file])

    found = one_episode(exported(replace))
    assert found.findings == []
    assert "the export does not hold its sensor" in found.unchecked[0]


def test_an_export_that_fails_half_way_leaves_no_file(
    exported: Exported, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def lose(_: BlobStore, digest: str) -> bytes:
        raise StoredFileLost(digest)

    with monkeypatch.context() as patch:
        patch.setattr(BlobStore, "read", lose)
        with pytest.raises(StoredFileLost):
            exported()
    assert list(tmp_path.iterdir()) == []
    assert one_episode(exported()).findings == [], "the same name is free"


def test_another_sensor_than_the_one_played_with_is_found(exported: Exported) -> None:
    found = one_episode(with_sensor(exported(), OTHER.as_bytes()))
    assert [finding.partition(": ")[2] for finding in found.findings] == [
        "the sensor in the export is not the one that was played with."
    ]
    assert found.resimulated == []


def test_a_sensor_of_an_export_that_cannot_be_used_is_found_or_told(exported: Exported) -> None:
    export = exported()
    corners = MADE.model_copy(update={"corners": MADE.corners[:8] + "////" + MADE.corners[12:]})
    for content in (b"", b"{}", corners.as_bytes(), MADE.as_bytes() + b" " * MAX_BYTES):
        found = one_episode(with_sensor(export, content))
        assert len(found.findings) == 1
        assert "the sensor cannot be used" in found.findings[0]
    found = one_episode(with_sensor(export, None))
    assert found.findings == []
    assert "the export does not hold its sensor" in found.unchecked[0]


def test_the_sensor_of_a_removed_team_is_not_exported(exported: Exported) -> None:
    found = one_episode(exported(lambda session: team_data.erase(session, CONSOLE, teams.find(session, "Ants"))))
    assert found.findings == []
    assert any("does not hold its sensor" in each for each in found.unchecked)


def test_a_board_of_logs_is_audited(exported: Exported) -> None:
    path = exported(of_logs=True)
    found = one_episode(path)
    assert found.findings == []
    assert found.unchecked == [
        "Drones: receipt 8; the service says that this is a copy of an earlier one, so it is not ranked."
    ]
    assert (found.entries, found.logs, len(found.resimulated)) == (3, 3, 1)
    assert audit(path, episodes=1, seed=SEED + 1).findings != []


def test_a_copy_of_several_tasks_is_named_once(exported: Exported) -> None:
    columns = [column.name for column in BoardResult.__table__.columns if column.name != "board"]
    again = (
        f"INSERT INTO board_results (board, {', '.join(columns)}) "  # noqa: S608 - names of our own columns
        f"SELECT 'lock-opening', {', '.join(columns)} FROM board_results WHERE is_copy"
    )
    with ExportReader.opened(exported(again, of_logs=True)) as reader:
        assert len(reader.description.copies) == 1


@pytest.mark.parametrize(
    ("statement", "finding"),
    [
        ("UPDATE evaluations SET scores = jsonb_set(scores, '{0,successes}', '270')", "269 in the receipt"),
        (
            "UPDATE board_results SET is_copy = true WHERE kind = 'log'",
            "Bees: receipt 4; the service says that this is a copy",
        ),
        ("DELETE FROM board_results WHERE team_id = (SELECT id FROM teams WHERE name = 'Cats')", "is not on it"),
        ("DELETE FROM episode_results WHERE episode = 9", "the first missing one is 9"),
    ],
)
def test_a_tampered_board_of_logs_is_found(exported: Exported, statement: str, finding: str) -> None:
    found = audit(exported(statement, of_logs=True), episodes=0)
    assert any(finding in each for each in found.findings + found.unchecked), found


def test_logs_are_exported_task_by_task_and_text_logs_not(database: Database, blobs: BlobStore, tmp_path: Path) -> None:
    with database.transaction() as session:
        for kind, message in ((SubmissionKind.LOG, "name one of peg-insertion"), (SubmissionKind.TEXT_LOG, "no board")):
            with pytest.raises(ServiceError, match=message):
                export_receipts(session, blobs, tmp_path / "logs.zip", shown_stage(session, TRACK), kind=kind)
    assert not (tmp_path / "logs.zip").exists()
