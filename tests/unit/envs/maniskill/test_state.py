from typing import Any

import numpy as np
from vitac.envs.maniskill.state import flattened, parts_of_state, unbatched


class Tensor:
    """What a torch tensor offers of itself here."""

    def __init__(self, values: Any) -> None:
        self._values = np.asarray(values)

    def cpu(self) -> "Tensor":
        return self

    def numpy(self) -> np.ndarray:
        return self._values


OBSERVATION = {
    "agent": {"qpos": Tensor(np.arange(9.0).reshape(1, 9)), "qvel": np.zeros((1, 9))},
    "extra": {"is_grasped": Tensor([True]), "pose": Tensor(np.ones((1, 2, 3), np.float32))},
    "sensor_param": {"hand": {"intrinsic": Tensor(np.eye(3)[None])}},
    "sensor_data": {"hand": {"rgb": Tensor(np.zeros((1, 4, 5, 3), np.uint8))}},
}


def test_leaves_are_named_by_their_path_without_the_words_that_say_nothing() -> None:
    assert {key: value.shape for key, value in flattened(OBSERVATION).items()} == {
        "agent_qpos": (9,), "agent_qvel": (9,), "extra_is_grasped": (1,), "extra_pose": (2, 3),
        "hand_intrinsic": (3, 3), "hand_rgb": (4, 5, 3),
    }  # fmt: skip


def test_truth_values_become_numbers_which_the_channel_carries() -> None:
    grasped = unbatched(Tensor([True]))
    assert (str(grasped.dtype), grasped.tolist()) == ("uint8", [1])


def test_what_is_sent_is_not_the_simulations_own_memory() -> None:
    values = np.zeros((1, 3), np.float32)
    sent = unbatched(Tensor(values))
    values[:] = 7.0
    assert sent.tolist() == [0.0, 0.0, 0.0]


def test_parts_of_the_state_are_counted_in_numbers() -> None:
    assert parts_of_state({"agent": OBSERVATION["agent"], "extra": OBSERVATION["extra"]}) == [
        ("agent_qpos", 9), ("agent_qvel", 9), ("extra_is_grasped", 1), ("extra_pose", 6),
    ]  # fmt: skip
