import pytest
from vitac.envs.tasks.definition import Family
from vitac.worker import families


@pytest.mark.parametrize(
    ("missing", "expected"),
    [(("torch",), (Family.TACTILE,)), ((), (Family.TACTILE, Family.MANISKILL))],
)
def test_a_worker_can_run_what_it_has_the_packages_for(
    monkeypatch: pytest.MonkeyPatch, missing: tuple[str, ...], expected: tuple[Family, ...]
) -> None:
    monkeypatch.setattr(families, "missing_packages", lambda: missing)
    assert families.families_here() == expected
