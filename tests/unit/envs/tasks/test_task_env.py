"""What the base adds to every task: parts that are composed from outside."""

import hashlib
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from fake_scene import FakeScene
from vitac.envs.observable import Observable
from vitac.envs.tactile.gel import GelCells, structured_gel
from vitac.envs.tasks.definition import UnknownObservationKey
from vitac.envs.tasks.fusion_insertion.env import FusionInsertionEnv
from vitac.envs.tasks.lock_opening.env import LockOpeningEnv
from vitac.envs.tasks.peg_insertion.env import PegInsertionEnv
from vitac.envs.vision.observables import RGB_IMAGES

START = {"shape": "cuboid", "offset_mm_deg": (1.0, 0.0, 0.0), "rng_seed": (0, 1)}


class TopCamera:
    """Sees the height of the held part as a picture of one pixel, and counts how often it is asked."""

    def __init__(self) -> None:
        self.pictures = 0
        self.observables: tuple[Observable[Any], ...] = (
            Observable(
                name="top_picture",
                shape=(1, 1, 3),
                dtype="uint8",
                unit="mm",
                meaning="Height of the held part, three times.",
                read=lambda scene, _: self._picture(scene),
            ),
        )

    def _picture(self, scene: Any) -> np.ndarray:
        self.pictures += 1
        top_m = scene.grasped.held_vertices_m(np.arange(4))[:, 2].max()
        return np.full((1, 1, 3), round(top_m * 1e3))


def test_a_camera_is_added_without_touching_the_task() -> None:
    camera = TopCamera()
    env = PegInsertionEnv(observables=camera.observables)
    observation, _ = env.reset(options=START)
    assert list(observation) == ["relative_motion", "marker_flow", "top_picture"]
    assert observation["top_picture"].dtype == np.uint8
    assert observation["top_picture"].tolist() == [[[20, 20, 20]]]
    assert observation in env.observation_space
    env.step(np.zeros(3, dtype=np.float32))
    assert camera.pictures == 2


def test_an_added_observable_changes_nothing_of_the_others() -> None:
    plain, _ = PegInsertionEnv().reset(options=START)
    seen, _ = PegInsertionEnv(observables=TopCamera().observables).reset(options=START)
    assert all(np.array_equal(plain[key], seen[key]) for key in plain)


def test_another_gel_is_added_without_touching_the_task(physics: list[FakeScene]) -> None:
    gel = structured_gel(name="coarse", cells=GelCells(x=4, y=4))
    env = PegInsertionEnv(gel=gel)
    env.reset(options=START)
    assert [body.mesh for body in physics[0].gels] == [gel, gel]
    assert env.mesh_hash() != PegInsertionEnv().mesh_hash()


@pytest.mark.parametrize("env_type", [PegInsertionEnv, LockOpeningEnv, FusionInsertionEnv])
def test_tactile_pictures_are_added_to_any_task_with_dots_on_the_markers_of_the_flow(env_type: Any) -> None:
    env = env_type(observables=(RGB_IMAGES,), observation_keys=("marker_flow",))
    observation, _ = env.reset(options={"rng_seed": (0, 1)})
    pictures, flow = observation["rgb_images"], observation["marker_flow"]
    assert observation in env.observation_space
    assert (pictures.shape, pictures.dtype) == ((2, 240, 320, 3), np.uint8)
    for picture, markers in zip(pictures, flow[:, 1], strict=True):
        u, v = np.floor(markers).astype(int).T
        inside = (u >= 0) & (u < 320) & (v >= 0) & (v < 240)
        assert (picture[v[inside], u[inside]] < 8).all()  # black but for noise


@pytest.mark.parametrize("env_type", [PegInsertionEnv, LockOpeningEnv, FusionInsertionEnv])
def test_tactile_pictures_are_optional_in_every_task_by_name(env_type: Any) -> None:
    options = {"rng_seed": (0, 1)}
    named = env_type(optional_observables=("rgb_images",), observation_keys=("rgb_images",))
    observation, _ = named.reset(options=options)
    assert list(observation) == ["rgb_images"]
    assert observation in named.observation_space
    given, _ = env_type(observables=(RGB_IMAGES,), observation_keys=()).reset(options=options)
    np.testing.assert_array_equal(observation["rgb_images"], given["rgb_images"])
    with pytest.raises(UnknownObservationKey, match="no observation key 'rgb'; expected rgb_images"):
        env_type(optional_observables=("rgb",))


def test_noise_of_tactile_pictures_follows_from_the_seed_and_differs_between_sensors_and_moments() -> None:
    """The scene of these tests does not move, so that noise and dots are all that differs."""

    def pictures(seed: int) -> list[np.ndarray]:
        env = PegInsertionEnv(observables=(RGB_IMAGES,), observation_keys=())
        seen = [env.reset(options=START | {"rng_seed": (0, seed)})[0]]
        return [each["rgb_images"] for each in (*seen, env.step(np.zeros(3, dtype=np.float32))[0])]

    first, again, other = pictures(1), pictures(1), pictures(2)
    np.testing.assert_array_equal(first, again)
    corner = [picture[0, :4, 300:].astype(int) for picture in (*first, other[0])]  # beyond the dots
    assert all((one != two).any() for one, two in combinations(corner, 2))
    assert max(np.abs(one - two).max() for one, two in combinations(corner, 2)) < 16


def test_tactile_pictures_change_no_markers() -> None:
    seen = PegInsertionEnv(observables=(RGB_IMAGES,))
    plain = PegInsertionEnv()
    for env in (seen, plain):
        env.reset(options=START)
    one, other = (env.step(np.zeros(3, dtype=np.float32))[0] for env in (seen, plain))
    np.testing.assert_array_equal(one["marker_flow"], other["marker_flow"])


def test_tactile_pictures_without_the_flow_are_the_same() -> None:
    alone = PegInsertionEnv(observables=(RGB_IMAGES,), observation_keys=())
    both = PegInsertionEnv(observables=(RGB_IMAGES,), observation_keys=("marker_flow",))
    one, other = (env.reset(options=START)[0]["rgb_images"] for env in (alone, both))
    np.testing.assert_array_equal(one, other)


def fusion(keys: tuple[str, ...] | None = None, **settings: Any) -> FusionInsertionEnv:
    env = FusionInsertionEnv(observation_keys=keys, **settings)
    env.reset(options={"start": (2.0, -4.0, 6.0, 5.0, 1), "rng_seed": (0, 1)})
    return env


def test_pictures_have_the_same_hash_whatever_is_observed_and_however_often_they_are_asked_for() -> None:
    """With noise: it follows from the episode and the env step alone, so verification finds it without a policy."""
    hashes = set()
    for keys in (None, (), ("marker_flow",), ("depth_picture",)):
        env = fusion(keys)
        env.step(np.full(4, 0.25, np.float32))
        hashes |= {env.picture_hash(), env.picture_hash()}
    assert len(hashes) == 1


def test_the_hash_of_the_pictures_is_over_colours_and_depth() -> None:
    env = fusion(depth_mode="gt")
    observation, *_ = env.step(np.zeros(4, np.float32))
    digest = hashlib.sha256()
    for key, shape in (("rgb_picture", "uint8 (480, 640, 3)"), ("depth_picture", "float32 (480, 640)")):
        digest.update(f"{key} {shape}\n".encode() + observation[key].tobytes())
    assert env.picture_hash() == digest.hexdigest()


def test_the_hash_of_the_pictures_changes_with_the_scene_and_with_the_depth_mode() -> None:
    hashes = []
    for mode in ("gt", "stereo"):
        env = fusion((), depth_mode=mode)
        hashes.append(env.picture_hash())
        env.step(np.ones(4, np.float32))
        hashes.append(env.picture_hash())
    assert len(set(hashes)) == 4


def test_asking_for_the_hash_of_the_pictures_changes_no_later_observation() -> None:
    asked, left = fusion(), fusion()
    asked.picture_hash()
    one, other = (env.step(np.zeros(4, np.float32))[0] for env in (asked, left))
    assert all(np.array_equal(one[key], other[key]) for key in one)


@pytest.mark.parametrize("env_type", [PegInsertionEnv, LockOpeningEnv])
def test_a_task_without_cameras_has_no_hash_of_pictures(env_type: Any) -> None:
    env = env_type()
    env.reset(options={"rng_seed": (0, 1)})
    assert env.picture_hash() is None


def test_surfaces_have_as_many_nodes_as_the_gel() -> None:
    for gel, nodes in ((None, 49), (structured_gel(name="coarse", cells=GelCells(x=4, y=4)), 25)):
        env = PegInsertionEnv(gel=gel, privileged=True, observation_keys=("surface_pts",))
        observation, _ = env.reset(options=START)
        assert observation["surface_pts"].shape == (2, 2, nodes, 3)
        assert observation in env.observation_space


@pytest.mark.parametrize("env_type", [PegInsertionEnv, LockOpeningEnv, FusionInsertionEnv])
def test_each_truth_can_be_selected_alone(env_type: Any) -> None:
    for key in ("shape", "measured_pose", "surface_pts"):
        env = env_type(privileged=True, observation_keys=(key, "relative_motion"))
        observation, _ = env.reset(options={"rng_seed": (0, 1)})
        assert sorted(observation) == sorted((key, "relative_motion"))
        assert observation in env.observation_space


@pytest.mark.parametrize("env_type", [PegInsertionEnv, LockOpeningEnv, FusionInsertionEnv])
def test_shape_is_told_as_its_number(env_type: Any) -> None:
    env = env_type(privileged=True, observation_keys=("shape",))
    numbers = [
        env.reset(options={"shape": str(shape), "rng_seed": 1})[0]["shape"].tolist() for shape in env_type.shape_type
    ]
    assert numbers == [[float(number)] for number in range(len(env_type.shape_type))]


@pytest.mark.parametrize("env_type", [PegInsertionEnv, LockOpeningEnv, FusionInsertionEnv])
def test_only_shapes_that_were_asked_for_are_drawn(env_type: Any) -> None:
    wanted = str(list(env_type.shape_type)[-1])
    env = env_type(shapes=(wanted,), observation_keys=())
    for number in range(6):
        env.reset(options={"rng_seed": (0, number)})
        assert env.task_scene.shape == wanted


def test_truths_change_no_markers() -> None:
    plain, _ = PegInsertionEnv().reset(options=START)
    seen, _ = PegInsertionEnv(privileged=True).reset(options=START)
    np.testing.assert_array_equal(plain["marker_flow"], seen["marker_flow"])


SENSORS = ("joint_width", "wrist_wrench", "taxel_forces")


@pytest.mark.parametrize("env_type", [PegInsertionEnv, LockOpeningEnv, FusionInsertionEnv])
def test_further_sensors_are_optional_in_every_task_and_stand_in_its_info(env_type: Any) -> None:
    env = env_type(optional_observables=SENSORS)
    env.reset(options={"rng_seed": (0, 1)})
    observation, *_, info = env.step(np.zeros(len(env.task.actions), dtype=np.float32))
    assert observation in env.observation_space
    for name in SENSORS:
        assert name in observation
        np.testing.assert_array_equal(observation[name], info[name])
        for curve in next(entry for entry in env.plotted_observables if entry.name == name).curves:
            assert len(curve.read(info[name])) == len(curve.names)


def test_what_is_not_asked_for_is_in_no_info() -> None:
    env = PegInsertionEnv()
    _, info = env.reset(options=START)
    assert not set(SENSORS) & set(info)


def test_readings_have_the_same_noise_whatever_is_observed_and_another_at_every_moment_and_seed() -> None:
    def readings(seed: int, keys: tuple[str, ...] | None) -> list[dict[str, Any]]:
        env = PegInsertionEnv(optional_observables=SENSORS, observation_keys=keys)
        infos = [env.reset(options=START | {"rng_seed": (0, seed)})[1]]
        infos.append(env.step(np.zeros(3, dtype=np.float32))[-1])
        return [{name: info[name] for name in SENSORS} for info in infos]

    seen, alone, other = readings(1, None), readings(1, ("joint_width",)), readings(2, None)
    for name in SENSORS:
        np.testing.assert_array_equal([each[name] for each in seen], [each[name] for each in alone])
    for name in ("wrist_wrench", "taxel_forces"):
        different = [seen[0][name], seen[1][name], other[0][name]]
        assert all((one != two).any() for one, two in combinations(different, 2))


def test_further_sensors_change_no_markers() -> None:
    plain, seen = PegInsertionEnv(), PegInsertionEnv(optional_observables=SENSORS)
    for env in (plain, seen):
        env.reset(options=START)
    one, other = (env.step(np.zeros(3, dtype=np.float32))[0] for env in (plain, seen))
    np.testing.assert_array_equal(one["marker_flow"], other["marker_flow"])


def test_sensors_read_what_acts_with_the_noise_that_they_say(monkeypatch: pytest.MonkeyPatch) -> None:
    """The stand-in pushes 5 N on both gels, and 3 N up on the left one."""
    monkeypatch.setattr(FakeScene, "part_force_n", 3.0)
    env = PegInsertionEnv(optional_observables=SENSORS)
    env.reset(options=START)
    infos = [env.step(np.zeros(3, dtype=np.float32))[-1] for _ in range(40)]
    wrenches = np.array([info["wrist_wrench"] for info in infos])
    np.testing.assert_allclose(wrenches[:, :3].mean(axis=0), [0.0, 0.0, 3.0], atol=0.06)
    np.testing.assert_allclose(wrenches.std(axis=0), np.repeat([0.1, 0.005], 3), rtol=0.4)
    taxels = np.array([info["taxel_forces"] for info in infos])
    np.testing.assert_allclose(taxels.std(axis=0).mean(), 0.02, rtol=0.1)
    # The left gel looks along -y with its u upwards, the right one along +y.
    np.testing.assert_allclose(taxels.mean(axis=0).sum(axis=(1, 2)), [[3.0, 0.0, 5.0], [0.0, 0.0, 5.0]], atol=0.05)


def test_the_joint_width_is_that_of_the_gripper_in_the_steps_of_its_encoder() -> None:
    env = PegInsertionEnv(optional_observables=("joint_width",))
    observation, _ = env.reset(options=START)
    counts = observation["joint_width"][0] / (50.0 / 255.0)
    assert counts == pytest.approx(round(counts), abs=1e-4)
    assert observation["joint_width"][0] == pytest.approx(1e3 * env.scene.gripper_width_m, abs=25.0 / 255.0 + 1e-5)
