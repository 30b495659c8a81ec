"""The challenge's method: networks and gradient steps, and a training that ends in a submission, also if stopped."""

import json
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import replace
from fcntl import LOCK_EX, flock
from pathlib import Path
from runpy import run_path
from typing import Any

import gymnasium
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch, of which the challenge's networks are made, is not installed")
stable_baselines3 = pytest.importorskip(
    "stable_baselines3", reason="Stable-Baselines3, which has TD3, is not installed"
)

from stable_baselines3.common.logger import configure  # noqa: E402
from toy_touch import ToyTouch  # noqa: E402
from vitac.envs.tasks.settings import Fidelity  # noqa: E402
from vitac.evaluator.submission.manifest import load_manifest  # noqa: E402
from vitac.evaluator.tracks import find_task  # noqa: E402
from vitac.training.files import FileDamaged, NotSaved, load, save  # noqa: E402
from vitac.training.folder_lock import FolderInUse  # noqa: E402
from vitac.training.learning.network import TrainingDiverged  # noqa: E402
from vitac.training.log import Charts  # noqa: E402
from vitac.training.reference import td3  # noqa: E402
from vitac.training.reference.policy import PointNet, read_state  # noqa: E402
from vitac.training.reference.td3 import (  # noqa: E402
    CLOUDS_AT_ONCE,
    HYPERPARAMETERS,
    CachedPointNet,
    TrainingDeviceMissing,
    UnknownReferenceTask,
    gradient_step,
    make_env,
    new_model,
    train_reference,
)
from vitac.training.run import OtherRun  # noqa: E402
from vitac.training.sensor import SensorMismatch  # noqa: E402
from vitac.training.streams import StreamRefused, Use, stream  # noqa: E402


@pytest.mark.parametrize(
    ("task", "env_steps", "buffer_size", "policy_delay", "checkpoint_env_steps", "truths"),
    [
        ("peg-insertion", 400_000, 10_000, 5, 2000, ("gt_offset",)),
        ("lock-opening", 80_000, 10_000, 2, 2000, ("key1", "key2")),
        ("fusion-insertion", 100_000, 5000, 2, 5000, ("gt_offset", "relative_motion", "gt_direction")),
        ("sensor-design", 200_000, 20_000, 5, 2000, ("gt_offset",)),
    ],
)
def test_what_differs_by_task(
    task: str, env_steps: int, buffer_size: int, policy_delay: int, checkpoint_env_steps: int, truths: tuple[str, ...]
) -> None:
    found = HYPERPARAMETERS[task]
    assert (found.env_steps, found.buffer_size, found.policy_delay) == (env_steps, buffer_size, policy_delay)
    assert (found.checkpoint_env_steps, found.truths) == (checkpoint_env_steps, truths)
    track, definition = find_task(task)
    assert (found.track, found.env_id) == (track.name, definition.env_id)


@pytest.mark.parametrize("task", HYPERPARAMETERS)
def test_what_all_tasks_share(task: str) -> None:
    found = HYPERPARAMETERS[task]
    assert (found.learning_starts, found.batch_size) == (1000, 128)
    assert (found.learning_rate, found.discount, found.tau) == (3e-4, 0.99, 0.005)
    assert (found.target_noise, found.target_noise_clip, found.action_noise) == (0.5, 1.0, 0.5)
    assert (found.env_steps_per_training, found.log_interval, found.seed) == (2, 10, 0)


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


BATCH = 20


def both_encoders() -> tuple[Any, Any]:
    torch.manual_seed(0)
    plain, cached = PointNet(4, 32), CachedPointNet(4, 32)
    cached.load_state_dict(plain.state_dict())
    return plain, cached


@pytest.mark.parametrize("sets", [1, CLOUDS_AT_ONCE + 1])
def test_encoder_computes_the_numbers_and_gradients_of_the_plain_one(sets: int) -> None:
    plain, cached = both_encoders()
    points = torch.randn(sets, 2, 128, 4)
    with torch.no_grad():
        assert cached(points[:0]).shape == (0, 2, 32)
        torch.testing.assert_close(cached(points), plain(points), rtol=1e-4, atol=1e-5)
    own = points.clone().requires_grad_()
    theirs = points.clone().requires_grad_()
    weights = torch.randn(sets, 2, 32)
    (cached(own) * weights).sum().backward()
    (plain(theirs) * weights).sum().backward()
    torch.testing.assert_close(own.grad, theirs.grad, rtol=1e-3, atol=1e-5)
    for found, expected in zip(cached.parameters(), plain.parameters(), strict=True):
        torch.testing.assert_close(found.grad, expected.grad, rtol=1e-3, atol=1e-4 * float(expected.grad.abs().max()))


def test_gradient_of_equal_points_is_counted_once_as_in_the_plain_encoder() -> None:
    plain, cached = both_encoders()
    points = torch.randn(1, 1, 1, 4).expand(1, 1, 5, 4)
    found, expected = points.clone().requires_grad_(), points.clone().requires_grad_()
    cached(found).sum().backward()
    plain(expected).sum().backward()
    torch.testing.assert_close(found.grad.sum(dim=-2), expected.grad.sum(dim=-2), rtol=1e-3, atol=1e-6)


def model_with_transitions() -> Any:
    chosen = replace(HYPERPARAMETERS["peg-insertion"], batch_size=BATCH, buffer_size=60)
    env = ToyTouch(chosen.truths, 3)
    model = new_model("peg-insertion", chosen, env)
    model.set_logger(configure(None, []))
    random = np.random.default_rng(0)
    for number in range(40):
        seen = {key: box.sample()[None] / 1e3 for key, box in env.observation_space.spaces.items()}  # type: ignore[attr-defined]
        after = {key: value + 0.1 for key, value in seen.items()}
        action = random.uniform(-1, 1, (1, 3))
        model.replay_buffer.add(seen, after, action, np.array([-1.0]), np.array([number % 4 == 0]), [{}])
    return model


Train = Callable[[Any, int], dict[str, float]]


def train_plainly(model: Any, steps: int) -> dict[str, float]:
    stable_baselines3.TD3.train(model, steps, BATCH)
    return {name: model.logger.name_to_value[f"train/{name}"] for name in ("critic_loss", "actor_loss")}


def take_gradient_steps(model: Any, steps: int) -> dict[str, float]:
    chosen = replace(HYPERPARAMETERS["peg-insertion"], batch_size=BATCH)
    losses = [gradient_step(model, chosen, number) for number in range(1, steps + 1)]
    return {name: float(np.mean([each[name] for each in losses if name in each])) for name in losses[-1]}


def trained(model: Any, train: Train, steps: int) -> tuple[Any, dict[str, float]]:
    """Return a copy after gradient steps with the same random numbers, and the mean losses."""
    copy = deepcopy(model)
    np.random.seed(3)  # noqa: NPY002 - Stable-Baselines3 draws from it
    torch.manual_seed(3)
    return copy, train(copy, steps)


def test_gradient_steps_are_those_of_stable_baselines3() -> None:
    model = model_with_transitions()
    found, losses = trained(model, take_gradient_steps, 5)
    expected, plain_losses = trained(model, train_plainly, 5)
    before = model.policy.state_dict()
    changed = 0
    for name, value in expected.policy.state_dict().items():
        torch.testing.assert_close(found.policy.state_dict()[name], value, rtol=1e-3, atol=2e-5, msg=name)
        changed += not torch.equal(value, before[name])
    assert changed > 60
    assert losses == pytest.approx(plain_losses, rel=1e-3)
    assert all(parameter.requires_grad for parameter in found.critic.parameters())


def test_loss_that_is_no_number_stops_before_anything_is_changed() -> None:
    model = model_with_transitions()
    model.replay_buffer.rewards[:] = np.nan
    before = deepcopy(model.policy.state_dict())
    with pytest.raises(
        TrainingDiverged, match="The loss of the critic is nan in gradient step 1; expected a finite number"
    ):
        take_gradient_steps(model, 1)
    for name, value in model.policy.state_dict().items():
        assert torch.equal(value, before[name]), name


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


@pytest.mark.parametrize(
    ("task", "actions", "folder"),
    [("peg-insertion", 3, "Track_1"), ("fusion-insertion", 4, "Track_2"), ("sensor-design", 3, "Track_3")],
)
def test_training_ends_in_a_submission_that_plays(
    task: str, actions: int, folder: str, repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen = replace(HYPERPARAMETERS[task], **QUICK)  # type: ignore[arg-type]
    env = ToyTouch(chosen.truths, actions)
    monkeypatch.setattr(td3, "HYPERPARAMETERS", {task: chosen})
    monkeypatch.setattr(td3, "make_env", lambda *_: ToyTouch(chosen.truths, actions))
    sensor = repository / "examples" / "track_3_dome" / "Track_3" if folder == "Track_3" else None
    submission = train_reference(task, tmp_path / "run", env_steps=12, sensor=sensor) / folder
    assert load_manifest(submission).tasks == (task,)
    assert (submission / "gel.stl").exists() == (sensor is not None)
    assert (tmp_path / "run" / "checkpoints" / f"{task}_5_steps.zip").exists()
    with (tmp_path / "run" / "progress.csv").open() as file:
        assert "eval/mean_reward" in next(file)
    with np.load(tmp_path / "run" / "evaluations.npz") as evaluations:
        assert evaluations["timesteps"].tolist() == [5, 10]
        assert evaluations["results"].shape == (2, 3)
    policy = run_path(str(submission / "policy.py"))["Policy"]()
    policy.reset(task)
    action = policy.act(env.reset()[0])
    assert action.shape == (actions,)
    assert np.abs(action).max() <= 1.0


@pytest.mark.parametrize(("task", "sensor"), [("sensor-design", None), ("peg-insertion", Path("sensor"))])
def test_sensor_is_for_the_task_that_has_one(
    task: str, sensor: Path | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(td3, "HYPERPARAMETERS", {task: HYPERPARAMETERS[task]})
    with pytest.raises(SensorMismatch, match=f"Expected .* for {task}"):
        train_reference(task, tmp_path / "run", sensor=sensor)
    assert not (tmp_path / "run").exists()


def test_actor_and_critics_of_fusion_see_what_is_published() -> None:
    chosen = HYPERPARAMETERS["fusion-insertion"]
    env = make_env("fusion-insertion", chosen, None)
    model = new_model("fusion-insertion", replace(chosen, buffer_size=1), env)
    assert {"marker_flow", "object_point_cloud"} <= set(env.observation_space.spaces)
    assert model.critic.q_networks[0][0].in_features == 9 + 4
    assert env.unwrapped.settings.insertion_depth_mm == 2.0


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
    monkeypatch.setattr(td3, "HYPERPARAMETERS", {TASK: CHOSEN})
    monkeypatch.setattr(td3, "make_env", lambda *_: ToyTouch(CHOSEN.truths, 3))


def train(folder: Path, env_steps: int = ENV_STEPS) -> list[str]:
    """Train, and return the lines about the progress."""
    lines: list[str] = []
    train_reference(TASK, folder, env_steps=env_steps, tell=lines.append)
    return lines


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
        patched.setattr(td3, "HYPERPARAMETERS", {TASK: CHOSEN})
        patched.setattr(td3, "make_env", lambda *_: ToyTouch(CHOSEN.truths, 3))
        lines = train(folder)
    assert len(lines) >= 3
    assert lines[-1].startswith("4")
    assert lines[-1].partition(" env steps")[0].endswith(f"of {ENV_STEPS}")
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
    for name in states[1].keys() - {"state", "networks"}:
        np.testing.assert_array_equal(states[0][name], states[1][name], err_msg=name)


def test_time_of_all_processes_is_counted(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stopped_after(30, monkeypatch, tmp_path, Killed())
    path = tmp_path / "state.npz"
    arrays = load(path)
    state = json.loads(str(arrays["state"]))
    assert state["history"]["cpu_s"] > 0
    state["history"] |= {"cpu_s": 500.0, "elapsed_s": 700.0}
    save(path, {**arrays, "state": np.array(json.dumps(state))})
    train(tmp_path)
    header, *_, last = ((tmp_path / "progress.csv").read_text()).splitlines()
    row = dict(zip(header.split(","), last.split(","), strict=True))
    assert 500 < float(row["time/cpu_s"]) < 600
    assert 700 <= float(row["time/time_elapsed"]) < 800


def times_of_changes(folder: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.name != ".lock"}


def test_other_training_or_version_is_refused(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = times_of_changes(whole)
    with pytest.raises(OtherRun, match="holds a run of another recipe; give another folder"):
        train_reference(TASK, whole, env_steps=ENV_STEPS, seed=1)
    monkeypatch.setattr(td3, "version", lambda name: f"another {name}")
    with pytest.raises(OtherRun):
        train(whole)
    assert times_of_changes(whole) == before


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
        with pytest.raises(FolderInUse, match="wait for it, end it, or give another folder"):
            train(whole)
    assert (whole / "progress.csv").read_bytes() == log


def test_a_damaged_state_is_named_with_what_is_lost(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stopped_after(30, monkeypatch, tmp_path, Killed())
    (tmp_path / "state.npz").write_bytes(b"damaged")
    problem = r"state.npz cannot be read .*; delete it and run it again\. The training then begins at 0 env steps"
    with pytest.raises(FileDamaged, match=problem):
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


def test_full_disk_and_a_loss_that_is_no_number_keep_the_last_state(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stopped_after(20, monkeypatch, tmp_path, Killed())
    kept = (tmp_path / "state.npz").read_bytes()
    with monkeypatch.context() as patched:
        full = OSError(28, "No space left on device")
        patched.setattr("vitac.training.files.os.fsync", lambda _: (_ for _ in ()).throw(full))
        with pytest.raises(NotSaved, match=r"cannot be written \(No space left on device\); free some space"):
            train(tmp_path)
    with monkeypatch.context() as patched:
        patched.setattr(
            ToyTouch, "step", lambda env, _: (env._observed(), float("nan"), True, False, {"is_success": False})
        )
        with pytest.raises(TrainingDiverged, match="The loss of the critic is nan"):
            train(tmp_path)
    assert (tmp_path / "state.npz").read_bytes() == kept
    train(tmp_path)
    assert read_state(tmp_path / f"{TASK}.zip").keys() == read_state(whole / f"{TASK}.zip").keys()


def test_unknown_task_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnknownReferenceTask, match="The task is 'chess', expected one of peg-insertion"):
        train_reference("chess", tmp_path)


@pytest.mark.parametrize("device", ["cuda:77", "abacus"])
def test_a_missing_device_is_refused_before_a_folder_is_made(device: str, tmp_path: Path) -> None:
    with pytest.raises(TrainingDeviceMissing, match=f"torch cannot use the device '{device}' here: expected cpu"):
        train_reference(TASK, tmp_path / "run", device=device)
    assert not (tmp_path / "run").exists()


def test_only_the_episodes_that_are_learned_from_are_played_at_the_chosen_fidelity(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[str] = []
    monkeypatch.setattr(td3, "make_env", make_env)

    def make(*_: Any, fidelity: str, **__: Any) -> ToyTouch:
        made.append(fidelity)
        return ToyTouch((), 3)

    monkeypatch.setattr(gymnasium, "make", make)
    monkeypatch.setattr(td3, "new_model", lambda *_: None)
    chosen = replace(CHOSEN, fidelity=Fidelity.TRAINING)
    td3.Training(TASK, chosen, None, tmp_path, Charts(tmp_path, print), print)
    assert made == ["training", "full"]


@pytest.mark.skipif(not torch.cuda.is_available(), reason="torch finds no GPU here")
def test_the_gradient_step_on_a_gpu_equals_that_on_the_cpu_within_rounding(tmp_path: Path) -> None:
    losses = []
    for device in ("cpu", "cuda"):
        chosen = replace(CHOSEN, device=device)
        torch.manual_seed(0)
        training = td3.Training(TASK, chosen, None, tmp_path / device, Charts(tmp_path, print), print)
        training.learn(CHOSEN.learning_starts)
        losses.append([gradient_step(training.model, chosen, number) for number in (1, 2)])
    assert losses[1] == [pytest.approx(step, rel=1e-3) for step in losses[0]]


def test_nothing_is_written_for_a_seed_whose_stream_an_official_list_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("vitac.training.streams.FIRST_STREAM", 0)
    for seed, refusal in ((0, "Seed 0 is that of the official list of"), (-1, "The seed is -1")):
        with pytest.raises(StreamRefused, match=refusal):
            train_reference(TASK, tmp_path / "run", seed=seed)
    assert not (tmp_path / "run").exists()


def test_episodes_are_learned_from_in_the_order_of_their_numbers_and_each_evaluation_has_the_same_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[ToyTouch] = []

    def make_env(*_: Any) -> ToyTouch:
        made.append(ToyTouch(CHOSEN.truths, 3))
        return made[-1]

    monkeypatch.setattr(td3, "make_env", make_env)
    train(tmp_path, 24)
    learned, held_out = ([start["rng_seed"] for start in env.starts if start] for env in made)
    assert learned == [(stream(0, Use.COLLECT), number) for number in range(len(learned))]
    assert held_out == [(stream(0, Use.CHOOSE), number) for number in (0, 1, 0, 1)]
