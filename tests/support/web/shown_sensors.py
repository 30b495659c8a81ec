"""Sensors on their pages: uploaded to a seeded site, checked as a worker does, and played and measured if asked to."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import drawn_gels
from own_sensors import GELS, write_sensor
from seeded_site import SeededSite, form_token
from sensor_checks import check_sensors
from service_client import make_archive
from service_factories import own_record, play_all, sha256
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord
from vitac.evaluator.figures.figures import FiguresPart
from vitac.evaluator.figures.table import reference_figures
from vitac.evaluator.sensors.check import accepted_sensor
from vitac.evaluator.sensors.made import MadeSensor, made_sensor
from vitac.server.database.models import Submission, SubmissionFile
from vitac.server.database.states import FileRole
from vitac.server.evaluations.history import newest_evaluation

MARKERS = "markers: {grid: {columns: 8, rows: 6, spacing_mm: [2.4, 2.0]}}\n"
MANIFEST = "track: track_3\ntasks: [sensor-standard]\nname: {}\n"
DOCUMENT = b"%PDF-1.7 <script>"


@cache
def a_made_sensor(gel: str = "ridge") -> MadeSensor:
    with TemporaryDirectory() as name:
        return made_sensor(accepted_sensor(write_sensor(Path(name), GELS[gel](), MARKERS)))


def upload_sensor(site: SeededSite, team: str, name: str, gel: str) -> str:
    """The page of a sensor of a team, whose gel is made without the sandbox."""
    files: dict[str, str | bytes] = {
        "submission.yaml": MANIFEST.format(name),
        "sensor.yaml": MARKERS,
        "gel.stl": drawn_gels.stl_bytes(GELS[gel]()),
        "design.pdf": DOCUMENT,
    }
    archive = make_archive({f"Track_3/{file}": content for file, content in files.items()})
    browser = site.visitor(team)
    answer = browser.post(
        "/submissions/upload", data={"form_token": form_token(browser)}, files={"file": ("gel.zip", archive)}
    )
    with patch("vitac.worker.short_runs.make_sensor", lambda *_, **__: a_made_sensor(gel)):
        check_sensors(site.services)
    path: str = answer.headers["location"]
    with site.database.reading() as session:
        site.added[name] = session.get_one(Submission, path.rpartition("/")[2]).id
    return f"{path}/sensor"


def play_and_measure(site: SeededSite, name: str) -> None:
    """Complete the evaluation of a sensor: of 90 seen episodes 19 are solved, of the blind ones one."""

    def record_of(episode: int, *, task: str) -> EpisodeRecord:
        is_solved = episode <= (19 if task == "sensor-standard" else 1)
        return own_record(1, episode, EpisodeOutcome.SUCCESS if is_solved else EpisodeOutcome.STEPS, task)

    with site.database.reading() as session:
        submission = session.get_one(Submission, site.id_of(name))
        version = newest_evaluation(session, submission).evaluator_version
    play_all(site.database, submission, record_of)
    figures = reference_figures()
    part = FiguresPart(starts=(), touch=figures.touch, grasp=figures.grasp)
    facts = {"evaluator_version": version, "commitment": None, "shard": 0, "part": part.model_dump(mode="json")}
    with site.database.transaction() as session:
        session.add(
            SubmissionFile(
                submission_id=submission.id, role=FileRole.FIGURES, sha256=sha256("part"), n_bytes=1, name="part.json",
                facts=facts,
            )
        )  # fmt: skip
