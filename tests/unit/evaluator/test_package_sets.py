import importlib.util
from pathlib import Path

import pytest
from vitac.evaluator import package_sets
from vitac.evaluator.agent.isolation.packages import installed_packages
from vitac.evaluator.package_sets import (
    PackageSet,
    UnknownPackageSet,
    digest_of_packages,
    locked_versions,
    package_differences,
    shown_sets,
)

ROOT = Path(__file__).parents[3]


@pytest.fixture(autouse=True)
def _no_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("VITAC_POLICY_PACKAGES", raising=False)


def test_policies_see_the_base_and_what_their_track_declares() -> None:
    assert shown_sets() == (PackageSet.BASE,)
    assert shown_sets([PackageSet.TORCH]) == (PackageSet.BASE, PackageSet.TORCH)


def test_organizers_add_a_set_for_every_track(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VITAC_POLICY_PACKAGES", " torch,")
    assert shown_sets() == (PackageSet.BASE, PackageSet.TORCH)
    monkeypatch.setenv("VITAC_POLICY_PACKAGES", "tensorflow")
    with pytest.raises(
        UnknownPackageSet, match=r"VITAC_POLICY_PACKAGES names 'tensorflow', expected base, torch, sb3\."
    ):
        shown_sets()


def test_sets_are_those_of_the_lock_files() -> None:
    spec = importlib.util.spec_from_file_location("written", ROOT / "setup" / "package_sets.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    written = (Path(package_sets.__file__).with_name("package_sets.yaml")).read_text()
    assert written == module.document(), "run setup/package_sets.py"


def test_the_locked_base_is_installed_here() -> None:
    found = installed_packages().versions
    assert package_differences([PackageSet.BASE], found) == ()
    assert found.keys() == locked_versions([PackageSet.BASE]).keys()


def test_each_difference_is_named() -> None:
    found = dict(installed_packages().versions) | {"numpy": "2.5.0", "rich": "15.0.0+local"}
    del found["numba"]
    assert package_differences([PackageSet.BASE], found) == (
        "numba is not installed, expected 0.68.1",
        "numpy is 2.5.0, expected 2.4.6",
    )


def test_digest_is_that_of_names_and_versions() -> None:
    assert digest_of_packages({"a": "1", "b": "2"}) == digest_of_packages({"b": "2", "a": "1"})
    assert digest_of_packages({"a": "1"}) != digest_of_packages({"a": "1.0"})
