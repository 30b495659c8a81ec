"""Sizes of pictures, intrinsics of the rig's cameras (challenge-facts 4.5, 15); light to import, for observables."""

from typing import NamedTuple

HEIGHT_PX = 480
WIDTH_PX = 640
POINTS_PER_OBJECT = 128
TACTILE_HEIGHT_PX = 240
TACTILE_WIDTH_PX = 320


class Intrinsics(NamedTuple):
    """Focal lengths and principal point [px]; a tuple, so that kernels take it."""

    focal_u_px: float
    focal_v_px: float
    centre_u_px: float
    centre_v_px: float


COLOUR_INTRINSICS = Intrinsics(604.3075, 604.3075, 317.2341, 233.7944)
INFRARED_INTRINSICS = Intrinsics(595.8051, 595.8051, 315.0403, 246.2687)
