"""Stands in for the physics in tests of what is built on it: gels follow their driven nodes rigidly, parts the gels."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from vitac.envs.fem.contact.forces import PairForces, no_forces
from vitac.envs.fem.model.mesh import GelBody, PointLoad, RigidBody
from vitac.envs.fem.scene.report import StepReport, StepStatus


def report(status: StepStatus = StepStatus.CONVERGED, part_force_n: float = 0.0) -> StepReport:
    values: dict[str, Any] = dict.fromkeys(StepReport.__dataclass_fields__, 0)
    gel_forces_n = ((0.0, 5.0, part_force_n), (0.0, -5.0, 0.0))
    return StepReport(**(values | {"status": status, "gel_forces_n": gel_forces_n, "time_step_s": 0.1}))


class FakeScene:
    """Records what it is asked; `statuses` are handed out step by step.

    `bulge_m` pushes the sensing nodes out, `part_force_n` acts on the part.
    """

    bulge_m = 0.0
    part_force_n = 0.0
    statuses: Sequence[StepStatus] = ()
    built: "list[FakeScene]" = []  # noqa: RUF012 - cleared by the fixture that installs the class

    def __init__(
        self,
        *,
        gels: Sequence[GelBody],
        bodies: Sequence[RigidBody],
        time_step_s: float,
        contact: Any,
        solver: Any,
        gravity_m_s2: Sequence[float],
    ) -> None:
        self.gels, self.bodies, self.time_step_s = list(gels), list(bodies), time_step_s
        self.contact, self.solver, self.gravity_m_s2 = contact, solver, gravity_m_s2
        self.loads: list[dict[int, PointLoad]] = []
        self.targets_m: list[list[np.ndarray]] = []
        self.displacements_m: list[dict[int, np.ndarray]] = []
        self.placed = [(gel.rotation, gel.translation_m) for gel in gels]
        self._pending = list(self.statuses)
        self.built.append(self)

    def step(
        self,
        *,
        driven_targets_m: Sequence[np.ndarray],
        displacements_m: Mapping[int, np.ndarray],
        loads: Mapping[int, PointLoad],
    ) -> StepReport:
        self.loads.append(dict(loads))
        self.displacements_m.append(dict(displacements_m))
        self.targets_m.append([targets.copy() for targets in driven_targets_m])
        before_m = self._middle_m()
        for index, (gel, targets) in enumerate(zip(self.gels, driven_targets_m, strict=True)):
            if gel.mesh.is_free:
                rotation, centre_m = self.placed[index]
                self.placed[index] = (rotation, centre_m + self._middle_m() - before_m)
            else:
                self.placed[index] = rigid_fit(gel.mesh.rest_position_m[gel.mesh.driven_nodes], targets)
        return report(self._pending.pop(0) if self._pending else StepStatus.CONVERGED, self.part_force_n)

    def _middle_m(self) -> np.ndarray:
        return np.asarray(np.mean([centre for _, centre in self.placed[:2]], axis=0))

    def contact_forces(self) -> PairForces:
        """The forces of the gels, as contacts with the held part (body 2)."""
        forces_n = np.array(report(part_force_n=self.part_force_n).gel_forces_n)
        centres_m = np.array([centre for _, centre in self.placed[:2]])
        return no_forces()._replace(bodies=np.array([[0, 2], [1, 2]]), points_m=centres_m, forces_n=forces_n)

    def gel_contact_forces_n(self) -> list[np.ndarray]:
        """The force on each gel, the same on all nodes of its sensing face."""
        forces_n = report(part_force_n=self.part_force_n).gel_forces_n
        shares = [gel.mesh.sensing / np.count_nonzero(gel.mesh.sensing) for gel in self.gels]
        return [share[:, None] * np.array(force_n) for share, force_n in zip(shares, forces_n, strict=False)]

    def gel_positions_m(self, index: int) -> np.ndarray:
        mesh, (rotation, centre) = self.gels[index].mesh, self.placed[index]
        rest = mesh.rest_position_m + self.bulge_m * np.array([0.0, 0.0, 1.0]) * mesh.sensing[:, None]
        return np.asarray(rest @ rotation.T + centre)

    def body_vertices_m(self, index: int) -> np.ndarray:
        body = self.bodies[index]
        start = np.mean([gel.translation_m for gel in self.gels], axis=0)
        moved = np.mean([centre for _, centre in self.placed], axis=0) - start
        return np.asarray(body.mesh.vertices_m @ body.rotation.T + body.translation_m + moved)

    def state_bytes(self) -> bytes:
        return np.concatenate([self.gel_positions_m(i) for i in range(len(self.gels))]).astype("<f8").tobytes()


def rigid_fit(rest: np.ndarray, world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and translation of points that moved rigidly (Kabsch 1976)."""
    u, _, vt = np.linalg.svd((rest - rest.mean(axis=0)).T @ (world - world.mean(axis=0)))
    turn = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = vt.T @ turn @ u.T
    return rotation, world.mean(axis=0) - rotation @ rest.mean(axis=0)


def in_place_of_the_physics(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[FakeScene]]:
    """The body of a fixture: scenes are fakes, without a bulge and converging, while the test runs."""
    FakeScene.built.clear()
    monkeypatch.setattr(FakeScene, "bulge_m", 0.0)
    monkeypatch.setattr(FakeScene, "part_force_n", 0.0)
    monkeypatch.setattr(FakeScene, "statuses", ())
    monkeypatch.setattr("vitac.envs.scene.grasped_scene.Scene", FakeScene)
    yield FakeScene.built
    FakeScene.built.clear()
