"""The assembled forces are the derivatives of the energies, written out here in NumPy from the documented formulas."""

from dataclasses import dataclass

import numpy as np
import pytest
from block_meshes import box_gel
from engine_probe import Probe
from numpy.typing import NDArray
from small_scenes import Grip
from vectors import vec3
from vitac.envs.fem.contact.distance import EDGE_EDGE, closest_points

FloatArray = NDArray[np.float64]
STEP_M = 1e-8
FRICTION = 2.0


@dataclass(frozen=True, kw_only=True)
class Touching:
    """An active contact at a state."""

    points: NDArray[np.int64]
    coefficients: FloatArray
    distance_m: float
    normal: FloatArray
    fade: float  # of the mollifier


class Written:
    """A scene's energies at states of the caller's choice."""

    def __init__(self, probe: Probe) -> None:
        self.probe, self.model, self.h = probe, probe.model, probe.model.parameters.time_step_s

    def touching(self, x: FloatArray) -> list[Touching]:
        y, near = self.probe.points_m(x), self.probe.candidates(x, 2e-4)
        found = []
        for pair_type, p, eps in zip(near.pair_type, near.points, near.mollifier_eps_m4, strict=True):
            c, _, r = closest_points(int(pair_type), *(vec3(y[i]) for i in p))
            d = float(np.linalg.norm(r))
            if d < self.model.parameters.d_hat_m:
                cross = np.cross(y[p[1]] - y[p[0]], y[p[3]] - y[p[2]])
                ratio = min(1.0, cross @ cross / eps) if pair_type == EDGE_EDGE else 1.0
                fade = ratio * (2 - ratio)
                found.append(
                    Touching(points=p, coefficients=np.array(c), distance_m=d, normal=np.array(r) / d, fade=float(fade))
                )
        return found

    def energy(self, x: FloatArray) -> float:
        """Everything but friction [J]."""
        return self.elastic(x) + self.inertia(x) + self.affine(x) + self.barriers(x)

    def elastic(self, x: FloatArray) -> float:
        """V (mu/2 (tr F'F - 3) - mu ln J + lambda/2 (ln J)^2)."""
        e = self.model.elastic
        F = np.einsum("tai,taj->tij", x[e.nodes], e.gradients_1_m)
        log_j = np.log(np.linalg.det(F))
        density = e.mu_pa / 2 * ((F**2).sum(axis=(1, 2)) - 3) - e.mu_pa * log_j + e.lambda_pa / 2 * log_j**2
        return float(e.volume_m3 @ density)

    def inertia(self, x: FloatArray) -> float:
        """M |x - x_hat|^2 / (2 h^2)."""
        offset = x - self.probe.x_hat_m
        gels = self.probe.unknown_nodes[: self.model.system.block.n // 3]
        total = self.model.unknowns.node_mass_kg[gels] @ (offset[gels] ** 2).sum(axis=1)
        for first, mass in zip(self.model.affine.first_node, self.model.affine.mass_kg, strict=True):
            frame = offset[first : first + 4]
            total += np.sum(mass * (frame @ frame.T))
        return float(total / (2 * self.h**2))

    def affine(self, x: FloatArray) -> float:
        """kappa_affine V |A A' - I|^2 / h^2."""
        a, total = self.model.affine, 0.0
        for first, length, stiffness in zip(a.first_node, a.frame_length_m, a.stiffness_j, strict=True):
            A = (x[first + 1 : first + 4] - x[first]).T / length
            total += stiffness * np.sum((A @ A.T - np.eye(3)) ** 2)
        return float(total)

    def barriers(self, x: FloatArray) -> float:
        """kappa / h^2 e(c) b(d), b = -(d - d_hat)^2 ln(d / d_hat)."""
        p = self.model.parameters
        total = 0.0
        for t in self.touching(x):
            total -= t.fade * (t.distance_m - p.d_hat_m) ** 2 * np.log(t.distance_m / p.d_hat_m)
        return p.barrier_stiffness_n_m * total

    def friction(self, x: FloatArray, lagged: list[Touching]) -> float:
        """mu N f0(|u|) with normal force, direction and closest points held at those of `lagged`."""
        p, total = self.model.parameters, 0.0
        s, slip = p.slip_scale_m, self.probe.points_m(x) - self.probe.points_m(self.probe.start_m)
        for t in lagged:
            gap = t.distance_m - p.d_hat_m
            slope = -2 * gap * np.log(t.distance_m / p.d_hat_m) - gap**2 / t.distance_m
            w = t.coefficients @ slip[t.points]
            u = float(np.linalg.norm(w - (w @ t.normal) * t.normal))
            f0 = u if u >= s else -(u**3) / (3 * s**2) + u**2 / s + s / 3
            total += FRICTION * -p.barrier_stiffness_n_m * t.fade * slope * f0
        return float(total)


def probe(friction: float, seed: int) -> Probe:
    """A squeezed box, then moved and turned so that a diagonal of its face crosses one of a gel at a small angle."""
    grip = Grip(friction=friction, gel=box_gel((0.012, 0.012, 0.004), (3, 3, 2)))
    grip.squeeze(0.2e-3)
    x = grip.scene._x.copy()
    random = np.random.default_rng(seed)
    angle = -0.025
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    x[-4:] = (x[-4:] - x[-4]) @ turn.T + x[-4] - [0.00175, 0, 0]
    x += 1e-6 * random.normal(size=x.shape)
    found = Probe(grip.scene, start_m=grip.scene._x + 3e-4 * random.normal(size=3))
    found.x_m = x
    return found


def along(unknown_nodes: NDArray[np.int64], x: FloatArray, part: slice, random: np.random.Generator) -> FloatArray:
    direction = np.zeros_like(x)
    direction[unknown_nodes[part]] = random.normal(size=(len(unknown_nodes[part]), 3))
    return direction


# Gels and body apart: the body's stiff frame would hide errors in the gels' forces.
parts = pytest.mark.parametrize("part", [slice(0, -4), slice(-4, None)], ids=["gels", "body"])


@parts
@pytest.mark.parametrize("seed", range(2))
def test_forces_without_friction_are_the_derivative_of_the_energy(seed: int, part: slice) -> None:
    at = probe(0.0, seed)
    written, x = Written(at), at.x_m
    touching = written.touching(x)
    assert sum(t.fade == 1.0 for t in touching) > 10
    assert sum(0.1 < t.fade < 0.9 for t in touching) > 3
    direction = along(at.unknown_nodes, x, part, np.random.default_rng(seed))
    slope = (written.energy(x + STEP_M * direction) - written.energy(x - STEP_M * direction)) / (2 * STEP_M)
    assert float((at.at(x).all_forces_n * direction).sum()) == pytest.approx(slope, rel=1e-5)


@parts
def test_friction_is_the_derivative_of_its_potential_with_everything_else_held(part: slice) -> None:
    with_friction, without = probe(FRICTION, 0), probe(0.0, 0)
    with_friction.x_m, with_friction.start_m, with_friction.x_hat_m = without.x_m, without.start_m, without.x_hat_m
    written, x = Written(with_friction), with_friction.x_m
    lagged = written.touching(x)
    direction = along(with_friction.unknown_nodes, x, part, np.random.default_rng(1))
    ahead, behind = (written.friction(x + sign * STEP_M * direction, lagged) for sign in (1, -1))
    force = with_friction.at(x).all_forces_n - without.at(x).all_forces_n
    assert float((force * direction).sum()) == pytest.approx((ahead - behind) / (2 * STEP_M), rel=1e-5)
