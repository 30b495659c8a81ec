"""Shows what each structural difference of a twin of class B does to the pictures of its left gel.

Usage: python benchmarks/station/structure.py [--secret TEXT] [--out docs/pictures/twin.png]

The peg is grasped, pressed on the plate beside its hole, slid by 1 mm in half a second, and held for 2 s. A row has the
gel while it is pressed: of a twin without structure, of one with this difference alone as the secret draws it, and what
differs, fivefold; beside them how far the markers have moved apart and both forces on the peg. Light is an hour old,
the camera has no noise.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from vitac.station.description import TwinClass
from vitac.station.perception.markers import cut_picture, find_centres
from vitac.station.twin.bench import PEG_AT, Bench
from vitac.station.twin.grasp import CUBOID_PEG, Axes
from vitac.station.twin.hidden import HiddenSensor, HiddenSettings, TwinSecret, make_twin
from vitac.station.twin.structure import Difference, HiddenStructure

Picture = NDArray[np.uint8]
PICTURE: Final = Path(__file__).parents[2] / "docs" / "pictures" / "twin.png"
_FIVE_BITS: Final = np.uint8(0xF8)
PERIOD_S, OLD_S, GAIN, WIDTH, HEIGHT, LABEL = 0.1, 3600.0, 5, 144, 108, 250
PATH: Final[tuple[tuple[Axes, int], ...]] = (
    (CUBOID_PEG.garage, 1),
    ((4.0, 0.0, -39.8, 0.0), 110),
    ((4.0, 0.0, -40.3, 0.0), 5),
    ((3.0, 0.0, -40.3, 0.0), 5),
    ((3.0, 0.0, -40.3, 0.0), 20),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Seen:
    """A gel while it is pressed, and the force on the peg [N] while it slides and after the rest."""

    picture: Picture
    sliding_n: NDArray[np.float64]
    resting_n: NDArray[np.float64]


def play(structure: HiddenStructure) -> Seen:
    """Play the motion on a twin of public numbers with this structure."""
    bench = Bench(
        hidden=HiddenSettings(left=HiddenSensor(noise=0.0), structure=structure), period_s=PERIOD_S, now_s=OLD_S
    )
    for camera in bench.cameras:
        camera.streams = 1
    driven = _Driven(bench)
    pictures, forces = [], []
    for (start, _), (goal, periods) in pairwise(PATH):
        driven.go(start, goal, periods)
        pictures.append(driven.picture())
        forces.append(driven.force_n())
    return Seen(picture=pictures[1], sliding_n=forces[2], resting_n=forces[3])


class _Driven:
    """A bench whose stage and gripper are where they are put."""

    def __init__(self, bench: Bench) -> None:
        self._bench, self._axes = bench, CUBOID_PEG.garage
        bench.stage.axes = lambda: self._axes  # type: ignore[method-assign]
        bench.gripper.position = lambda: PEG_AT  # type: ignore[method-assign]
        bench.gripper.receive(bytes.fromhex("091003e8000306090000ffff32") + b"\x00\x00")
        bench.held = bench._hold(CUBOID_PEG.garage)

    def go(self, start: Axes, goal: Axes, periods: int) -> None:
        for part in np.linspace(0.0, 1.0, periods + 1)[1:]:
            x, y, z, rotation = (a + part * (b - a) for a, b in zip(start, goal, strict=True))
            self._axes = (x, y, z, rotation)
            self._bench.advance()

    def picture(self) -> Picture:
        jpeg = cv2.imencode(".jpg", self._bench.take(0), [cv2.IMWRITE_JPEG_QUALITY, self._bench.cameras[0].quality])[1]
        return cut_picture(np.asarray(cv2.imdecode(jpeg, cv2.IMREAD_COLOR), np.uint8))

    def force_n(self) -> NDArray[np.float64]:
        return np.asarray(np.mean([self._bench.box.wrench()[:3] for _ in range(100)], axis=0))


def rows(secret: str) -> Iterator[Picture]:
    """Yield a row of pictures for each difference."""
    plain, drawn = play(HiddenStructure()), make_twin(TwinSecret(secret=secret, twin=TwinClass.B)).hidden.structure
    for difference in Difference:
        other = play(HiddenStructure(**{difference: getattr(drawn, difference)}))
        moved_px = compare(plain.picture, other.picture)
        print(f"{difference}: markers {moved_px:.2f} px, {other.sliding_n.round(2)} N, {other.resting_n.round(2)} N")
        apart = cv2.convertScaleAbs(cv2.absdiff(plain.picture, other.picture), alpha=GAIN)
        small = [cv2.resize(each, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA) for each in
                 (plain.picture, other.picture, apart)]  # fmt: skip
        lines = (
            difference,
            f"markers {moved_px:.2f} px apart",
            *(f"{word} {np.linalg.norm(mine):.1f} N (plain {np.linalg.norm(its):.1f})" for word, mine, its in (
                ("sliding", other.sliding_n, plain.sliding_n), ("after 2 s", other.resting_n, plain.resting_n)))
        )  # fmt: skip
        yield np.hstack([_label(lines), *small])


def compare(one: Picture, other: Picture) -> float:
    """Return the median distance of markers from the nearest ones of another picture [pixel]."""
    first, second = find_centres(one), find_centres(other)
    return float(np.median(np.linalg.norm(first[:, None] - second[None], axis=2).min(axis=1)))


def _label(lines: tuple[str, ...]) -> Picture:
    label = np.full((HEIGHT, LABEL, 3), 255, np.uint8)
    for number, line in enumerate(lines):
        cv2.putText(label, line, (8, 24 + 24 * number), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (40, 40, 40), 1, cv2.LINE_AA)
    return label


def main() -> None:
    """Draw all rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--secret", default="a twin to look at")
    parser.add_argument("--out", type=Path, default=PICTURE)
    given = parser.parse_args()
    picture = np.vstack(list(rows(given.secret))) & _FIVE_BITS  # a third of the file
    cv2.imwrite(str(given.out), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main()
