"""Figures of sensors that nobody has measured."""

from vitac.evaluator.figures.figures import (
    GraspFigures,
    SensitivityMap,
    StartFigures,
    Symmetric,
    TouchFigures,
    Variation,
)

TOUCH = TouchFigures(
    sensitivity=SensitivityMap(x_mm=(0.0,), y_mm=(0.0,), normal_px_n=((2.0,),), shear_px_n=((None,),)),
    normal_px_n=2.0,
    shear_px_n=9.0,
    pin_mm=4.0,
    edge_mm=(3.0, 2.0),
)
GRASP = GraspFigures(indentation_mm=0.9, force_n=25.0, smallest_det_f=0.8)


def diagonal(xx: float, yy: float, tt: float) -> Symmetric:
    return xx, 0.0, 0.0, yy, 0.0, tt


def start(episode: int, *, won: bool, det_f: float = 0.7, cpu_s: float = 0.1) -> StartFigures:
    return StartFigures(
        episode=episode,
        information=tuple(diagonal(k, k, k) for k in (1.0, 2.0, 3.0)),
        smallest_det_f=det_f,
        successes={Variation.NONE: True, Variation.NOISE: won},
        cpu_s=cpu_s,
    )
