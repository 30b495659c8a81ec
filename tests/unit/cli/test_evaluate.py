import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import typer
from vitac.cli import main as cli
from vitac.cli.evaluate import EpisodesProgress, parse_episodes
from vitac.evaluator.agent.verdicts import VerdictCode
from vitac.evaluator.episodes.records import result_hash
from vitac.evaluator.evaluation.local import EvaluationReport
from vitac.evaluator.logs.log import LogReader

pytestmark = pytest.mark.usefixtures("one_fake_host")


@pytest.fixture
def submission(tmp_path: Path) -> Path:
    folder = tmp_path / "mine" / "Track_1"
    folder.mkdir(parents=True)
    (folder / "submission.yaml").write_text("{track: track_1, tasks: [peg-insertion], name: mine}")
    (folder / "policy.py").write_text("class Policy: pass")
    (folder / "behaviour").write_text("succeed")
    return folder


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as exit_:
        cli.main(["evaluate", *map(str, arguments)])
    out, err = capsys.readouterr()
    assert isinstance(exit_.value.code, int)
    return exit_.value.code, out, err


@pytest.mark.parametrize(
    ("text", "numbers"),
    [(None, None), ("5", (5,)), ("1:4", (1, 2, 3, 4)), ("7,1:3,2", (1, 2, 3, 7)), ("270:270", (270,))],
)
def test_episodes_are_numbers_and_ranges_with_both_ends(text: str | None, numbers: tuple[int, ...] | None) -> None:
    assert parse_episodes(text) == numbers


@pytest.mark.parametrize("text", ["", "a", "1:x", "4:1", "1:2:3", "1,,2", "-", "1:"])
def test_other_episodes_are_wrong_usage(text: str) -> None:
    with pytest.raises(typer.BadParameter, match="expected numbers and ranges"):
        parse_episodes(text)


def test_output_of_the_policy_is_written_by_episode(
    submission: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output, report = tmp_path / "output.txt", tmp_path / "report.json"
    code, _, _ = run(capsys, submission, "--episodes", "1,3", "--output", output, "--json", report)
    assert code == 0
    assert output.read_text() == (
        "[peg-insertion, episode 1: success]\nI am thinking.\n[peg-insertion, episode 3: success]\nI am thinking.\n"
    )
    content = EvaluationReport.model_validate_json(report.read_text())
    silent = [record.model_copy(update={"output": ""}) for record in content.episodes]
    assert content.result_hash == result_hash(content.manifest, silent)


def test_prints_score_and_result_hash(submission: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    report = tmp_path / "report.json"
    code, out, err = run(capsys, submission, "--episodes", "1:3,31", "--json", report)
    content = EvaluationReport.model_validate_json(report.read_text())
    assert code == 0
    assert "all               4       4          4  100.0%  51.0% to 100.0%" in out
    assert "mean env steps of the successes: 3.00" in out
    assert re.search(r"success +4 +1 +The task was solved\.", out), "the first of them is named"
    assert "`vitac show peg-insertion --policy SUBMISSION --episode N` draws one of them" in out
    assert "docs/failures.md" not in out, "nothing failed"
    assert f"result hash {content.result_hash}" in out
    assert "4/4" in err


def test_report_holds_the_records_that_the_hash_is_of(
    submission: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = tmp_path / "report.json"
    run(capsys, submission, "--episodes", "1:3", "--json", report)
    content = EvaluationReport.model_validate_json(report.read_text())
    assert content.result_hash == result_hash(content.manifest, content.episodes)
    written = json.loads(report.read_text())
    assert written["score"]["success_rate"] == 1.0
    assert written["packages"]["numpy"] == np.__version__
    assert "torch" not in written["packages"], "the track declares no set of packages"
    assert "vitac-arena" not in written["packages"]
    del written["packages"]
    assert EvaluationReport.model_validate_json(json.dumps(written)).packages == {}, (
        "expected reports of before to be readable"
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--log", "nowhere/run.jsonl"), "in an existing folder"),
        (("--json", "."), "in an existing folder"),
        (("--output", "nowhere/output.txt"), "in an existing folder"),
        (("--log", "run.jsonl", "--team", "a\tb"), "expected one line"),
    ],
)
def test_what_could_not_be_written_is_refused_before_the_evaluation(
    submission: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], message: str
) -> None:
    code, out, err = run(capsys, submission, *options)
    assert (code, out) == (2, "")
    assert message in " ".join(err.replace("│", "").split())


def test_log_can_be_read_again_and_is_the_same_each_time(
    submission: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = tmp_path / "first.jsonl", tmp_path / "second.jsonl"
    run(capsys, submission, "--episodes", "1:3", "--log", first, "--team", "Touch")
    run(capsys, submission, "--episodes", "1:3", "--log", second, "--team", "Touch", "--workers", "2")
    assert first.read_bytes() == second.read_bytes()
    with first.open("rb") as stream:
        reader = LogReader(stream)
        assert reader.header.team == "Touch"
        assert [record.episode for record in reader.records()] == [1, 2, 3]


def test_failing_policy_is_refused_with_its_verdict_and_output(
    submission: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (submission / "behaviour").write_text("fail")
    code, out, _ = run(capsys, submission, "--episodes", "1:5")
    assert code == 1
    assert "failed: crashed." in out
    assert "Segmentation fault" in out
    assert "result hash" not in out


def test_why_a_policy_failed_in_single_episodes_is_told(submission: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (submission / "behaviour").write_text("fail")
    code, out, _ = run(capsys, submission, "--episodes", "1:2")
    told = [line for line in out.splitlines() if line.startswith("crashed, episode 1, 2: ")]
    assert (code, len(told)) == (0, 1), "two failed episodes of a shard are counted, and the third ends the evaluation"
    assert told[0].endswith(VerdictCode.CRASHED.sentence)
    assert "docs/failures.md, which a service shows under /docs/failures," in out
    assert "result hash" in out


def test_fault_of_the_machine_is_one_line(submission: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (submission / "behaviour").write_text("break_sandbox")
    code, out, err = run(capsys, submission, "--episodes", "1")
    assert (code, out) == (1, "")
    assert err.splitlines()[-1] == "vitac: SandboxFailed: bwrap is missing"


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--task", "lock-opening"], 2, "expected one of the submission's tasks, peg-insertion"),
        (["--episodes", "1:271"], 1, "from 1 to 270, got 271"),
        (["--workers", "0"], 2, "greater than or equal to 1"),
    ],
)
def test_impossible_request_is_refused(
    submission: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], code: int, message: str
) -> None:
    refused, _, err = run(capsys, submission, *arguments)
    assert refused == code
    assert message in err


def test_what_is_no_submission_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = run(capsys, tmp_path / "nothing")
    assert code == 1
    assert "nothing does not exist; folder" in err


def test_progress_shows_how_far_a_step_is_before_episodes_are_counted(capsys: pytest.CaptureFixture[str]) -> None:
    progress = EpisodesProgress(4)
    progress.describe("calibrating the standard estimator")
    [line] = progress.bar.tasks
    assert line.total is None, "the bar moves"
    progress.count(45, 180)
    assert line.percentage == 25.0
    progress.count(180, 180)
    assert f"{line.completed} of {line.total}" == "0 of 4"
    assert capsys.readouterr().err == "vitac: calibrating the standard estimator\n"


@pytest.mark.parametrize(
    ("manifest", "arguments", "words"),
    [
        ("", ("--remote", "ws://127.0.0.1:1"), "no section `remote`"),
        (", remote: {protocol: openpi}", ("--remote", "127.0.0.1:1"), "Expected an address such as ws://"),
        (", remote: {protocol: openpi}", (), "give its address"),
        (", remote: {protocol: openpi}", ("--remote", "ws://127.0.0.1:1", "--station", "twin"), "leave it out"),
    ],
)
def test_policy_server_needs_its_address_and_what_it_speaks(
    submission: Path, capsys: pytest.CaptureFixture[str], manifest: str, arguments: tuple[str, ...], words: str
) -> None:
    (submission / "submission.yaml").write_text(f"{{track: track_1, tasks: [peg-insertion], name: mine{manifest}}}")
    code, _, err = run(capsys, submission, *arguments)
    assert code != 0
    assert words in " ".join(re.sub(r"[│╭╰─╮╯]", " ", err).split())


@pytest.mark.slow
def test_the_command_loads_no_compiler_beside_the_processes_that_play(repository: Path) -> None:
    """Numba takes half a second of CPU time, in which the first episodes could be played."""
    heuristic = repository / "examples" / "peg_insertion_heuristic"
    code = (
        "import atexit, sys\n"
        "atexit.register(lambda: print('numba' in sys.modules))\n"
        "from vitac.cli.main import main\n"
        f"main(['evaluate', {str(heuristic)!r}, '--task', 'peg-insertion', '--episodes', '1'])\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ended.stdout.splitlines()[-1] == "False", ended.stderr
