"""The challenge's actors: layers, counts, first weights, and whose weights are accepted. Needs torch."""

import json
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch, of which the challenge's networks are made, is not installed")

from vitac.training.reference import policy as module  # noqa: E402
from vitac.training.reference.policy import (  # noqa: E402
    ACTORS,
    PointNet,
    Policy,
    load_actor,
    lock_actor,
    peg_actor,
    read_state,
)


def count(network: Any) -> int:
    return sum(parameter.numel() for parameter in network.parameters())


def linear_shapes(network: Any) -> list[tuple[int, ...]]:
    return [tuple(each.weight.shape) for each in network.modules() if isinstance(each, torch.nn.Linear)]


def test_encoder_has_the_published_layers() -> None:
    encoder = PointNet(4, 32)
    points = [(64, 4), (64, 64), (64, 64), (128, 64), (512, 128)]
    assert linear_shapes(encoder) == [*points, (256, 512), (256, 256), (32, 256)]
    assert count(encoder) == 288_352
    relus = [isinstance(layer, torch.nn.ReLU) for part in (encoder.points, encoder.whole) for layer in part]
    assert sum(relus) == 6
    assert not relus[8]


@pytest.mark.parametrize(
    ("make", "motion", "actions", "total"), [(peg_actor, 4, 3, 373_603), (lock_actor, 3, 2, 373_090)]
)
def test_actors_have_the_published_layers_and_first_weights(
    make: Callable[[], Any], motion: int, actions: int, total: int
) -> None:
    actor = make()
    assert linear_shapes(actor.head) == [(256, 64 + motion), (256, 256), (actions, 256)]
    assert sum(isinstance(layer, torch.nn.LayerNorm) for layer in actor.head) == 2
    assert count(actor) == total
    assert not actor.head[-1].bias.any()
    assert float(actor.head[-1].weight.detach().abs().max()) <= 0.01 / 16 + 1e-9
    flow, moved = torch.rand(5, 2, 2, 128, 2) * 200, torch.rand(5, motion)
    found = actor(flow, moved)
    assert tuple(found.shape) == (5, actions)
    assert float(found.detach().abs().max()) < 0.1


def test_fusion_actor_has_the_published_layers() -> None:
    actor = ACTORS["fusion-insertion"]()
    assert linear_shapes(actor.head) == [(256, 384), (256, 256), (4, 256)]
    assert [tuple(norm.normalized_shape) for norm in (actor.norm_of_seen, actor.norm_of_felt)] == [(256,), (128,)]
    assert [linear_shapes(each)[-1] for each in (actor.encoder, actor.peg, actor.hole)] == [
        (64, 256), (128, 256), (128, 256),
    ]  # fmt: skip
    flow, clouds = torch.rand(5, 2, 2, 128, 2) * 200, torch.rand(5, 2, 128, 3)
    found = actor(flow, clouds)
    assert tuple(found.shape) == (5, 4)
    assert torch.allclose(actor(flow, clouds[:, :, torch.randperm(128)]), found, atol=1e-5)
    assert not torch.allclose(actor(flow, clouds.flip(1)), found, atol=1e-5), "peg and hole have encoders of their own"


def test_order_of_the_markers_does_not_matter_but_which_gel_does() -> None:
    actor = peg_actor()
    flow, moved = torch.rand(1, 2, 2, 128, 2) * 200, torch.rand(1, 4)
    found = actor(flow, moved)
    assert torch.allclose(actor(flow[:, :, :, torch.randperm(128)], moved), found, atol=1e-6)
    assert not torch.allclose(actor(flow.flip(1), moved), found, atol=1e-6)


def renamed(state: dict[str, Any], *, head_first: bool = False) -> dict[str, Any]:
    """As another program may name and write the same layers, with what Stable-Baselines3 adds."""
    names = sorted(state, key=lambda name: name.startswith("encoder") == head_first)
    layers = {f"actor.layer{number}.x": state[name] for number, name in enumerate(names)}
    convolved = {name: value[..., None] if value.ndim == 2 else value for name, value in layers.items()}
    unused = {} if "peg.points.0.weight" in state else {"actor.mu.0.weight": torch.zeros(256, 3)}
    return {**unused, **convolved, "critic.qf0.0.weight": torch.zeros(256, 6)}


@pytest.mark.parametrize("head_first", [False, True])
@pytest.mark.parametrize("task", ACTORS)
def test_weights_with_other_names_give_the_same_actions(task: str, head_first: bool) -> None:
    theirs, ours = ACTORS[task](), ACTORS[task]()
    load_actor(ours, renamed(theirs.state_dict(), head_first=head_first))
    for name, value in theirs.state_dict().items():
        assert torch.equal(value, ours.state_dict()[name])


def test_weights_of_another_actor_are_refused() -> None:
    with pytest.raises(ValueError, match=r"not those of this actor: expected encoder.points.0.weight \(64, 4\)"):
        load_actor(peg_actor(), renamed(lock_actor().state_dict()))
    with pytest.raises(ValueError, match="got no actor"):
        load_actor(peg_actor(), {})


def saved(path: Path, state: Any) -> Path:
    """A model as Stable-Baselines3 saves one, whose other entries must never be opened."""
    weights = path.with_suffix(".pth")
    torch.save(state, weights)
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(weights, "policy.pth")
        archive.writestr("data", pickle.dumps(Exploding()))
    weights.unlink()
    return path


class Exploding:
    """Raises where it is unpickled."""

    def __reduce__(self) -> Any:
        return (_explode, ())


def _explode() -> None:
    raise AssertionError("was unpickled")


def test_policy_plays_the_tasks_whose_weights_are_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    actor = peg_actor()
    saved(tmp_path / "peg-insertion.zip", renamed(actor.state_dict()))
    monkeypatch.setattr(module, "__file__", str(tmp_path / "policy.py"))
    policy = Policy()
    policy.reset("peg-insertion")
    flow, motion = np.random.default_rng(0).random((2, 2, 128, 2), np.float32) * 200, np.zeros(4, np.float32)
    found = policy.act({"marker_flow": flow, "relative_motion": motion})
    expected = actor(torch.as_tensor(flow)[None], torch.zeros(1, 4))[0].detach().numpy()
    np.testing.assert_allclose(found, expected, atol=1e-6)
    with pytest.raises(ValueError, match="no weights for lock-opening, only for peg-insertion"):
        policy.reset("lock-opening")


def test_order_of_sight_and_touch_in_foreign_weights_is_what_their_owner_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    actor = ACTORS["fusion-insertion"]()
    state = actor.state_dict()
    touch_first = torch.cat([state["head.0.weight"][:, 256:], state["head.0.weight"][:, :256]], dim=1)
    saved(tmp_path / "fusion-insertion.zip", renamed({**state, "head.0.weight": touch_first}))
    monkeypatch.setattr(module, "__file__", str(tmp_path / "policy.py"))
    with pytest.raises(ValueError, match=r'It is not published .*; .*|write adapter\.json beside them: {"head"'):
        Policy()
    random, found = np.random.default_rng(0), {}
    seen = {
        "marker_flow": random.random((2, 2, 128, 2), np.float32) * 200,
        "object_point_cloud": random.random((2, 128, 3), np.float32),
    }
    for first, second in (("sight", "touch"), ("touch", "sight")):
        (tmp_path / "adapter.json").write_text(json.dumps({"head": [first, second]}))
        policy = Policy()
        policy.reset("fusion-insertion")
        found[first] = policy.act(seen)
    expected = actor(*(torch.as_tensor(value)[None] for value in seen.values()))[0].detach().numpy()
    np.testing.assert_allclose(found["touch"], expected, atol=1e-6)
    assert not np.allclose(found["sight"], expected, atol=1e-4)


def test_policy_without_weights_says_what_it_expected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "__file__", str(tmp_path / "policy.py"))
    with pytest.raises(
        ValueError,
        match=r"expected one of peg-insertion, lock-opening, fusion-insertion, sensor-design with \.zip or \.pth",
    ):
        Policy()


def test_code_in_weights_is_never_run(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"peg-insertion\.zip holds no plain state dict"):
        read_state(saved(tmp_path / "peg-insertion.zip", {"actor.x": Exploding()}))
    (tmp_path / "a.pth").write_bytes(pickle.dumps(Exploding()))
    with pytest.raises(ValueError, match="holds no plain state dict"):
        read_state(tmp_path / "a.pth")


@pytest.mark.parametrize("content", [[1, 2], {"actor.x": 3}])
def test_what_is_no_state_dict_is_refused(tmp_path: Path, content: Any) -> None:
    torch.save(content, tmp_path / "a.pth")
    with pytest.raises(ValueError, match="expected tensors by name"):
        read_state(tmp_path / "a.pth")


def test_zip_without_weights_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("data", "{}")
    with pytest.raises(ValueError, match=r"holds no policy\.pth"):
        read_state(tmp_path / "a.zip")
