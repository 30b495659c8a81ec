import ctypes.util
import os
from pathlib import Path

import pytest
from vitac.evaluator.agent.isolation import cgroup
from vitac.evaluator.agent.isolation.machine import Requirement, requirements, user_namespaces


def by_name(found: list[Requirement], part: str) -> Requirement:
    (requirement,) = [item for item in found if part in item.name]
    return requirement


def sysctl(folder: Path, **values: str) -> Path:
    for name, value in values.items():
        file = folder / name.replace("__", "/")
        file.parent.mkdir(exist_ok=True)
        file.write_text(f"{value}\n")
    return folder


def test_ubuntu_restriction_of_namespaces_is_named(tmp_path: Path) -> None:
    found = user_namespaces(sysctl(tmp_path, kernel__apparmor_restrict_unprivileged_userns="1"))
    requirement = by_name(found, "AppArmor")
    assert not requirement.is_met
    assert "Ubuntu" in requirement.remedy
    assert "apparmor_restrict_unprivileged_userns=0" in requirement.remedy


@pytest.mark.parametrize(
    ("name", "told"),
    [("kernel__unprivileged_userns_clone", "unprivileged_userns_clone=1"), ("user__max_user_namespaces", "15000")],
)
def test_kernel_settings_against_namespaces_are_named(name: str, told: str, tmp_path: Path) -> None:
    unmet = [item for item in user_namespaces(sysctl(tmp_path, **{name: "0"})) if not item.is_met]
    assert [told in item.remedy for item in unmet] == [True]


def test_kernels_without_such_settings_are_fine(tmp_path: Path) -> None:
    assert all(item.is_met and not item.remedy for item in user_namespaces(tmp_path))


def test_missing_bubblewrap_is_needed_and_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VITAC_BWRAP", "/none")
    requirement = by_name(requirements(), "bubblewrap")
    assert (requirement.is_met, requirement.is_needed) == (False, True)
    assert "apt-get install bubblewrap" in requirement.remedy


def test_missing_control_group_is_weaker_but_no_obstacle(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cgroup, "create", lambda limits: None)
    requirement = by_name(requirements(), "control group")
    assert (requirement.is_met, requirement.is_needed) == (False, False)
    assert "Delegate" in requirement.remedy


def test_missing_seccomp_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ctypes.util, "find_library", lambda name: None)
    assert "libseccomp2" in by_name(requirements(), "libseccomp").remedy


@pytest.mark.parametrize(("uid", "looks"), [(0, False), (1000, True)])
def test_namespaces_matter_to_normal_users_only(uid: int, looks: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: uid)
    assert any("AppArmor" in item.name for item in requirements()) is looks
    assert any(item.name == "setpriv" for item in requirements()) is not looks


def test_memory_for_files_is_needed_and_its_remedies_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    assert by_name(requirements(), "memory").is_met
    monkeypatch.setenv("VITAC_MEMORY_DIR", "/proc")
    requirement = by_name(requirements(), "memory")
    assert (requirement.is_met, requirement.is_needed) == (False, True)
    assert "VITAC_MEMORY_DIR" in requirement.remedy
    assert "VITAC_SANDBOX_FILES=disk" in requirement.remedy
