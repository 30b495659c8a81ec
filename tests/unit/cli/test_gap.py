import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from evaluation_records import make_manifest, make_record
from vitac.cli import main as cli
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome
from vitac.evaluator.logs.log import LogHeader, write_log
from vitac.station.outcome import TrialOutcome
from vitac.station.rehearsal import AttemptRecord, RehearsalReport, TrialRecord


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as exit_:
        cli.main(["gap", *map(str, arguments)])
    out, err = capsys.readouterr()
    assert isinstance(exit_.value.code, int)
    return exit_.value.code, out, err


def simulated(path: Path, solved: set[int], digest: str = "3" * 64) -> Path:
    outcomes = {True: EpisodeOutcome.SUCCESS, False: EpisodeOutcome.STEPS}
    with path.open("wb") as stream:
        header = LogHeader(team=None, submission_digest=digest, manifest=make_manifest())
        write_log(stream, header, [make_record(number, outcomes[number in solved]) for number in range(1, 9)])
    return path


def tried(path: Path, outcomes: dict[int, TrialOutcome], digest: str = "3" * 64, **changes: Any) -> Path:
    def trial(number: int, outcome: TrialOutcome) -> TrialRecord:
        record = make_record(number)
        attempt = AttemptRecord(
            outcome=outcome, actions=ActionSequence.from_array(np.zeros((1, 3), dtype=np.float32)),
            thresholds_px=(1.0, 1.0), policy_s=0.1,
        )  # fmt: skip
        start = {"shape": record.shape, "offset": record.initial_offset} | changes
        return TrialRecord(episode=number, attempts=(attempt,), **start)

    report = RehearsalReport.from_trials(
        [trial(number, outcome) for number, outcome in outcomes.items()],
        station="bench", submission="mine", submission_digest=digest, track="track_1", task="peg-insertion",
    )  # fmt: skip
    path.write_text(report.model_dump_json())
    return path


TRIALS = {1: TrialOutcome.SUCCESS, 2: TrialOutcome.TACTILE, 3: TrialOutcome.SUCCESS, 4: TrialOutcome.DEVICE_FAULT}


def test_trials_that_count_are_paired_with_their_episodes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = simulated(tmp_path / "a.jsonl", {1, 2, 4}), tried(tmp_path / "a.json", TRIALS)
    code, out, _ = run(capsys, *files, "--json")
    (policy,) = json.loads(out)["policies"]
    assert code == 0
    assert {key: policy[key] for key in ("episodes", "both", "only_simulation", "only_station", "neither")} == {
        "episodes": 3, "both": 1, "only_simulation": 1, "only_station": 1, "neither": 0,
    }  # fmt: skip
    code, out, _ = run(capsys, *files)
    assert code == 0
    assert "Episodes that end alike: 33.3 %" in out
    assert re.search(r"^Chance alone, without any gap, .* of up to [0-9.]+ points\.$", out, re.MULTILINE)
    assert "say little of 1 policies; play 10 or more" in out


def test_a_trial_that_began_at_another_start_of_the_list_is_no_pair(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, report = simulated(tmp_path / "a.jsonl", {1, 2, 3}), tried(tmp_path / "a.json", TRIALS)
    content = json.loads(report.read_text())
    content["trials"][0]["attempts"][0]["start"] = [9.0, 9.0, 9.0]
    report.write_text(json.dumps(content))
    code, out, _ = run(capsys, log, report, "--json")
    (policy,) = json.loads(out)["policies"]
    assert (code, policy["episodes"], policy["both"]) == (0, 2, 1)


def test_files_of_other_policies_lists_and_kinds_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, report = simulated(tmp_path / "a.jsonl", {1}), tried(tmp_path / "a.json", TRIALS)
    other = tried(tmp_path / "b.json", TRIALS, digest="4" * 64)
    elsewhere = tried(tmp_path / "c.json", TRIALS, offset=(0.0, 0.0, 0.0))
    for files, code, message in (
        ((log,), 2, "expected two files of each policy, simulation and station, got 1 files"),
        ((log, other), 1, "Expected one policy in"),
        ((log, elsewhere), 1, "Expected episode 1 of one list, got"),
        ((log, log), 1, "Expected a file of `vitac evaluate --station ... --json`, got"),
        ((report, report), 1, "Expected a log or a file of `vitac evaluate --json`, got"),
        ((log, tmp_path / "missing.json"), 1, "Expected a file of `vitac evaluate --station ... --json`, got"),
    ):
        got, _, err = run(capsys, *files)
        assert (got, message in " ".join(err.replace("│", " ").split())) == (code, True), err


def test_a_twin_is_named_and_what_it_lacks_explains_a_share(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def at_twin(name: str, solved: set[int], *without: str) -> Path:
        outcomes = {n: TrialOutcome.SUCCESS if n in solved else TrialOutcome.STEPS for n in range(1, 5)}
        file = tried(tmp_path / name, outcomes)
        content = json.loads(file.read_text()) | {"twin": {"twin_class": "B", "without": without}}
        file.write_text(json.dumps(content))
        return file

    log = simulated(tmp_path / "a.jsonl", {1, 2, 3, 4})
    whole, mesh, tilt = at_twin("w.json", {1}), at_twin("m.json", {1, 2, 3, 4}, "mesh"), at_twin("t.json", {1}, "tilt")
    code, out, _ = run(capsys, log, whole, log, mesh, log, tilt, "--json")
    gap = json.loads(out)
    assert code == 0
    assert len(gap["policies"]) == 1  # the twin as it is
    assert gap["difference"]["value"] == pytest.approx(0.75)
    assert {name: share["value"] for name, share in gap["shares"].items()} == pytest.approx({"mesh": 1.0, "tilt": 0.0})
    assert "bench is a twin of class B, no hardware." in gap["twins"]
    assert "bench is a twin of class B without mesh, no hardware." in gap["twins"]
    both = at_twin("b.json", {1, 2, 3}, "tilt", "mesh")
    code, out, _ = run(capsys, log, tilt, log, both, "--json")  # a station of its own, which never had a tilt
    assert (code, len(json.loads(out)["policies"])) == (0, 1)
    assert {name: share["value"] for name, share in json.loads(out)["shares"].items()} == pytest.approx({"mesh": 2 / 3})


def test_trials_at_a_twin_of_identified_settings_stand_for_simulation(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trials = tried(tmp_path / "a.json", TRIALS)
    twin = tmp_path / "identified.json"
    twin.write_text(json.dumps(json.loads(trials.read_text()) | {"twin": {"twin_class": "A", "identified": True}}))
    code, out, _ = run(capsys, twin, trials, "--json")
    assert (code, json.loads(out)["agreement"]["value"]) == (0, 1.0)
