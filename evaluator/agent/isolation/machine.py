"""What a machine needs to isolate policies, and what to do where it is missing; `vitac doctor` prints it."""

import ctypes.util
import os
import platform
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ..limits import Limits
from ..verdicts import SandboxFailed
from . import bubblewrap, cgroup, gvisor, tracing
from .bubblewrap import UserIsolation
from .memory_files import FILES_VARIABLE, memory_folder

_SYSCTL: Final = Path("/proc/sys")
_NAMESPACES: Final = ("mnt", "pid", "net", "ipc", "uts")
"""Kinds of namespaces that every sandbox needs, as the kernel's settings name them."""
_CONTAINER_MARKS: Final = (Path("/.dockerenv"), Path("/run/.containerenv"))
"""Files by which Docker and Podman mark a container."""
_DEADLINE_S: Final = 10.0


@dataclass(frozen=True, kw_only=True)
class Requirement:
    """One thing that was looked for on this machine."""

    name: str
    found: str
    remedy: str
    """What to do; empty where it is met."""
    is_needed: bool = True
    """False where something else stands in for it, or may do so."""

    @property
    def is_met(self) -> bool:
        """Whether there is nothing to do."""
        return not self.remedy


def requirements() -> list[Requirement]:
    """Look for everything; nothing is started but bubblewrap, with a program that does nothing."""
    needed = [_bubblewrap(), _seccomp(), *_programs(), _memory(), _control_group(), _frozen_copies(), _gvisor()]
    if needed[0].is_met:
        needed.append(_namespaces())
    is_user = bubblewrap.current_user_isolation() is UserIsolation.USER_NAMESPACE
    needed.append(limits_of_namespaces(("user", *_NAMESPACES) if is_user else _NAMESPACES))
    if is_user:
        needed += user_namespaces()
    return [*needed, *subsystem_for_windows(platform.release())]


def explain_no_namespaces() -> str:
    """Return why this machine cannot isolate a policy, by isolating a program that does nothing; empty where it can."""
    try:
        command = bubblewrap.empty_command()
        subprocess.run(  # noqa: S603 - the program that runs every policy
            command, capture_output=True, text=True, check=True, timeout=_DEADLINE_S
        )
    except SandboxFailed as error:
        return str(error)
    except subprocess.CalledProcessError as error:
        return f"bubblewrap says: {error.stderr.strip() or f'exit code {error.returncode}'}"
    except (OSError, subprocess.SubprocessError) as error:
        return f"bubblewrap could not be run: {error}"
    return ""


def _namespaces() -> Requirement:
    reason = explain_no_namespaces()
    remedy = (
        "change the setting that is named below; where none is, the kernel has no namespaces, or this is a chroot, "
        "where only root may make them"
    )
    if any(mark.exists() for mark in _CONTAINER_MARKS):
        remedy = (
            "the container's engine refuses them: start it with `--security-opt seccomp=unconfined --security-opt "
            "apparmor=unconfined --security-opt systempaths=unconfined`"
        )
    return Requirement(
        name="namespaces made for a sandbox", found=reason.rstrip(".") or "all", remedy=remedy if reason else ""
    )


def limits_of_namespaces(kinds: Sequence[str], sysctl: Path = _SYSCTL) -> Requirement:
    """Look for kinds of namespaces of which the kernel allows none, as hardened ones do."""
    limits = [sysctl / f"user/max_{kind}_namespaces" for kind in kinds]
    none_of = [f"user.{limit.name}" for limit in limits if limit.exists() and limit.read_text().strip() == "0"]
    return Requirement(
        name="namespaces are not limited to none",
        found=", ".join(f"{name}: 0" for name in none_of) or "none is 0",
        remedy=f"`sudo sysctl {' '.join(f'{name}=15000' for name in none_of)}`" if none_of else "",
    )


def subsystem_for_windows(release: str) -> list[Requirement]:
    """Recognise the Windows Subsystem for Linux by its kernel's release; its first version has no Linux kernel."""
    if "microsoft" not in release.lower():
        return []
    remedy = "" if "WSL2" in release else "WSL 1 has no namespaces: `wsl --set-version DISTRIBUTION 2` in Windows"
    return [Requirement(name="Windows Subsystem for Linux 2", found=release, remedy=remedy)]


def user_namespaces(sysctl: Path = _SYSCTL) -> list[Requirement]:
    """Look for settings of the kernel that keep a normal user from making namespaces."""
    return [
        _setting(
            sysctl / "kernel/apparmor_restrict_unprivileged_userns",
            bad="1",
            name="AppArmor lets every program make namespaces",
            is_needed=False,  # bwrap may have a profile of its own that allows it; the attempts tell
            remedy="Ubuntu 23.10 and later: `sudo sysctl kernel.apparmor_restrict_unprivileged_userns=0`, or give "
            "bwrap an AppArmor profile with the rule `userns,`",
        ),
        _setting(
            sysctl / "kernel/unprivileged_userns_clone",
            bad="0",
            name="the kernel lets users make namespaces",
            remedy="`sudo sysctl kernel.unprivileged_userns_clone=1`",
        ),
    ]


def _setting(file: Path, *, bad: str, name: str, remedy: str, is_needed: bool = True) -> Requirement:
    value = file.read_text().strip() if file.exists() else "not there"
    missing = remedy if value == bad else ""
    return Requirement(name=name, found=f"{file.name}: {value}", remedy=missing, is_needed=is_needed)


def _bubblewrap() -> Requirement:
    try:
        program = bubblewrap.find_program()
        version = subprocess.run(  # noqa: S603 - the program that runs every policy
            [str(program), "--version"], capture_output=True, text=True, check=True, timeout=_DEADLINE_S
        ).stdout.strip()
    except (SandboxFailed, OSError, subprocess.SubprocessError) as error:
        return Requirement(name="bubblewrap", found="none", remedy=str(error))
    return Requirement(name="bubblewrap", found=f"{version}, {program}", remedy="")


def _seccomp() -> Requirement:
    library = ctypes.util.find_library("seccomp")
    return Requirement(
        name="libseccomp",
        found=library or "none",
        remedy="" if library else "install libseccomp (Debian, Ubuntu: `apt-get install libseccomp2`)",
    )


def _programs() -> list[Requirement]:
    names = ["prlimit", "unshare"]
    if bubblewrap.current_user_isolation() is UserIsolation.ROOT:
        names.append("setpriv")
    needed = [_program(name, Path("/usr/bin", name), is_needed=True) for name in names]
    program = shutil.which("nsenter")
    return [*needed, _program("nsenter", Path(program) if program else None, is_needed=False)]


def _program(name: str, path: Path | None, *, is_needed: bool) -> Requirement:
    is_met = path is not None and os.access(path, os.X_OK)
    return Requirement(
        name=name,
        is_needed=is_needed,
        found=str(path) if is_met else "none",
        remedy="" if is_met else "install util-linux",
    )


def _memory() -> Requirement:
    try:
        folder = memory_folder()
    except SandboxFailed as error:
        remedy = f"{str(error).removesuffix('.')}, or set {FILES_VARIABLE}=disk where no list is sealed"
        return Requirement(name="memory for files", found="none", remedy=remedy)
    free_mib = shutil.disk_usage(folder).free >> 20
    return Requirement(name="memory for files", found=f"{folder}, {free_mib} MiB free", remedy="")


def _control_group() -> Requirement:
    remedy = "run as a service with `Delegate=yes`, or start with `systemd-run --user --scope -p Delegate=yes`"
    if subsystem_for_windows(platform.release()):
        remedy += "; under WSL 2 both need `systemd=true` below `[boot]` in /etc/wsl.conf, and `wsl --shutdown`"
    group = cgroup.create(Limits())
    if group is not None:
        group.remove()
        return Requirement(name="control group", is_needed=False, found=str(group.isolation), remedy="")
    return Requirement(
        name="control group", is_needed=False, found="none; a watchdog looks at memory instead", remedy=remedy
    )


def _gvisor() -> Requirement:
    try:
        program, remedy = str(gvisor.find_program()), ""
    except SandboxFailed as error:
        program, remedy = "none; only stages that ask for isolation vm need it", str(error)
    return Requirement(name="gVisor", is_needed=False, found=program, remedy=remedy)


def _frozen_copies() -> Requirement:
    reason = tracing.explain_unsupported()
    return Requirement(
        name="frozen copies for episodes",
        is_needed=False,
        found=f"{reason}: the policy is loaded again for every episode" if reason else "Linux on x86-64",
        remedy=""
        if not reason
        else "evaluate on Linux on x86-64 with kernel.yama.ptrace_scope below 3, which is faster",
    )
