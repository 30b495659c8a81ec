"""The contact model arena-2 against textbooks, on materials and shapes that no task has: target, measured, verdict.

Usage: python benchmarks/contact/textbook.py [--only GROUP ...] [--fine] [--json FILE]
       [--seed N] [--modulus PA] [--poisson RATIO] [--friction MU] [--radius M] [--size FACTOR]

Prints a line for each check as soon as it is known. `--fine` takes the finer mesh of each, in some minutes. What is
given replaces the benchmark's own: modulus and Poisson's ratio of gels, the friction coefficient where it is not what
is sought, the radius of balls, and a factor of the sizes of blocks, pads, grips, pegs and walls. A seed draws those
that are not given, and triangulations, angles, places and loads on flat faces, so that no value can be tuned to. Exit
code 1 where a measured value is beyond its bound.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "support" / "physics"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from contact.beams import bent_over_theory
from contact.domes import Dome, partial_slip, press_dome
from contact.elastic import Rubber, sheared_grip, slide_pad
from contact.faces import change_of_velocity, press_corner, work_of_cycle_j
from contact.jamming import PegInHole
from contact.rigid import (
    Block,
    incline_acceleration_error,
    incline_drift_m,
    largest_rise_of_energy,
    rigid_strain,
    wedging_friction,
)
from contact.viscosity import VISCOUS

CUBE = Block(material="wood")
HEXAGON = Block(corners=6, radius_m=0.02, height_m=0.006, density_kg_m3=7800.0, material="brass")
TRIANGLE = Block(corners=3, radius_m=0.03, height_m=0.02, density_kg_m3=1200.0, material="nylon")
SOFT, FIRM = Rubber(youngs_modulus_pa=8e4, poisson_ratio=0.42), Rubber(youngs_modulus_pa=2e6, poisson_ratio=0.25)


@dataclass(frozen=True, kw_only=True)
class Check:
    """One figure: its target, what was measured, and by how much it may differ; all in one unit."""

    name: str
    target: float
    measured: float
    bound: float
    unit: str

    @property
    def holds(self) -> bool:
        """Whether what was measured is within the bound."""
        return abs(self.measured - self.target) <= self.bound


@dataclass(frozen=True, kw_only=True)
class Choice:
    """What replaces the materials and sizes of the benchmark, and whether meshes are fine; None replaces nothing."""

    youngs_modulus_pa: float | None = None
    poisson_ratio: float | None = None
    friction: float | None = None
    radius_m: float | None = None
    size: float = 1.0
    fine: bool = False
    seed: int | None = None

    def drawn(self) -> "Choice":
        """Return what a seed draws where nothing is given."""
        if self.seed is None:
            return self
        rng = self.rng()
        drawn = {
            "youngs_modulus_pa": float(np.exp(rng.uniform(np.log(3e4), np.log(1e6)))),
            "poisson_ratio": float(rng.uniform(0.2, 0.42)),
            "friction": float(rng.uniform(0.2, 0.8)),
            "radius_m": float(rng.uniform(0.4, 1.0)),
        }
        given = {name: value for name, value in asdict(self).items() if name in drawn and value is not None}
        return replace(self, **drawn | given, size=self.size * float(rng.uniform(0.8, 1.6)))

    def rng(self) -> np.random.Generator:
        """Return what draws; without a seed always the same."""
        return np.random.default_rng(self.seed or 0)

    def rubber(self, own: Rubber) -> Rubber:
        """Return a gel's material."""
        return replace(
            own, youngs_modulus_pa=self.youngs_modulus_pa or own.youngs_modulus_pa,
            poisson_ratio=own.poisson_ratio if self.poisson_ratio is None else self.poisson_ratio,
        )  # fmt: skip

    def rubs(self, own: float) -> float:
        """Return a friction coefficient."""
        return self.friction or own

    def block(self, own: Block) -> Block:
        """Return a block of the size."""
        return replace(own, radius_m=own.radius_m * self.size, height_m=own.height_m * self.size)

    def dome(self, own_radius_m: float) -> Dome:
        """Return a dome of the ball's radius."""
        dome = Dome(radius_m=self.radius_m or own_radius_m)
        return replace(dome, cells=14, outer_cells=9, growth=1.2) if self.fine else dome


def drifts(choice: Choice) -> Iterator[Check]:
    """Yield how far blocks drift at 90 % of what friction holds."""
    for own, own_friction, seconds, time_step_s in (
        (CUBE, 0.5, 10.0, 0.01), (HEXAGON, 0.15, 60.0, 0.1), (TRIANGLE, 0.8, 60.0, 0.2), (CUBE, 0.3, 10.0, 0.005),
        (CUBE, 0.5, 60.0, 0.05), (CUBE, 0.5, 60.0, 0.5),
    ):  # fmt: skip
        block, friction = choice.block(own), choice.rubs(own_friction)
        drift_um = 1e6 * incline_drift_m(block, friction, 0.9, seconds, time_step_s)
        name = (
            f"drift on an incline at 90 %: {block.material}, mu {friction}, {seconds:g} s in steps of {time_step_s} s"
        )
        yield Check(name=name, target=0.0, measured=drift_um, bound=10.0, unit="um")


def accelerations(choice: Choice) -> Iterator[Check]:
    """Yield errors of the acceleration of blocks above the friction angle."""
    for own, own_friction, steeper, time_step_s in (
        (CUBE, 0.3, 5 / 3, 0.01), (HEXAGON, 0.15, 5 / 3, 0.005), (TRIANGLE, 0.6, 2.0, 0.002),
    ):  # fmt: skip
        block, friction = choice.block(own), choice.rubs(own_friction)
        slope = steeper * friction
        error = 100 * incline_acceleration_error(block, friction, slope, time_step_s)
        name = f"acceleration on an incline: {block.material}, mu {friction}, slope {slope:g}, steps of {time_step_s} s"
        yield Check(name=name, target=0.0, measured=error, bound=1.0, unit="%")


def strains(choice: Choice) -> Iterator[Check]:
    """Yield how far parts give way that should be rigid, under 50 N."""
    for own, time_step_s in ((CUBE, 0.1), (CUBE, 0.001), (HEXAGON, 0.1), (TRIANGLE, 0.02)):
        block = choice.block(own)
        percent = 100 * rigid_strain(block, 50.0, time_step_s)
        name = f"strain of a rigid part: {block.material}, 50 N, steps of {time_step_s} s"
        yield Check(name=name, target=0.0, measured=percent, bound=0.02, unit="%")


def wedges(choice: Choice) -> Iterator[Check]:
    """Yield from which friction a peg wedges: the line between its touches lies within both cones (Whitney 1982)."""
    steeps = (0.25, 0.5, 1.0) if choice.seed is None else choice.rng().uniform(0.2, 1.0, 5).round(3).tolist()
    for steepness in steeps:
        name = f"friction from which a peg wedges, touching {steepness} of the gap apart in height"
        measured = wedging_friction(steepness, 0.02 * choice.size)
        yield Check(name=name, target=steepness, measured=measured, bound=0.03 * steepness, unit="")


def jams(choice: Choice) -> Iterator[Check]:
    """Yield the loads at which a peg jams, along lines of the plane of M / (r F_z) and F_x / F_z (Whitney 1982)."""
    for own in (PegInHole(), PegInHole(radius_m=0.006, friction=0.15), PegInHole(depth_m=0.03, friction=0.5)):
        peg = replace(
            own, friction=choice.rubs(own.friction), radius_m=own.radius_m * choice.size,
            depth_m=own.depth_m * choice.size,
        )  # fmt: skip
        one_side = peg.friction * (1 + peg.slenderness)
        for contacts, moment, side in (
            ("two contacts", 1.0, 0.0), ("two contacts", 0.0, 1.0), ("two contacts", -1.0, 0.3),
            ("contacts on one side", one_side, 1.0), ("contacts on one side", -one_side, -1.0),
        ):  # fmt: skip
            name = (
                f"load at which a peg jams over Whitney's: mu {peg.friction}, {1e3 * peg.depth_m:g} mm deep, "
                f"{2e3 * peg.radius_m:g} mm wide, {contacts}, M / (r Fz) to Fx / Fz as {moment:.2g} to {side:g}"
            )
            measured = peg.jamming_load(moment, side) / peg.foretold_load(moment, side)
            yield Check(name=name, target=1.0, measured=measured, bound=0.03, unit="")


def energies(choice: Choice) -> Iterator[Check]:
    """Yield how far the energy of blocks rises that slide to rest."""
    for own, friction, time_step_s in ((CUBE, 0.3, 0.01), (HEXAGON, 0.15, 0.005)):
        block = choice.block(own)
        rise = 100 * largest_rise_of_energy(block, choice.rubs(friction), time_step_s)
        name = f"largest rise of energy in a step: {block.material}, steps of {time_step_s} s"
        yield Check(name=name, target=0.0, measured=max(0.0, rise), bound=0.01, unit="%")


def corners(choice: Choice) -> Iterator[Check]:
    """Yield what a flat face does to the corner of a turned box that is pressed on it, however it is triangulated."""
    rng = choice.rng()
    for low_n, high_n in ((0.3, 1.0), (1.0, 5.0), (5.0, 20.0)):
        pressed = [press_corner(rng, float(rng.uniform(low_n, high_n))) for _ in range(20)]
        name = f"20 corners on drawn triangulations, {low_n:g} to {high_n:g} N"
        yield Check(name=f"{name}: largest lateral over normal force", target=0.0,
                    measured=100 * max(each.lateral for each in pressed), bound=0.5, unit="%")  # fmt: skip
        yield Check(name=f"{name}: largest error of the normal force", target=0.0,
                    measured=100 * max(abs(each.excess) for each in pressed), bound=0.5, unit="%")  # fmt: skip


def throws(choice: Choice) -> Iterator[Check]:
    """Yield how far the velocity of blocks changes that are thrown over a plate without friction."""
    rng = choice.rng()
    for speed_m_s in (0.003, 0.01, float(rng.uniform(0.02, 0.2))):
        change = 100 * change_of_velocity(rng, speed_m_s)
        name = f"change of the velocity of a frictionless block at {1e3 * speed_m_s:.3g} mm/s"
        yield Check(name=name, target=0.0, measured=change, bound=0.1, unit="%")


def cycles(choice: Choice) -> Iterator[Check]:
    """Yield the work that friction does in closed cycles of shear and pressure, as a part of what it stores at most."""
    rng = choice.rng()
    for friction in (choice.rubs(0.3), 1.0):
        work_j, stored_j = work_of_cycle_j(rng, friction)
        name = f"energy that friction gives in two closed cycles of shear and pressure, mu {friction:.3g}"
        yield Check(name=name, target=0.0, measured=100 * max(0.0, work_j / stored_j), bound=0.01, unit="%")


def pads(choice: Choice) -> Iterator[Check]:
    """Yield figures of pads that are pressed, dragged and held."""
    for own, own_friction, (x, y, z) in ((SOFT, 0.7, (0.02, 0.015, 0.004)), (FIRM, 0.2, (0.1, 0.1, 0.03))):
        rubber, friction, size = choice.rubber(own), choice.rubs(own_friction), choice.size
        slid = slide_pad((x * size, y * size, z * size), rubber, friction)
        name = f"pad of {rubber.youngs_modulus_pa:g} Pa, mu {friction}"
        yield Check(name=f"{name}: force in full slip over mu N", target=1.0, measured=slid.full, bound=0.01, unit="")
        yield Check(name=f"{name}: largest force over mu N", target=1.0, measured=slid.peak, bound=0.01, unit="")
        yield Check(name=f"{name}: what a minute takes of 90 % of mu N", target=0.0, measured=100 * slid.relaxed,
                    bound=0.1, unit="%")  # fmt: skip


def grips(choice: Choice) -> Iterator[Check]:
    """Yield figures of a box that two pads squeeze and shear: both sides, other steps, other meshes."""
    cells, halved = ((8, 8, 6), (16, 16, 12)) if choice.fine else ((7, 7, 5), (14, 14, 10))
    for own, own_friction in ((SOFT, 0.6), (FIRM, 0.4)):
        rubber, friction = choice.rubber(own), choice.rubs(own_friction)
        name = f"grip of {rubber.youngs_modulus_pa:g} Pa, mu {friction}"
        base = sheared_grip(rubber, friction, cells=cells, size=choice.size)
        yield Check(name=f"{name}: forces on the part that do not cancel", target=0.0,
                    measured=100 * base.unbalanced, bound=1.0, unit="%")  # fmt: skip
        yield Check(
            name=f"{name}: asymmetry of both gels", target=0.0, measured=100 * base.asymmetry, bound=1.0, unit="%"
        )
        for what, other in (
            ("halved step", sheared_grip(rubber, friction, cells=cells, size=choice.size, halved_step=True)),
            ("halved mesh", sheared_grip(rubber, friction, cells=halved, size=choice.size)),
        ):
            change = 100 * float(np.linalg.norm(other.force_n) / np.linalg.norm(base.force_n) - 1)
            yield Check(name=f"{name}: force changes by {what}", target=0.0, measured=change, bound=3.0, unit="%")


def domes(choice: Choice) -> Iterator[Check]:
    """Yield figures of domes on a plate: Hertz, and Cattaneo and Mindlin."""
    for own_radius_m, own in ((0.8, Rubber()), (0.5, SOFT)):
        dome, rubber = choice.dome(own_radius_m), choice.rubber(own)
        name = f"dome of {dome.radius_m} m, {rubber.youngs_modulus_pa:g} Pa"
        pressed = press_dome(dome, rubber)
        yield Check(name=f"{name}: force over Hertz'", target=1.0, measured=pressed.force_n / pressed.hertz_force_n,
                    bound=0.02, unit="")  # fmt: skip
        yield Check(name=f"{name}: radius over Hertz'", target=1.0, measured=pressed.radius_m / pressed.hertz_radius_m,
                    bound=0.02, unit="")  # fmt: skip
        for part in (0.3, 0.6):
            measured, foretold = partial_slip(pressed, rubber, friction=choice.rubs(0.5), part=part)
            yield Check(name=f"{name}: stick radius over a, at {part} mu N", target=foretold, measured=measured,
                        bound=0.05 * foretold, unit="")  # fmt: skip


def beams(choice: Choice) -> Iterator[Check]:
    """Yield how far cantilevers of hexahedra, two cells across, bend against Timoshenko's."""
    rng = choice.rng()
    for poisson_ratio in (0.3, 0.48, 0.4 if choice.poisson_ratio is None else choice.poisson_ratio):
        name = f"deflection of a cantilever, two cells across, over Timoshenko's: nu {poisson_ratio:.3g}"
        yield Check(name=name, target=1.0, measured=bent_over_theory(rng, poisson_ratio, 2), bound=0.05, unit="")


def viscosities(choice: Choice) -> Iterator[Check]:
    """Yield how gels with a viscous branch relax, creep and cost energy against the standard linear solid."""
    rng = choice.rng()
    for poisson_ratio in (0.3, 0.48 if choice.poisson_ratio is None else choice.poisson_ratio):
        for what, measure in VISCOUS.items():
            name = f"viscous block: {what}: nu {poisson_ratio:.3g}"
            yield Check(name=name, target=1.0, measured=measure(rng, poisson_ratio), bound=0.01, unit="")


GROUPS = {
    group.__name__: group
    for group in (
        drifts, accelerations, strains, wedges, jams, energies, corners, throws, cycles, pads, grips, domes, beams,
        viscosities,
    )
}  # fmt: skip


def main() -> None:
    """Print the checks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=GROUPS)
    parser.add_argument("--fine", action="store_true")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--seed", type=int)
    parser.add_argument("--modulus", type=float, help="[Pa]")
    parser.add_argument("--poisson", type=float)
    parser.add_argument("--friction", type=float)
    parser.add_argument("--radius", type=float, help="[m]")
    parser.add_argument("--size", type=float, default=1.0)
    arguments = parser.parse_args()
    choice = Choice(
        youngs_modulus_pa=arguments.modulus, poisson_ratio=arguments.poisson, friction=arguments.friction,
        radius_m=arguments.radius, size=arguments.size, fine=arguments.fine, seed=arguments.seed,
    ).drawn()  # fmt: skip
    checks: list[Check] = []
    for name in arguments.only or GROUPS:
        for check in GROUPS[name](choice):
            verdict = "holds " if check.holds else "FAILS "
            sys.stdout.write(
                f"{verdict} {check.name}: target {check.target:.5g} +- {check.bound:.3g}, "
                f"measured {check.measured:.5g} {check.unit}\n"
            )
            sys.stdout.flush()
            checks.append(check)
    if arguments.json:
        arguments.json.write_text(json.dumps([asdict(check) for check in checks], indent=1) + "\n")
    sys.exit(int(not all(check.holds for check in checks)))


if __name__ == "__main__":
    main()
