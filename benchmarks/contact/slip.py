"""Drags both gels of a gripper along a part that is held fast, under both contact models, and draws their marker flow.

Usage: python benchmarks/contact/slip.py [--friction 0.6] [--indentation-mm 0.5] [--out docs/pictures/slip.png]

The part is the cuboid peg, the gels are the challenge's, markers have neither noise nor shifts, and both models have
the same friction coefficient. The gripper rises by 1.6 mm in IPC steps of 0.1 s and then rests for 2 s. Prints the
force that friction holds, and how far the gel has slid in the inner and in the outer half of the contact.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from vitac.envs.fem.model.mesh import GEL_MATERIAL, PART_MATERIAL
from vitac.envs.fem.model.settings import ArenaContactSettings, ContactModel, PairFriction
from vitac.envs.scene.grasped_scene import GraspedScene
from vitac.envs.scene.gripper import UPRIGHT_MOUNTS, Gripper
from vitac.envs.tactile.markers import MarkerSettings
from vitac.envs.tactile.sensor import TactileSensor

FloatArray = NDArray[np.float64]
PICTURE = Path(__file__).parents[2] / "docs" / "pictures" / "slip.png"
STEP_MM, DRAGS_MM, REST_STEPS = 0.05, (0.4, 0.8, 1.2, 1.6), 20
GRID = MarkerSettings(
    interval_mm=(2.0, 2.0), rotation_rad=0.0, translation_mm=0.0, shift_mm=0.0, noise_px=0.0, loss_probability=0.0
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Moment:
    """The left gel at one moment.

    Attributes:
        title: what was done.
        flow: reference and current marker positions [pixel], shape [2, m, 2].
        force_n: what friction holds, both gels together [N].
        normal_n: force on one gel across the face [N].
        slid_mm: how far each node of the flat face has slid along the part [mm].
        distance_mm: of each of them from the middle of the contact [mm].
    """

    title: str
    flow: FloatArray
    force_n: float
    normal_n: float
    slid_mm: FloatArray
    distance_mm: FloatArray


class HeldPart:
    """Two gels that grip a part which nothing moves."""

    def __init__(self, model: ContactModel, friction: float, indentation_mm: float) -> None:
        env: Any = gymnasium.make(
            "ViTac/PegInsertion-v1", disable_env_checker=True, contact_model=str(model), indentation_mm=indentation_mm,
            peg_friction=friction,
        ).unwrapped  # fmt: skip
        env.reset(options={"shape": "cuboid", "offset_mm_deg": (0.0, 0.0, 0.0), "rng_seed": (1,)})
        scene = env.task_scene
        gel = scene._parts.gel
        contact = scene._settings.physics.contact
        if isinstance(contact, ArenaContactSettings):
            pairs = ((GEL_MATERIAL, PART_MATERIAL), (PART_MATERIAL, PART_MATERIAL), (GEL_MATERIAL, GEL_MATERIAL))
            frictions = tuple(PairFriction(first=a, second=b, coefficient=friction) for a, b in pairs)
            contact = replace(contact, pair_frictions=frictions)
        self.grasped = GraspedScene(
            gripper=Gripper(mounts=UPRIGHT_MOUNTS, gel=gel, pose=scene._open_pose(scene.offset)),
            held=replace(scene._placed_peg(), fixed=True), fixed=scene._parts.fixed,
            physics=replace(scene._settings.physics, contact=contact, gel_friction=friction),
            sensors=(TactileSensor(gel, GRID), TactileSensor(gel, GRID)), clocks=env._clocks,
        )  # fmt: skip
        pose = self.grasped.pose.moved(closing_m=(0.1 + indentation_mm) * 1e-3)
        self.grasped.move_to(pose, ipc_steps=3)
        self.grasped.capture_references()
        reference = self.grasped.gel_nodes_m(0)
        sensing = gel.sensing_nodes
        wide = np.abs(reference[sensing, 1] - reference[sensing, 1].min()) < 1e-4
        self._touching, self._at_m = sensing[wide], reference[sensing[wide]]
        self.grasped.take_reports()

    def rise(self, millimetres: float, ipc_steps: int) -> None:
        """Drag both gels upwards along the part."""
        self.grasped.move_to(self.grasped.pose.moved(z_m=millimetres * 1e-3), ipc_steps=ipc_steps)

    def moment(self, title: str) -> Moment:
        """Return what there is to see of the left gel."""
        forces = np.array(self.grasped.take_reports()[-1].gel_forces_n)
        flow = np.asarray(self.grasped.marker_flow(np.random.default_rng(0))[0], dtype=np.float64)
        slid_mm = 1e3 * (self.grasped.gel_nodes_m(0)[self._touching] - self._at_m)[:, 2]
        middle = self._at_m.mean(axis=0)
        return Moment(
            title=title, flow=flow, force_n=float(-forces[:, 2].sum()), normal_n=float(np.abs(forces[0, 1])),
            slid_mm=slid_mm, distance_mm=1e3 * np.sqrt(((self._at_m - middle)[:, [0, 2]] ** 2).sum(axis=1)),
        )  # fmt: skip


def moments(model: ContactModel, friction: float, indentation_mm: float) -> Iterator[Moment]:
    """Yield what is to be seen while the gels are dragged, and after a rest."""
    held, risen_mm = HeldPart(model, friction, indentation_mm), 0.0
    for drag_mm in DRAGS_MM:
        held.rise(drag_mm - risen_mm, round((drag_mm - risen_mm) / STEP_MM))
        risen_mm = drag_mm
        yield held.moment(f"dragged by {drag_mm:.1f} mm")
    held.rise(0.0, REST_STEPS)
    yield held.moment("2 s later, at rest")


def draw(runs: dict[str, list[Moment]], path: Path) -> None:
    """Draw the marker flow of the left gel, a row for each model."""
    from matplotlib.figure import Figure

    columns = len(next(iter(runs.values())))
    figure = Figure(figsize=(2.2 * columns, 1.9 * len(runs)), layout="constrained")
    axes = figure.subplots(len(runs), columns)
    for row, (name, run) in zip(axes, runs.items(), strict=True):
        for axis, moment in zip(row, run, strict=True):
            (u, v), way = moment.flow[0].T, (moment.flow[1] - moment.flow[0]).T
            arrows = axis.quiver(
                u, v, *way, np.hypot(*way), angles="xy", scale_units="xy", scale=1, width=0.01, clim=(0, 25)
            )
            axis.set_title(f"{name}, {moment.force_n:.1f} N\n{moment.title}", fontsize=8)
            axis.set(xlim=(u.min() - 35, u.max() + 15), ylim=(v.max() + 15, v.min() - 15), aspect="equal")
            axis.set(xticks=[], yticks=[])
    figure.colorbar(arrows, ax=axes, label="motion of a marker [pixel]", shrink=0.8)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Drag, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--friction", type=float, default=0.6)
    parser.add_argument("--indentation-mm", type=float, default=0.5)
    parser.add_argument("--out", type=Path, default=PICTURE)
    arguments = parser.parse_args()
    runs = {str(model): list(moments(model, arguments.friction, arguments.indentation_mm)) for model in ContactModel}
    for name, run in runs.items():
        for moment in run:
            inner = moment.distance_mm < np.median(moment.distance_mm)
            print(
                f"{name}, {moment.title}: {moment.force_n:.2f} N, limit "
                f"{2 * arguments.friction * moment.normal_n:.2f} N, slid by {moment.slid_mm[inner].mean():.3f} mm "
                f"inside, {moment.slid_mm[~inner].mean():.3f} mm outside"
            )
    draw(runs, arguments.out)


if __name__ == "__main__":
    main()
