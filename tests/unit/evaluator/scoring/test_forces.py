from evaluation_records import make_record
from recorded_forces import some_forces
from vitac.evaluator.scoring.score import score, summarize_forces


def test_medians_are_over_the_episodes_that_have_forces() -> None:
    found = summarize_forces([some_forces(10.0), None, some_forces(20.0), some_forces(50.0, events=2)])
    assert found is not None
    assert (found.episodes, found.part.peak_n, found.part.p95_n) == (3, 20.0, 10.0)
    assert (found.over_force_events, found.over_force_episodes) == (2, 1)


def test_a_gel_counts_by_its_more_loaded_side() -> None:
    found = summarize_forces([some_forces(1.0, gels_n=(30.0, 40.0)), some_forces(1.0, gels_n=(50.0, 35.0))])
    assert found is not None
    assert found.gel is not None
    assert found.gel.peak_n == 45.0


def test_a_score_has_forces_where_records_have_them() -> None:
    assert score([make_record(1)]).forces is None
    forces = score([make_record(1), make_record(2, forces=some_forces(7.0))]).forces
    assert forces is not None
    assert (forces.episodes, forces.part.peak_n) == (1, 7.0)
