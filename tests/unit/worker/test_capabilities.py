from pathlib import Path

import pytest
from cubes_track import FILE
from vitac.envs.maniskill.abilities import Abilities
from vitac.envs.tasks.definition import Family
from vitac.evaluator.agent.isolation.packages import PolicyPackages
from vitac.evaluator.isolation_kinds import IsolationKind
from vitac.evaluator.package_sets import PackageSet, locked_versions
from vitac.evaluator.tracks.registry import find_version
from vitac.evaluator.version import evaluator_version
from vitac.server.queue.work import name_requirement
from vitac.server.queue.workers import explain_other_evaluator, explain_other_tracks
from vitac.worker import capabilities


@pytest.fixture(autouse=True)
def cubes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A track of ManiSkill beside ours, on a machine that can run it."""
    (tmp_path / "cubes.yaml").write_text(FILE)
    monkeypatch.setenv("VITAC_TRACKS_DIR", str(tmp_path))
    monkeypatch.setattr(capabilities, "abilities", lambda: Abilities(physics=True, pictures=True))


def install(monkeypatch: pytest.MonkeyPatch, **other: str) -> None:
    """Installs the locked packages, and some in another version."""

    def found(declared: tuple[PackageSet, ...]) -> PolicyPackages:
        locked = locked_versions([PackageSet.BASE, *declared])
        return PolicyPackages(versions={name: versions[0] for name, versions in locked.items()} | other, binds=())

    monkeypatch.setattr(capabilities, "installed_packages", found)
    monkeypatch.setenv("VITAC_SANDBOX_FILES", "memory")


@pytest.mark.slow
def test_a_worker_with_the_declared_packages_takes_shards_of_all_tracks(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, torch="2.13.0+cpu")
    assert capabilities.explain_unfit({}) == ""
    assert capabilities.fit_families() == (Family.TACTILE, Family.MANISKILL, Family.MANISKILL_PICTURES)
    assert name_requirement(find_version("cubes"), Family.MANISKILL) in capabilities.list_abilities()


def test_a_worker_with_another_torch_takes_shards_of_the_tracks_that_show_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    install(monkeypatch, torch="2.12.0")
    assert capabilities.explain_unfit({}) == (
        "Takes no shards of maniskill: its policies would see other packages than it declares: torch is 2.12.0, "
        "expected 2.13.0. Install the expected versions beside the worker and start it again."
    )
    assert capabilities.fit_families() == (Family.TACTILE,)
    abilities = capabilities.list_abilities()
    assert name_requirement(evaluator_version()) in abilities
    assert name_requirement(evaluator_version(), Family.MANISKILL) not in abilities
    assert name_requirement(find_version("cubes"), Family.MANISKILL) in abilities


@pytest.mark.parametrize("here", ["other", "none"])
def test_a_worker_whose_track_file_is_not_the_services_says_which(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, here: str
) -> None:
    install(monkeypatch)
    declared = {"": evaluator_version(), "track_1": evaluator_version(), "cubes": find_version("cubes")}
    assert explain_other_tracks(declared) == {}
    monkeypatch.delenv("VITAC_TRACKS_DIR")
    if here == "other":
        folder = tmp_path / "of_the_worker"
        folder.mkdir()
        (folder / "cubes.yaml").write_text(FILE.replace("title:", "title: Other", 1))
        monkeypatch.setenv("VITAC_TRACKS_DIR", str(folder))
    assert explain_other_evaluator(declared) is None
    assert list(explain_other_tracks(declared)) == ["cubes"]
    said = capabilities.explain_unfit(declared)
    got = find_version("cubes") if here == "other" else "none"
    assert f"cubes: the service has version {declared['cubes']} of it, this worker {got}." in said
    assert "VITAC_TRACKS_DIR" in said


def test_a_service_that_has_declared_nothing_takes_every_worker() -> None:
    assert explain_other_evaluator({}) is None
    assert explain_other_tracks({}) == {}


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
    monkeypatch.setattr(capabilities, "abilities", lambda: found)
    assert capabilities.families_here() == expected


def test_a_worker_whose_sandboxes_read_the_disk_takes_no_shards_of_sealed_lists_and_says_which_setting_it_needs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    install(monkeypatch)
    sealed = name_requirement(evaluator_version(), sealed=True)
    assert sealed in capabilities.list_abilities()
    monkeypatch.setenv("VITAC_SANDBOX_FILES", "disk")
    assert sealed not in capabilities.list_abilities()
    assert name_requirement(evaluator_version()) in capabilities.list_abilities()
    assert "sealed lists: expected VITAC_SANDBOX_FILES to be memory, got disk" in capabilities.explain_unfit({})


def test_a_worker_that_declares_a_gpu_takes_images_that_need_one_beside_all_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    install(monkeypatch)
    requirement = name_requirement(evaluator_version(), sealed=True, needs_gpu=True)
    others = capabilities.list_abilities()
    assert requirement not in others
    assert {requirement, *others} < set(capabilities.list_abilities(has_gpu=True))


@pytest.mark.parametrize("has_vm", [True, False])
def test_a_worker_takes_stages_with_isolation_vm_where_a_policy_can_answer_under_it(
    monkeypatch: pytest.MonkeyPatch, has_vm: bool
) -> None:
    install(monkeypatch)
    monkeypatch.setattr(capabilities, "_has_kind", lambda kind: has_vm)
    requirement = name_requirement(evaluator_version(), isolation=IsolationKind.VM)
    assert (requirement in capabilities.list_abilities()) is has_vm
    assert name_requirement(evaluator_version(), isolation=IsolationKind.NAMESPACES) in capabilities.list_abilities()
