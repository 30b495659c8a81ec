"""Makes `ManiSkill/weights.npz`: behaviour cloning of the scripted policy for `pick-cube`.

Run it as `python examples/maniskill_cloning/train.py` where the extra maniskill is installed; it takes a few minutes on
one core. The script says what it would do in every state; the arm does that with noise, so that the network also learns
to come back. No episode is of the list of the track (list seed 0), or of those of the README (1).
"""

import sys
from pathlib import Path

import numpy as np
import torch
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.tracks import load_track

sys.path.insert(0, str(Path(__file__).parents[1] / "maniskill" / "ManiSkill"))
sys.path.insert(0, str(Path(__file__).parent / "ManiSkill"))
from pick_cube import PickCube
from policy import WEIGHTS, network

LIST_SEED = 2
EPISODES = 300
ENV_STEPS = 30
NOISE = 0.3  # of actions in [-1, 1]
EPOCHS = 150
BATCH = 256
HELD_OUT = 0.1


def main() -> None:
    """Collect, fit, and write the weights."""
    states, actions = collect()
    mean, scale = states.mean(axis=0), states.std(axis=0) + 1e-3
    fitted = fit((states - mean) / scale, actions)
    stored = {name: value.numpy() for name, value in fitted.state_dict().items()}
    np.savez_compressed(WEIGHTS, mean=mean, scale=scale, **stored)


def collect() -> tuple[np.ndarray, np.ndarray]:
    """Return states, shape [n, 42], and what the script does in them, shape [n, 4]."""
    env = make_environment(load_track("maniskill").tasks["pick-cube"])
    script, states, actions = PickCube(), [], []
    for number in range(EPISODES):
        random = np.random.default_rng((LIST_SEED, number))
        observation, _ = env.reset(options={"rng_seed": (LIST_SEED, number)})
        for _ in range(ENV_STEPS):
            action = script.act(observation)
            states.append(observation["state"])
            actions.append(action.copy())
            action[:3] += random.normal(0.0, NOISE, 3) * random.integers(0, 2)
            observation, *_ = env.step(action)
        print(f"\repisode {number + 1} of {EPISODES}", end="", file=sys.stderr)
    print(file=sys.stderr)
    return np.array(states), np.array(actions)


def fit(states: np.ndarray, actions: np.ndarray) -> torch.nn.Module:
    """Return the network fitted to the actions; the last tenth, of other episodes, only says how well."""
    torch.manual_seed(0)
    inputs, targets = torch.from_numpy(states), torch.from_numpy(actions)
    n_train = int(len(inputs) * (1.0 - HELD_OUT))
    model = network()
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, EPOCHS)
    loss_of = torch.nn.SmoothL1Loss(beta=0.1)
    for epoch in range(EPOCHS):
        for batch in torch.randperm(n_train).split(BATCH):
            optimizer.zero_grad()
            loss_of(model(inputs[batch]), targets[batch]).backward()
            optimizer.step()
        schedule.step()
        if epoch % 10 == 9:
            with torch.no_grad():
                held_out = loss_of(model(inputs[n_train:]), targets[n_train:]).item()
            print(f"epoch {epoch + 1}: loss {held_out:.4f} in held-out episodes", file=sys.stderr)
    return model


if __name__ == "__main__":
    main()
