"""The observables of SAPIEN's pictures; light to import."""

from typing import TYPE_CHECKING

from ...observable import Observable
from ..observables import HasSight
from ..optics import HEIGHT_PX, WIDTH_PX
from .modes import RenderMode

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def rendered_picture(mode: RenderMode) -> Observable[HasSight]:
    """Return the observable of the rig's colour camera as SAPIEN renders it, `rgb_rast` or `rgb_rt`.

    For training and transfer: given to an environment's `observables`, listed by no task. Its bits change with CPU and
    driver. The renderer is made at the first reading.
    """

    def read(scene: HasSight, _: "np.random.Generator") -> "NDArray[np.uint8]":
        from .renderer import make_renderer

        return make_renderer(mode).picture(scene.sight())

    return Observable(
        name=f"rgb_{mode}",
        shape=(HEIGHT_PX, WIDTH_PX, 3),
        dtype="uint8",
        unit="1",
        meaning="Red, green, blue of the same view as `rgb_picture`, with shadows and highlights, on white.",
        read=read,
    )
