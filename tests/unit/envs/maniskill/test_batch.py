"""Several scenes in one simulation, on a stand-in for ManiSkill; one scene, and a GPU, where the extra is installed."""

import threading
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_scenes import FakeScenes, Rows, in_place_of_the_gpu
from PIL import Image
from vitac.envs.maniskill.abilities import abilities
from vitac.envs.maniskill.batch import HEIGHT, WIDTH, Batch, NothingDrawn, Player, _fetched, _row, file_name, write
from vitac.envs.maniskill.definition import catalogue
from vitac.envs.maniskill.env import ManiSkillEnv, ManiSkillFailed, ManiSkillMissing, missing_packages

pytestmark = pytest.mark.filterwarnings("ignore:__array_wrap__ must accept:DeprecationWarning")  # ManiSkill's own

PICK_CUBE = "ManiSkill/PickCube-v1"
MAX_STEPS = 5
Played = list[tuple[int, list[str], list[float], str]]
"""Of each episode: its number, its state hashes, its rewards and its end."""


@pytest.fixture
def simulations(monkeypatch: pytest.MonkeyPatch) -> list[FakeScenes]:
    return in_place_of_the_gpu(monkeypatch)


def made(size: int) -> Batch:
    settings = {"sim_backend": "physx_cuda", "batch_size": size}
    return Batch(PICK_CUBE, max_steps=MAX_STEPS, settings=settings)


def actions_of(number: int) -> np.ndarray:
    """Actions of an episode that is solved at its third env step if its number is odd, and never if it is even."""
    actions = np.random.default_rng(number).uniform(-0.9, 0.9, (MAX_STEPS, 7)).astype(np.float32)
    if number % 2:
        actions[2, 0] = 1
    return actions


def play(numbers: Sequence[int], env: ManiSkillEnv) -> Played:
    played = []
    for number in numbers:
        _, info = env.reset(options={"rng_seed": (0, number)})
        hashes, rewards, actions = [env.state_hash()], [], iter(actions_of(number))
        while info["end_reason"] is None:
            _, reward, _, _, info = env.step(next(actions))
            hashes.append(env.state_hash())
            rewards.append(reward)
        played.append((number, hashes, rewards, info["end_reason"]))
    return played


def together(batch: Batch, *parts: Sequence[int]) -> list[Played]:
    return batch.play([partial(play, part) for part in parts])


def test_an_episode_is_the_same_in_every_scene_and_beside_any_others(simulations: list[FakeScenes]) -> None:
    (alone,) = together(made(2), [1, 2, 3, 4, 5])
    assert [end for *_, end in alone] == ["success", "steps", "success", "steps", "success"]
    assert [len(hashes) for _, hashes, _, _ in alone] == [4, 6, 4, 6, 4]
    assert len({hashes[0] for _, hashes, _, _ in alone}) == 5
    assert [rewards for _, _, rewards, _ in alone] == [
        pytest.approx(actions_of(number)[: len(rewards), 1]) for number, _, rewards, _ in alone
    ]
    parts = together(made(3), [4, 1], [3], [2, 5])
    assert sorted(episode for part in parts for episode in part) == alone
    assert [[number for number, *_ in part] for part in parts] == [[4, 1], [3], [2, 5]]


def test_all_that_play_move_in_one_env_step_and_those_that_are_over_rest(simulations: list[FakeScenes]) -> None:
    together(made(3), [2, 1], [1, 3])
    (simulation,) = simulations
    assert len(simulation.built) == 2, "both episodes of a scene start together with those of the others"
    first, second = simulation.built
    assert (first[2], second[2], len(set(first))) == (first[0], second[0], 2)
    assert len(simulation.commands) == 5 + 3
    moving = [[bool(row.any()) for row in command] for command in simulation.commands]
    assert moving == 3 * [[True, True, False]] + 2 * [[True, False, False]] + 3 * [[True, True, False]]


def test_the_simulation_runs_in_the_thread_of_its_caller_alone(
    simulations: list[FakeScenes], monkeypatch: pytest.MonkeyPatch
) -> None:
    threads = set()
    real = FakeScenes.step

    def step(self: FakeScenes, actions: np.ndarray) -> Any:
        threads.add(threading.get_ident())
        return real(self, actions)

    monkeypatch.setattr(FakeScenes, "step", step)
    together(made(2), [1], [2])
    assert threads == {threading.get_ident()}


def test_each_environment_has_its_part_of_the_cpu_time(simulations: list[FakeScenes]) -> None:
    batch = made(3)
    together(batch, [2], [1])
    longer, shorter, idle = (env.physics_cpu_s for env in batch.environments)
    assert longer > shorter > idle == 0


def test_an_error_of_the_simulation_fails_every_episode_that_plays_and_a_batch_can_go_on(
    simulations: list[FakeScenes],
) -> None:
    batch, failed = made(2), []

    def noted(numbers: Sequence[int], env: ManiSkillEnv) -> Played:
        try:
            return play(numbers, env)
        except ManiSkillFailed as error:
            failed.append(str(error))
            raise

    simulations[0].raises_at = 4
    with pytest.raises(ManiSkillFailed, match="failed in step at env step 4: ValueError: PhysX lost the GPU"):
        batch.play([partial(noted, [2]), partial(noted, [1])])
    assert len(failed) == 1, "the other episode was over before"
    simulations[0].raises_at = len(simulations[0].commands)
    with pytest.raises(ManiSkillFailed):
        batch.play([partial(noted, [2]), partial(noted, [1])])
    assert len(failed) == 3
    simulations[0].raises_at = None
    assert together(batch, [2], [1]) == [*together(made(1), [2]), *together(made(1), [1])]


def test_a_player_that_fails_keeps_none_of_the_others_from_their_end(simulations: list[FakeScenes]) -> None:
    ended = []

    def fails(when: Callable[[ManiSkillEnv], object], env: ManiSkillEnv) -> None:
        when(env)
        raise KeyError("sandbox")

    def ends(env: ManiSkillEnv) -> None:
        ended.extend(play([2, 3], env))

    for when in (lambda env: None, lambda env: env.reset(options={}), lambda env: play([1], env)):
        players: list[Player[None]] = [partial(fails, when), ends]
        with pytest.raises(KeyError, match="sandbox"):
            made(3).play(players)
    assert len(ended) == 6


def no_third_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Has the machine no thread left after two."""
    real, started = threading.Thread.start, []

    def start(self: threading.Thread) -> None:
        started.append(self)
        if len(started) == 3:
            raise RuntimeError("can't start new thread")
        real(self)

    monkeypatch.setattr(threading.Thread, "start", start)


def ctrl_c(monkeypatch: pytest.MonkeyPatch) -> None:
    """Has Ctrl-C come while an env step is simulated; no signal, which a process in the background may ignore."""

    def step(self: FakeScenes, actions: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(FakeScenes, "step", step)


@pytest.mark.parametrize(
    ("happens", "error"), [(no_third_thread, RuntimeError), (ctrl_c, KeyboardInterrupt)], ids=["no thread", "Ctrl-C"]
)
def test_whatever_ends_the_simulation_ends_all_that_play_and_is_told(
    simulations: list[FakeScenes],
    monkeypatch: pytest.MonkeyPatch,
    happens: Callable[[pytest.MonkeyPatch], None],
    error: type[BaseException],
) -> None:
    batch = made(3)
    with monkeypatch.context() as patch:
        happens(patch)
        with pytest.raises(error):
            together(batch, [1], [2], [3])
    assert [thread.name for thread in threading.enumerate() if "ThreadPoolExecutor" in thread.name] == []
    assert together(batch, [2], [1]) == [*together(made(1), [2]), *together(made(1), [1])], "it can go on"


def test_a_scene_whose_state_is_lost_ends_its_own_episode_alone(simulations: list[FakeScenes]) -> None:
    batch = made(2)
    simulations[0].lost_scene = 1
    (lost,), (kept,) = batch.play([partial(play, [2]), partial(play, [2])])[::-1]
    assert (lost[3], len(lost[1])) == ("not_converged", 2)
    assert (kept[3], len(kept[1])) == ("steps", 6)


def test_results_of_another_batch_size_have_a_provenance_of_their_own(simulations: list[FakeScenes]) -> None:
    hashes = {env.mesh_hash() for size in (1, 2, 3) for env in made(size).environments}
    assert len(hashes) == 3


def test_only_the_keys_that_are_read_are_returned(simulations: list[FakeScenes]) -> None:
    settings = {"sim_backend": "physx_cuda", "batch_size": 2}
    batch = Batch(PICK_CUBE, max_steps=5, observation_keys=(), settings=settings)
    assert batch.play([lambda env: env.reset(options={})[0]]) == [{}]


def test_rows_are_taken_of_every_leaf_that_has_them() -> None:
    class OnGpu:
        def cpu(self) -> Rows:
            return Rows([[1.0, 2.0], [3.0, 4.0]])

    values = _fetched(({"camera": {"rgb": OnGpu()}}, OnGpu(), {"reconfigure": True}))
    observation, reward, info = _row(values, 1)
    for leaf in (observation["camera"]["rgb"], reward):
        assert leaf.numpy().tolist() == [[3.0, 4.0]]
    assert info == {"reconfigure": True}


@pytest.mark.skipif(bool(missing_packages()), reason="the extra maniskill is not installed")
def test_a_batch_of_one_real_scene_on_the_cpu_plays_what_is_played_alone() -> None:
    """Here the real ManiSkill starts a scene alone, as it has to where there are several, and gives the same bits."""
    batch = Batch(PICK_CUBE, max_steps=MAX_STEPS)
    assert together(batch, [1, 2]) == [play([1, 2], ManiSkillEnv(PICK_CUBE, max_steps=MAX_STEPS))]


@pytest.mark.skipif(bool(missing_packages()), reason="the extra maniskill is not installed")
def test_a_batch_without_a_gpu_is_refused_by_name() -> None:
    if abilities().cuda:
        pytest.skip("there is a GPU")
    with pytest.raises(ManiSkillMissing, match="PickCube-v1 with sim_backend physx_cuda needs an NVIDIA GPU"):
        made(2)


@pytest.mark.skipif(not abilities().cuda, reason="no GPU that an installed torch can use: no batch was played on one")
def test_two_real_scenes_on_a_gpu_start_as_each_does_alone() -> None:
    """Starts are drawn, not simulated, so they agree; states after env steps need not."""

    def start(number: int, env: ManiSkillEnv) -> np.ndarray:
        observation, _ = env.reset(options={"rng_seed": (0, number)})
        env.step(np.zeros(7, np.float32))
        return observation["state"]

    numbers = (1, 2)
    both = made(2).play([partial(start, number) for number in numbers])
    alone = ManiSkillEnv(PICK_CUBE, max_steps=MAX_STEPS, settings={"sim_backend": "physx_cuda"})
    assert np.allclose(both, [start(number, alone) for number in numbers], atol=1e-5)
    assert not np.allclose(both[0], both[1], atol=1e-2)


def test_a_picture_is_cut_to_the_size_of_all(tmp_path: Path) -> None:
    drawn = np.zeros((512, 512, 3), np.uint8)
    drawn[200:300] = 255
    write(drawn, tmp_path / "scene.jpg")
    with Image.open(tmp_path / "scene.jpg") as image:
        assert image.size == (WIDTH, HEIGHT)
        assert np.asarray(image)[:, :, 0].max() > 200


@pytest.mark.parametrize("value", [0, 128, 255])
def test_a_placeholder_is_refused_and_not_written(tmp_path: Path, value: int) -> None:
    with pytest.raises(NothingDrawn, match=r"has a contrast of 0\.0, expected at least 8"):
        write(np.full((64, 64, 3), value, np.uint8), tmp_path / "scene.jpg")
    assert list(tmp_path.iterdir()) == []


def test_every_environment_that_can_be_a_task_has_a_small_picture_that_shows_something(repository: Path) -> None:
    shipped = sorted((repository / "web" / "static").glob("scene-*.jpg"))
    assert {path.name for path in shipped} == {file_name(env_id) for env_id in catalogue().environments}
    for path in shipped:
        assert path.stat().st_size < 60_000
        with Image.open(path) as image:
            assert image.size == (WIDTH, HEIGHT)
            assert np.asarray(image.convert("L")).std() > 8
