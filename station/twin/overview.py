"""What an overview camera sees of a twin: stage, gripper, plate or lock from the side, and the screen with the code."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from ..description import StationTask
from .grasp import HOLE, Axes, Mounted
from .pictures import Picture
from .stage import StageTwin

_WIDTH, _HEIGHT = 640, 480
_GROUND, _PART, _ARM, _HELD = (58, 54, 50), (150, 140, 130), (90, 90, 96), (60, 130, 200)
_MIDDLE_X, _RIM = 280, 400
_PX_PER_MM: Final = 4.0
_SCREEN: Final = (440, 20, 190)
"""Left edge, upper edge and size of the screen [px]; before a lock it would hide the gripper in the garage."""
_SCREEN_OF_LOCK: Final = (20, 20, 190)
_NOISE: Final = 4
_GRIP: Final = 80
"""Middle of the gels above the lower end of a peg, or the middle of a key [px]."""

Rectangle = tuple[int, int, int, int]
"""Left, upper, right and lower edge [px]."""
_PLATE: Final = ((0, _RIM, _MIDDLE_X - 8, _HEIGHT), (_MIDDLE_X + 8, _RIM, _WIDTH, _HEIGHT))
_LOCK: Final = ((0, _RIM - 180, 184, _RIM - 136), (0, _RIM - 56, 184, _RIM))
"""Above and below its channel."""
_PEG: Final = ((-7, -10, 7, 80),)
_KEY: Final = ((-270, -20, -30, 20), (-30, -40, 30, 40))
"""Shaft and handle."""


class OverviewTwin:
    """Draws the platform as its stage stands."""

    def __init__(
        self, stage: StageTwin, find_part: Callable[[], Axes | None], mounted: Mounted, code_picture: Path
    ) -> None:
        """Look at a stage and at the picture with the code; `find_part` says where peg or key is."""
        self._stage, self._find_part, self._code_picture = stage, find_part, code_picture
        is_lock = mounted.task is StationTask.LOCK
        self._fixed: Sequence[Rectangle] = _LOCK if is_lock else _PLATE
        self._part: Sequence[Rectangle] = _KEY if is_lock else _PEG
        self._screen = _SCREEN_OF_LOCK if is_lock else _SCREEN
        self._generator = np.random.default_rng(0)

    def __call__(self) -> Picture:
        """Return the next picture, blue first."""
        import cv2

        picture = np.full((_HEIGHT, _WIDTH, 3), _GROUND, np.uint8)
        _draw(picture, self._fixed, (0, 0), _PART)
        if (part_at := self._find_part()) is not None:
            _draw(picture, self._part, _find_pixel(part_at), _HELD)
        arm = ((-24, -40, -9, 35), (9, -40, 24, 35), (-40, -110, 40, -40))
        _draw(picture, arm, _find_pixel(self._stage.axes()), _ARM)
        self._show_code(picture)
        noise = self._generator.integers(0, _NOISE, picture.shape, dtype=np.uint8)
        return np.asarray(cv2.add(picture, noise), dtype=np.uint8)

    def _show_code(self, picture: Picture) -> None:
        import cv2

        code = cv2.imread(str(self._code_picture)) if self._code_picture.exists() else None
        if code is not None:
            left, upper, size = self._screen
            shown = cv2.resize(code, (size, size), interpolation=cv2.INTER_AREA)
            picture[upper : upper + size, left : left + size] = shown


def _find_pixel(at: Axes) -> tuple[int, int]:
    """Return where the gripper is seen that stands at a pose of the stage."""
    x_mm, _, z_mm, _ = at
    return round(_MIDDLE_X + _PX_PER_MM * x_mm), round(_RIM - _GRIP - _PX_PER_MM * (z_mm - HOLE[2]))


def _draw(picture: Picture, rectangles: Sequence[Rectangle], at: tuple[int, int], colour: tuple[int, int, int]) -> None:
    import cv2

    x, y = at
    for left, upper, right, lower in rectangles:
        cv2.rectangle(picture, (x + left, y + upper), (x + right, y + lower), colour, -1)
