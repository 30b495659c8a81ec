"""Bodies joined to one list of triangles."""

import numpy as np
import pytest
from vitac.envs.vision.surfaces import Body, Label, VerticesDoNotFit, VisibleSurfaces

TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])


def two_bodies() -> VisibleSurfaces:
    return VisibleSurfaces(
        [
            Body(vertex_count=4, triangles=TRIANGLES, label=Label.PEG),
            Body(vertex_count=5, triangles=TRIANGLES[:1], label=Label.LEFT_GEL),
        ]
    )


def test_triangles_count_through_the_bodies_vertices() -> None:
    assert two_bodies().triangles.tolist() == [[0, 1, 2], [0, 2, 3], [4, 5, 6]]
    assert two_bodies().labels.tolist() == [Label.PEG, Label.PEG, Label.LEFT_GEL]


def test_vertices_stand_in_the_order_of_the_bodies() -> None:
    first, second = np.zeros((4, 3)), np.ones((5, 3))
    assert two_bodies().vertices_m([first, second])[:, 0].tolist() == [0.0] * 4 + [1.0] * 5


@pytest.mark.parametrize("counts", [(4,), (4, 4), (5, 4), (4, 5, 4)])
def test_refuses_vertices_of_other_bodies(counts: tuple[int, ...]) -> None:
    with pytest.raises(VerticesDoNotFit, match=r"expected \[\(4, 3\), \(5, 3\)\]"):
        two_bodies().vertices_m([np.zeros((count, 3)) for count in counts])
