import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from evaluation_records import make_manifest, make_record
from vitac.cli import compare
from vitac.cli import main as cli
from vitac.cli.client.http import Client
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord
from vitac.evaluator.evaluation.local import EvaluationReport
from vitac.evaluator.logs.log import LogHeader, write_log

A, B = "11111111-1111-1111-1111-111111111111", "22222222-2222-2222-2222-222222222222"


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as exit_:
        cli.main(["compare", *map(str, arguments)])
    out, err = capsys.readouterr()
    assert isinstance(exit_.value.code, int)
    return exit_.value.code, out, err


def played(solved: set[int], n: int = 8) -> list[EpisodeRecord]:
    return [
        make_record(number, EpisodeOutcome.SUCCESS if number in solved else EpisodeOutcome.STEPS)
        for number in range(1, n + 1)
    ]


def log_of(path: Path, records: list[EpisodeRecord], **manifest: Any) -> Path:
    header = LogHeader(team=None, submission_digest="3" * 64, manifest=make_manifest(**manifest))
    with path.open("wb") as stream:
        write_log(stream, header, records)
    return path


def report_of(path: Path, records: list[EpisodeRecord], **manifest: Any) -> Path:
    report = EvaluationReport(
        name="one",
        submission_digest="3" * 64,
        manifest=make_manifest(**manifest),
        isolation=None,
        score=None,
        result_hash=None,
        failure=None,
        episodes=tuple(records),
    )
    path.write_text(report.model_dump_json())
    return path


@pytest.mark.parametrize("second_of", [log_of, report_of])
def test_two_files_are_compared_episode_by_episode(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], second_of: Callable[..., Path]
) -> None:
    first = report_of(tmp_path / "a.json", played({1, 2, 3, 4, 5, 6}))
    second = second_of(tmp_path / "b", played({1, 8}, n=9))
    code, out, _ = run(capsys, first, second, "--json")
    found = json.loads(out)
    assert code == 0
    assert [row["episode"] for row in found["episodes"]] == list(range(1, 9))
    assert [(row["successes"], row["episodes"], row["starts"]) for row in found["results"]] == [(6, 8, 8), (2, 9, 9)]
    [pair] = found["pairs"]
    assert pair["low"] < pair["difference"] == 0.5 < pair["high"]
    assert pair["p_value"] == pair["adjusted_p_value"] == 2 * (1 + 6) / 2**6
    assert [pair[name] for name in COUNTS] == [8, 1, 1, 5, 1, 1]


COUNTS = (
    "episodes", "episodes_of_one", "both_solve", "only_first_solves", "only_second_solves", "neither_solves",
)  # fmt: skip


def test_people_see_the_episodes_that_some_of_them_solve(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [log_of(tmp_path / name, played(solved)) for name, solved in (("a", {1, 2}), ("b", {2, 5}), ("c", {2}))]
    code, out, _ = run(capsys, *files)
    table, results, pairs = out.strip().split("\n\n")
    assert code == 0
    assert [line.split()[1] for line in table.splitlines()[1:3]] == ["1", "5"]
    assert "success, 3" in table
    assert table.splitlines()[-2:] == ["success: The task was solved.", "steps: All env steps were used up."]
    assert [line.split()[2] for line in results.splitlines()[1:]] == ["2", "2", "1"]
    assert len(pairs.splitlines()) == 4
    assert str(tmp_path / "a") in results


def test_tables_for_spreadsheets_and_papers_have_the_same_numbers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = log_of(tmp_path / "a_b", played({1, 2, 3})), log_of(tmp_path / "c", played({2}))
    [row] = csv.DictReader(run(capsys, *files, "--csv")[1].splitlines())
    [pair] = json.loads(run(capsys, *files, "--json")[1])["pairs"]
    assert {name: str(value) for name, value in pair.items()} == row
    latex = run(capsys, *files, "--latex")[1]
    assert latex.count(r"\begin{tabular}") == latex.count(r"\bottomrule") == 2
    assert r"a\_b & " in latex
    assert all(line.endswith(r"\\") for line in latex.splitlines() if "&" in line)


def test_one_alone_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = run(capsys, log_of(tmp_path / "a", played({1})))
    assert (code, "expected two or more" in err) == (2, True)


def test_small_p_value_is_not_shown_as_zero(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = log_of(tmp_path / "a", played(set(range(1, 21)), n=20)), log_of(tmp_path / "b", played(set(), n=20))
    assert run(capsys, first, second)[1].split()[-1] == "1.91e-06"


def test_equal_results_differ_nowhere(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    same = log_of(tmp_path / "a", played({1, 2}))
    _, out, _ = run(capsys, same, same)
    assert "No episode is solved by only some of them." in out
    assert json.loads(run(capsys, same, same, "--json")[1])["pairs"][0]["p_value"] == 1.0


@pytest.mark.parametrize(
    ("manifest", "said"),
    [({"track": "track_2"}, "one track, got track_1 and track_2"), ({"task_hash": "9" * 64}, "one list, got 000")],
)
def test_evaluations_of_other_lists_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], manifest: dict[str, str], said: str
) -> None:
    first, second = log_of(tmp_path / "a", played({1})), log_of(tmp_path / "b", played({1}), **manifest)
    code, _, err = run(capsys, first, second)
    assert (code, said in err) == (1, True)


def test_evaluations_without_a_common_episode_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = log_of(tmp_path / "a", [make_record(1)]), log_of(tmp_path / "b", [make_record(2)])
    code, _, err = run(capsys, first, second)
    assert (code, "none of them in both" in err) == (1, True)


@pytest.mark.parametrize("content", [b"", b"{}", b"\xff\xfe", b"[1, 2"])
def test_file_of_another_kind_is_refused_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes
) -> None:
    other = tmp_path / "other"
    other.write_bytes(content)
    code, _, err = run(capsys, other, other)
    assert (code, "Expected a log or a file of `vitac evaluate --json`" in err) == (1, True)


class Service:
    """Has submission A with all episodes solved, B with none; remembers who was asked."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.asked: list[str] = []
        self.shape = "cuboid"
        monkeypatch.setattr(compare, "make_client", self.client)

    def client(self, server: str | None, _: Path | None) -> Client:
        return Client(server=server or "http://default.test", transport=httpx.MockTransport(self.answer))

    def answer(self, request: httpx.Request) -> httpx.Response:
        self.asked.append(str(request.url))
        number = request.url.path.split("/")[4]
        if not request.url.path.endswith("/episodes"):
            return httpx.Response(200, json={"name": number[:2], "track": "track_1"})
        solved = number == A
        outcome = "success" if solved else "steps"
        shape = "cuboid" if solved else self.shape
        ended = {"task": "peg-insertion", "shape": shape, "outcome": outcome, "success": solved, "env_steps": 8}
        return httpx.Response(
            200, json=[ended | {"episode": episode, "initial_offset": [1, -3, -episode]} for episode in (1, 2, 3)]
        )


def test_submissions_of_a_service_are_named_by_id_or_address(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    service = Service(monkeypatch)
    code, out, _ = run(capsys, A, f"http://other.test/submissions/{B}", "--json")
    [found] = json.loads(out)["pairs"]
    assert (code, found["only_first_solves"], found["p_value"]) == (0, 3, 0.25)
    assert service.asked[0] == f"http://default.test/api/v1/submissions/{A}"
    assert service.asked[-1] == f"http://other.test/api/v1/submissions/{B}/episodes"


def test_starts_that_differ_are_not_of_one_list(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Service(monkeypatch).shape = "trapezoid"
    code, _, err = run(capsys, A, B)
    assert code == 1
    assert "episode 1 starts with cuboid at 1, -3, -1 and trapezoid at 1, -3, -1." in err


def test_a_file_and_a_submission_are_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Service(monkeypatch)
    file = log_of(tmp_path / "a", [make_record(1, shape="cuboid")])
    [found] = json.loads(run(capsys, file, B, "--json")[1])["pairs"]
    assert (found["only_first_solves"], found["episodes_of_one"]) == (1, 2)
