"""A training that was stopped ends with the same bits as one that was not, and a damaged or full disk is told."""

import json
from collections.abc import Callable
from dataclasses import replace
from fcntl import LOCK_EX, flock
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch, of which the challenge's networks are made, is not installed")
pytest.importorskip("stable_baselines3", reason="Stable-Baselines3, which has TD3, is not installed")

from toy_touch import ToyTouch  # noqa: E402
from vitac.training.files import FileDamaged, NotSaved, load, save  # noqa: E402
from vitac.training.learning.network import TrainingDiverged  # noqa: E402
from vitac.training.reference import method  # noqa: E402
from vitac.training.reference.hyperparameters import HYPERPARAMETERS  # noqa: E402
from vitac.training.reference.policy import read_state  # noqa: E402
from vitac.training.reference.state import NumberedStarts  # noqa: E402
from vitac.training.run import OtherRun  # noqa: E402
from vitac.training.streams import Use, stream  # noqa: E402

TASK = "peg-insertion"
CHOSEN = replace(
    HYPERPARAMETERS[TASK],
    learning_starts=8,
    batch_size=2,
    buffer_size=16,
    checkpoint_env_steps=10,
    evaluation_episodes=2,
    log_interval=2,
)
ENV_STEPS = 44

Step = Callable[[ToyTouch, Any], Any]


class Killed(BaseException):
    """The process ends here."""


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(method, "HYPERPARAMETERS", {TASK: CHOSEN})
    monkeypatch.setattr(method, "_environment", lambda chosen: ToyTouch(chosen.truths, 3))


def train(folder: Path, env_steps: int = ENV_STEPS) -> list[str]:
    """Train, and return what was told."""
    told: list[str] = []
    method.train_reference(TASK, folder, env_steps=env_steps, tell=told.append)
    return told


def stopped_after(env_steps: int, monkeypatch: pytest.MonkeyPatch, folder: Path, error: BaseException) -> None:
    """Train until so many env steps of any environment, and raise."""
    real, left = ToyTouch.step, [env_steps]

    def step(env: ToyTouch, action: Any) -> Any:
        left[0] -= 1
        if left[0] < 0:
            raise error
        return real(env, action)

    with monkeypatch.context() as patched:
        patched.setattr(ToyTouch, "step", step)
        with pytest.raises(type(error)):
            train(folder)


def log_of(folder: Path) -> list[str]:
    """Return the log without its times and losses, whose means begin again."""
    lines = [line.split(",") for line in (folder / "progress.csv").read_text().splitlines()]
    kept = [number for number, key in enumerate(lines[0]) if key.startswith(("rollout", "eval", "time/total"))]
    return sorted(",".join([*(line[number] for number in kept)]) for line in lines)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training that was never stopped."""
    folder = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(method, "HYPERPARAMETERS", {TASK: CHOSEN})
        patched.setattr(method, "_environment", lambda chosen: ToyTouch(chosen.truths, 3))
        told = train(folder)
    assert len(told) >= 3
    assert told[-1].startswith("4")
    assert told[-1].partition(" env steps")[0].endswith(f"of {ENV_STEPS}")
    return folder


def test_stopped_training_ends_with_the_same_bits(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for env_steps in (3, 37, 14):  # before anything is kept, with a full replay buffer, and once more
        stopped_after(env_steps, monkeypatch, tmp_path, Killed())
    (tmp_path / "checkpoints" / f".{TASK}_10_steps.zip.999999999.new").write_bytes(b"half")
    train(tmp_path)
    found, expected = (read_state(folder / f"{TASK}.zip") for folder in (tmp_path, whole))
    assert found.keys() == expected.keys()
    assert all(torch.equal(found[name], expected[name]) for name in expected)
    assert log_of(tmp_path) == log_of(whole)
    evaluations = [dict(np.load(folder / "evaluations.npz")) for folder in (tmp_path, whole)]
    for name, values in evaluations[1].items():
        np.testing.assert_array_equal(evaluations[0][name], values)
    names = [sorted(path.name for path in (folder / "checkpoints").iterdir()) for folder in (tmp_path, whole)]
    assert names[0] == names[1] == [f"{TASK}_{number}_steps.zip" for number in (10, 20, 30, 40)]
    states = [load(folder / "state.npz") for folder in (tmp_path, whole)]
    for name in states[1].keys() - {"told", "networks"}:
        np.testing.assert_array_equal(states[0][name], states[1][name], err_msg=name)


def test_time_of_all_processes_is_counted(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stopped_after(30, monkeypatch, tmp_path, Killed())
    path = tmp_path / "state.npz"
    arrays = load(path)
    told = json.loads(str(arrays["told"]))
    assert told["cpu_s"] > 0
    told["cpu_s"], told["elapsed_ns"] = 500.0, int(700e9)
    save(path, {**arrays, "told": np.array(json.dumps(told))})
    train(tmp_path)
    header, *_, last = ((tmp_path / "progress.csv").read_text()).splitlines()
    row = dict(zip(header.split(","), last.split(","), strict=True))
    assert 500 < float(row["time/cpu_s"]) < 600
    assert 700 <= float(row["time/time_elapsed"]) < 800


def test_other_training_or_version_is_refused(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = {path: path.stat().st_mtime_ns for path in whole.rglob("*")}
    with pytest.raises(OtherRun, match="holds a run of another recipe or version; give another folder"):
        method.train_reference(TASK, whole, env_steps=ENV_STEPS, seed=1)
    monkeypatch.setattr(method, "version", lambda name: f"another {name}")
    with pytest.raises(OtherRun):
        train(whole)
    assert {path: path.stat().st_mtime_ns for path in whole.rglob("*")} == before


def test_fewer_env_steps_than_a_training_has_are_refused_before_its_result_is_lost(whole: Path) -> None:
    before = {path: path.read_bytes() for path in whole.rglob("*") if path.is_file()}
    with pytest.raises(
        OtherRun, match=r"holds a training of 4\d env steps, expected at most 30; ask for more, or give"
    ):
        train(whole, env_steps=30)
    assert {path: path.read_bytes() for path in whole.rglob("*") if path.is_file()} == before


def test_second_process_in_the_same_folder_is_refused(whole: Path) -> None:
    log = (whole / "progress.csv").read_bytes()
    with (whole / ".lock").open("rb") as file:
        flock(file, LOCK_EX)
        with pytest.raises(OtherRun, match=r"Another process trains in .*; wait for it, or give another folder"):
            train(whole)
    assert (whole / "progress.csv").read_bytes() == log


def test_a_damaged_state_is_told_with_what_is_lost(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stopped_after(30, monkeypatch, tmp_path, Killed())
    (tmp_path / "state.npz").write_bytes(b"damaged")
    told = r"state.npz cannot be read .*; delete it and run it again\. The training then begins at 0 env steps"
    with pytest.raises(FileDamaged, match=told):
        train(tmp_path)
    assert (tmp_path / "checkpoints" / f"{TASK}_10_steps.zip").exists()
    (tmp_path / "state.npz").unlink()
    train(tmp_path)
    assert log_of(tmp_path) == log_of(whole), "as if it had never been stopped"


def test_log_of_another_program_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "progress.csv").write_text("a\n1\n")
    with pytest.raises(OtherRun, match=r"holds a training but no run\.json that says of which recipe"):
        train(tmp_path)
    assert (tmp_path / "progress.csv").read_text() == "a\n1\n"


def test_damaged_state_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stopped_after(20, monkeypatch, tmp_path, Killed())
    path = tmp_path / "state.npz"
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(FileDamaged, match=r"state\.npz cannot be read"):
        train(tmp_path)


def test_full_disk_and_a_loss_that_is_no_number_keep_the_last_state(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stopped_after(20, monkeypatch, tmp_path, Killed())
    kept = (tmp_path / "state.npz").read_bytes()
    with monkeypatch.context() as patched:
        full = OSError(28, "No space left on device")
        patched.setattr("vitac.training.files.np.savez", lambda *_, **__: (_ for _ in ()).throw(full))
        with pytest.raises(NotSaved, match=r"cannot be written \(No space left on device\); free some space"):
            train(tmp_path)
    with monkeypatch.context() as patched:
        patched.setattr(ToyTouch, "step", lambda env, _: (env._observed(), float("nan"), True, False, {}))
        with pytest.raises(TrainingDiverged, match="The loss of the critic is nan"):
            train(tmp_path)
    assert (tmp_path / "state.npz").read_bytes() == kept
    train(tmp_path)
    assert read_state(tmp_path / f"{TASK}.zip").keys() == read_state(whole / f"{TASK}.zip").keys()


def test_starts_are_those_of_the_stream_whatever_is_asked() -> None:
    env = ToyTouch((), 3)
    few = NumberedStarts(env, stream(4, Use.CHOOSE), count=3)
    for _ in range(4):
        few.reset(seed=9, options={"rng_seed": (1, 2)})
    assert few.is_at_start
    few.step(np.zeros(3))
    assert not few.is_at_start
    assert env.starts == [{"rng_seed": (stream(4, Use.CHOOSE), number)} for number in (0, 1, 2, 0)]
    all_of_them = NumberedStarts(env, stream(4, Use.COLLECT))
    for _ in range(5):
        all_of_them.reset()
    assert env.starts[-1] == {"rng_seed": (stream(4, Use.COLLECT), 4)}
