"""What the runtime says to a team, on its functions alone; tests/integration/sandbox runs it in the sandbox."""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
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
    return agent.list_available(error, submission, "polcy.main")


def test_nothing_is_imported_that_every_copy_of_a_policy_would_carry_in_vain() -> None:
    code = "import runpy, sys; runpy.run_path(sys.argv[1]); print(*sys.modules)"
    command = [sys.executable, "-I", "-S", "-c", code, str(agent.__file__)]
    imported = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    assert "json" in imported
    assert not {"importlib.metadata", "email", "zipfile", "random", "numpy"} & set(imported)


FILES = ". Files in the submission: models/weights.npz, policy.py"


@pytest.mark.parametrize("error", [FileNotFoundError(2, "gone", "weigths.npz"), ModuleNotFoundError(name="polcy")])
def test_wrong_file_name_lists_the_files(error: BaseException, submission: str) -> None:
    assert hint(error, submission) == f"{FILES}."


def test_many_files_are_counted(tmp_path: Path) -> None:
    for number in range(25):
        (tmp_path / f"{number:02}.npy").touch()
    text = hint(FileNotFoundError(), str(tmp_path))
    assert text.endswith("18.npy, 19.npy and 5 more.")


def test_missing_package_is_said_in_one_sentence_with_those_of_a_like_name(submission: str) -> None:
    text = hint(ModuleNotFoundError("No module named 'nunpy'", name="nunpy"), submission)
    said = r"\. None of the \d+ installed packages has it \(names like it: .*numpy.*\); `vitac sandbox` lists them\."
    assert re.fullmatch(re.escape(FILES) + said, text)
    assert len(text.removeprefix(FILES)) < 200


LOADED_ALONE = """
import runpy, sys
agent = runpy.run_path(sys.argv[1])
try:
    agent["load"]("policy:Policy", sys.argv[2])
except agent["Refused"] as refused:
    print(refused)
"""


@pytest.mark.parametrize("own_file", ["", "raise SystemExit"])
def test_packages_are_listed_though_a_file_has_the_name_of_a_module_of_pythons_own(
    submission: str, own_file: str
) -> None:
    Path(submission, "policy.py").write_text("import torhc")
    Path(submission, "email.py").write_text(own_file)
    command = [sys.executable, "-I", "-B", "-c", LOADED_ALONE, str(agent.__file__), submission]
    shown = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    assert "No module named 'torhc'. Files in the submission: email.py, models/weights.npz, policy.py." in shown
    assert "installed packages has it" in shown


@pytest.mark.parametrize("error", [RuntimeError(), ImportError(), PermissionError(), SystemExit()])
def test_other_errors_have_no_hint(error: BaseException, submission: str) -> None:
    assert hint(error, submission) == ""


@pytest.fixture
def refusal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[[str], tuple[str, str]]:
    """Load a policy of the given code, and return what is said of it and what it printed."""

    def load(code: str) -> tuple[str, str]:
        (tmp_path / "wrong_policy.py").write_text(code)
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr("sys.path", [*sys.path])
        monkeypatch.delitem(sys.modules, "wrong_policy", raising=False)
        with pytest.raises(agent.Refused) as caught:
            agent.load("wrong_policy:Policy", str(tmp_path))
        assert caught.value.code == "import_error"
        return caught.value.message, capsys.readouterr().err

    return load


@pytest.mark.parametrize(
    ("code", "told"),
    [
        ("from pathlib import Path\nclass Polcy: pass\nclass Arm: pass", "Classes there: Arm, Polcy."),
        ("from pathlib import Path", "Classes there: none."),
    ],
)
def test_a_wrong_name_of_the_class_lists_those_that_are_there(
    refusal: Callable[[str], tuple[str, str]], code: str, told: str
) -> None:
    message, output = refusal(code)
    missing = "module 'wrong_policy' has no attribute 'Policy'"
    assert message.endswith(f"{missing}. {told}")
    assert output == f"AttributeError: {missing}\n"


@pytest.mark.parametrize(
    ("code", "first", "last"),
    [
        ("import gone_for_good", ", line 1, in <module>", "No module named 'gone_for_good'\n"),
        ("x = (", "wrong_policy.py", "SyntaxError: '(' was never closed\n"),
    ],
)
def test_a_traceback_begins_with_the_policys_code(
    refusal: Callable[[str], tuple[str, str]], code: str, first: str, last: str
) -> None:
    _, output = refusal(code)
    lines = [line for line in output.splitlines() if not line.startswith("Traceback")]
    assert first in lines[0]
    assert code in lines[1]
    assert output.endswith(last)
    assert "agent.py" not in output
    assert "importlib" not in output


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
    assert agent.as_numbers(value).tolist() == np.asarray(value, np.float32).tolist()


@pytest.mark.parametrize(
    "value",
    [
        [True, False],
        np.zeros(3, bool),
        [1j],
        ["1"],
        [object()],
        "1 0",
        {"a": 1},
        None,
        np.ma.array(np.ones(3), mask=True),
    ],
)
def test_refuses_what_is_no_number(value: Any) -> None:
    with pytest.raises(agent.Refused) as caught:
        agent.as_numbers(value)
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
    assert agent.as_numbers(Tensor(np.ones(4, np.float32))).tolist() == [1.0, 1.0, 1.0, 1.0]
    assert agent.as_numbers(Tensor(np.ones((1, 4), np.float32))).shape == (1, 4)


@pytest.mark.parametrize("error", ["Can't call numpy() on Tensor that requires grad.", "can't convert cuda:0 tensor"])
def test_a_tensor_that_is_no_array_is_refused_with_torchs_reason(error: str) -> None:
    with pytest.raises(agent.Refused, match="NumPy cannot make an array of") as caught:
        agent.as_numbers(Tensor(np.ones(4), error))
    assert (caught.value.code, error in caught.value.message) == ("bad_action_type", True)


def test_real_tensors_are_taken_and_refused_alike() -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed: tensors were not tried")
    assert agent.as_numbers(torch.ones(4)).tolist() == [1.0, 1.0, 1.0, 1.0]
    assert agent.as_numbers(torch.ones(1, 4)).shape == (1, 4)
    with pytest.raises(agent.Refused, match="requires grad"):
        agent.as_numbers(torch.ones(4, requires_grad=True))
    with pytest.raises(agent.Refused, match="expected real numbers"):
        agent.as_numbers(torch.ones(4) > 0)


@pytest.mark.parametrize("code", sorted(agent.DTYPES))
def test_arrays_of_a_question_are_found_one_behind_the_other(code: str) -> None:
    first, empty = np.arange(6).reshape(2, 3), np.zeros((0, 4))
    last = np.array([1], dtype="<f4")
    payload = bytearray(first.astype(agent.DTYPES[code]).tobytes() + last.tobytes())
    specs = [
        {"name": "first", "dtype": code, "shape": [2, 3]},
        {"name": "empty", "dtype": "f8", "shape": list(empty.shape)},
        {"name": "last", "dtype": "f4", "shape": [1]},
    ]
    arrays = agent.decode_arrays(specs, payload)
    np.testing.assert_array_equal(arrays["first"], first.astype(agent.DTYPES[code]))
    assert arrays["empty"].shape == (0, 4)
    assert arrays["last"].tolist() == [1.0]
    assert arrays["first"].dtype == np.dtype(agent.DTYPES[code])
    arrays["first"][:] = 0
    assert payload[0] == 0, "the policy may write into its observation"


def test_a_number_of_a_question_has_no_axes() -> None:
    arrays = agent.decode_arrays(
        [{"name": "one", "dtype": "f8", "shape": []}], bytearray(np.array(2.5, dtype="<f8").tobytes())
    )
    assert arrays["one"].shape == ()
    assert float(arrays["one"]) == 2.5


@pytest.mark.parametrize("keep", [True, False])
def test_a_depth_picture_is_kept_for_those_that_read_it(monkeypatch: pytest.MonkeyPatch, keep: bool) -> None:
    monkeypatch.setattr(agent, "point_cloud", lambda: lambda depth, intrinsics: (depth, intrinsics))
    arrays: dict[str, Any] = {"depth": "picture", "other": 1}
    clouds = [
        {"name": "one", "depth": "depth", "intrinsics": [1.0, 2.0, 3.0, 4.0], "keep_depth": keep},
        {"name": "two", "depth": "depth", "intrinsics": [5.0, 6.0, 7.0, 8.0], "keep_depth": True},
    ]
    agent.add_clouds(clouds, arrays)
    assert arrays.pop("one") == ("picture", [1.0, 2.0, 3.0, 4.0])
    assert arrays.pop("two") == ("picture", [5.0, 6.0, 7.0, 8.0]), "made before the picture is taken out"
    assert arrays == ({"depth": "picture", "other": 1} if keep else {"other": 1})


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (MemoryError(), "out_of_memory"),
        (RuntimeError("can't start new thread"), "too_many_processes"),
        (BlockingIOError(11, "Resource temporarily unavailable"), "too_many_processes"),
        (ValueError("can't start new thread"), "crashed"),
        (RuntimeError("out of ideas"), "crashed"),
        (KeyboardInterrupt(), "crashed"),
    ],
)
def test_an_exception_that_tells_of_a_limit_has_its_own_verdict(error: BaseException, code: str) -> None:
    assert agent.verdict_code(error, "crashed") == code


def test_a_refusal_of_ours_passes_through_and_any_other_end_becomes_one(capsys: pytest.CaptureFixture[str]) -> None:
    def refuse() -> None:
        raise agent.Refused("bad_action_type", "own words")

    def leave() -> None:
        raise SystemExit(3)

    with pytest.raises(agent.Refused) as refused:
        agent.guarded("crashed", "act()", refuse)
    assert (refused.value.code, refused.value.message) == ("bad_action_type", "own words")
    assert capsys.readouterr().err == ""
    with pytest.raises(agent.Refused) as refused:
        agent.guarded("load_failed", "Policy()", leave)
    assert (refused.value.code, refused.value.message) == ("load_failed", "Policy() raised SystemExit: 3")
    assert "SystemExit: 3" in capsys.readouterr().err
    assert agent.guarded("crashed", "act()", lambda: 5) == 5


class Believer:
    def __init__(self, believed: Any) -> None:
        self._believed = believed

    def belief(self) -> Any:
        if isinstance(self._believed, Exception):
            raise self._believed
        return self._believed


def test_a_belief_is_numbers_or_nothing() -> None:
    assert agent.read_belief(object()) is None
    assert agent.read_belief(Believer(None)) is None
    assert agent.read_belief(Believer([1, 2.5, -3])).tolist() == [1.0, 2.5, -3.0]


def test_an_attribute_of_that_name_that_is_no_method_says_nothing() -> None:
    for attribute in (np.zeros(3), {"x": 1.0}, 0.5, "left"):
        assert agent.read_belief(SimpleNamespace(belief=attribute)) is None


def test_a_property_of_that_name_that_raises_is_refused_by_name() -> None:
    class Divides:
        @property
        def belief(self) -> float:
            return 1 / 0

    class Wants:
        def belief(self, observation: object) -> object:
            return observation

    for policy, message in (
        (Divides(), "belief() raised ZeroDivisionError: division by zero"),
        (Wants(), "missing 1 required positional argument: 'observation'"),
    ):
        with pytest.raises(agent.Refused) as refused:
            agent.read_belief(policy)
        assert refused.value.code == "crashed"
        assert message in refused.value.message


def test_a_refused_belief_is_answered_and_the_episode_goes_on() -> None:
    answers: list[tuple[str, dict[str, Any]]] = []
    connection = SimpleNamespace(write=lambda kind, **said: answers.append((kind, said)))
    for believed in (ValueError("unsure"), "left", None):
        agent.answer_belief(Believer(believed), connection)  # type: ignore[arg-type]
    assert answers == [
        ("failed", {"code": "crashed", "message": "belief() raised ValueError: unsure"}),
        (
            "failed",
            {"code": "bad_action_type", "message": "belief() returned str, expected an array of real numbers."},
        ),
        ("belief", {"numbers": None}),
    ]


@pytest.mark.parametrize(
    ("believed", "code", "message"),
    [
        ("left", "bad_action_type", "belief() returned str, expected an array of real numbers."),
        ([True, False], "bad_action_type", "belief() returned an array of dtype bool, expected real numbers."),
        (np.zeros(5000), "bad_action_shape", "belief() returned an array of shape (5000,), far larger than expected."),
        (ValueError("unsure"), "crashed", "belief() raised ValueError: unsure"),
    ],
)
def test_a_wrong_belief_is_refused_by_name(believed: Any, code: str, message: str) -> None:
    with pytest.raises(agent.Refused) as caught:
        agent.read_belief(Believer(believed))
    assert (caught.value.code, caught.value.message) == (code, message)


@pytest.mark.parametrize(
    ("kind", "text", "arrays", "method"), [("reset", "peg-insertion", {}, "reset"), ("observe", "", {"x": 1}, "act")]
)
def test_a_policy_without_a_method_is_refused_by_its_name(
    kind: str, text: str, arrays: dict[str, Any], method: str
) -> None:
    connection = SimpleNamespace(read=lambda: (kind, text, arrays))
    with pytest.raises(agent.Refused) as caught:
        agent.answer_episode(object(), connection)  # type: ignore[arg-type]
    assert caught.value.code == "crashed"
    assert caught.value.message == f"{method}() raised AttributeError: 'object' object has no attribute '{method}'"
