import json
import re
import threading
from pathlib import Path

from cli_service import MANIFEST, CliService, submission_folder
from service_factories import make_failed_record, make_record, play_all
from submission_steps import make_worker
from vitac.cli.client.refusals import RequestRefused
from vitac.cli.client.status import EvaluationEndedWithoutScore
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord
from vitac.server.db.models import Submission

RATES = {"peg-insertion": "66.7 %", "lock-opening": "66.9 %", "all tasks": "66.8 %"}
BOTH = MANIFEST.replace("[peg-insertion]", "[lock-opening, peg-insertion]")


def submitted(service: CliService, tmp_path: Path, manifest: str = MANIFEST) -> str:
    answer = json.loads(service.run("submit", str(submission_folder(tmp_path / "mine", manifest)), "--json").stdout)
    return str(answer["id"])


def play(service: CliService, submission_id: str, *, fails: bool = False) -> None:
    with service.database.transaction() as session:
        submission = session.get_one(Submission, submission_id)
        _ = submission.team
    play_all(service.database, submission, make_failed_record if fails else some_fail)


def some_fail(episode: int, *, task: str) -> EpisodeRecord:
    return make_record(episode, EpisodeOutcome.TACTILE if episode % 3 == 0 else EpisodeOutcome.SUCCESS, task)


def test_lists_the_newest_or_says_how_to_begin(service: CliService, tmp_path: Path) -> None:
    assert "vitac submit FOLDER" in service.run("status").stdout
    submission_id = submitted(service, tmp_path)
    table = service.run("status").stdout
    for shown in (submission_id, "zero", "Team A", "queued", "0/270"):
        assert shown in table
    assert [item["id"] for item in json.loads(service.run("status", "--json").stdout)] == [submission_id]


def test_says_that_no_worker_takes_the_submission_and_why(service: CliService, tmp_path: Path) -> None:
    waits = "waits\\s+no worker is running"
    submission_id = submitted(service, tmp_path)
    assert re.search(waits, service.run("submit", str(tmp_path / "mine")).stdout)
    assert re.search(waits, service.run("status", submission_id).stdout)
    make_worker(service.database)
    assert "waits" not in service.run("status", submission_id).stdout
    play(service, submission_id)
    assert "waits" not in service.run("status", submission_id).stdout


def test_shows_a_score_with_its_interval_and_hash(service: CliService, tmp_path: Path) -> None:
    submission_id = submitted(service, tmp_path)
    play(service, submission_id)
    shown = service.run("status", submission_id).stdout
    for part in ("completed", "66.7 % (60.8 % to 72.0 %), 3.00 env steps, rank 1 of 1", "270 of 270"):
        assert part in shown
    assert "33.3 % (30.4 % to 36.0 %), no success, rank 1 of 1" in shown
    assert "lock-opening (counts as 0" in shown
    as_json = json.loads(service.run("status", submission_id, "--json").stdout)
    assert as_json["evaluation"]["result_hash"] in shown


def test_two_tasks_are_shown_each_and_together(service: CliService, tmp_path: Path) -> None:
    submission_id = submitted(service, tmp_path, BOTH)
    queued = service.run("status", submission_id).stdout
    assert queued.index("0 of 430") < queued.index("0 of 270, 0 successes") < queued.index("0 of 160, 0 successes")
    play(service, submission_id)
    shown = service.run("status", submission_id).stdout
    assert "not submitted" not in shown
    evaluation = json.loads(service.run("status", submission_id, "--json").stdout)["evaluation"]
    hashes = [evaluation["result_hash"], *(score["result_hash"] for score in evaluation["scores"])]
    rates = [f"{task:<19}  {rate}" for task, rate in RATES.items()]
    for part in (*rates, *hashes):
        assert part in shown
    assert "peg-insertion 66.7 %, lock-opening 66.9 %" in service.run("status").stdout


def test_watch_ends_with_the_evaluation(service: CliService, tmp_path: Path) -> None:
    submission_id = submitted(service, tmp_path)
    worker = threading.Thread(target=play, args=[service, submission_id])
    worker.start()
    watched = service.run("status", submission_id, "--watch")
    worker.join()
    assert watched.exit_code == 0
    assert "completed" in watched.stdout
    assert "270/270 episodes, 180 successes" in watched.stderr


def test_watching_one_that_fails_is_refused_with_its_verdict(service: CliService, tmp_path: Path) -> None:
    submission_id = submitted(service, tmp_path)
    play(service, submission_id, fails=True)
    watched = service.run("status", submission_id, "--watch")
    assert isinstance(watched.exception, EvaluationEndedWithoutScore)
    assert "crashed" in str(watched.exception)
    assert "last lines of the policy's output" in watched.stdout
    assert "(peg-insertion, episode 1)" in watched.stdout


def test_watching_one_that_is_cancelled_is_refused(service: CliService, tmp_path: Path) -> None:
    submission_id = submitted(service, tmp_path)
    assert service.run("admin", "submission", "cancel", submission_id, "--yes").exit_code == 0
    watched = service.run("status", submission_id, "--watch", "--json")
    assert str(watched.exception) == "The evaluation cancelled."
    assert json.loads(watched.stdout)["evaluation"]["state"] == "cancelled"


def test_watch_needs_an_id(service: CliService) -> None:
    assert service.run("status", "--watch").exit_code == 2


def test_a_foreign_or_missing_id_is_refused(service: CliService) -> None:
    refused = service.run("status", "00000000-0000-4000-8000-000000000000")
    assert isinstance(refused.exception, RequestRefused)
    assert "404" in str(refused.exception)
