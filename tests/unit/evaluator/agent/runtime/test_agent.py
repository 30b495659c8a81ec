"""What the runtime says to a team, on its functions alone; tests/integration/sandbox runs it in the sandbox."""

from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from vitac.evaluator.agent.runtime import agent


@pytest.fixture
def submission(tmp_path: Path) -> str:
    for name in ("policy.py", "models/weights.npz"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    return str(tmp_path)


def hint(error: BaseException, submission: str) -> str:
    return agent.what_is_there(error, submission, "polcy.main")


FILES = ". Files in the submission: models/weights.npz, policy.py"


@pytest.mark.parametrize("error", [FileNotFoundError(2, "gone", "weigths.npz"), ModuleNotFoundError(name="polcy")])
def test_wrong_file_name_lists_the_files(error: BaseException, submission: str) -> None:
    assert hint(error, submission) == f"{FILES}."


def test_many_files_are_counted(tmp_path: Path) -> None:
    for number in range(25):
        (tmp_path / f"{number:02}.npy").touch()
    text = hint(FileNotFoundError(), str(tmp_path))
    assert text.endswith("18.npy, 19.npy and 5 more.")


def test_missing_package_lists_what_is_installed(submission: str) -> None:
    text = hint(ModuleNotFoundError("No module named 'torch'", name="torch"), submission)
    assert text.startswith(f"{FILES}. Installed packages: ")
    assert f", numpy {version('numpy')}, " in text
    assert "vitac" not in text.removeprefix(FILES)


@pytest.mark.parametrize("error", [RuntimeError(), ImportError(), PermissionError(), SystemExit()])
def test_other_errors_have_no_hint(error: BaseException, submission: str) -> None:
    assert hint(error, submission) == ""


def test_hint_that_fails_leaves_the_error_named() -> None:
    with pytest.raises(agent.Refused, match=r"^Loading raised FileNotFoundError: gone$"):
        agent.guarded("load_failed", "Loading", raise_not_found, lambda error: str(1 / 0))


def test_message_has_a_longest_length() -> None:
    with pytest.raises(agent.Refused) as caught:
        agent.guarded("load_failed", "Loading", raise_not_found, lambda error: "x" * 5000)
    assert len(caught.value.message) == agent.MESSAGE_MAX_CHARS


def raise_not_found() -> None:
    raise FileNotFoundError("gone")


@pytest.mark.parametrize(
    "value", [[1, 0, -1], (1.0, 0.0, -1.0), [1, 0.0, False], *(np.ones(3, dtype) for dtype in ("f2", "f8", "i1", "u8"))]
)
def test_accepts_every_kind_of_real_numbers(value: Any) -> None:
    assert agent.as_action(value).tolist() == np.asarray(value, np.float32).tolist()


@pytest.mark.parametrize("value", [[True, False], np.zeros(3, bool), [1j], ["1"], [object()], "1 0", {"a": 1}, None])
def test_refuses_what_is_no_number(value: Any) -> None:
    with pytest.raises(agent.Refused) as caught:
        agent.as_action(value)
    assert caught.value.code == "bad_action_type"


class Tensor:
    """What NumPy sees of a tensor of torch: an array, or an error where it is on a GPU or needs its gradient."""

    def __init__(self, values: Any, error: str = "") -> None:
        self._values, self._error = np.asarray(values), error

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        if self._error:
            raise RuntimeError(self._error)
        return self._values


def test_a_tensor_counts_as_the_array_that_it_holds_and_its_batch_is_left_to_be_refused() -> None:
    assert agent.as_action(Tensor(np.ones(4, np.float32))).tolist() == [1.0, 1.0, 1.0, 1.0]
    assert agent.as_action(Tensor(np.ones((1, 4), np.float32))).shape == (1, 4)


@pytest.mark.parametrize("error", ["Can't call numpy() on Tensor that requires grad.", "can't convert cuda:0 tensor"])
def test_a_tensor_that_is_no_array_is_refused_with_torchs_reason(error: str) -> None:
    with pytest.raises(agent.Refused, match="NumPy cannot make an array of") as caught:
        agent.as_action(Tensor(np.ones(4), error))
    assert (caught.value.code, error in caught.value.message) == ("bad_action_type", True)


def test_real_tensors_are_taken_and_refused_alike() -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed: tensors were not tried")
    assert agent.as_action(torch.ones(4)).tolist() == [1.0, 1.0, 1.0, 1.0]
    assert agent.as_action(torch.ones(1, 4)).shape == (1, 4)
    with pytest.raises(agent.Refused, match="requires grad"):
        agent.as_action(torch.ones(4, requires_grad=True))
    with pytest.raises(agent.Refused, match="expected real numbers"):
        agent.as_action(torch.ones(4) > 0)
