"""What `vitac check` prints; the sandbox is that of `tests/integration/sandbox/test_check.py`."""

import json
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from evaluation_records import make_failure, make_record
from submissions import submission_folder
from typer.testing import CliRunner, Result
from vitac.cli.main import build_app
from vitac.errors import VitacError
from vitac.evaluator.agent.verdicts import VerdictCode
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord
from vitac.evaluator.tracks import load_track

LAST = len(load_track("track_1").tasks["peg-insertion"].episodes)


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> list[EpisodeRecord]:
    """The records of the two episodes, which a test may change."""
    records = [make_record(1, env_steps=1), make_record(LAST, EpisodeOutcome.STEPS, env_steps=8)]

    def evaluate(*, episodes: list[int], **_: Any) -> SimpleNamespace:
        assert episodes == [1, LAST]
        return SimpleNamespace(records=records)

    monkeypatch.setattr("vitac.evaluator.evaluation.local.evaluate", evaluate)
    monkeypatch.setattr("vitac.cli.terminal.compiling.compiling_shown", nullcontext)
    return records


def check(submission: Path, *options: str) -> Result:
    return CliRunner().invoke(build_app(["check"]), ["check", str(submission), *options])


@pytest.mark.usefixtures("played")
def test_what_is_in_order_is_listed_with_the_digest(tmp_path: Path) -> None:
    result = check(submission_folder(tmp_path))
    lines = result.stdout.splitlines()
    assert result.exit_code == 0
    assert lines[:4] == [
        "ok       the files follow the archive rules",
        "ok       submission.yaml is complete: test policy, peg-insertion",
        f"ok       peg-insertion, episode 1: 1 env step, outcome success. {EpisodeOutcome.SUCCESS.sentence}",
        f"ok       peg-insertion, episode {LAST}: 8 env steps, outcome steps. {EpisodeOutcome.STEPS.sentence}",
    ]
    assert lines[4].startswith("All checks passed. Content digest ")


def test_no_advice_is_to_run_the_command_that_gives_it(tmp_path: Path, played: list[EpisodeRecord]) -> None:
    folder = submission_folder(tmp_path)
    for code in VerdictCode:
        played[0] = make_record(1, EpisodeOutcome.POLICY_FAILED, 1, failure=make_failure(code=code))
        result = check(folder)
        assert result.exit_code == 1
        assert f"{code}. It ended with signal 11. {code.sentence}" in result.stdout
        assert "vitac check" not in result.stdout


def test_a_failure_is_a_refusal_with_the_last_twenty_lines_of_output(
    tmp_path: Path, played: list[EpisodeRecord]
) -> None:
    output = "\n".join(f"line {number}" for number in range(1, 22))
    failure = make_failure(output_tail=output)
    played[0] = make_record(1, EpisodeOutcome.POLICY_FAILED, 0, failure=failure)
    result = check(submission_folder(tmp_path))
    lines = result.stdout.splitlines()
    assert result.exit_code == 1
    assert "refused  peg-insertion, episode 1: crashed. It ended with signal 11. " + failure.code.sentence in lines
    tail = lines[lines.index("Last lines of the policy's output:") + 1 : -1]
    assert tail == [f"  | line {number}" for number in range(2, 22)]
    assert lines[-1] == "This submission would be refused."


@pytest.mark.parametrize(
    ("module", "is_told"), [("torch", True), ("torch.nn", False), ("torchvision", False), ("tensorflow", False)]
)
def test_a_submission_that_needs_torch_is_told_how_to_add_it(
    tmp_path: Path, played: list[EpisodeRecord], module: str, is_told: bool
) -> None:
    message = f"Importing policy raised ModuleNotFoundError: No module named '{module}'. Installed packages: numpy 2."
    played[0] = make_record(1, EpisodeOutcome.POLICY_FAILED, 0, failure=make_failure(message=message))
    result = check(submission_folder(tmp_path))
    (refused,) = (line for line in result.stdout.splitlines() if line.startswith("refused"))
    assert result.exit_code == 1
    assert message in refused
    assert ("The submission needs torch, which is not installed here: ./vitac --torch check adds" in refused) is is_told
    assert ("from an index that PIP_EXTRA_INDEX_URL names if pip's own does not have it" in refused) is is_told


def test_a_failure_without_output_keeps_that_of_the_one_before(tmp_path: Path, played: list[EpisodeRecord]) -> None:
    played[0] = make_record(1, EpisodeOutcome.POLICY_FAILED, 0, failure=make_failure(output_tail="before"))
    played[1] = make_record(LAST, EpisodeOutcome.POLICY_FAILED, 0, failure=make_failure())
    found = json.loads(check(submission_folder(tmp_path), "--json").stdout)
    assert (found["ok"], found["output_tail"], len(found["refused"]), len(found["passed"])) == (False, "before", 2, 2)


@pytest.mark.usefixtures("played")
def test_json_holds_what_the_lines_say(tmp_path: Path) -> None:
    found = json.loads(check(submission_folder(tmp_path), "--json").stdout)
    assert (found["ok"], found["refused"], found["output_tail"]) == (True, [], "")
    assert len(found["passed"]) == 4
    assert found["digest"] in check(tmp_path).stdout


@pytest.mark.usefixtures("played")
def test_a_submission_with_an_unfinished_manifest_is_refused_and_not_played(tmp_path: Path) -> None:
    files = {"policy.py": "", "submission.yaml": "track: track_1\ntasks: [peg-insertion]\n"}
    result = check(submission_folder(tmp_path, files), "--json")
    found = json.loads(result.stdout)
    assert (result.exit_code, found["ok"], len(found["refused"])) == (1, False, 1)
    assert "'name'" in found["refused"][0]
    assert (found["passed"], found["digest"]) == ([], None)


@pytest.mark.usefixtures("played")
def test_a_folder_that_needs_what_only_images_get_is_refused_and_not_played(tmp_path: Path) -> None:
    manifest = "track: track_1\ntasks: [peg-insertion]\nname: fast\nneeds: gpu\n"
    folder = submission_folder(tmp_path, {"policy.py": "", "submission.yaml": manifest})
    (refusal,) = json.loads(check(folder, "--json").stdout)["refused"]
    assert refusal.startswith("submission.yaml says `needs: gpu`, which only container images get")


@pytest.mark.usefixtures("played")
def test_a_folder_without_a_manifest_is_no_submission(tmp_path: Path) -> None:
    result = check(submission_folder(tmp_path, {"policy.py": ""}))
    assert isinstance(result.exception, VitacError)
    assert "submission.yaml" in str(result.exception)
