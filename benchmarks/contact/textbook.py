"""The contact model arena-1 against textbooks, on materials and shapes that no task has: target, measured, verdict.

Usage: python benchmarks/contact/textbook.py [--only GROUP ...] [--fine] [--json FILE]

Prints a line for each check as soon as it is known. `--fine` takes the mesh on which Hertz' and Mindlin's figures hold,
which takes minutes; without it the domes are coarse. Exit code 1 where a measured value is beyond its bound.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "support" / "physics"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from contact.elastic import Dome, Rubber, partial_slip, press_dome, sheared_grip, slide_pad
from contact.rigid import (
    Block,
    incline_acceleration_error,
    incline_drift_m,
    largest_rise_of_energy,
    rigid_strain,
    wedging_friction,
)

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


def drifts(_: bool) -> Iterator[Check]:
    """Yield how far blocks drift at 90 % of what friction holds."""
    for block, friction, seconds, time_step_s in (
        (CUBE, 0.5, 10.0, 0.01), (HEXAGON, 0.15, 60.0, 0.1), (TRIANGLE, 0.8, 60.0, 0.2), (CUBE, 0.3, 10.0, 0.005),
        (CUBE, 0.5, 60.0, 0.05), (CUBE, 0.5, 60.0, 0.5),
    ):  # fmt: skip
        drift_um = 1e6 * incline_drift_m(block, friction, 0.9, seconds, time_step_s)
        name = (
            f"drift on an incline at 90 %: {block.material}, mu {friction}, {seconds:g} s in steps of {time_step_s} s"
        )
        yield Check(name=name, target=0.0, measured=drift_um, bound=10.0, unit="um")


def accelerations(_: bool) -> Iterator[Check]:
    """Yield errors of the acceleration of blocks above the friction angle."""
    for block, friction, slope, time_step_s in (
        (CUBE, 0.3, 0.5, 0.01), (HEXAGON, 0.15, 0.25, 0.005), (TRIANGLE, 0.6, 1.2, 0.002),
    ):  # fmt: skip
        error = 100 * incline_acceleration_error(block, friction, slope, time_step_s)
        name = f"acceleration on an incline: {block.material}, mu {friction}, slope {slope}, steps of {time_step_s} s"
        yield Check(name=name, target=0.0, measured=error, bound=1.0, unit="%")


def strains(_: bool) -> Iterator[Check]:
    """Yield how far parts give way that should be rigid, under 50 N."""
    for block, time_step_s in ((CUBE, 0.1), (CUBE, 0.001), (HEXAGON, 0.1), (TRIANGLE, 0.02)):
        percent = 100 * rigid_strain(block, 50.0, time_step_s)
        name = f"strain of a rigid part: {block.material}, 50 N, steps of {time_step_s} s"
        yield Check(name=name, target=0.0, measured=percent, bound=0.02, unit="%")


def wedges(_: bool) -> Iterator[Check]:
    """Yield from which friction a peg wedges: the line between its touches lies within both cones (Whitney 1982)."""
    for steepness in (0.25, 0.5, 1.0):
        name = f"friction from which a peg wedges, touching {steepness} of the gap apart in height"
        measured = wedging_friction(steepness)
        yield Check(name=name, target=steepness, measured=measured, bound=0.03 * steepness, unit="")


def energies(_: bool) -> Iterator[Check]:
    """Yield how far the energy of blocks rises that slide to rest."""
    for block, friction, time_step_s in ((CUBE, 0.3, 0.01), (HEXAGON, 0.15, 0.005)):
        rise = 100 * largest_rise_of_energy(block, friction, time_step_s)
        name = f"largest rise of energy in a step: {block.material}, steps of {time_step_s} s"
        yield Check(name=name, target=0.0, measured=max(0.0, rise), bound=0.01, unit="%")


def pads(_: bool) -> Iterator[Check]:
    """Yield figures of pads that are pressed, dragged and held."""
    for rubber, friction, size_m in ((SOFT, 0.7, (0.02, 0.015, 0.004)), (FIRM, 0.2, (0.1, 0.1, 0.03))):
        slid = slide_pad(size_m, rubber, friction)
        name = f"pad of {rubber.youngs_modulus_pa:g} Pa, mu {friction}"
        yield Check(name=f"{name}: force in full slip over mu N", target=1.0, measured=slid.full, bound=0.01, unit="")
        yield Check(name=f"{name}: largest force over mu N", target=1.0, measured=slid.peak, bound=0.01, unit="")
        yield Check(name=f"{name}: what a minute takes of 90 % of mu N", target=0.0, measured=100 * slid.relaxed,
                    bound=0.1, unit="%")  # fmt: skip


def grips(fine: bool) -> Iterator[Check]:
    """Yield figures of a box that two pads squeeze and shear: both sides, other steps, other meshes."""
    cells, halved = ((8, 8, 6), (16, 16, 12)) if fine else ((6, 6, 4), (12, 12, 8))
    for rubber, friction in ((SOFT, 0.6), (FIRM, 0.4)):
        name, base = (
            f"grip of {rubber.youngs_modulus_pa:g} Pa, mu {friction}",
            sheared_grip(rubber, friction, cells=cells),
        )
        yield Check(name=f"{name}: forces on the part that do not cancel", target=0.0,
                    measured=100 * base.unbalanced, bound=1.0, unit="%")  # fmt: skip
        yield Check(
            name=f"{name}: asymmetry of both gels", target=0.0, measured=100 * base.asymmetry, bound=1.0, unit="%"
        )
        for what, other in (
            ("halved step", sheared_grip(rubber, friction, cells=cells, halved_step=True)),
            ("halved mesh", sheared_grip(rubber, friction, cells=halved)),
        ):
            change = 100 * float(np.linalg.norm(other.force_n) / np.linalg.norm(base.force_n) - 1)
            yield Check(name=f"{name}: force changes by {what}", target=0.0, measured=change, bound=3.0, unit="%")


def domes(fine: bool) -> Iterator[Check]:
    """Yield figures of domes on a plate: Hertz, and Cattaneo and Mindlin."""
    for dome, rubber in (
        (Dome(cells=16 if fine else 8), Rubber()), (Dome(radius_m=0.5, touching_m=0.03, cells=16 if fine else 8), SOFT)
    ):  # fmt: skip
        name = f"dome of {dome.radius_m} m, {rubber.youngs_modulus_pa:g} Pa"
        pressed = press_dome(dome, rubber)
        yield Check(name=f"{name}: force over Hertz'", target=1.0, measured=pressed.force_n / pressed.hertz_force_n,
                    bound=0.02, unit="")  # fmt: skip
        yield Check(name=f"{name}: radius over Hertz'", target=1.0, measured=pressed.radius_m / pressed.hertz_radius_m,
                    bound=0.02, unit="")  # fmt: skip
        for part in (0.3, 0.6):
            measured, foretold = partial_slip(pressed, rubber, friction=0.5, part=part)
            yield Check(name=f"{name}: stick radius over a, at {part} mu N", target=foretold, measured=measured,
                        bound=0.05 * foretold, unit="")  # fmt: skip


GROUPS = {group.__name__: group for group in (drifts, accelerations, strains, wedges, energies, pads, grips, domes)}


def main() -> None:
    """Print the checks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=GROUPS)
    parser.add_argument("--fine", action="store_true")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    checks: list[Check] = []
    for name in arguments.only or GROUPS:
        for check in GROUPS[name](arguments.fine):
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
