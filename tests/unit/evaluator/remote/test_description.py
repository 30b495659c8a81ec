import numpy as np
import pytest
from vitac.evaluator.remote.description import RemoteServer, resize


def server(**fields: object) -> RemoteServer:
    """A section `remote` with the given fields."""
    return RemoteServer.model_validate({"protocol": "openpi", **fields})


def test_observations_go_under_the_names_of_the_server() -> None:
    named = server(observations={"observation/image": {"key": "rgb", "size": [2, 3]}, "state": "relative_motion"})
    assert named.keys == ("rgb", "relative_motion")
    sent = named.names({"rgb": np.full((4, 6, 3), 7, np.uint8), "relative_motion": np.arange(4.0)})
    assert sent["observation/image"].tolist() == [[[7, 7, 7]] * 3] * 2
    assert sent["state"].tolist() == [0, 1, 2, 3]


def test_without_a_map_everything_goes_under_its_own_name() -> None:
    assert server().keys is None
    assert list(server().names({"marker_flow": np.zeros(1)})) == ["marker_flow"]


def test_value_of_another_task_is_left_out() -> None:
    assert server(observations={"a": "rgb", "b": "marker_flow"}).names({"rgb": np.zeros(1)}).keys() == {"a"}


def test_smaller_picture_has_the_mean_of_the_pixels_below_each_new_one() -> None:
    picture = np.array([[0, 10, 20, 30, 40, 50]] * 2, np.uint8)
    assert resize(picture, (1, 2)).tolist() == [[10, 40]]
    assert resize(picture, (1, 4)).tolist() == [[3, 17, 33, 47]]  # (0 + 10 / 2) / 1.5, (10 / 2 + 20) / 1.5, ...


def test_depth_takes_the_nearest_pixel_so_that_no_edge_becomes_a_ramp() -> None:
    depth = np.array([[1.0, 1.0, 1.0, 0.0, 0.0, 0.0]], np.float32)
    assert set(np.unique(resize(depth, (1, 4)))) == {0.0, 1.0}


@pytest.mark.parametrize("size", [(480, 640), (1, 1), (1024, 1024)])
def test_even_picture_stays_even_at_every_size(size: tuple[int, int]) -> None:
    resized = resize(np.full((480, 640, 3), 200, np.uint8), size)
    assert resized.shape == (*size, 3)
    assert (resized == 200).all()


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"protocol": "lerobot"}, "needs a section `policy`"),
        ({"policy": {"type": "act", "path": "/m"}}, "is for lerobot alone"),
    ],
)
def test_what_a_server_loads_is_told_to_those_of_lerobot_alone(fields: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        server(**fields)
