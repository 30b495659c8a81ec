"""What `gymnasium.make` adds to a task's environment."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
import vitac.envs
from vitac.envs.tasks.definition import EndReason
from vitac.envs.tasks.making import EqualInfoShapes, NumericInfos, UnexpectedArgument, make
from vitac.envs.tasks.registry import task_definitions

PEG, LOCK = "ViTac/PegInsertion-v1", "ViTac/LockOpening-v1"
CORNERS = {"cuboid": 4, "trapezoid": 4, "concave1": 8}


def infos(env: Any, options: Mapping[str, Any]) -> list[dict[str, Any]]:
    _, first = env.reset(seed=1, options=dict(options))
    return [first, env.step(np.zeros(env.action_space.shape, dtype=np.float32))[4]]


@pytest.mark.parametrize("shape", CORNERS)
def test_corner_heights_have_one_length_for_all_shapes(shape: str) -> None:
    env = gymnasium.make(PEG, disable_env_checker=True)
    for info in infos(env, {"shape": shape}):
        heights = info["peg_relative_z_mm"]
        assert heights.shape == (8,)
        assert (heights[CORNERS[shape] :] == heights[CORNERS[shape] - 1]).all()


@pytest.mark.parametrize("shape", CORNERS)
def test_unwrapped_environment_tells_the_corners_that_there_are(shape: str) -> None:
    env = gymnasium.make(PEG, disable_env_checker=True)
    filled = infos(env, {"shape": shape})
    for info, wrapped in zip(infos(env.unwrapped, {"shape": shape}), filled, strict=True):
        heights = info["peg_relative_z_mm"]
        assert heights.shape == (CORNERS[shape],)
        assert heights.tolist() == wrapped["peg_relative_z_mm"][: len(heights)].tolist()
        assert list(info) == list(wrapped)


def test_filling_up_leaves_the_environments_own_info_alone() -> None:
    env = make(PEG)
    assert isinstance(env, EqualInfoShapes)
    original: dict[str, Any] = {}
    inner = env.env.step

    def step(action: Any) -> Any:
        result = inner(action)
        original.update(result[4])
        return result

    env.env.step = step  # type: ignore[method-assign]
    env.reset(seed=0, options={"shape": "cuboid"})
    env.step(np.zeros(3, dtype=np.float32))
    assert len(original["peg_relative_z_mm"]) == 4


def test_task_whose_infos_are_equal_is_not_wrapped() -> None:
    assert not isinstance(make(LOCK), gymnasium.Wrapper)


def test_lengths_are_those_of_the_shape_with_the_most_corners() -> None:
    found = {env_id: dict(task.info_lengths) for env_id, task in task_definitions().items() if task.info_lengths}
    assert found == {
        PEG: {"peg_relative_z_mm": 8},
        "ViTac/PegInsertion2024-v1": {"peg_relative_z_mm": 8},
        "ViTac/FusionInsertion-v1": {"peg_relative_z_mm": 6},
        "ViTac/MovingHole-v1": {"peg_relative_z_mm": 8},
        "ViTac/Slip-v1": {"heights_mm": 6},
        "ViTac/SoftPlug-v1": {"heights_mm": 4},
        "ViTac/CableEnd-v1": {"heights_mm": 4},
    }
    assert replace(task_definitions()[LOCK], info_lengths={"x": 2}).info_lengths == {"x": 2}


def test_environment_can_be_made_again_from_its_specification() -> None:
    env = gymnasium.make(PEG, disable_env_checker=True, max_steps=3)
    assert env.spec is not None
    again: Any = gymnasium.make(env.spec, disable_env_checker=True)
    assert again.unwrapped.settings.max_steps == 3
    assert vitac.envs.ENVIRONMENTS[PEG].endswith(type(again.unwrapped).__name__)


def test_unknown_argument_is_refused_in_pythons_words_with_the_nearest() -> None:
    with pytest.raises(
        UnexpectedArgument, match=r"an unexpected keyword argument 'max_step'; did you mean 'max_steps'\?"
    ):
        gymnasium.make(PEG, max_step=3)
    with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'"):  # the words TorchRL looks for
        make(LOCK, frameskip=1)


def test_numeric_infos_have_entries_of_one_type() -> None:
    env = NumericInfos(make(PEG, max_steps=1))
    first, last = infos(env, {"shape": "cuboid"})
    assert {name: type(value) for name, value in first.items()} == {name: type(value) for name, value in last.items()}
    assert "step_reports" not in first
    assert first["end_reason"] == 0
    assert list(EndReason)[last["end_reason"] - 1] is EndReason.STEPS
