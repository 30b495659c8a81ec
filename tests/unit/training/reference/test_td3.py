"""TD3 with the challenge's policies: what actor and critics see, and that a training ends in a submission."""

from dataclasses import replace
from pathlib import Path
from runpy import run_path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch, of which the challenge's networks are made, is not installed")
pytest.importorskip("stable_baselines3", reason="Stable-Baselines3, which has TD3, is not installed")

from toy_touch import ToyTouch  # noqa: E402
from vitac.evaluator.submission.manifest import load_manifest  # noqa: E402
from vitac.training.reference import method  # noqa: E402
from vitac.training.reference.hyperparameters import HYPERPARAMETERS  # noqa: E402
from vitac.training.reference.td3 import new_model  # noqa: E402

QUICK = {"learning_starts": 6, "batch_size": 4, "buffer_size": 50, "checkpoint_env_steps": 5, "evaluation_episodes": 3}


@pytest.mark.parametrize(("task", "actions", "truth"), [("peg-insertion", 3, 3), ("lock-opening", 2, 6)])
def test_model_is_the_published_one(task: str, actions: int, truth: int) -> None:
    chosen = HYPERPARAMETERS[task]
    model = new_model(task, chosen, ToyTouch(chosen.truths, actions))
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
    monkeypatch.setattr(method, "_environment", lambda chosen: ToyTouch(chosen.truths, 3))
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
