import json
import re
import threading
from pathlib import Path
from typing import Any

import pytest
from cli_service import MANIFEST, CliService, submission_folder
from service_factories import make_failed_record, make_record, play_all
from submission_steps import make_worker
from vitac.cli.client.answers import RequestRefused
from vitac.cli.client.status import EvaluationEndedWithoutScore, require_score, show
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord
from vitac.server.database.models import Submission


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


def test_lists_the_newest_or_says_how_to_begin_and_watches_it_without_an_id(
    service: CliService, tmp_path: Path
) -> None:
    for words in ((), ("--watch",)):
        assert "vitac submit FOLDER" in service.run("status", *words).stdout
    submission_id = submitted(service, tmp_path)
    table = service.run("status").stdout
    for shown in (submission_id, "zero", "Team A", "queued", "0/270"):
        assert shown in table
    assert [item["id"] for item in json.loads(service.run("status", "--json").stdout)] == [submission_id]
    play(service, submission_id)
    assert json.loads(service.run("status", "--watch", "--json").stdout)["id"] == submission_id


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
    for part in ("completed", "66.7 % (56.4 % to 75.5 %), 3.00 env steps, rank 1 of 1", "270 of 270"):
        assert part in shown
    assert "33.3 % (28.2 % to 37.8 %), not every task has a success, rank 1 of 1" in shown
    assert "lock-opening (counts as 0 %" in shown
    as_json = json.loads(service.run("status", submission_id, "--json").stdout)
    assert as_json["evaluation"]["result_hash"] in shown


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


def test_a_foreign_or_missing_id_is_refused(service: CliService) -> None:
    refused = service.run("status", "00000000-0000-4000-8000-000000000000")
    assert isinstance(refused.exception, RequestRefused)
    assert "404" in str(refused.exception)


SCORE = {"success_rate": 0.5, "success_rate_interval": [0.25, 0.75], "mean_steps": 4.25, "result_hash": "aa"}


def answer(**changes: Any) -> dict[str, Any]:
    """What the service says of a completed submission of one task."""
    progress = {"episodes_done": 270, "episodes_total": 270, "episodes_reused": 3, "tasks": []}
    evaluation = {
        "state": "completed",
        "queue_position": None,
        "progress": progress,
        "verdict": None,
        "log_tail": "",
        "scores": [{"task": "peg-insertion", **SCORE}],
        "counted_tasks": ["peg-insertion"],
        "result_hash": "bb",
    }
    whole = {
        "id": "1234",
        "name": "mine",
        "team": {"name": "Team A"},
        "track": "track_1",
        "stage": None,
        "kind": "model",
        "tasks": ["peg-insertion"],
        "missing_tasks": [],
        "evaluation": evaluation | SCORE | {"result_hash": "bb"} | changes.pop("evaluation", {}),
        "workers": {"alive": 1, "missing_family": None, "last_heartbeat_at": None},
        "rank": None,
        "task_ranks": {"peg-insertion": {"rank": 2, "of": 7}},
        "log": None,
    }
    return whole | changes


def printed(found: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> dict[str, str]:
    """Names and values of the printed lines."""
    show(found)
    lines = capsys.readouterr().out.partition("\n\n")[0].splitlines()
    return {name.strip(): value.strip() for name, _, value in (line.partition("  ") for line in lines)}


def test_one_task_is_shown_with_its_rank_and_no_sum(capsys: pytest.CaptureFixture[str]) -> None:
    lines = printed(answer(), capsys)
    assert lines["peg-insertion"] == "50.0 % (25.0 % to 75.0 %), 4.25 env steps, rank 2 of 7"
    assert lines["episodes"] == "270 of 270, 3 reused"
    assert lines["result hash"] == "bb"
    assert (lines["track"], printed(answer(stage="final"), capsys)["track"]) == ("track_1", "track_1, final")
    assert not {"all tasks", "hash, peg-insertion", "verdict", "waits", "not submitted"} & lines.keys()


def test_a_task_that_was_not_submitted_counts_and_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    both = {"counted_tasks": ["peg-insertion", "lock-opening"]}
    lines = printed(answer(missing_tasks=["lock-opening"], evaluation=both, rank={"rank": 5, "of": 9}), capsys)
    assert lines["all tasks"].endswith(", rank 5 of 9")
    assert lines["not submitted"] == "lock-opening (counts as 0 % in the ranking of all tasks)"
    assert "hash, peg-insertion" not in lines, "one score has the hash of the whole"


def test_a_sensor_without_a_policy_has_a_score_for_each_run_and_none_of_all_tasks(
    capsys: pytest.CaptureFixture[str],
) -> None:
    tasks = ["sensor-standard", "sensor-blind"]
    none = {"success_rate": None, "success_rate_interval": None, "mean_steps": None}
    scores = [{**SCORE, "task": task} for task in tasks]
    evaluation = {**none, "scores": scores, "counted_tasks": ["sensor-design"]}
    lines = printed(answer(tasks=tasks, missing_tasks=["sensor-design"], evaluation=evaluation), capsys)
    assert lines["sensor-standard"] == lines["sensor-blind"] == "50.0 % (25.0 % to 75.0 %), 4.25 env steps"
    assert lines["not submitted"] == "sensor-design (without it no place in the ranking of all tasks)"
    assert "all tasks" not in lines


def test_two_scores_have_a_hash_each_and_no_success_has_no_steps(capsys: pytest.CaptureFixture[str]) -> None:
    none = {"task": "lock-opening", **SCORE, "mean_steps": None, "success_rate": 0.0, "result_hash": "cc"}
    scores = [{"task": "peg-insertion", **SCORE}, none]
    lines = printed(answer(tasks=["peg-insertion", "lock-opening"], evaluation={"scores": scores}), capsys)
    assert lines["lock-opening"] == "0.0 % (25.0 % to 75.0 %), no success"
    assert (lines["hash, peg-insertion"], lines["hash, lock-opening"], lines["result hash"]) == ("aa", "cc", "bb")
    assert list(lines)[-1] == "result hash"


def test_progress_of_each_task_is_shown_where_there_are_several(capsys: pytest.CaptureFixture[str]) -> None:
    tasks = [
        {"task": "peg-insertion", "episodes_done": 4, "episodes_total": 270, "successes": 3},
        {"task": "lock-opening", "episodes_done": 0, "episodes_total": 160, "successes": 0},
    ]
    progress = {"episodes_done": 4, "episodes_total": 430, "episodes_reused": 0, "tasks": tasks}
    running = {"state": "running", "scores": [], "progress": progress}
    lines = printed(answer(evaluation=running), capsys)
    assert lines["peg-insertion"] == "4 of 270, 3 successes"
    assert lines["lock-opening"] == "0 of 160, 0 successes"
    alone = printed(answer(evaluation=running | {"progress": progress | {"tasks": tasks[:1]}}), capsys)
    assert "peg-insertion" not in alone
    assert alone["episodes"] == "4 of 430, 0 reused"


def test_a_log_is_shown_with_its_claim_and_where_it_diverged(capsys: pytest.CaptureFixture[str]) -> None:
    log = {
        "label": "verified log",
        "claimed_success_rate": 1 / 3,
        "claimed_successes": 90,
        "claimed_episodes": 270,
        "verdict": "diverged",
        "reason": "diverged at episode 3, env step 2",
        "divergence": {"recorded_state": "11", "resimulated_state": "22"},
        "problems": ["first", "second"],
    }
    lines = printed(answer(log=log), capsys)
    assert lines["claimed"] == "33.3 %, 90 of 270"
    assert (lines["state in the log"], lines["re-simulated state"]) == ("11", "22")
    assert lines["problems"] == "2, the first: first"
    assert "log" not in lines, "why it failed is in the verdict"
    verified = printed(answer(log=log | {"verdict": "verified", "divergence": None, "problems": []}), capsys)
    assert verified["log"] == "verified: diverged at episode 3, env step 2"
    assert not {"problems", "state in the log"} & verified.keys()
    waiting = printed(answer(log=log | {"verdict": None, "divergence": None, "problems": []}), capsys)
    assert "log" not in waiting


def test_the_end_of_the_output_stands_below(capsys: pytest.CaptureFixture[str]) -> None:
    show(answer(evaluation={"log_tail": "Traceback\n  boom"}))
    assert capsys.readouterr().out.endswith("\n\nlast lines of the policy's output:\nTraceback\n  boom\n")


@pytest.mark.parametrize(
    ("evaluation", "sentence"),
    [
        ({"state": "cancelled"}, "The evaluation cancelled."),
        ({"state": "running"}, "The evaluation running."),
        (
            {"state": "failed", "verdict": {"title": "It crashed.", "message": "In episode 1.", "code": "crashed"}},
            "The evaluation failed: It crashed. In episode 1. (crashed).",
        ),
    ],
)
def test_only_a_completed_evaluation_has_a_score(evaluation: dict[str, Any], sentence: str) -> None:
    require_score(answer())
    with pytest.raises(EvaluationEndedWithoutScore) as refused:
        require_score(answer(evaluation=evaluation))
    assert str(refused.value) == sentence
