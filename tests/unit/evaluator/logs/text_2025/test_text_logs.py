"""The organizers' own logs."""

import io
import json
from pathlib import Path
from typing import Any

import pytest
from text_log_writer import text_log
from vitac.evaluator.logs.text_2025 import TextLogSummary, read_text_log, summarize, to_json_lines
from vitac.evaluator.logs.text_2025.scripts import Script, all_scripts

SCRIPTS = {script.name: script for script in all_scripts()}
PEG, LOCK = SCRIPTS["track 1 peg insertion"], SCRIPTS["track 1 lock opening"]
VISION, DESIGN = SCRIPTS["track 2 peg insertion"], SCRIPTS["track 3 peg insertion"]


def summary_of(text: str | bytes) -> tuple[TextLogSummary, list[dict[str, Any]]]:
    log = read_text_log(io.BytesIO(text.encode() if isinstance(text, str) else text))
    script, summary = summarize(log)
    return summary, json.loads(json.dumps(list(to_json_lines(log, script))))


def parsed(reference_dir: Path, name: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (reference_dir / "logs" / name).read_text().splitlines()]


def header(reference_dir: Path, name: str) -> dict[str, Any]:
    content = json.loads((reference_dir / "logs" / name).read_text())
    assert isinstance(content, dict)
    return content


def test_hand_edited_peg_log_is_read_whole_and_only_its_end_is_missing(reference_dir: Path) -> None:
    summary, lines = summary_of((reference_dir / "logs" / "track1_peg_insertion.first90.log").read_bytes())
    assert summary.model_dump(exclude={"script_md5", "track"}) == {
        "task": "peg_insertion",
        "team": "deg",
        "era": None,
        "episodes": 90,
        "successes": 13,
        "success_rate": 13 / 90,
        "claimed_success_rate": None,
        "claimed_average_steps": None,
        "problems": ("expected the 270 tests of the list, got 90", "the log has no totals at its end"),
    }
    assert lines == parsed(reference_dir, "track1_peg_insertion.repeat0.jsonl")


def test_vision_log_is_read_whole_without_a_problem(reference_dir: Path) -> None:
    summary, lines = summary_of((reference_dir / "logs" / "track2_peg_insertion_v2.log").read_bytes())
    assert (summary.track, summary.task, summary.episodes, summary.successes) == ("Track_2", "peg_insertion_v2", 150, 0)
    assert (summary.claimed_success_rate, summary.claimed_average_steps, summary.problems) == (0.0, None, ())
    assert lines == parsed(reference_dir, "track2_peg_insertion_v2.jsonl")


@pytest.mark.parametrize(
    ("script", "name", "listed", "successes"),
    [(LOCK, "track1_open_lock", 160, None), (DESIGN, "track3_peg_insertion", 270, None)],
)
def test_other_scripts_logs_are_read_from_what_the_organizers_log_holds(
    reference_dir: Path, script: Script, name: str, listed: int, successes: int | None
) -> None:
    episodes = parsed(reference_dir, f"{name}.repeat0.jsonl")
    if script is LOCK:  # Repeat 0 of each key; the whole list has two. The scripts log no start of it.
        numbered = [{"steps": e["steps"], "result": e["result"], "episode": n} for n, e in enumerate(episodes, start=1)]
    else:
        numbered = episodes
    environment = header(reference_dir, f"{name}.header.json")["env"]
    summary, lines = summary_of(text_log(numbered, environment, script.md5[0]))
    assert (summary.track, summary.task) == (script.track, script.task)
    assert summary.episodes == len(episodes)
    assert summary.successes == sum(episode["result"] == "SUCCESS" for episode in episodes)
    assert summary.problems == (
        f"expected the {listed} tests of the list, got {len(episodes)}",
        "the log has no totals at its end",
    )
    assert [[step["action"] for step in line["steps"]] for line in lines] == [
        [step["action"] for step in episode["steps"]] for episode in episodes
    ]


def test_lists_have_their_published_lengths_and_orders() -> None:
    assert {name: len(script.starts()) for name, script in SCRIPTS.items()} == {
        "track 1 peg insertion": 270,
        "track 1 lock opening": 160,
        "track 2 peg insertion": 150,
        "track 3 peg insertion": 270,
        "peg insertion of 2024": 180,
        "lock opening of 2024": 160,
    }
    assert [(start.shape, start.offset[0]) for start in LOCK.starts()[19:22]] == [
        ("key1", 4.75),
        ("key1", 0),
        ("key1", 0.25),
    ]
    assert [start.shape for start in PEG.starts()[:4]] == ["cuboid", "trapezoid", "concave1", "cuboid"]
    assert VISION.starts()[0].offset == pytest.approx((2.3, -26.725, -3.2, 21.8))
    assert VISION.starts(17.4)[0].offset == pytest.approx((2.3, -26.725, -3.2, 19.3))
