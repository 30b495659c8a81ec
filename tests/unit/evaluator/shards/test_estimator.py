from collections.abc import Sequence
from pathlib import Path
from typing import Any

import drawn_gels
import pytest
from own_sensors import write_sensor
from vitac.evaluator import estimator
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.evaluator.figures import starts
from vitac.evaluator.figures.figures import FigureChoice, StartFigures, Variation
from vitac.evaluator.figures.starts import Measurement
from vitac.evaluator.shards.estimator import run_estimator
from vitac.evaluator.shards.order import OrderedShard, ShardEnd, ShardOrder, ShardResult
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import Episode, load_track
from vitac.evaluator.tracks.definition import cut

TRACK = load_track("track_3")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_sensor(tmp_path_factory.mktemp("sensor"), drawn_gels.flat(2.0))


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Calibrate with few starts, and measure starts without playing them."""
    calibrate = estimator.calibrate
    monkeypatch.setattr(estimator, "calibrate", lambda *of, **given: calibrate(*of, starts=2, **given))
    monkeypatch.setattr(Measurement, "start", lambda _, episode: measured(episode))


def measured(episode: Episode) -> StartFigures:
    return StartFigures(
        episode=episode.number, information=None, smallest_det_f=0.5, successes={Variation.NONE: True}, cpu_s=0.1
    )


def run(
    folder: Path, task: str, choice: FigureChoice, numbers: Sequence[int], **changes: Any
) -> tuple[ShardResult, list[EpisodeRecord]]:
    (shard,) = cut(TRACK.tasks[task], numbers)
    order = ShardOrder(
        kind=SubmissionKind.MODEL,
        submission=folder,
        track=TRACK.name,
        task=task,
        shard=shard.index,
        sensor=folder,
        figures=choice,
        **changes,
    )
    records: list[EpisodeRecord] = []
    ordered = OrderedShard(order=order, track=TRACK, task=TRACK.tasks[task], shard=shard)
    return run_estimator(ordered, records.append), records


def test_blind_run_measures_at_the_starts_of_its_shard(folder: Path) -> None:
    result, records = run(folder, "sensor-blind", FigureChoice.ALL, [1, 2, 4])
    assert sorted(record.episode for record in records) == [1, 2, 4]
    assert result.figures is not None
    # Of three repeats of the list another one is measured for each start: episodes 1, 4, 7 of the first.
    assert [start.episode for start in result.figures.starts] == [1, 4]
    assert result.figures.touch is not None
    assert result.figures.grasp is not None
    assert result.figures.problem is None


def test_coefficients_of_the_order_are_played_with_and_nothing_is_calibrated(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    learned, played = run(folder, "sensor-standard", FigureChoice.NONE, [1])
    assert learned.coefficients is not None
    monkeypatch.setattr(estimator, "_calibrated", {})
    monkeypatch.setattr(estimator, "calibrate", None)
    again, records = run(folder, "sensor-standard", FigureChoice.NONE, [1], coefficients=learned.coefficients)
    assert again.coefficients == learned.coefficients
    assert [record.state_hashes for record in records] == [record.state_hashes for record in played]
    other = learned.coefficients.model_copy(update={"regressions": learned.coefficients.regressions[:1]})
    assert run(folder, "sensor-standard", FigureChoice.NONE, [1], coefficients=other)[0].coefficients == other


def test_starts_of_episodes_that_were_played_before_are_measured(folder: Path) -> None:
    result, records = run(folder, "sensor-blind", FigureChoice.ALL, [1, 2, 4], skip=(1, 2, 4))
    assert records == []
    assert result.figures is not None
    assert [start.episode for start in result.figures.starts] == [1, 4]


def test_quick_figures_need_no_starts(folder: Path) -> None:
    result, _ = run(folder, "sensor-blind", FigureChoice.QUICK, [1])
    assert result.figures is not None
    assert result.figures.starts == ()
    assert result.figures.touch is not None


def test_figures_that_cannot_be_measured_never_fail_a_shard_that_was_played(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def one_fails(_: Measurement, episode: Episode) -> StartFigures:
        if episode.number == 1:
            raise ZeroDivisionError("no marker moves")
        return measured(episode)

    def fail(*_: object, **__: object) -> None:
        raise ValueError("no place senses" + 1000 * "!")

    monkeypatch.setattr(Measurement, "start", one_fails)
    monkeypatch.setattr(starts, "touch_figures", fail)
    result, records = run(folder, "sensor-blind", FigureChoice.ALL, [1, 4])
    assert (len(records), result.end) == (2, ShardEnd.COMPLETE)
    part = result.figures
    assert part is not None
    assert ([start.episode for start in part.starts], part.touch, part.grasp) == ([4], None, None)
    assert part.problem == "Start 1 could not be measured: ZeroDivisionError: no marker moves"
    quick = run(folder, "sensor-blind", FigureChoice.QUICK, [1])[0].figures
    assert quick is not None
    assert quick.problem is not None
    assert quick.problem.startswith("Touch and grasp could not be measured: ValueError: no place senses!")
    assert len(quick.problem) == 500


@pytest.mark.parametrize("task", ["sensor-blind", "sensor-standard"])
def test_a_run_without_figures_measures_nothing(folder: Path, task: str) -> None:
    result, _ = run(folder, task, FigureChoice.NONE, [1])
    assert result.figures is None
    assert result.coefficients is not None
