import re
from pathlib import Path

import pytest
from service_factories import LOCK, TASK, TRACK
from vitac.evaluator.scoring.score import Interval, Rate, interval_of_mean
from vitac.evaluator.tracks import load_track
from vitac.server.leaderboards.baselines import list_examples
from vitac.server.views.leaderboards import BaselineView


def test_figures_are_the_measured_ones(repository: Path) -> None:
    measured = re.findall(
        r"^\| ([a-z-]+) \| (\w+) \| [^|]+ \| [^|]+ \| ([0-9.]+) \[([0-9.]+), ([0-9.]+)\] \| ([0-9.]+) \|",
        (repository / "benchmarks" / "baselines.md").read_text(),
        re.MULTILINE,
    )
    shown = [
        (
            task,
            one.name,
            *(f"{100 * part:.1f}" for part in (one.success_rate, *one.success_rate_interval)),
            f"{one.mean_steps:.2f}",
        )
        for task in (TASK, LOCK)
        for one in list_examples(load_track(TRACK), task)
    ]
    assert len(shown) == 5
    assert set(shown) == set(measured)


def test_figures_by_shape_are_the_measured_ones(repository: Path) -> None:
    text = (repository / "benchmarks" / "baselines.md").read_text().partition("## By shape")[2]
    counts = re.sub(r" \([^)]+\)", "", text)
    measured = dict(re.findall(r"^\| [a-z-]+ \| (\w+) \| (\w+ \d+ of [^|]+) \|", counts, re.MULTILINE))
    shown = {one.name: one.scores for task in (TASK, LOCK) for one in list_examples(load_track(TRACK), task)}
    assert len(shown) == len(measured) == 5
    for name, [score] in shown.items():
        shapes = sorted(f"{part.shape} {part.successes} of {part.episodes}" for part in score.shapes)
        assert ", ".join(shapes) == measured[name]


@pytest.mark.parametrize(("track", "depth"), [("track_2", "stereo"), ("track_2_gt", "exact")])
def test_figures_of_track_2_are_those_of_its_example(repository: Path, track: str, depth: str) -> None:
    text = (repository / "examples" / "track_2_fusion" / "README.md").read_text()
    measured = re.search(rf"^\| {depth} \(`{track}`\) \| (\d+) of (\d+) \| [^|]+ \| ([0-9.]+) \|", text, re.MULTILINE)
    assert measured
    [shown] = list_examples(load_track(track), None)
    assert (str(shown.successes), str(shown.episodes), f"{shown.mean_steps:.2f}") == measured.groups()


def test_figures_of_track_3_are_those_of_its_example(repository: Path) -> None:
    text = (repository / "examples" / "track_3_dome" / "README.md").read_text()
    measured = re.search(r"solves (\d+) of the (\d+) public episodes .* in ([0-9.]+) env steps", text)
    assert measured
    [shown] = list_examples(load_track("track_3"), "sensor-standard")
    assert (str(shown.successes), str(shown.episodes), f"{shown.mean_steps:.2f}") == measured.groups()


def rate_of(one: BaselineView) -> Rate:
    [score] = one.scores
    low, high = score.success_rate_interval
    values = score.model_dump(include={"episodes", "starts", "successes", "success_rate"})
    return Rate(**values, interval=Interval(low=low, high=high))


def test_all_tasks_together_have_the_mean_of_an_example_that_plays_all() -> None:
    [shown] = list_examples(load_track(TRACK), None)
    assert (shown.name, shown.successes, shown.episodes) == ("track_1_heuristic", 200, 430)
    assert shown.success_rate == pytest.approx((40 / 270 + 1) / 2)
    parts = [rate_of(one) for one in list_examples(load_track(TRACK), TASK) + list_examples(load_track(TRACK), LOCK)]
    interval = interval_of_mean([one for one in parts if one.successes in (40, 160)][:2], of=2)
    assert shown.success_rate_interval == pytest.approx((interval.low, interval.high))
    assert [score.starts for score in shown.scores] == [90, 80]
    assert shown.mean_steps == pytest.approx((4.40 + 6.25) / 2)


def test_the_example_of_all_tasks_has_copies_of_those_of_each(repository: Path) -> None:
    for name in ("peg_insertion", "lock_opening"):
        single = repository / "examples" / f"{name}_heuristic" / "Track_1" / "policy.py"
        assert (
            repository / "examples" / "track_1_heuristic" / "Track_1" / name / "policy.py"
        ).read_text() == single.read_text()


def test_a_track_that_no_example_has_played_has_none() -> None:
    assert list_examples(load_track("track_1_peg_robust"), None) == []


@pytest.mark.parametrize(
    ("track", "measure"),
    [
        ("assembly", "stages"),
        ("cable_end", "largest_bend_mm"),
        ("explore", "brier_score"),
        ("in_hand_turn", "angle_error_deg"),
        ("slip", "grip_force_n"),
        ("soft_plug", "largest_bend_mm"),
    ],
)
def test_figures_of_the_new_tasks_are_those_of_their_examples(repository: Path, track: str, measure: str) -> None:
    examples = list_examples(load_track(track), None)
    assert examples
    for shown in examples:
        text = (repository / "examples" / shown.name / "README.md").read_text()
        measured = re.search(r"^(\d+) of the (\d+) public episodes", text, re.MULTILINE)
        assert measured
        assert (str(shown.successes), str(shown.episodes)) == measured.groups()
        assert f" of {shown.measures[measure]:.3g}" in text
