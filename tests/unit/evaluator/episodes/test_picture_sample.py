import hashlib

from vitac.evaluator.episodes.records import SampledPicture
from vitac.evaluator.episodes.traces import PictureSample
from vitac.evaluator.tracks import Episode


class Scene:
    """Goes through given states; counts the pictures that are taken."""

    def __init__(self, states: list[str], cameras: bool = True) -> None:
        self.states, self.cameras, self.now, self.taken = states, cameras, 0, 0

    def state_hash(self) -> str:
        return self.states[self.now]

    def picture_hash(self) -> str | None:
        self.taken += 1
        return hashlib.sha256(f"picture of {self.now}".encode()).hexdigest() if self.cameras else None


def states(count: int, name: str = "") -> list[str]:
    return [hashlib.sha256(f"{name}{number}".encode()).hexdigest() for number in range(count)]


def episode(number: int = 1, list_seed: int = 0) -> Episode:
    return Episode(number=number, shape="cuboid", offset=(1.0,), offset_option="offset", list_seed=list_seed)


def sampled(scene: Scene, of: Episode) -> SampledPicture | None:
    sample = PictureSample(scene, of)
    for step, state in enumerate(scene.states):
        scene.now = step
        assert sample.look(step) == state
    return sample.picture


def test_the_env_step_is_that_of_the_smallest_ticket_as_the_manual_says() -> None:
    scene, of = Scene(states(30)), episode(7, list_seed=3)
    tickets = [hashlib.sha256(f"3 7 {state}".encode()).hexdigest() for state in scene.states]
    expected = tickets.index(min(tickets))
    picture = hashlib.sha256(f"picture of {expected}".encode()).hexdigest()
    assert sampled(scene, of) == SampledPicture(env_step=expected, sha256=picture)


def test_every_env_step_may_be_sampled_and_which_one_changes_with_episode_list_and_states() -> None:
    def step_of(number: int = 1, list_seed: int = 0, name: str = "") -> int:
        found = sampled(Scene(states(5, name)), episode(number, list_seed))
        assert found is not None
        return found.env_step

    assert {step_of(number) for number in range(1, 60)} == set(range(5))
    assert {step_of(list_seed=seed) for seed in range(60)} == set(range(5))
    assert {step_of(name=f"{other} ") for other in range(60)} == set(range(5))


def test_few_pictures_are_taken_while_the_episode_runs() -> None:
    taken = []
    for number in range(1, 101):
        scene = Scene(states(26, f"{number} "))
        sampled(scene, episode(number))
        taken.append(scene.taken)
    assert 3.0 < sum(taken) / len(taken) < 5.0  # 1 + 1/2 + ... + 1/26 = 3.85
    assert max(taken) < 12


def test_a_task_without_cameras_has_no_sample() -> None:
    assert sampled(Scene(states(4), cameras=False), episode()) is None


def test_the_state_after_the_reset_may_be_the_only_one() -> None:
    found = sampled(Scene(states(1)), episode())
    assert found is not None
    assert found.env_step == 0
