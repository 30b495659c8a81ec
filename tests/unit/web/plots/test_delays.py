from pathlib import Path
from types import SimpleNamespace
from typing import Any

import yaml
from vitac.evaluator.strict_model import parse_yaml
from vitac.evaluator.tracks import Track
from vitac.web.plots.delays import success_by_delay
from vitac.web.plots.files import write_pdf, write_svg

TRACK_1 = Path(__file__).parents[4] / "evaluator" / "tracks" / "track_1.yaml"


def delayed_track() -> Track:
    content = yaml.safe_load(TRACK_1.read_text())
    content["tasks"]["peg-insertion"] |= {"control_period_ms": 50, "delays_ms": [0, 50, 200]}
    return parse_yaml(Track, yaml.safe_dump(content), "track_1.yaml")


def entry(team: str, **successes: int) -> Any:
    scores = [
        SimpleNamespace(
            task=task.replace("_", "-"), success_rate=solved / 10, successes=solved, episodes=10,
            success_rate_interval=(0.1, 0.9),
        )
        for task, solved in successes.items()
    ]  # fmt: skip
    return SimpleNamespace(team=team, scores=scores)


def test_the_best_entries_are_drawn_against_the_delays_that_they_have_played() -> None:
    entries = [
        entry("Ants", peg_insertion=9, peg_insertion_50ms=6, peg_insertion_200ms=1, lock_opening=8),
        entry("Bees", peg_insertion=8, peg_insertion_200ms=2),
        entry("Cats", peg_insertion=7),
    ]
    (figure,) = success_by_delay(delayed_track(), entries)
    assert figure.title == "Peg insertion: success rate against delay [ms]"
    assert (
        figure.summary.replace("\N{NO-BREAK SPACE}", " ") == "Ants: 90.0 % at 0 ms, 60.0 % at 50 ms, 10.0 % at 200 ms."
    )
    assert [row[:3] for row in figure.table.rows] == [
        ("Ants", "0", "9 of 10"), ("Ants", "50", "6 of 10"), ("Ants", "200", "1 of 10"),
        ("Bees", "0", "8 of 10"), ("Bees", "200", "2 of 10"),
    ]  # fmt: skip
    assert figure.drawing.count('class="best"') == 2
    assert "Cats" not in figure.drawing
    assert write_svg(figure).startswith(b"<")
    assert write_pdf(figure).startswith(b"%PDF")


def test_a_track_without_delays_has_no_plot() -> None:
    track = parse_yaml(Track, TRACK_1.read_text(), "track_1.yaml")
    assert success_by_delay(track, [entry("Ants", peg_insertion=9, lock_opening=8)]) == []
