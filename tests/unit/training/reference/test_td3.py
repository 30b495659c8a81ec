"""TD3 with the challenge's policies: what actor and critics see, and that a training ends in a submission."""

from dataclasses import replace
from pathlib import Path
from runpy import run_path
from typing import Any

import gymnasium
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch, of which the challenge's networks are made, is not installed")
pytest.importorskip("stable_baselines3", reason="Stable-Baselines3, which has TD3, is not installed")

from vitac.evaluator.submission.manifest import load_manifest  # noqa: E402
from vitac.training.reference import method  # noqa: E402
from vitac.training.reference.hyperparameters import HYPERPARAMETERS, Hyperparameters  # noqa: E402
from vitac.training.reference.td3 import HeldOutStarts, new_model  # noqa: E402
from vitac.training.streams import Use, stream  # noqa: E402

SIZES = {"gt_offset": 3, "key1": 3, "key2": 3}
QUICK = {"learning_starts": 6, "batch_size": 4, "buffer_size": 50, "checkpoint_env_steps": 5, "evaluation_episodes": 3}


class Random(gymnasium.Env[Any, Any]):
    """Random observations of a task."""

    def __init__(self, chosen: Hyperparameters, actions: int) -> None:
        self.starts: list[Any] = []
        motion = 4 if actions == 3 else 3
        shapes = {"marker_flow": (2, 2, 128, 2), "relative_motion": (motion,), **dict.fromkeys(chosen.truths, (3,))}
        boxes: dict[str, Any] = {
            key: gymnasium.spaces.Box(-1e3, 1e3, shape, np.float32) for key, shape in shapes.items()
        }
        self.observation_space = gymnasium.spaces.Dict(boxes)
        self.action_space = gymnasium.spaces.Box(-1, 1, (actions,), np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.starts.append(options)
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> Any:
        return self.observation_space.sample(), 0.0, bool(self.np_random.random() < 0.3), False, {}


@pytest.mark.parametrize(("task", "actions", "truth"), [("peg-insertion", 3, 3), ("lock-opening", 2, 6)])
def test_model_is_the_published_one(task: str, actions: int, truth: int) -> None:
    chosen = HYPERPARAMETERS[task]
    model = new_model(task, chosen, Random(chosen, actions))
    critics = [
        [tuple(layer.weight.shape) for layer in critic if isinstance(layer, torch.nn.Linear)]
        for critic in model.critic.q_networks
    ]
    assert critics == [[(256, truth + actions), (256, 256), (1, 256)]] * 2
    assert model.actor.optimizer.defaults["lr"] == 3e-4
    assert (model.policy_delay, model.buffer_size, model.batch_size) == (chosen.policy_delay, 10_000, 128)
    assert (model.train_freq.frequency, model.gradient_steps, model.learning_starts) == (2, -1, 1000)
    assert [name for name in model.policy.state_dict() if name.startswith("actor.mu.")]


def test_training_ends_in_a_submission_that_plays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    quick = {"peg-insertion": replace(HYPERPARAMETERS["peg-insertion"], **QUICK)}  # type: ignore[arg-type]
    monkeypatch.setattr(method, "HYPERPARAMETERS", quick)
    monkeypatch.setattr(method, "_environment", lambda chosen: Random(chosen, 3))
    folder = method.train_reference("peg-insertion", tmp_path / "run", env_steps=12)
    assert load_manifest(folder / "Track_1").tasks == ("peg-insertion",)
    assert (tmp_path / "run" / "checkpoints" / "peg-insertion_5_steps.zip").exists()
    with (tmp_path / "run" / "progress.csv").open() as file:
        assert "eval/mean_reward" in next(file)
    with np.load(tmp_path / "run" / "evaluations.npz") as evaluations:
        assert evaluations["timesteps"].tolist() == [5, 10]
        assert evaluations["results"].shape == (2, 3)
    policy = run_path(str(folder / "Track_1" / "policy.py"))["Policy"]()
    policy.reset("peg-insertion")
    action = policy.act(
        {"marker_flow": np.ones((2, 2, 128, 2), np.float32), "relative_motion": np.zeros(4, np.float32)}
    )
    assert action.shape == (3,)
    assert np.abs(action).max() <= 1.0


def test_evaluations_play_the_same_few_starts_that_no_training_learns_from() -> None:
    chosen = replace(HYPERPARAMETERS["peg-insertion"], seed=4, evaluation_episodes=3)
    env = Random(chosen, 3)
    held_out = HeldOutStarts(env, chosen)
    for _ in range(4):
        held_out.reset(seed=9, options={"rng_seed": (1, 2)})
    assert env.starts == [{"rng_seed": (stream(4, Use.CHOOSE), number)} for number in (0, 1, 2, 0)]
