"""Acts by an actor of the challenge's own shape: PointNet encoders of markers and of seen objects, in torch.

This file is a whole submission with weights beside it: for each task that it plays, `<task>.zip` as Stable-Baselines3
saves a model, or the `policy.pth` of such a file as `<task>.pth`. Only the state dict is read, as tensors and nothing
else; the pickled rest of a zip is never opened. Training imports the same file, so that what is learned is what is
played. `adapter.json` says of foreign weights for Track 2 what is not published: {"head": ["sight", "touch"]} or the
reverse.
"""

import io
import json
import zipfile
from collections.abc import Callable, Mapping
from itertools import pairwise, permutations
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

HIDDEN = 256
FELT, FELT_BY_FUSION, SEEN = 32, 64, 128  # numbers that an encoder makes of one gel, and of one object
CLOUD_SCALE = 100.0  # metres to centimetres
OF_ACTOR = "actor."
SIGHT_FIRST = ("sight", "touch")
OURS = "network."  # of a model that this code trained; beside it stands Stable-Baselines3's own network, never used


class PointNet(nn.Module):  # type: ignore[misc] # torch is not there when types are checked
    """Numbers from a set of points, whatever their order (Qi et al. 2017)."""

    def __init__(self, channels: int, outputs: int) -> None:
        super().__init__()
        self.points = _perceptron([channels, 64, 64, 64, 128, 512], last_relu_after=4)
        self.whole = _perceptron([512, HIDDEN, HIDDEN, outputs], last_relu_after=2)

    def forward(self, points: Any) -> Any:
        """Return numbers of shape [..., outputs] from points of shape [..., n, channels]."""
        return self.whole(self.points(points).max(dim=-2).values)


class TactileActor(nn.Module):  # type: ignore[misc]
    """Action from both gels' markers and the gripper's motion."""

    observed = ("marker_flow", "relative_motion")
    not_played = ("mu.", "features_extractor.")  # what Stable-Baselines3 built beside the challenge's actor

    def __init__(self, motion: int, actions: int, encoder: type[PointNet] = PointNet) -> None:
        super().__init__()
        self.encoder = encoder(4, FELT)
        self.head = nn.Sequential(
            *(nn.Linear(2 * FELT + motion, HIDDEN), nn.LayerNorm(HIDDEN), nn.ReLU()),
            *(nn.Linear(HIDDEN, HIDDEN), nn.LayerNorm(HIDDEN), nn.ReLU()),
            nn.Linear(HIDDEN, actions),
        )
        with torch.no_grad():
            self.head[-1].weight *= 0.01
            self.head[-1].bias.zero_()

    def forward(self, marker_flow: Any, relative_motion: Any) -> Any:
        """Return actions of shape [b, actions].

        Args:
            marker_flow: pixels, shape [b, 2, 2, n, 2]: gel, reference and current, marker, u and v.
            relative_motion: shape [b, motion].
        """
        felt = self.encoder(marker_points(marker_flow)).flatten(1)
        return torch.tanh(self.head(torch.cat([felt, relative_motion], dim=1)))


class FusionActor(nn.Module):  # type: ignore[misc]
    """Action from both gels' markers and the clouds of peg and hole.

    Attributes:
        head_order: of what enters the head; the challenge's is not published.
    """

    observed = ("marker_flow", "object_point_cloud")
    not_played = ()
    head_order: tuple[str, ...] = SIGHT_FIRST

    def __init__(self, encoder: type[PointNet] = PointNet) -> None:
        super().__init__()
        self.encoder = encoder(4, FELT_BY_FUSION)
        self.peg, self.hole = encoder(3, SEEN), encoder(3, SEEN)
        self.norm_of_felt, self.norm_of_seen = nn.LayerNorm(2 * FELT_BY_FUSION), nn.LayerNorm(2 * SEEN)
        self.head = _perceptron([2 * SEEN + 2 * FELT_BY_FUSION, HIDDEN, HIDDEN, 4], last_relu_after=2)

    def forward(self, marker_flow: Any, object_point_cloud: Any) -> Any:
        """Return actions of shape [b, 4].

        Args:
            marker_flow: as for `TactileActor`.
            object_point_cloud: metres, shape [b, 2, n, 3]: peg and hole.
        """
        felt = self.encoder(marker_points(marker_flow)).flatten(1)
        peg, hole = (CLOUD_SCALE * object_point_cloud).unbind(1)
        seen = torch.cat([self.peg(peg), self.hole(hole)], dim=1)
        parts = {"sight": self.norm_of_seen(seen), "touch": self.norm_of_felt(felt)}
        return torch.tanh(self.head(torch.cat([parts[name] for name in self.head_order], dim=1)))


Actor = TactileActor | FusionActor


def marker_points(marker_flow: Any) -> Any:
    """Return reference and current pixels of each marker, shape [b, 2, n, 4], from shape [b, 2, 2, n, 2]."""
    return marker_flow.permute(0, 1, 3, 2, 4).flatten(-2)


def peg_actor(encoder: type[PointNet] = PointNet) -> TactileActor:
    """Return the challenge's TD3PolicyForPointFlowEnv actor."""
    return TactileActor(motion=4, actions=3, encoder=encoder)


def lock_actor(encoder: type[PointNet] = PointNet) -> TactileActor:
    """Return the challenge's TD3PolicyForLongOpenLockPointFlowEnv actor."""
    return TactileActor(motion=3, actions=2, encoder=encoder)


ACTORS: dict[str, Callable[..., Actor]] = {
    "peg-insertion": peg_actor,
    "lock-opening": lock_actor,
    "fusion-insertion": FusionActor,
    "sensor-design": peg_actor,
}


class Policy:
    """Plays every task whose weights are beside this file."""

    def __init__(self) -> None:
        torch.set_num_threads(1)
        folder = Path(__file__).parent
        self.actors = {}
        for task, make in ACTORS.items():
            for path in (folder / f"{task}.zip", folder / f"{task}.pth"):
                if path.exists():
                    state, actor = read_state(path), make()
                    if isinstance(actor, FusionActor) and not is_ours(state):
                        actor.head_order = read_head_order(folder)
                    load_actor(actor, state)
                    self.actors[task] = actor
        if not self.actors:
            raise ValueError(
                f"No weights are beside {__file__}; expected one of {', '.join(ACTORS)} with .zip or .pth."
            )

    def reset(self, task: str) -> None:
        """Begin an episode."""
        if task not in self.actors:
            raise ValueError(f"There are no weights for {task}, only for {', '.join(self.actors)}.")
        self.actor = self.actors[task]

    def act(self, observation: Mapping[str, Any]) -> Any:
        """Return the actor's action."""
        seen = [torch.as_tensor(np.asarray(observation[key]))[None] for key in self.actor.observed]
        with torch.no_grad():
            return self.actor(*seen)[0].numpy()


def read_head_order(folder: Path) -> tuple[str, ...]:
    """Return in which order sight and touch enter the head of a foreign actor of Track 2, as `adapter.json` says it.

    Raises:
        ValueError: it does not say it.
    """
    path = folder / "adapter.json"
    order = tuple(json.loads(path.read_text())["head"]) if path.exists() else ()
    if sorted(order) != sorted(SIGHT_FIRST):
        raise ValueError(
            "It is not published whether what is seen or what is felt enters the head of Track 2's actor first. Look "
            'into the code that trained these weights, and write adapter.json beside them: {"head": ["sight", '
            '"touch"]} or {"head": ["touch", "sight"]}.'
        )
    return order


def read_state(path: Path) -> Mapping[str, Any]:
    """Return the state dict of a `.pth` file, or of the one in a zip of Stable-Baselines3.

    Raises:
        ValueError: there is none, or it holds something else than tensors.
    """
    data = path.read_bytes()
    if path.suffix == ".zip":
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if "policy.pth" not in archive.namelist():
                raise ValueError(f"{path.name} holds no policy.pth; expected a model that Stable-Baselines3 saved.")
            data = archive.read("policy.pth")
    try:
        state = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except Exception as error:
        raise ValueError(
            f"{path.name} holds no plain state dict ({type(error).__name__}); expected tensors."
        ) from error
    if not isinstance(state, Mapping) or not all(isinstance(value, torch.Tensor) for value in state.values()):
        raise ValueError(f"{path.name} holds no state dict; expected tensors by name.")
    return state


def load_actor(actor: Actor, state: Mapping[str, Any]) -> None:
    """Give an actor the weights of a state dict, its own or one with other names for the same layers.

    Only the order and the sizes of an actor's layers are published, not what its modules are called; so layers are
    matched by their order, with the parts of the actor in any order. A convolution over points of width 1 is a layer
    too.

    Raises:
        ValueError: the sizes are not those of this actor.
    """
    published = {name: value.squeeze(-1) if value.ndim == 3 else value for name, value in _played(actor, state).items()}
    own = actor.state_dict()
    names_of = {part: [name for name in own if name.startswith(f"{part}.")] for part, _ in actor.named_children()}
    for parts in permutations(names_of):
        names = [name for part in parts for name in names_of[part]]
        if [own[name].shape for name in names] == [value.shape for value in published.values()]:
            actor.load_state_dict(dict(zip(names, published.values(), strict=True)))
            return
    raise ValueError(
        f"The weights are not those of this actor: expected {_sizes(own)}, got {_sizes(published) or 'no actor'} ..."
    )


def _played(actor: Actor, state: Mapping[str, Any]) -> dict[str, Any]:
    """Return the layers that act, of a model that this code trained or of one that the challenge's code did."""
    layers = {name.removeprefix(OF_ACTOR): value for name, value in state.items() if name.startswith(OF_ACTOR)}
    if is_ours(state):
        return {name: value for name, value in layers.items() if name.startswith(OURS)}
    return {name: value for name, value in layers.items() if not name.startswith(actor.not_played)}


def is_ours(state: Mapping[str, Any]) -> bool:
    """Return whether this code trained a model."""
    return any(name.startswith(OF_ACTOR + OURS) for name in state)


def _sizes(state: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {tuple(value.shape)}" for name, value in list(state.items())[:4])


def _perceptron(sizes: list[int], last_relu_after: int) -> Any:
    """Return linear layers with a ReLU after each of the first ones."""
    layers: list[Any] = []
    for number, (inputs, outputs) in enumerate(pairwise(sizes), start=1):
        layers.append(nn.Linear(inputs, outputs))
        if number <= last_relu_after:
            layers.append(nn.ReLU())
    return nn.Sequential(*layers)
