from enum import StrEnum
from typing import Any

import numpy as np
import pytest
from vitac.envs.tasks.options import (
    ResetOptionsError,
    choice,
    chosen_shapes,
    drawn_shape,
    numbers,
    refuse_unknown,
    seeded_generator,
)
from vitac.envs.tasks.settings import SettingsError


class Side(StrEnum):
    LEFT = "left"
    RIGHT = "right"


def test_unknown_option_names_the_nearest() -> None:
    with pytest.raises(ResetOptionsError, match=r"Toy-v1 has no reset option 'sidee'; did you mean 'side'\?"):
        refuse_unknown("Toy-v1", {"sidee": "left"}, ("side",))
    refuse_unknown("Toy-v1", {"side": "left", "rng_seed": 1}, ("side",))


def test_choice_is_one_of_a_closed_set() -> None:
    assert choice("Toy-v1", "side", "left", Side) is Side.LEFT
    with pytest.raises(ResetOptionsError, match="Toy-v1: option 'side' is 'up', expected one of left, right"):
        choice("Toy-v1", "side", "up", Side)


@pytest.mark.parametrize("value", [None, 1.0, (1.0,), (1.0, 2.0, 3.0), (1.0, float("nan")), ("a", "b")])
def test_numbers_are_so_many_and_finite(value: Any) -> None:
    with pytest.raises(ResetOptionsError, match=r"option 'place_mm' is .*, expected two numbers"):
        numbers("Toy-v1", "place_mm", value, 2, "expected two numbers")
    assert numbers("Toy-v1", "place_mm", (1, np.float32(2)), 2, "expected two numbers") == [1.0, 2.0]


@pytest.mark.parametrize("value", [(), (-1,), "seed", 1.5, (0, "1")])
def test_seed_is_of_non_negative_integers(value: Any) -> None:
    with pytest.raises(ResetOptionsError, match="'rng_seed'"):
        seeded_generator("Toy-v1", value)


def test_the_same_seed_gives_the_same_numbers() -> None:
    assert seeded_generator("Toy-v1", (0, 4)).random() == seeded_generator("Toy-v1", [0, 4]).random()
    assert seeded_generator("Toy-v1", (0, 4)).random() != seeded_generator("Toy-v1", (0, 5)).random()


def test_all_shapes_are_drawn_unless_some_are_named() -> None:
    assert chosen_shapes("Toy-v1", Side, None) == (Side.LEFT, Side.RIGHT)
    assert chosen_shapes("Toy-v1", Side, ["right", "left"]) == (Side.LEFT, Side.RIGHT)
    assert chosen_shapes("Toy-v1", Side, ("right", "right")) == (Side.RIGHT,)
    assert chosen_shapes("Toy-v1", None, None) == ()


@pytest.mark.parametrize("names", [(), ("up",), ("left", "up"), "left", (1,)])
def test_shapes_are_some_of_the_closed_set(names: Any) -> None:
    with pytest.raises(SettingsError, match=r"Toy-v1: argument 'shapes' is .*, expected some of left, right"):
        chosen_shapes("Toy-v1", Side, names)


def test_task_without_shapes_draws_none() -> None:
    with pytest.raises(SettingsError, match="expected some of none"):
        chosen_shapes("Toy-v1", None, ("left",))


def test_shapes_are_drawn_equally_often_by_one_number_each() -> None:
    random, other = np.random.default_rng(1), np.random.default_rng(1)
    drawn = [drawn_shape(tuple(Side), random) for _ in range(400)]
    assert drawn == [list(Side)[number] for number in other.integers(2, size=400)]
    assert 150 < drawn.count(Side.LEFT) < 250
