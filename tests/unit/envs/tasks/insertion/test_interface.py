import numpy as np
import pytest
from vitac.envs.scene.perspective import Perspective
from vitac.envs.tasks.fusion_insertion import definition as fusion
from vitac.envs.tasks.peg_insertion import definition as peg


@pytest.mark.parametrize(
    ("perspective", "offset", "words"),
    [
        (peg.PERSPECTIVE, [1.0, -2.5, 3.0], "offset x +1.00 mm, y −2.50 mm, θ +3.00°"),
        (fusion.PERSPECTIVE, [1.0, -2.5, 3.0, -0.004], "offset x +1.00 mm, y −2.50 mm, θ +3.00°, z +0.00 mm"),
    ],
)
def test_position_is_told_with_every_number_of_the_offset(
    perspective: Perspective, offset: list[float], words: str
) -> None:
    assert perspective.position({"gt_offset_mm_deg": np.array(offset)}) == words


@pytest.mark.parametrize(
    ("perspective", "fixed_name", "goal_mm"),
    [(peg.PERSPECTIVE, "plate, cut open", -0.3), (fusion.PERSPECTIVE, "base, cut open", -1.0)],
)
def test_success_lies_below_the_depth_of_the_task(perspective: Perspective, fixed_name: str, goal_mm: float) -> None:
    progress = perspective.progress
    assert (perspective.fixed_name, progress.goal_mm, progress.goal_is_below) == (fixed_name, goal_mm, True)
    heights_mm = np.array([-0.2, -1.5])
    assert np.array_equal(progress.heights_mm({"peg_relative_z_mm": heights_mm}), heights_mm)
