"""Fixed parts with a motion: they push, drag, and see the world move past them."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from vitac.envs.assets import Meshes
from vitac.envs.fem.model.mesh import GelBody, RigidBody
from vitac.envs.fem.scene.layout import SceneError
from vitac.envs.fem.scene.scene import Scene
from vitac.envs.geometry.solid import prism_faces, rectangle, solid_from_faces
from vitac.envs.scene.grasped_scene import Clocks, GraspedScene, PhysicsSettings, Stopwatch, fixed_at_origin
from vitac.envs.scene.gripper import UPRIGHT_MOUNTS, Gripper, GripperPose
from vitac.envs.tactile.markers import MarkerSettings
from vitac.envs.tasks.moving_hole.env import MovingHoleEnv

FloatArray = NDArray[np.float64]
AGAINST_EACH_OTHER_MM = -0.3 * np.array([np.cos(np.radians(30.0)), np.sin(np.radians(30.0))])


def block(x_mm: float, z_mm: float, **options: Any) -> RigidBody:
    mesh = solid_from_faces(prism_faces(rectangle(-5.0, 5.0, -5.0, 5.0), -5.0, 5.0), "block")
    return RigidBody(mesh=mesh, rotation=np.eye(3), translation_m=np.array([x_mm, 0.0, z_mm]) * 1e-3, **options)


def along_x(time_s: float) -> FloatArray:
    return np.array([4e-3 * time_s, 0.0, 0.0])


def test_a_part_with_a_motion_pushes_a_loose_one_before_it() -> None:
    meshes = Meshes()
    pose = GripperPose(x_m=0.0, y_m=0.0, z_m=0.3, angle_rad=0.0, half_opening_m=20e-3)
    scene = GraspedScene(
        gripper=Gripper(mounts=UPRIGHT_MOUNTS, gel=meshes.gel(), pose=pose),
        held=block(0.0, 300.0),
        fixed=fixed_at_origin(block(0.0, 0.0).mesh, friction=0.5),
        others=(block(-30.0, 0.0, fixed=True, motion=along_x), block(-19.5, 0.0)),
        physics=PhysicsSettings(),
        sensors=meshes.sensors(MarkerSettings()),
        clocks=Clocks(physics=Stopwatch(), markers=Stopwatch()),
    )
    pusher, loose = scene.other_vertices_m(0), scene.other_vertices_m(1)
    scene.move_to(pose, ipc_steps=5)
    assert scene.solved
    assert scene.other_vertices_m(0) - pusher == pytest.approx(np.broadcast_to(along_x(0.5), (8, 3)))
    pushed_mm = 1e3 * (scene.other_vertices_m(1) - loose)
    assert pushed_mm[:, 0].min() > 2.0 - 0.5
    assert np.abs(pushed_mm[:, 1:]).max() < 0.02
    assert (scene.fixed_shift_m() == 0.0).all()


def played(*, speed_mm_s: float, action: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    """Where the peg is from the plate, and the forces on it, after each of three env steps."""
    env = MovingHoleEnv(plate_speed_mm_s=speed_mm_s)
    path = {"plate_motion": "constant", "plate_direction_deg": 30.0, "plate_start_s": 0.4}
    env.reset(options={"rng_seed": (1, 1), "shape": "trapezoid", "offset_mm_deg": (3.0, -2.0, 0.0), **path})
    after = []
    for _ in range(3):
        env.step(action.astype(np.float32))
        scene = env.scene
        assert scene.solved
        after.append((scene.held_vertices_m(np.arange(8)) - scene.fixed_shift_m(), scene.contact_forces_n()))
    return after


def test_a_plate_that_moves_is_as_a_gripper_that_moves_the_other_way() -> None:
    own = np.append(AGAINST_EACH_OTHER_MM / 2.0, 0.0)  # of an action
    moved, still = played(speed_mm_s=0.75, action=np.zeros(3)), played(speed_mm_s=0.0, action=own)
    for (one_m, one_n), (other_m, other_n) in zip(moved, still, strict=True):
        assert np.abs(one_m - other_m).max() < 1e-8
        assert one_n == pytest.approx(other_n, abs=1e-3)
    assert np.linalg.norm(moved[-1][1][0, :2]) > 0.5, "the plate drags at the peg"


def test_only_what_nothing_else_moves_has_a_motion() -> None:
    gel = Meshes().gel()
    targets = [gel.rest_position_m[gel.driven_nodes]]
    with pytest.raises(SceneError, match="body 0 has a motion, but is not fixed"):
        scene_of(block(0.0, 30.0, motion=along_x))
    with pytest.raises(SceneError, match="Body 0 can move freely"):
        scene_of(block(0.0, 30.0)).step(driven_targets_m=targets, displacements_m={0: np.zeros(3)})
    with pytest.raises(SceneError, match="expected three finite numbers"):
        scene_of(block(0.0, 30.0, fixed=True)).step(
            driven_targets_m=targets, displacements_m={0: np.array([0.0, np.nan, 0.0])}
        )


def scene_of(body: RigidBody) -> Scene:
    gel = GelBody(mesh=Meshes().gel(), rotation=np.eye(3), translation_m=np.zeros(3))
    return Scene(gels=[gel], bodies=[body], time_step_s=0.1)
