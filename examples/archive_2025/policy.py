"""Plays models of the 2025 challenge with the network code that they were trained with, as that evaluation did.

An archive has `solutions/policies.py` and zips that Stable-Baselines3 saved; `adapter.json` says which class and which
zip play which task. Of a zip, the observation and action spaces and the arguments of the class are unpickled, here in
the sandbox. Needs torch and Stable-Baselines3, the package sets `torch` and `sb3`.
"""

import base64
import json
import zipfile
from importlib import import_module
from pathlib import Path

import cloudpickle
import torch

FOLDER = Path(__file__).parent
ARGUMENTS = ("observation_space", "action_space", "policy_kwargs")


class Policy:
    """Plays every task that `adapter.json` names."""

    def __init__(self):
        torch.set_num_threads(1)
        chosen = json.loads((FOLDER / "adapter.json").read_text())
        self.models = {task: load_model(entry["model"], FOLDER / entry["weights"]) for task, entry in chosen.items()}

    def reset(self, task):
        """Begin an episode."""
        if task not in self.models:
            raise ValueError(f"adapter.json names no model for {task}, only for {', '.join(self.models)}.")
        self.model = self.models[task]

    def act(self, observation):
        """Return the model's action for tensors without a batch, which is how the evaluation of 2025 asked."""
        with torch.no_grad():
            return self.model({key: torch.tensor(value) for key, value in observation.items()}).numpy().ravel()


def load_model(name, path):
    """Return a policy of a class in `solutions.policies` with the weights of a zip; no more of the zip is read."""
    with zipfile.ZipFile(path) as archive:
        stored = json.loads(archive.read("data"))
        with archive.open("policy.pth") as file:
            weights = torch.load(file, map_location="cpu", weights_only=True)
    space, actions, arguments = (unpickle(stored[key]) for key in ARGUMENTS)
    model = getattr(import_module("solutions.policies"), name)(space, actions, lambda _: 0.0, **arguments)
    model.load_state_dict(weights)
    return model.eval()


def unpickle(entry):
    """Return what Stable-Baselines3 wrote of an object: itself, or beside a description its pickle."""
    if isinstance(entry, dict) and ":serialized:" in entry:
        return cloudpickle.loads(base64.b64decode(entry[":serialized:"]))
    return entry
