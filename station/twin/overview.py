"""What an overview camera sees of a twin: stage, gripper and plate from the side, and the screen with the code."""

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from .pictures import Picture
from .stage import StageTwin

_WIDTH, _HEIGHT = 640, 480
_GROUND, _PLATE, _ARM, _PEG = (58, 54, 50), (150, 140, 130), (90, 90, 96), (60, 130, 200)
_RIM: Final = 400
_PX_PER_MM: Final = 4.0
_SCREEN: Final = (440, 20, 190)
"""Left edge, upper edge and size of the screen [px]."""
_NOISE: Final = 4


class OverviewTwin:
    """Draws the platform as its stage stands."""

    def __init__(self, stage: StageTwin, is_held: Callable[[], bool], hole_z_mm: float, code_picture: Path) -> None:
        """Look at a stage and at the picture with the code; `is_held` says whether the gripper has a peg."""
        self._stage, self._is_held, self._hole_z_mm, self._code_picture = stage, is_held, hole_z_mm, code_picture
        self._generator = np.random.default_rng(0)

    def __call__(self) -> Picture:
        """Return the next picture, blue first."""
        import cv2

        picture = np.full((_HEIGHT, _WIDTH, 3), _GROUND, np.uint8)
        x_mm, _, z_mm, _ = self._stage.axes()
        x, tip = round(280 + _PX_PER_MM * x_mm), round(_RIM - _PX_PER_MM * (z_mm - self._hole_z_mm))
        cv2.rectangle(picture, (0, _RIM), (_WIDTH, _HEIGHT), _PLATE, -1)
        cv2.rectangle(picture, (272, _RIM), (288, _HEIGHT), _GROUND, -1)
        if self._is_held():
            cv2.rectangle(picture, (x - 7, tip - 90), (x + 7, tip), _PEG, -1)
        for side in (-1, 1):
            cv2.rectangle(picture, (x + side * 9, tip - 120), (x + side * 24, tip - 45), _ARM, -1)
        cv2.rectangle(picture, (x - 40, max(tip - 190, 0)), (x + 40, tip - 120), _ARM, -1)
        self._show_code(picture)
        noise = self._generator.integers(0, _NOISE, picture.shape, dtype=np.uint8)
        return np.asarray(cv2.add(picture, noise), dtype=np.uint8)

    def _show_code(self, picture: Picture) -> None:
        import cv2

        code = cv2.imread(str(self._code_picture)) if self._code_picture.exists() else None
        if code is not None:
            left, upper, size = _SCREEN
            shown = cv2.resize(code, (size, size), interpolation=cv2.INTER_AREA)
            picture[upper : upper + size, left : left + size] = shown
