import json
from pathlib import Path
from typing import Any

import pytest
from evaluation_fakes import FakeEnvironment, FakeSession, succeed
from text_log_writer import text_log
from vitac.cli import main as cli
from vitac.evaluator.episodes import episode as episode_module
from vitac.evaluator.episodes.records import EpisodeRecord, Manifest
from vitac.evaluator.logs import resimulation
from vitac.evaluator.logs.log import LogHeader, write_log
from vitac.evaluator.logs.text_2025.scripts import all_scripts
from vitac.evaluator.shards import policy
from vitac.evaluator.shards.policy import run_shard
from vitac.evaluator.tracks import find_task
from vitac.evaluator.tracks.definition import cut

TRACK, TASK = find_task("peg-insertion")


def evaluated() -> tuple[Manifest, list[EpisodeRecord]]:
    records: list[EpisodeRecord] = []
    result = run_shard(
        submission_dir=Path("unused"),
        track=TRACK,
        task=TASK,
        shard=cut(TASK, [1, 2, 3])[0],
        on_episode=records.append,
        load_policy=FakeSession(succeed).load,
        make_env=lambda *_: FakeEnvironment(),
    )
    return result.manifest, sorted(records, key=lambda record: record.episode)


@pytest.fixture(autouse=True)
def no_simulation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(episode_module, "make_environment", lambda *_: FakeEnvironment())


@pytest.fixture
def manifest_and_records() -> tuple[Manifest, list[EpisodeRecord]]:
    return evaluated()


def write(path: Path, manifest: Manifest, records: list[EpisodeRecord]) -> Path:
    with path.open("wb") as stream:
        write_log(stream, LogHeader(team="Touch", manifest=manifest), records)
    return path


@pytest.fixture
def log(tmp_path: Path, manifest_and_records: tuple[Manifest, list[EpisodeRecord]]) -> Path:
    return write(tmp_path / "log.jsonl", *manifest_and_records)


@pytest.fixture
def false_log(tmp_path: Path, manifest_and_records: tuple[Manifest, list[EpisodeRecord]]) -> Path:
    """A log with right digests whose second episode claims another state."""
    manifest, records = manifest_and_records
    hashes = (*records[1].state_hashes[:2], "f" * 64, *records[1].state_hashes[3:])
    return write(
        tmp_path / "false.jsonl",
        manifest,
        [records[0], records[1].model_copy(update={"state_hashes": hashes}), records[2]],
    )


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as exit_:
        cli.main(["log", *map(str, arguments)])
    out, err = capsys.readouterr()
    assert isinstance(exit_.value.code, int)
    return exit_.value.code, out, err


def test_show_prints_a_table_of_episodes(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "show", log)
    assert code == 0
    assert out.startswith("team Touch, track_1, peg-insertion, evaluator 1+")
    assert "      2  trapezoid  -4 -4 -8  success          3    2.00" in out.splitlines()
    assert "success: The task was solved." in out.splitlines()
    assert out.endswith("claimed: 3 of 3 successes, 100.0%\n")


def test_show_as_json(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = json.loads(run(capsys, "show", log, "--json")[1])
    assert content["header"]["team"] == "Touch"
    assert [episode["episode"] for episode in content["episodes"]] == [1, 2, 3]
    assert content["claimed_score"]["success_rate"] == 1.0


def test_verify_true_log(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "verify", log, "--episodes", "1:3")
    assert (code, out.splitlines()) == (
        0,
        ["3 of 270 episodes verified: all states are equal", "3 of 3 successes", PART],
    )


def test_verify_false_log_shows_both_states(false_log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "verify", false_log, "--episodes", "1:3", "--json")
    content = json.loads(out)
    assert code == 1
    assert (content["verdict"], content["score"]) == ("diverged", None)
    assert (content["divergence"]["episode"], content["divergence"]["env_step"]) == (2, 2)
    assert content["divergence"]["recorded_state"] == "f" * 64
    assert len(content["divergence"]["resimulated_state"]) == 64


PART = "only a part: 3 of 270 episodes, the first missing one is 4; a service takes whole logs only"


def test_verify_log_of_a_part_of_the_list_says_what_is_missing(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "verify", log)
    assert (code, out.splitlines()) == (
        0,
        ["3 of 270 episodes verified: all states are equal", "3 of 3 successes", PART],
    )
    content = json.loads(run(capsys, "verify", log, "--json")[1])
    assert (content["verdict"], content["missing_episodes"]) == ("verified", list(range(4, 271)))


def test_verify_false_log_of_a_part_of_the_list_diverges(false_log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "verify", false_log)
    assert (code, out.splitlines()[0]) == (1, "diverged: diverged at episode 2, env step 2")
    assert PART not in out


def test_verify_log_that_lacks_required_episodes(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "verify", log, "--episodes", "2:5")
    assert code == 1
    assert out.startswith("impossible: Expected 4 episodes, got 2; the first missing one is 4")


def test_verify_log_without_episodes(
    tmp_path: Path, manifest_and_records: tuple[Manifest, list[EpisodeRecord]], capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = run(capsys, "verify", write(tmp_path / "empty.jsonl", manifest_and_records[0], []))
    assert code == 1
    assert out.startswith("impossible: Expected 270 episodes, got 0; the first missing one is 1")


def test_verify_log_of_another_version(
    tmp_path: Path, manifest_and_records: tuple[Manifest, list[EpisodeRecord]], capsys: pytest.CaptureFixture[str]
) -> None:
    manifest, records = manifest_and_records
    old = write(tmp_path / "old.jsonl", manifest.model_copy(update={"evaluator_version": "0+old"}), records)
    code, out, _ = run(capsys, "verify", old)
    assert code == 1
    assert out.startswith("impossible: Expected a log made with evaluator_version ")


@pytest.mark.parametrize("verb", ["show", "verify", "diff"])
def test_damaged_log_is_refused_by_line(log: Path, verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    log.write_bytes(log.read_bytes().replace(b'"total_reward":2.0', b'"total_reward":3.0', 1))
    code, out, err = run(capsys, verb, log, *([log] if verb == "diff" else []))
    assert (code, out) == (1, "")
    assert err.startswith("vitac: Line 2: its digest is wrong")


def test_diff_of_equal_logs(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, "diff", log, log) == (0, "no difference\n", "")
    assert run(capsys, "diff", log, log, "--json") == (0, "null\n", "")


def test_diff_names_the_first_difference(log: Path, false_log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "diff", log, false_log)
    assert code == 1
    assert out.startswith("episode 2 env step 2: state_hash is ")
    assert json.loads(run(capsys, "diff", log, false_log, "--json")[1])["second"] == "f" * 64


def test_import_of_what_is_no_text_log(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = run(capsys, "import", log)
    assert code == 1
    assert err.startswith("vitac: Line 1: expected `<date> <time>")


def test_import_tells_and_converts_the_organizers_log(
    reference_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, output = reference_dir / "logs" / "track1_peg_insertion.first90.log", tmp_path / "out.jsonl"
    code, out, _ = run(capsys, "import", file, "--output", output)
    assert code == 0
    assert out.splitlines() == [
        "track 1 peg insertion, team deg: 13 of 90 successes",
        "success rate 14.44%, claimed no totals",
        "claimed average of env steps -",
        "problem: expected the 270 tests of the list, got 90",
        "problem: the log has no totals at its end",
    ]
    assert len(output.read_text().splitlines()) == 90
    assert json.loads(run(capsys, "import", file, "--json")[1])["episodes"] == 90


@pytest.fixture
def model(tmp_path: Path) -> Path:
    folder = tmp_path / "model" / "Track_1"
    folder.mkdir(parents=True)
    (folder / "submission.yaml").write_text("{track: track_1, tasks: [peg-insertion], name: mine}")
    return folder


def test_match_counts_the_actions_that_a_model_gives(
    log: Path, model: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def load(answer: Any) -> None:
        monkeypatch.setattr(policy, "load_in_sandbox", lambda *_, **__: FakeSession(answer).load())

    load(succeed)
    assert run(capsys, "match", log, model) == (0, "the model gives 9 of 9 actions\n", "")
    load(lambda _, step: succeed(1, 3 if step == 2 else step))
    code, out, _ = run(capsys, "match", log, model)
    assert code == 1
    assert out.splitlines()[:2] == ["the model gives 6 of 9 actions", "episode 1: 2 of 3, different from env step 2 "]
    content = json.loads(run(capsys, "match", log, model, "--json")[1])
    assert (content["reproduced"], content["actions"], content["episodes"][0]["first_mismatch"]) == (6, 9, 2)


def a_text_log_file(path: Path, *, tests: int = 270, team: str = "1") -> Path:
    """A log of Track 1's peg task; the fake environment ends every test at the second action, and well."""
    script = all_scripts()[0]
    steps = [{"n": n, "action": (n / 2, 0.0, 0.0)} for n in (1, 2)]
    episodes = [
        {"episode": n, "initial_offset": s.offset, "steps": steps, "result": "SUCCESS" if n <= 27 else "FAIL"}
        for n, s in enumerate(script.starts()[:tests], start=1)
    ]
    totals = ("#SUCCESS_RATE: 10.00%", "#AVG_STEP: 2.00")
    path.write_text(text_log(episodes, script.environment, script.md5[0], totals, team=team))
    return path


def test_verify_says_what_a_text_log_can_be_checked_for_and_shows_both_rates(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(resimulation, "make_environment", lambda *_: FakeEnvironment())
    log = a_text_log_file(tmp_path / "organizers.log")
    code, told, _ = run(capsys, "verify", log)
    assert code == 1
    assert told.startswith("A 2025 text log holds no states")
    assert "peg-insertion of track_1, team 1: 270 tests, 0 missing" in told
    assert "claimed:      27 of 270 successes, 10.0%" in told
    assert "re-simulated: 270 of 270 successes, 100.0%" in told
    assert "27 of 270 tests end here as in the log, at the same env step. Claimed and re-simulated rate differ" in told
    assert "problem: test 1: env step 1 lacks info" in told
    found = json.loads(run(capsys, "verify", log, "--json")[1])
    assert (found["successes"], found["same_ends"], found["is_consistent"]) == (270, 27, False)
    assert (found["summary"]["claimed_success_rate"], found["tests"][0]["end_step"]) == (0.1, 2)


def test_verify_of_a_part_of_a_text_log_says_how_many_tests_are_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(resimulation, "make_environment", lambda *_: FakeEnvironment())
    code, told, _ = run(capsys, "verify", a_text_log_file(tmp_path / "part.log", tests=90))
    assert code == 1
    assert "90 tests, 180 missing" in told
