"""The adapter on a stand-in for ManiSkill, and on the real one where the extra is installed."""

import gc
import json
import subprocess
import sys
import weakref
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fake_pick_cube import FakePickCube, in_place_of_maniskill
from vitac.envs.maniskill import env as adapter
from vitac.envs.maniskill.abilities import abilities
from vitac.envs.maniskill.env import (
    ManiSkillEnv,
    ManiSkillFailed,
    ManiSkillMissing,
    compute_seed,
    flattened,
    parts_of_state,
    unbatched,
)
from vitac.envs.tasks.definition import UnknownObservationKey
from vitac.envs.tasks.settings import ResetOptionsError

PICK_CUBE = "ManiSkill/PickCube-v1"
START = {"shape": "drawn", "variant": (0.0,), "rng_seed": (5, 3)}
HOLD = np.zeros(7, np.float32)


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> FakePickCube:
    return in_place_of_maniskill(monkeypatch)


def pick_cube(**arguments: Any) -> ManiSkillEnv:
    return ManiSkillEnv(PICK_CUBE, **({"max_steps": 5} | arguments))


def test_every_reset_builds_the_scene_anew_with_a_seed_of_the_episode_alone(fake: FakePickCube) -> None:
    env = pick_cube()
    for number in (3, 4, 3):
        env.reset(options=START | {"rng_seed": (5, number)})
    (first, options), (second, _), (again, _) = fake.resets
    assert options == {"reconfigure": True}
    assert (first == again, first == second) == (True, False)
    assert (0 <= first < 2**31, 0 <= second < 2**31) == (True, True)


def test_seeds_of_published_lists_stay(fake: FakePickCube) -> None:
    options = START | {"rng_seed": (0, 1)}
    pick_cube().reset(options=options)
    assert fake.resets[0][0] == compute_seed(PICK_CUBE, options) == 1121323793


def test_observations_are_plain_arrays_without_the_batch_and_infos_plain_values(fake: FakePickCube) -> None:
    env = pick_cube()
    observation, info = env.reset(options=START)
    assert {key: (type(value), value.shape) for key, value in observation.items()} == {"state": (np.ndarray, (42,))}
    assert info == {"steps": 0, "elapsed_steps": 0, "end_reason": None}
    _, reward, terminated, truncated, info = env.step(HOLD)
    assert (reward, terminated, truncated) == (0.25, False, False)
    assert info["force"].tolist() == [1.0, 2.0]
    assert {key: value for key, value in info.items() if key != "force"} == {
        "steps": 1, "success": False, "fail": False, "end_reason": None,
    }  # fmt: skip


def test_success_the_last_env_step_and_failure_end_an_episode_in_this_order(fake: FakePickCube) -> None:
    def ends(**facts: bool) -> tuple[int, str, bool, bool]:
        fake.solves, fake.fails = facts.get("solves", False), facts.get("fails", False)
        env = pick_cube()
        env.reset(options=START)
        for step in range(1, 10):
            _, _, terminated, truncated, info = env.step(HOLD)
            if terminated or truncated:
                return step, info["end_reason"], terminated, truncated
        raise AssertionError("no end")

    assert ends(solves=True) == (3, "success", True, False)
    assert ends() == (5, "steps", False, True)
    assert ends(fails=True) == (1, "error", False, True)


def test_success_counts_in_the_last_env_step_too(fake: FakePickCube) -> None:
    fake.solves = True
    env = pick_cube(max_steps=3)
    env.reset(options=START)
    assert [env.step(HOLD)[4]["end_reason"] for _ in range(3)] == [None, None, "success"]


def test_the_track_names_what_counts_as_success(fake: FakePickCube) -> None:
    env = pick_cube(settings={"success_key": "fail"})
    fake.fails = True
    env.reset(options=START)
    assert env.step(HOLD)[4]["end_reason"] == "success"
    other = pick_cube(settings={"success_key": "solved"})
    other.reset(options=START)
    with pytest.raises(ManiSkillFailed, match="has no 'solved' in its info"):
        other.step(HOLD)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
@pytest.mark.parametrize("name", ["reward", "force"])
def test_numbers_that_are_not_finite_are_the_environments_failure(fake: FakePickCube, name: str, value: float) -> None:
    """Records cannot hold them, and finite actions have led there."""
    env = pick_cube()
    env.reset(options=START)
    env.step(HOLD)
    setattr(fake, name, value)
    with pytest.raises(ManiSkillFailed, match=rf"gave .*{value}.* as {name} at env step 2, expected finite numbers"):
        env.step(HOLD)


def test_actions_outside_the_box_are_clipped(fake: FakePickCube) -> None:
    env = pick_cube()
    env.reset(options=START)
    env.step(np.array([3, -3, 0.5, 0, 0, 0, 1], np.float32))
    assert fake.commands[0].tolist() == [1, -1, 0.5, 0, 0, 0, 1]


def test_the_state_hash_covers_state_and_env_step(fake: FakePickCube) -> None:
    env = pick_cube()
    hashes = []
    for action in (HOLD, HOLD + 0.5):
        env.reset(options=START)
        hashes.append(env.state_hash())
        env.step(action)
        hashes.append(env.state_hash())
    assert hashes[0] == hashes[2]
    assert len(set(hashes)) == 3
    assert env.picture_hash() is None


def test_provenance_names_versions_and_what_is_simulated(fake: FakePickCube) -> None:
    env = pick_cube()
    assert env.solver_version == "mani-skill-3.0.1+sapien-3.0.3+torch-2.13.0"
    other = pick_cube(settings={"control_mode": "pd_ee_target_delta_pose"})
    assert len({env.mesh_hash(), pick_cube().mesh_hash(), other.mesh_hash()}) == 2


def test_only_the_named_keys_are_returned_and_others_refused(fake: FakePickCube) -> None:
    assert pick_cube(observation_keys=()).reset(options=START)[0] == {}
    with pytest.raises(UnknownObservationKey, match=r"'depth'.* expected state"):
        pick_cube(observation_keys=("depth",))


def test_an_environment_that_is_not_the_catalogues_is_refused(fake: FakePickCube) -> None:
    fake.state_size = 43
    with pytest.raises(ManiSkillFailed, match=r"expected state as float32 \(42,\), got float32 \(43,\); install mani-"):
        pick_cube().reset(options=START)
    fake.single_action_space.shape = (8,)
    with pytest.raises(ManiSkillFailed, match="takes 8 numbers as an action, expected 7"):
        pick_cube()


def test_an_error_of_maniskill_is_named_as_the_environments_in_one_line(fake: FakePickCube) -> None:
    env = pick_cube()
    env.reset(options=START)
    env.step(HOLD)
    fake.raises = True
    with pytest.raises(ManiSkillFailed, match="PickCube-v1 failed in step at env step 1: ValueError: PhysX lost a jo"):
        env.step(HOLD)


def test_a_state_that_is_no_longer_finite_ends_the_episode_for_anybody(fake: FakePickCube) -> None:
    env = pick_cube()
    env.reset(options=START)
    fake.reward, fake.force = np.nan, np.nan
    fake.state = np.full(4, np.inf, np.float32)
    _, reward, terminated, truncated, info = env.step(HOLD)
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert info == {"steps": 1, "end_reason": "not_converged"}
    assert len(env.state_hash()) == 64


def test_an_unknown_option_is_refused(fake: FakePickCube) -> None:
    with pytest.raises(ResetOptionsError, match="has no reset option 'sede'"):
        pick_cube().reset(options={"sede": 1})
    with pytest.raises(ResetOptionsError, match="has no reset option 'sede'"):
        compute_seed(PICK_CUBE, {"sede": 1})


def test_without_the_packages_the_error_names_size_and_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(adapter, "missing_packages", lambda: ("mani-skill", "torch"))
    with pytest.raises(ManiSkillMissing) as missing:
        pick_cube()
    assert "need mani-skill, torch (extra maniskill, 3 GB)" in str(missing.value)
    assert "pip install 'mani-skill>=" in str(missing.value)


def test_physics_on_a_gpu_is_refused_where_torch_finds_none(monkeypatch: pytest.MonkeyPatch) -> None:
    torch = SimpleNamespace(set_num_threads=lambda count: None, __version__="2.13.0+cpu")
    for name, module in (("mani_skill", None), ("mani_skill.envs", SimpleNamespace()), ("torch", torch)):
        monkeypatch.setitem(sys.modules, name, module or SimpleNamespace())
    monkeypatch.setattr(adapter, "missing_packages", tuple)
    monkeypatch.setattr(adapter, "has_cuda", lambda: False)
    with pytest.raises(
        ManiSkillMissing, match=r"sim_backend physx_cuda needs an NVIDIA GPU .* torch 2\.13\.0\+cpu finds"
    ):
        pick_cube(settings={"sim_backend": "physx_cuda"})


def test_results_of_both_backends_have_provenances_of_their_own(fake: FakePickCube) -> None:
    hashes = {pick_cube(settings={"sim_backend": backend}).mesh_hash() for backend in ("physx_cpu", "physx_cuda")}
    assert len(hashes) == 2
    assert pick_cube().mesh_hash() in hashes


def test_pictures_without_a_driver_are_refused_with_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("mani_skill", "mani_skill.envs", "torch"):
        monkeypatch.setitem(sys.modules, name, SimpleNamespace(set_num_threads=lambda count: None))
    monkeypatch.setattr(adapter, "missing_packages", tuple)
    monkeypatch.setattr(adapter, "has_driver", lambda: False)
    with pytest.raises(ManiSkillMissing, match=r"obs_mode rgb is drawn by SAPIEN, which .* Mesa 24.3 or newer"):
        pick_cube(settings={"obs_mode": "rgb"})
    with pytest.raises(ManiSkillMissing, match=r"PushT-v1 with obs_mode state is drawn"):
        ManiSkillEnv("ManiSkill/PushT-v1", max_steps=5)
    with pytest.raises(ManiSkillMissing, match=r"A picture of ManiSkill/PickCube-v1 is drawn by SAPIEN, which finds n"):
        pick_cube(draws=True)


@pytest.fixture
def loaded_stand_ins(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Stands in for what `made` imports; each environment is a new one of the stand-in."""
    torch = SimpleNamespace(set_num_threads=lambda count: None, inference_mode=lambda: lambda method: method)
    gymnasium = SimpleNamespace(make=lambda name, **settings: SimpleNamespace(unwrapped=FakePickCube()))
    for name, module in (("torch", torch), ("gymnasium", gymnasium), ("mani_skill", None), ("mani_skill.envs", None)):
        monkeypatch.setitem(sys.modules, name, module or SimpleNamespace())
    monkeypatch.setattr(adapter, "missing_packages", tuple)
    monkeypatch.setattr(adapter, "has_driver", lambda: True)
    monkeypatch.setattr(adapter, "version", lambda package: "1")
    for name in adapter._SAME_ON_EVERY_CPU:  # set by `made`, and here as before again after the test
        monkeypatch.setenv(name, "1")
    adapter._keep_what_is_loaded.cache_clear()
    yield
    adapter._keep_what_is_loaded.cache_clear()


@pytest.mark.usefixtures("without_earlier_garbage", "loaded_stand_ins")
def test_environments_that_others_replace_are_freed() -> None:
    replaced = []
    for _ in range(3):
        env = pick_cube()
        env.reset(options=START)
        replaced.append(weakref.ref(env._env))
    gc.collect()
    assert [it() is None for it in replaced] == [True, True, False]


@pytest.mark.usefixtures("loaded_stand_ins")
def test_all_that_is_loaded_is_kept_from_collections_once_after_the_garbage_is_gone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    done: list[str] = []
    for name in ("collect", "freeze"):
        monkeypatch.setattr(gc, name, lambda name=name: done.append(name))
    for _ in range(2):
        pick_cube()
    assert done == ["collect", "freeze"]


def test_the_adapter_is_imported_without_maniskill() -> None:
    code = "import sys, vitac.envs.maniskill.env\nprint({'torch', 'sapien', 'mani_skill', 'numba'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


REAL = """
import json, sys, numpy as np
from vitac.envs.maniskill.env import ManiSkillEnv
env = ManiSkillEnv(sys.argv[1], max_steps=50)
found = {}
for number in json.loads(sys.argv[2]):
    env.reset(options={"rng_seed": (0, number)})
    random, hashes = np.random.default_rng(number), []
    for _ in range(8):
        env.step(random.uniform(-1, 1, 7).astype(np.float32))
        hashes.append(env.state_hash())
    found[number] = hashes
print(json.dumps(found))
"""


def really_played(env_id: str, numbers: list[int], **environment: str) -> dict[str, list[str]]:
    import os

    done = subprocess.run(
        [sys.executable, "-P", "-W", "ignore", "-c", REAL, env_id, json.dumps(numbers)],
        capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL, env=os.environ | environment,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    found: dict[str, list[str]] = json.loads(done.stdout.splitlines()[-1])
    return found


@pytest.mark.skipif(bool(adapter.missing_packages()), reason="the extra maniskill is not installed")
@pytest.mark.parametrize("name", ["PickCube-v1", "PegInsertionSide-v1"])
def test_states_repeat_in_other_processes_orders_threads_and_without_a_driver(name: str) -> None:
    env_id = f"ManiSkill/{name}"
    first = really_played(env_id, [1, 2])
    assert len({state for states in first.values() for state in states}) == 16
    assert really_played(env_id, [2, 1], OMP_NUM_THREADS="2", PYTHONHASHSEED="7") == first
    assert (
        really_played(env_id, [2], VK_DRIVER_FILES="/nonexistent", VK_ICD_FILENAMES="/nonexistent")["2"] == first["2"]
    )


@pytest.mark.skipif(bool(adapter.missing_packages()), reason="the extra maniskill is not installed")
def test_states_repeat_where_newer_vector_instructions_are_switched_off() -> None:
    generic = {
        "ATEN_CPU_CAPABILITY": "default",
        "MKL_ENABLE_INSTRUCTIONS": "SSE4_2",
        "OPENBLAS_CORETYPE": "Prescott",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-AVX512F,-FMA,-FMA4,-AVX",
    }
    assert really_played("ManiSkill/PickCube-v1", [1], **generic) == really_played("ManiSkill/PickCube-v1", [1])


@pytest.mark.skipif(not abilities().cuda, reason="no GPU that an installed torch can use: physx_cuda was not run")
def test_the_real_environment_is_played_on_a_gpu() -> None:
    env = pick_cube(settings={"sim_backend": "physx_cuda"})
    observation, _ = env.reset(options=START)
    assert {key: value.shape for key, value in observation.items()} == {"state": (42,)}
    _, reward, *_ = env.step(HOLD)
    assert (np.isfinite(reward), len(env.state_hash())) == (True, 64)


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
