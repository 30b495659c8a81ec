"""Identifies twins of drawn settings, and prints how far the estimates are from what they hide.

Usage: python benchmarks/station/identification.py --twin A|B [--secrets TEXT ...]

Of each twin: the error of each number and whether its interval holds the true one (of a twin of class B both are
effective values), and the largest distance between where the fitted and the true camera see the same place of a print
that is off as a whole. Frictions and modulus are asked within 10 and 20 %, cameras within 1 and 2 pixels.
"""

import argparse
import os
from collections.abc import Iterator
from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from vitac.evaluator.strict_model import validate
from vitac.station.description import StationDescription, TwinClass
from vitac.station.eyes import open_station
from vitac.station.identification.station import IdentifiedStation, identify
from vitac.station.twin.gel_view import print_off, see_through_lens
from vitac.station.twin.hidden import HiddenSettings, TwinSecret, make_twin
from vitac.station.twin.laboratory import twin_process

NAMES = ("youngs_modulus_pa", "gel_friction", "plate_friction", "poisson_ratio", "indentation_mm")
PLACES_PX = np.stack(np.meshgrid(np.linspace(10, 310, 13), np.linspace(10, 230, 10)), axis=-1).reshape(-1, 2)


def compare(found: IdentifiedStation, hidden: HiddenSettings) -> Iterator[str]:
    """Yield a line for each number."""
    for name in NAMES:
        estimate, true = found.estimates[name], getattr(hidden, name)
        holds = estimate.low <= true <= estimate.high
        seen = "" if estimate.seen else ", not seen"
        yield f"{name}: {estimate.value:.4g}, true {true:.4g}, {estimate.value / true - 1:+.1%}, interval {holds}{seen}"
    for side in ("left", "right"):
        fitted = see_through_lens(getattr(found.settings, side), _printed_px(found.settings))
        true = see_through_lens(getattr(hidden, side), _printed_px(hidden))
        yield f"{side} camera: {np.linalg.norm(fitted - true, axis=1).max():.2f} px"


def _printed_px(hidden: HiddenSettings) -> NDArray[np.float64]:
    """Return where the print puts what belongs to some places; what it scatters is no camera's."""
    off = hidden.structure.print
    if off is None:
        return PLACES_PX
    return print_off(off.model_copy(update={"scatter_px": 0.0}), PLACES_PX, np.random.default_rng(0))


def main() -> None:
    """Identify all twins."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--twin", type=TwinClass, default=TwinClass.A)
    parser.add_argument("--secrets", nargs="+", default=["1", "2", "3", "4", "5"])
    given = parser.parse_args()
    for secret in given.secrets:
        twin = make_twin(TwinSecret(secret=secret, twin=given.twin))
        started_s = perf_counter()
        with twin_process(twin.hidden, mark=twin.mark) as running:
            description = validate(StationDescription, running.description, "twin")
            with open_station(description) as station:
                found = identify(station)
        load = os.getloadavg()[0]
        print(f"{secret}, {twin.mark}: {perf_counter() - started_s:.0f} s, load {load:.0f}, misfit {found.misfit:.2f}")
        for line in compare(found, twin.hidden):
            print(f"  {line}", flush=True)


if __name__ == "__main__":
    main()
