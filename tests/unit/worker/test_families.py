import pytest
from vitac.envs.maniskill.abilities import Abilities
from vitac.envs.tasks.definition import Family
from vitac.worker import families

T, STATE, PICTURES, CUDA, _ = Family


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (Abilities(), (T,)),
        (Abilities(physics=True), (T, STATE)),
        (Abilities(physics=True, pictures=True), (T, STATE, PICTURES)),
        (Abilities(physics=True, cuda=True), (T, STATE)),
        (Abilities(physics=True, pictures=True, cuda=True), (T, STATE, PICTURES, CUDA)),
        (Abilities(pictures=True, cuda=True), (T,)),
    ],
)
def test_a_worker_can_run_what_its_machine_has_the_packages_and_drivers_for(
    monkeypatch: pytest.MonkeyPatch, found: Abilities, expected: tuple[Family, ...]
) -> None:
    monkeypatch.setattr(families, "abilities", lambda: found)
    assert families.families_here() == expected
