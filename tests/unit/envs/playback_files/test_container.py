import gzip
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray
from unpacked_files import unpack
from vitac.envs.playback_files.container import Changes, pack, whole_numbers


def test_header_and_arrays_come_back() -> None:
    given_arrays: dict[str, NDArray[Any] | Changes] = {
        "bytes": np.arange(5, dtype=np.uint8),
        "heights": np.array([[1.5, -2.25]], dtype=np.float32),
        "indices": np.array([[0, 65535, 7]], dtype=np.uint16),
        "nothing": np.zeros((0, 3), dtype=np.float32),
    }
    found = unpack(pack({"name": "Höhe", "goal": -1.5}, given_arrays))
    assert found.header["name"] == "Höhe"
    assert found.header["goal"] == -1.5
    for name, array in given_arrays.items():
        assert isinstance(array, np.ndarray)
        assert found.arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(found.arrays[name], array)


@given(
    arrays.arrays(st.sampled_from([np.int16, np.uint8]), st.tuples(st.integers(1, 6), st.integers(1, 3)), elements=None)
)
def test_changes_add_up_to_the_values_even_where_they_wrap_around(values: np.ndarray) -> None:
    found = unpack(pack({}, {"first": np.zeros(1, np.uint8), "values": Changes(values=values)}))
    np.testing.assert_array_equal(found.arrays["values"], values)


def test_the_same_content_makes_the_same_file() -> None:
    array = np.arange(100, dtype=np.int16)
    assert pack({"a": 1}, {"x": array}) == pack({"a": 1}, {"x": array})


def test_slow_motion_takes_less_room_as_changes() -> None:
    steps = np.cumsum(np.random.default_rng(1).integers(-2, 3, (40, 200)), axis=0).astype(np.int16)
    assert len(pack({}, {"x": Changes(values=steps)})) < 0.7 * len(pack({}, {"x": steps}))


def test_a_file_is_gzip_that_a_browser_unpacks_by_itself() -> None:
    assert gzip.decompress(pack({}, {})).startswith(b"VITACPB1")


def test_a_header_holds_no_number_that_json_lacks() -> None:
    with pytest.raises(ValueError, match="JSON"):
        pack({"goal": float("nan")}, {})


def test_whole_numbers_are_rounded_and_end_at_the_range_of_their_type() -> None:
    values = whole_numbers([-40.0, -0.0014, 0.0016, 40.0], 0.001, np.int16)
    assert values.tolist() == [-32768, -1, 2, 32767]
    assert values.dtype == np.int16
