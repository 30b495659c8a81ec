"""Observables of the parts that scenes are composed of; a task lists those that its policies see."""

from enum import StrEnum
from functools import partial
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from ..observable import Curves, Observable, noise_digest
from ..tactile.gel import MARKER_COUNT, SENSING_NODES
from ..tactile.taxels import TaxelArray
from .measured_pose import held_pose_mm_deg

if TYPE_CHECKING:
    from .grasped_scene import GraspedScene

FloatArray = NDArray[np.float64]
Random = np.random.Generator


class HasGrasp(Protocol):
    """A task's scene in which a gripper with two tactile sensors holds a part."""

    grasped: "GraspedScene"


class HasShape(Protocol):
    """A task's scene that plays one of several shapes."""

    @property
    def shape(self) -> StrEnum:
        """Which one."""


MEASURED_POSE: Observable[HasGrasp] = Observable(
    name="measured_pose",
    shape=(6,),
    unit="mm, mm, mm, degree, degree, degree",
    meaning=(
        "Where the held part really is, which differs from what is commanded: x, y and z of its own origin in the "
        "world, and its roll, pitch and yaw."
    ),
    read=lambda scene, _: held_pose_mm_deg(scene.grasped),
    privileged=True,
)

CONTACT_FORCES: Observable[HasGrasp] = Observable(
    name="contact_forces",
    shape=(3, 3),
    unit="N",
    meaning=(
        "[held part, left gel, right gel][x, y, z] forces of contacts in the world at the end of the env step: on the "
        "held part of all that does not hold it, on a gel of all that it touches."
    ),
    read=lambda scene, _: scene.grasped.contact_forces_n(),
    privileged=True,
)

GRIPPER_WIDTH: Observable[HasGrasp] = Observable(
    name="gripper_width",
    shape=(1,),
    unit="mm",
    meaning="Commanded width of the gripper, between both gels' highest points where nothing presses on them.",
    read=lambda scene, _: np.array([1e3 * scene.grasped.gripper_width_m]),
)

SURFACE_POINTS: Observable[HasGrasp] = Observable(
    name="surface_pts",
    shape=(2, 2, SENSING_NODES, 3),
    unit="m",
    meaning=(
        "[sensor left, right][reference, current][node][x, y, z] of the sensing faces in the sensors' camera frames, "
        "without noise."
    ),
    read=lambda scene, _: scene.grasped.surface_points_m(),
    privileged=True,
    node_axis=2,
)


def played_shape(shapes: str) -> Observable[HasShape]:
    """Return the observable of the shape that is played.

    Args:
        shapes: their names in the order of the numbers.
    """
    return Observable(
        name="shape",
        shape=(1,),
        unit="1",
        meaning=f"Number of the shape that is played, from 0: {shapes}.",
        read=lambda scene, _: np.array([list(type(scene.shape)).index(scene.shape)]),
        privileged=True,
    )


def marker_flow(directions: str) -> Observable[HasGrasp]:
    """Return the observable of both sensors' markers.

    Args:
        directions: which way u and v point in this task, as sentences.
    """
    return Observable(
        name="marker_flow",
        shape=(2, 2, MARKER_COUNT, 2),
        unit="pixel",
        meaning=(
            "[sensor left, right][reference, current][marker][u, v] in a 320 x 240 image. The reference is taken after "
            "the grasp, and decides which markers are seen: those inside the image. A current position is given as it "
            "is projected, as the challenge does, also where it has left the image (up to 30 px outside while a gel is "
            "sheared); under arena-2 such a marker is not seen. "
            f"About 56 to 80 markers are seen, the last one is repeated up to {MARKER_COUNT}. {directions}"
        ),
        read=lambda scene, random: scene.grasped.marker_flow(random),
    )


_NOISE_STREAM = 0x5E4D1
_XYZ = ("x", "y", "z")


def _with_noise(
    name: str, values: FloatArray, spread: FloatArray, grasped: "GraspedScene", random: Random
) -> FloatArray:
    """Return what a sensor reads of values, with normal noise of these standard deviations."""
    from ..deterministic_math import normal_pairs

    content = f"{name} {grasped.ipc_steps} ".encode() + values.astype("<f8").tobytes()
    seed = int.from_bytes(noise_digest(random, _NOISE_STREAM, content), "little")
    uniform = np.random.default_rng(seed).random(((values.size + 1) // 2, 2))
    return values + spread * normal_pairs(uniform).ravel()[: values.size].reshape(values.shape)


def joint_width(step_mm: float = 50.0 / 255.0) -> Observable[HasGrasp]:
    """Return the observable of the gripper's width as its encoder gives it.

    Args:
        step_mm: between two readings [mm]; a Robotiq Hand-E gives its stroke of 50 mm as a number from 0 to 255.
    """
    return Observable(
        name="joint_width",
        shape=(1,),
        unit="mm",
        meaning=(
            f"Width of the gripper as its encoder gives it, in steps of {step_mm:.3g} mm, between both gels' highest "
            "points where nothing presses on them. The jaws do not yield: they are where they are commanded to."
        ),
        read=lambda scene, _: np.array([step_mm * np.rint(1e3 * scene.grasped.gripper_width_m / step_mm)]),
        curves=(Curves(title="Joint width [mm]", names=("width",)),),
    )


JOINT_WIDTH = joint_width()


def wrist_wrench(above_mm: float = 150.0, noise_n: float = 0.1, noise_n_m: float = 0.005) -> Observable[HasGrasp]:
    """Return the observable of a force/torque sensor between arm and gripper.

    It is set to zero with the gripper in the air, and the gripper never tilts, so that the gripper's weight is not in
    it. The default noise is of the size of the resolution of a Robotiq FT 300-S (0.1 N; 100 readings a second); that of
    the moments and the place are ours, as the makers of the platform's own sensor, SRI M3813A, publish none.

    Args:
        above_mm: height of the sensor above the middle between both gels' centres [mm].
        noise_n: standard deviation of each force [N].
        noise_n_m: standard deviation of each moment [N m].
    """
    spread = np.repeat([noise_n, noise_n_m], 3)

    def read(scene: HasGrasp, random: Random) -> FloatArray:
        wrench = scene.grasped.wrench_on_gripper(1e-3 * above_mm)
        return _with_noise("wrist_wrench", wrench, spread, scene.grasped, random)

    return Observable(
        name="wrist_wrench",
        shape=(6,),
        unit="N, N, N, N m, N m, N m",
        meaning=(
            "Force x, y, z and moment x, y, z on the gripper, in its axes (z up, turned with it about the vertical), "
            f"as a sensor {above_mm:g} mm above the middle between both gels reads them at the end of the env step, "
            f"with noise of {noise_n:g} N and {noise_n_m:g} N m. The gripper's own weight is taken off."
        ),
        read=read,
        curves=(
            Curves(title="Wrist force [N]", names=_XYZ, read=lambda wrench: wrench[:3]),
            Curves(title="Wrist moment [N m]", names=_XYZ, read=lambda wrench: wrench[3:]),
        ),
    )


WRIST_WRENCH = wrist_wrench()


def taxel_forces(array: TaxelArray) -> Observable[HasGrasp]:
    """Return the observable of an array of taxels in the place of each gel's markers."""

    def read(scene: HasGrasp, random: Random) -> FloatArray:
        grasped = scene.grasped
        pairs = enumerate(grasped.gel_contact_forces_n())
        values = np.stack(
            [array.forces_n(on_nodes_n, grasped.gel, grasped.sensor_pose(at).rotation) for at, on_nodes_n in pairs]
        )
        return _with_noise("taxel_forces", values, np.full(3, array.noise_n), grasped, random)

    return Observable(
        name="taxel_forces",
        shape=(2, array.rows, array.columns, 3),
        unit="N",
        meaning=(
            "[sensor left, right][row along v][column along u][along u, along v, pressure] force of the contacts on "
            "equal rectangles of the sensing face at the end of the env step, u and v as in `marker_flow`, with noise "
            f"of {array.noise_n:g} N."
        ),
        read=read,
        curves=tuple(
            Curves(
                title=f"Taxels: {what} [N]",
                names=("left", "right"),
                read=partial(_sum_over_taxels, axis),
            )
            for axis, what in enumerate(("shear along u", "shear along v", "pressure"))
        ),
    )


def _sum_over_taxels(axis: int, forces_n: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(forces_n[..., axis].sum(axis=(1, 2)))


TAXEL_FORCES = taxel_forces(TaxelArray())
