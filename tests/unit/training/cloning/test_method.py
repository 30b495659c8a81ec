"""Cloning: what is learned, what the blind policy lacks, what is played, and the bits of a run that was stopped."""

import json
from collections.abc import Iterator
from pathlib import Path
from runpy import run_path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from toy_peg import ToyPeg
from vitac.evaluator.scoring.comparison import SensingGain
from vitac.evaluator.scoring.score import rate
from vitac.evaluator.submission.manifest import load_manifest
from vitac.evaluator.tracks import find_task
from vitac.training.cloning import playing
from vitac.training.cloning.method import ClonePlan, Round, best, clone
from vitac.training.demonstrations import expert
from vitac.training.demonstrations.expert import NoExpert
from vitac.training.log import FOLDER
from vitac.training.run import OtherRun
from vitac.training.sensor import SensorMismatch
from vitac.training.streams import Use, stream

PLAN = ClonePlan(
    task="peg-insertion",
    seed=3,
    rounds=2,
    episodes=30,
    chosen_by=10,
    reported=40,
    hidden=32,
    gradient_steps=300,
    batch=64,
)


class Stopped(BaseException):
    """Like Ctrl-C or a kill: nobody in the cloning catches it."""


@pytest.fixture(autouse=True, scope="module")
def toy() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(expert, "make_environment", lambda _, observation_keys, settings: ToyPeg(observation_keys))
        patched.setattr(expert, "held_pose_mm_deg", lambda grasped: grasped)
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, SensingGain]:
    """A cloning that was never stopped, and what it found."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    return folder, clone(PLAN, folder)


def files(folder: Path) -> dict[str, bytes]:
    """All but the charts, which hold times, by name."""
    found = [path for path in folder.rglob("*") if path.is_file() and path.parent.name != FOLDER]
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


def test_policy_that_senses_solves_what_the_blind_one_cannot(whole: tuple[Path, SensingGain]) -> None:
    folder, gain = whole
    assert gain.episodes == PLAN.reported
    assert gain.low > 0
    assert json.loads((folder / "gain.json").read_text()) == json.loads(gain.model_dump_json())


@pytest.mark.parametrize(
    ("where", "keys"), [(".", ("marker_flow", "relative_motion")), ("blind", ("relative_motion",))]
)
def test_best_round_becomes_a_submission_that_acts_as_in_training(
    whole: tuple[Path, SensingGain], where: str, keys: tuple[str, ...]
) -> None:
    submission = whole[0] / where / "submission" / "Track_1"
    assert load_manifest(submission).observation_keys == keys
    policy = run_path(str(submission / "policy.py"))["Policy"]()
    env, ended = ToyPeg(keys), []
    for number in range(PLAN.reported):
        observation, info = env.reset(options={"rng_seed": (stream(PLAN.seed, Use.REPORT), number)})
        policy.reset(PLAN.task)
        while info["end_reason"] is None:
            observation, _, _, _, info = env.step(policy.act(observation))
        ended.append(info["is_success"])
    counts = (whole[1].standard_successes, whole[1].blind_successes)
    assert sum(ended) == counts[where == "blind"]


@pytest.mark.slow
@pytest.mark.parametrize("stop_at", ["run: round-001: 2", "run: round 1", "run: round-002: 1", "blind: round 1"])
def test_stopped_cloning_ends_with_the_same_bits(whole: tuple[Path, SensingGain], tmp_path: Path, stop_at: str) -> None:
    def stop(line: str) -> None:
        if line.startswith(stop_at):
            raise Stopped

    with pytest.raises(Stopped):
        clone(PLAN, tmp_path / "run", tell=stop)
    assert clone(PLAN, tmp_path / "run", processes=2) == whole[1]
    assert files(tmp_path / "run") == files(whole[0])


def test_starts_of_one_use_are_of_no_other(whole: tuple[Path, SensingGain], monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[ToyPeg] = []

    def make(_: Any, observation_keys: Any, settings: Any) -> ToyPeg:
        made.append(ToyPeg(observation_keys))
        return made[-1]

    monkeypatch.setattr(expert, "make_environment", make)
    clone(PLAN, whole[0].parent / "counted")
    for env in made:
        used = {use: [number for seed, number in env.resets if seed == stream(PLAN.seed, use)] for use in Use}
        assert len(set(used[Use.COLLECT])) == len(used[Use.COLLECT]) == PLAN.rounds * PLAN.episodes
        assert used[Use.CHOOSE] == PLAN.rounds * [*range(PLAN.chosen_by)]
        assert used[Use.REPORT] == [*range(PLAN.reported)]
        assert sum(map(len, used.values())) == len(env.resets)
    assert len(made) == 2


def test_other_plan_is_refused(whole: tuple[Path, SensingGain]) -> None:
    with pytest.raises(OtherRun, match="holds a run of another recipe; give another folder"):
        clone(PLAN.model_copy(update={"rounds": 3}), whole[0])


def test_task_without_expert_or_without_its_sensor_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SensorMismatch, match="Expected the folder of a sensor for sensor-design"):
        clone(PLAN.model_copy(update={"task": "sensor-design"}), tmp_path)
    with pytest.raises(NoExpert, match="pick-cube has no expert, expected a task whose definition has a guided_motion"):
        clone(PLAN.model_copy(update={"task": "pick-cube"}), tmp_path)
    assert not list(tmp_path.glob("*.npz"))


def test_best_solves_most_and_is_the_latest() -> None:
    rounds = [Round(number=number, solved=rate(solved, 9), env_steps=9) for number, solved in ((1, 8), (2, 8), (3, 7))]
    assert best(rounds).number == 2


def test_expert_lowers_a_peg_that_is_nearly_over_its_hole(monkeypatch: pytest.MonkeyPatch) -> None:
    env = SimpleNamespace(task_scene=SimpleNamespace(grasped=None))
    monkeypatch.setattr(expert, "make_environment", lambda *_, **__: env)
    stage, random = playing.ClonedTask(find_task("fusion-insertion")[1], ()), np.random.default_rng(0)
    for x_mm, down in ((0.9, 1.0), (1.1, 0.0)):
        monkeypatch.setattr(expert, "held_pose_mm_deg", lambda _, x_mm=x_mm: (x_mm, -0.9, 0.0, 0.0, 0.0, 1.4))
        action = stage.expert_action({"gt_offset_mm_deg": np.array([9.0, 9.0, 9.0, 10.1])}, random)
        assert action[3] == pytest.approx(-down, abs=1e-6)
        assert (action[0] == 0.0) == (down == 1.0)


@pytest.mark.parametrize(("task", "loss"), [("fusion-insertion", playing.squared), ("in-hand-turn", playing.cautious)])
def test_caution_is_learned_where_nothing_can_be_taken_back(
    task: str, loss: playing.Loss, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(expert, "make_environment", lambda *_, **__: None)
    assert playing.ClonedTask(find_task(task)[1], ()).loss is loss


@pytest.mark.parametrize(("task", "gone"), [("peg-insertion", 0.6), ("assembly", 0.4)])
def test_an_expert_that_says_what_to_do_is_copied_as_it_is_and_one_that_says_the_way_goes_further(
    task: str, gone: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(expert, "make_environment", lambda *_, **__: None)
    cloned = playing.ClonedTask(find_task(task)[1], ())
    monkeypatch.setattr(cloned._expert, "_way", lambda *_: np.array([0.4]))
    assert cloned.expert_action({}, np.random.default_rng(0)) == pytest.approx([gone])


@pytest.mark.parametrize(("task", "power"), [("peg-insertion", 1), ("assembly", 3)])
def test_noise_on_the_actions_of_an_exact_expert_is_small_in_most_episodes(
    task: str, power: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(expert, "make_environment", lambda *_, **__: Noted())
    stage = playing.ClonedTask(find_task(task)[1], ())
    monkeypatch.setattr(stage, "expert_action", lambda *_: np.zeros(stage.n_actions))
    for number in range(3):
        stage.play(7, [number], None)
        part = np.random.default_rng((7, number, 1)).uniform()
        assert np.std(stage.env.actions) == pytest.approx(playing.SPREAD * part**power, rel=0.1)


class Noted:
    """An environment that notes the actions of its last episode, of 200 env steps."""

    task_scene = SimpleNamespace(shape="none")

    def reset(self, **_: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        self.actions: list[Any] = []
        return {"relative_motion": np.zeros(3)}, {"end_reason": None}

    def step(self, action: Any) -> tuple[Any, ...]:
        self.actions.append(action)
        ended = "steps" if len(self.actions) == 200 else None
        return {"relative_motion": np.zeros(3)}, 0.0, False, False, {"end_reason": ended, "is_success": False}
