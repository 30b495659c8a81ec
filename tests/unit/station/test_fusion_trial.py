"""The fusion task at a twin whose base has two holes, by a policy that knows where they are."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from vitac.evaluator.agent.protocol import CloudSpec
from vitac.evaluator.agent.session import Isolation
from vitac.evaluator.episodes.episode import PlayingPolicy
from vitac.evaluator.episodes.records import Observation, make_reading
from vitac.evaluator.strict_model import validate
from vitac.evaluator.tracks import Episode, load_track
from vitac.station.check import check_station
from vitac.station.description import Prompts, StationDescription, StationTask
from vitac.station.eyes import OpenStation, open_station
from vitac.station.outcome import TrialOutcome
from vitac.station.trial import Attempt
from vitac.station.trials import FusionTrial
from vitac.station.twin.grasp import Mounted
from vitac.station.twin.hidden import HiddenSettings
from vitac.station.twin.laboratory import twin_process

TASK = load_track("track_2").tasks["fusion-insertion"]
START = (0.0, 6.0, 0.0, 3.0, 1.0)
"""The hexagon's hole is 16.6 mm further along y, and the rim 4 mm lower."""
WAY = np.array((0.3205, 45.25 / 2 - 6.0, 0.0))
READ = ("relative_motion", "rgb_picture", "depth_picture", "object_point_cloud", "marker_flow")


class Guided:
    """A policy in this process that goes along a way [mm, mm, degree], and down over its end."""

    isolation: Isolation | None = None
    cpu_s = channel_s = 0.0
    answers_s = ()
    output = ""

    def __init__(self, way: NDArray[np.float64]) -> None:
        self._way, self.seen = way, list[Observation]()

    def begin_shard(self) -> None:
        """Nothing is counted."""

    @contextmanager
    def episode(
        self, *, task: str, action_shape: tuple[int, ...], clouds: Sequence[CloudSpec] = ()
    ) -> Iterator[PlayingPolicy]:
        assert (task, action_shape, clouds) == ("fusion-insertion", (4,), ())
        yield self

    def act(self, observation: Observation) -> NDArray[np.float32]:
        self.seen.append(observation)
        left = self._way - observation["relative_motion"][:3]
        down = -1.0 if np.abs(left).max() < 0.1 else 0.0
        return np.array((*left, down), np.float32)


@pytest.fixture(scope="module")
def station() -> Iterator[OpenStation]:
    hidden, hexagon = HiddenSettings(latency_s=0.0), Mounted(StationTask.FUSION, "hexagon")
    with twin_process(hidden, mounted=hexagon, period_s=0.2) as running:
        description = validate(StationDescription, running.description, "station.yaml")
        assert "RGB-D camera" in [each.device for each in check_station(description) if not each.problems]
        with open_station(description) as opened:
            yield opened


def play(station: OpenStation, folder: Path, policy: Guided) -> Attempt:
    return FusionTrial(
        station,
        task=TASK,
        episode=Episode(number=1, shape="hexagon", offset=START, offset_option="start", list_seed=0),
        reading=make_reading(TASK, READ),
        open_session=lambda: policy,
        folder=folder,
    ).play()


@pytest.mark.slow
def test_peg_that_goes_to_its_own_hole_succeeds_and_the_policy_sees_it(station: OpenStation, tmp_path: Path) -> None:
    policy = Guided(WAY)
    attempt = play(station, tmp_path, policy)
    assert attempt.outcome is TrialOutcome.SUCCESS, attempt.reason
    assert np.array(attempt.actions).shape == (len(policy.seen), 4)
    first, last = policy.seen[0], policy.seen[-1]
    assert set(first) == set(READ)
    assert last["relative_motion"][1] == pytest.approx(WAY[1], abs=0.1)
    assert (first["rgb_picture"].shape, first["depth_picture"].shape) == ((480, 640, 3), (480, 640))
    peg_m, base_m = first["object_point_cloud"]
    assert peg_m.shape == base_m.shape == (128, 3)
    assert np.median(peg_m[:, 2]) == pytest.approx(0.42, abs=0.02)
    assert np.median(base_m[:, 2]) == pytest.approx(0.44, abs=0.03)
    red, green, blue = first["rgb_picture"][290, 346].astype(int)
    assert red > 2 * max(green, blue)  # the peg, and not blue first


@pytest.mark.slow
def test_prompt_beside_the_picture_refuses_the_trial(
    station: OpenStation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prompts = Prompts(peg=(5000, 0), base=(0, 0))
    monkeypatch.setattr(station, "procedure", station.procedure.model_copy(update={"prompts": prompts}))
    attempt = play(station, tmp_path, Guided(WAY))
    assert attempt.outcome is TrialOutcome.REFUSED
    assert attempt.reason.startswith("The prompt (5000, 0) is outside of the picture")


@pytest.mark.slow
def test_policy_that_leaves_the_range_moves_nothing_more(station: OpenStation, tmp_path: Path) -> None:
    attempt = play(station, tmp_path, Guided(np.array((-30.0, 0.0, 0.0))))
    assert attempt.outcome is TrialOutcome.ERROR
    assert station.stage.status().pose.x_mm == pytest.approx(-12.0, abs=0.01)
