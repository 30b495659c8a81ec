import ctypes.util
import os
import platform
from pathlib import Path

import pytest
from vitac.evaluator.agent.isolation import cgroup, machine, tracing
from vitac.evaluator.agent.isolation.machine import (
    Requirement,
    limits_of_namespaces,
    requirements,
    user_namespaces,
)


def by_name(found: list[Requirement], part: str) -> Requirement:
    (requirement,) = [item for item in found if item.name.startswith(part)]
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


def test_a_kernel_that_lets_no_user_make_namespaces_is_named(tmp_path: Path) -> None:
    found = user_namespaces(sysctl(tmp_path, kernel__unprivileged_userns_clone="0"))
    assert ["unprivileged_userns_clone=1" in item.remedy for item in found if not item.is_met] == [True]


@pytest.mark.parametrize("kind", ["user", "mnt", "pid", "net", "ipc", "uts"])
def test_each_kind_of_namespaces_that_a_hardened_kernel_allows_none_of_is_named(kind: str, tmp_path: Path) -> None:
    settings = {f"user__max_{other}_namespaces": str(100 * (other != kind)) for other in ("user", "mnt", "pid", kind)}
    limits = limits_of_namespaces(("user", "mnt", "pid", "net", "ipc", "uts"), sysctl(tmp_path, **settings))
    assert not limits.is_met
    assert limits.found == f"user.max_{kind}_namespaces: 0"
    assert limits.remedy == f"`sudo sysctl user.max_{kind}_namespaces=15000`"


def test_kernels_without_such_settings_are_fine(tmp_path: Path) -> None:
    found = [*user_namespaces(tmp_path), limits_of_namespaces(("user", "mnt"), tmp_path)]
    assert all(item.is_met and not item.remedy for item in found)


def test_a_container_that_refuses_namespaces_is_told_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert by_name(requirements(), "namespaces made").is_met
    refusing = tmp_path / "bwrap"
    refusing.write_text(
        '#!/bin/sh\ntest "$1" = --version && exit\necho "No permissions to create new namespace" >&2\nexit 1'
    )
    refusing.chmod(0o755)
    monkeypatch.setenv("VITAC_BWRAP", str(refusing))
    monkeypatch.setattr(machine, "_CONTAINER_MARKS", (tmp_path / "mark",))
    requirement = by_name(requirements(), "namespaces made")
    assert (requirement.is_met, requirement.is_needed) == (False, True)
    assert "No permissions to create new namespace" in requirement.found
    assert "setting that is named below" in requirement.remedy
    (tmp_path / "mark").touch()
    assert "seccomp=unconfined" in by_name(requirements(), "namespaces made").remedy


@pytest.mark.parametrize(
    ("release", "is_met"),
    [("5.15.167.4-microsoft-standard-WSL2", True), ("4.4.0-19041-Microsoft", False), ("6.1.0-18-amd64", None)],
)
def test_the_subsystem_for_windows_is_recognised(
    release: str, is_met: bool | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(platform, "release", lambda: release)
    monkeypatch.setattr(cgroup, "create", lambda limits: None)
    found = requirements()
    assert [item.is_met for item in found if "Windows" in item.name] == ([] if is_met is None else [is_met])
    assert any("set-version" in item.remedy for item in found) is (is_met is False)
    assert ("systemd=true" in by_name(found, "control group").remedy) is (is_met is not None)


def test_a_kernel_that_lets_nobody_trace_loads_policies_again(tmp_path: Path) -> None:
    assert tracing.explain_unsupported(tmp_path / "none") == ""
    (tmp_path / "ptrace_scope").write_text("3\n")
    assert tracing.explain_unsupported(tmp_path / "ptrace_scope") == "kernel.yama.ptrace_scope is 3"


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
