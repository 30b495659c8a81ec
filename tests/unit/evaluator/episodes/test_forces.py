from typing import Any

import pytest
from evaluation_records import make_manifest, make_record
from fake_scene import report
from vitac.envs.fem.scene.report import StepStatus
from vitac.evaluator.episodes.records import ContactForces, EpisodeRecord, result_hash
from vitac.evaluator.episodes.traces import OVER_FORCE_N, ForceTrace


def info(*forces_n: float, status: StepStatus = StepStatus.CONVERGED) -> dict[str, Any]:
    return {"step_reports": [report(status, part_force_n=force_n) for force_n in forces_n]}


def figures(*infos: dict[str, Any]) -> ContactForces:
    trace = ForceTrace()
    for each in infos:
        trace.add(each)
    found = trace.figures()
    assert found is not None
    return found


def test_figures_are_over_all_ipc_steps_of_the_episode() -> None:
    found = figures(info(*range(1, 20)), info(100.0))
    assert (found.part.peak_n, found.part.p95_n) == (100.0, 19.0)
    assert found.part.impulse_n_s == pytest.approx(0.1 * (sum(range(1, 20)) + 100))
    assert [gel.peak_n for gel in found.gels or ()] == [pytest.approx(10025**0.5), 5.0]


def test_an_event_is_a_run_of_ipc_steps_above_the_threshold_also_across_env_steps() -> None:
    found = figures(info(41.0, 39.0, 41.0), info(50.0, 40.0), info(60.0))
    assert (found.over_force_events, found.over_force_n) == (3, OVER_FORCE_N)
    limited = figures(info(8.0, 12.0) | {"force_limit_n": 10.0})
    assert (limited.over_force_events, limited.over_force_n) == (1, 10.0)


def test_a_step_that_is_not_solved_has_no_forces() -> None:
    found = figures(info(3.0), info(1e9, status=StepStatus.NOT_CONVERGED))
    assert found.part.peak_n == 3.0


def test_physics_that_reports_no_steps_leaves_no_forces() -> None:
    trace = ForceTrace()
    trace.add({"is_success": False})
    assert trace.figures() is None


def test_forces_are_beside_what_the_result_hash_covers() -> None:
    plain, manifest = make_record(1), make_manifest()
    forced = EpisodeRecord.model_validate(plain.model_dump() | {"forces": figures(info(3.0))})
    assert "forces" not in plain.model_dump(mode="json")
    assert result_hash(manifest, [forced]) == result_hash(manifest, [plain])
    assert forced.record_digest() != plain.record_digest()
    assert EpisodeRecord.model_validate_json(forced.model_dump_json()) == forced
