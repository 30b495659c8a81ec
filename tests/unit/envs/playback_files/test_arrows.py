import numpy as np
from vitac.envs.fem.contact.forces import PairForces, no_forces
from vitac.envs.playback_files.arrows import PLACES, make_arrows

LEFT, HELD, FIXED = 0, 2, 3


def found(*pairs: tuple[int, int, tuple[float, float, float], tuple[float, float, float]]) -> PairForces:
    return PairForces(
        np.array([pair[:2] for pair in pairs]),
        np.array([pair[2] for pair in pairs]) * 1e-3,
        np.array([pair[3] for pair in pairs]),
    )


def test_an_arrow_of_a_gel_adds_up_its_contacts_whichever_body_comes_first() -> None:
    places_m, forces_n = make_arrows(found((HELD, LEFT, (0, 0, 0), (3, 0, 0)), (LEFT, HELD, (4, 0, 0), (-1, 0, 0))))
    assert forces_n[0].tolist() == [4, 0, 0]
    np.testing.assert_allclose(places_m[0], [1e-3, 0, 0])
    assert not forces_n[1:].any()


def test_contacts_with_the_fixed_part_are_one_arrow_for_each_place() -> None:
    near, far = (0, 0, 0), (10, 0, 0)
    _, forces_n = make_arrows(
        found((HELD, FIXED, near, (0, 0, 1)), (HELD, FIXED, far, (0, 0, 5)), (HELD, FIXED, (0, 1, 0), (0, 0, 2)))
    )
    assert forces_n[2:4].tolist() == [[0, 0, 5], [0, 0, 3]]


def test_nothing_that_touches_is_no_arrow_and_many_places_are_the_strongest() -> None:
    assert not make_arrows(no_forces())[1].any()
    row = [(HELD, FIXED, (5.0 * at, 0.0, 0.0), (0.0, 0.0, float(at))) for at in range(1, 10)]
    assert make_arrows(found(*row))[1][2:, 2].tolist() == [9, 8, 7, 6, 5, 4][:PLACES]
