"""A dome that a plate touches, and is dragged along it: Hertz' contact, and Cattaneo's and Mindlin's partial slip."""

from dataclasses import dataclass

import numpy as np
from block_meshes import box_gel
from contact.elastic import START_GAP_M, OnPlate, Rubber
from numpy.typing import NDArray
from vitac.envs.fem.model.mesh import GelMesh

FloatArray = NDArray[np.float64]
# Length of an IPC step in which the inertia of domes of many kilograms does not count [s].
QUASI_STATIC_S = 100.0


def graded(inner: float, outer: float, cells: int, more: int) -> FloatArray:
    """Coordinates from -outer to outer: equal cells within the inner part, growing ones outside."""
    size, low, high = 2 * inner / cells, 1.0, 4.0
    for _ in range(60):
        ratio = 0.5 * (low + high)
        reach = size * sum(ratio**k for k in range(1, more + 1))
        low, high = (ratio, high) if reach < outer - inner else (low, ratio)
    far = inner + np.cumsum(size * low ** np.arange(1, more + 1))
    return np.concatenate([-far[::-1], np.linspace(-inner, inner, cells + 1), far])


@dataclass(frozen=True, kw_only=True)
class Dome:
    """A block with a spherical face, refined where it touches over a twentieth of the ball's radius.

    Attributes:
        radius_m: of the ball [m].
        cells: across the contact.
        outer_cells: from the contact to each side, growing.
        growth: of cells downwards.
    """

    radius_m: float = 0.8
    cells: int = 12
    outer_cells: int = 8
    growth: float = 1.25

    @property
    def touching_m(self) -> float:
        """Radius of the contact that it is refined for [m]."""
        return self.radius_m / 20

    @property
    def thickness_m(self) -> float:
        """Thickness [m]; half the width is the same."""
        return self.radius_m / 4

    @property
    def mesh(self) -> GelMesh:
        """Mesh, its face at the top, centred."""
        along = graded(1.15 * self.touching_m, self.thickness_m, round(1.15 * self.cells), self.outer_cells)
        size, ratio, heights = 2 * self.touching_m / self.cells, 1.0, [0.0]
        while heights[-1] < self.thickness_m:
            heights.append(heights[-1] + size * ratio)
            ratio = ratio * self.growth if heights[-1] > 0.4 * self.touching_m else ratio
        z = self.thickness_m * (1 - np.array(heights) / heights[-1])[::-1]
        grid = box_gel((0.1, 0.1, 0.1), (len(along) - 1, len(along) - 1, len(z) - 1))
        index = np.rint(10 * grid.rest_position_m * [len(along) - 1, len(along) - 1, len(z) - 1]).astype(int)
        x, y, height = along[index[:, 0]], along[index[:, 1]], z[index[:, 2]]
        sagging = np.minimum(x**2 + y**2, (3 * self.touching_m) ** 2) / (2 * self.radius_m)
        height = height - sagging * (height / self.thickness_m)
        position = np.ascontiguousarray(np.stack([x, y, height], axis=1))
        return GelMesh(
            rest_position_m=position, tetrahedra=grid.tetrahedra, driven=grid.driven, sensing=grid.sensing, name="dome"
        )


def hertz_force_n(dome: Dome, rubber: Rubber, depth_m: float) -> float:
    """Force that presses a ball into a layer on a stiff ground (Dimitriadis et al., Biophysical Journal 82, 2002)."""
    nu = rubber.poisson_ratio
    chi = np.sqrt(dome.radius_m * depth_m) / dome.thickness_m
    alpha = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1 - nu)
    beta = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1 - nu)
    layer = 1 - 2 * alpha / np.pi * chi + 4 * alpha**2 / np.pi**2 * chi**2
    layer -= 8 / np.pi**3 * (alpha**3 + 4 * np.pi**2 / 15 * beta) * chi**3
    layer += 16 * alpha / np.pi**4 * (alpha**3 + 3 * np.pi**2 / 5 * beta) * chi**4
    half_space = 4 * rubber.youngs_modulus_pa / (3 * (1 - nu**2)) * np.sqrt(dome.radius_m) * depth_m**1.5
    return float(half_space * layer)


def hertz_radius_m(dome: Dome, rubber: Rubber, force_n: float) -> float:
    """Contact radius under a force [m]: a^3 = 3 F R (1 - nu^2) / (4 E)."""
    return float(
        (3 * force_n * dome.radius_m * (1 - rubber.poisson_ratio**2) / (4 * rubber.youngs_modulus_pa)) ** (1 / 3)
    )


@dataclass(frozen=True, kw_only=True)
class Pressed:
    """A dome that was pressed on the plate, measured and foretold."""

    scene: OnPlate
    force_n: float
    hertz_force_n: float
    radius_m: float
    hertz_radius_m: float
    gap_m: float


def press_dome(dome: Dome, rubber: Rubber, friction: float = 0.0, ipc_steps: int = 2) -> Pressed:
    """Press a dome so far that it touches over about `touching_m`, and compare force and radius with Hertz.

    Both hold for a gap that is the same everywhere, and the barrier's is wider where it presses less. So the depth is
    the way of the back and the change of the mean gap, weighted as a flat punch of the contact's radius presses: by
    Betti's theorem that is what a small change of an indenter's shape does to its force (Sneddon, International
    Journal of Engineering Science 3, 1965, has the same from his solution). The radius is that of the pressure's second
    moment, 2/5 a^2 for Hertz' pressure.
    """
    scene = OnPlate(dome.mesh, rubber, friction, time_step_s=QUASI_STATIC_S)
    way_m = dome.touching_m**2 / dome.radius_m
    scene.move(np.array([0.0, 0.0, -way_m]), ipc_steps)
    place, gap, force = scene.pressed_nodes()
    squared = place[:, 0] ** 2 + place[:, 1] ** 2
    radius_m = float(np.sqrt(2.5 * (squared * force).sum() / force.sum()))
    mean_gap_m = punch_mean(np.sqrt(squared), gap, radius_m)
    total_n = float(scene.force_n()[2])
    return Pressed(
        scene=scene, force_n=total_n, hertz_force_n=hertz_force_n(dome, rubber, way_m - START_GAP_M + mean_gap_m),
        radius_m=radius_m, hertz_radius_m=hertz_radius_m(dome, rubber, total_n), gap_m=mean_gap_m,
    )  # fmt: skip


def punch_mean(distance_m: FloatArray, value: FloatArray, radius_m: float) -> float:
    """Return the mean over a circle of what is known at some distances, weighted as a flat punch presses on it."""
    order = np.argsort(distance_m)
    sines = np.sin(0.5 * np.pi * (np.arange(200) + 0.5) / 200)
    # r = a sin t turns the weight r / sqrt(a^2 - r^2) into a sin t.
    return float((np.interp(radius_m * sines, distance_m[order], value[order]) * sines).sum() / sines.sum())


def partial_slip(pressed: Pressed, rubber: Rubber, *, friction: float, part: float) -> tuple[float, float]:
    """Stick radius by contact radius under a tangential force of about a part of mu N: measured, and Mindlin's.

    A scene of the same nodes with friction starts from the dome that was pressed without, as the theory does, and its
    back is dragged until the force is there. The radius follows from the second moment of the friction,
    2/5 mu N (a^2 - c^5 / a^3) for Cattaneo's traction; theory has c^3 = a^3 (1 - Q / mu N).
    """
    scene = OnPlate(pressed.scene.gel.mesh, rubber, friction, time_step_s=QUASI_STATIC_S)
    scene.continue_from(pressed.scene)
    limit_n = friction * pressed.force_n
    nu = rubber.poisson_ratio
    stiffness_n_m = 4 * pressed.radius_m * rubber.youngs_modulus_pa / ((1 + nu) * (2 - nu))
    scene.move(np.array([0.5 * part * limit_n / stiffness_n_m, 0.0, 0.0]))
    while -scene.force_n()[0] < part * limit_n:
        scene.move(np.array([0.1 * limit_n / stiffness_n_m, 0.0, 0.0]))
    place, _, normal_n = scene.pressed_nodes()
    rubbed_n = scene.friction_n()
    a2 = 2.5 * ((place[:, 0] ** 2 + place[:, 1] ** 2) * normal_n).sum() / normal_n.sum()
    second = ((place[:, 0] ** 2 + place[:, 1] ** 2) * rubbed_n).sum() / rubbed_n.sum()
    ratio = np.linspace(1e-3, 1 - 1e-6, 100_000)
    moments = 0.4 * (1 - ratio**5) / (1 - ratio**3)
    measured = float(ratio[np.argmin(np.abs(moments - second / a2))])
    load = -scene.force_n()[0] / (friction * normal_n.sum())
    return measured, float((1 - load) ** (1 / 3))
