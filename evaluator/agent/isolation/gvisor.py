"""A sandbox with a kernel of its own: gVisor's, which answers the policy's system calls as an ordinary program.

What kernels keep for all of their processes (names and pages that were looked up, file locks, counters) then ends with
the sandbox, and an attack on the kernel meets gVisor's first. Its platform `ptrace` was tried, that by KVM was not
(https://gvisor.dev/docs/architecture_guide/platforms).
"""

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from ...isolation_kinds import IsolationKind
from ..limits import Limits
from ..verdicts import SandboxFailed
from . import bubblewrap
from .gpu import ImageProgram
from .packages import Interpreter

PROGRAM_VARIABLE: Final = "VITAC_RUNSC"
EXTRA_PROCESSES: Final = 128
"""Threads of gVisor's own, which the control group counts with the policy's."""
_TAKE_DESCRIPTORS: Final = 'exec 3<&0 4>&2 </dev/null 2>&1; exec "$@"'
"""gVisor passes on the three standard streams only: channel, output and status come in as those."""
_REFUSED: Final = ("statfs", "fstatfs")
"""What gVisor asks the machine: how full the memory is that sandboxes share."""
_FOLDERS: Final = ("usr", "opt", "etc", "tmp", "dev", "proc", "sys", "submission", "image")


def find_program() -> Path:
    """Return gVisor: VITAC_RUNSC, else from the PATH.

    Raises:
        SandboxFailed: there is none.
    """
    named = os.environ.get(PROGRAM_VARIABLE) or "runsc"
    program = shutil.which(named)
    if program is None:
        raise SandboxFailed(
            f"Isolation {IsolationKind.VM} needs the program {named}, which is not there; install gVisor (Debian: "
            f"`apt-get install runsc`) or name it in {PROGRAM_VARIABLE}, then run `vitac doctor`."
        )
    return Path(program)


def command(
    bundle: Path,
    *,
    submission: Path,
    interpreter: Interpreter,
    limits: Limits,
    uid: int,
    system: Path,
    image: ImageProgram | None = None,
) -> list[str]:
    """Return the whole command line, and write what it reads into a folder.

    Its standard input is the channel, its output the policy's, and its errors are the status reports.

    Args:
        bundle: empty folder, which stays for as long as the sandbox runs.
        submission: folder of the policy, or of an image's files.
        interpreter: Python and its packages.
        limits: what the policy may use.
        uid: inside.
        system: folder in memory with all files of system, Python and packages.
        image: what is run in place of a policy's class.
    """
    root = bundle / "root"
    for name in _FOLDERS:
        (root / name).mkdir(mode=0o755, parents=True)
    (root / "etc/passwd").write_bytes(bubblewrap.passwd_file(uid))
    if (system / "etc/ld.so.cache").exists():
        shutil.copy(system / "etc/ld.so.cache", root / "etc")
    inside = bubblewrap.inside_folder(image)
    binds = {"/usr": system / "usr", "/opt": system / "opt", inside: submission}
    for folder in map(Path, bubblewrap.TOP_FOLDERS):
        if folder.is_symlink():
            (root / folder.name).symlink_to(folder.readlink())
        elif (system / folder.name).exists():
            (root / folder.name).mkdir(mode=0o755)
            binds[str(folder)] = system / folder.name
    runtime = bubblewrap.inside_command(interpreter, limits, image=image, own_uid=uid)
    # The runtime of images gives up these and the user; gVisor leaves none to a user who is not root.
    rights = [] if image is None else ["CAP_SYS_CHROOT", "CAP_SETUID", "CAP_SETGID"]
    first_uid = uid if image is None else 0
    variables = bubblewrap.environment(interpreter)
    specification = {
        "ociVersion": "1.0.0",
        "hostname": "sandbox",
        "root": {"path": str(root), "readonly": True},
        "process": {
            "args": ["/bin/sh", "-c", _TAKE_DESCRIPTORS, "sh", *runtime],
            "cwd": inside,
            "capabilities": dict.fromkeys(("bounding", "effective", "permitted"), rights),
            "env": [f"{name}={value}" for name, value in variables.items()],
            "user": {"uid": first_uid, "gid": first_uid},
            "noNewPrivileges": True,
            "rlimits": list(_limits(limits)),
        },
        "mounts": [
            *({"destination": inside, "type": "bind", "source": str(outside), "options": ["ro", "rbind"]}
              for inside, outside in binds.items()),
            *_writable_folders(limits, "" if image is None else inside),
        ],
        "linux": {
            "namespaces": [{"type": name} for name in ("pid", "network", "ipc", "uts", "mount")],
            "seccomp": {
                "defaultAction": "SCMP_ACT_ALLOW",
                "architectures": ["SCMP_ARCH_X86_64"],
                "syscalls": [{"names": list(_REFUSED), "action": "SCMP_ACT_ERRNO"}],
            },
        },
    }  # fmt: skip
    (bundle / "config.json").write_text(json.dumps(specification))
    # All of gVisor's processes end with the first of a pid namespace, which ends with whoever waits for it.
    ended_together = ["/usr/bin/unshare", "--pid", "--fork", "--kill-child", "--mount-proc"]
    runsc = [str(find_program()), "--network=none", "--ignore-cgroups", "--oci-seccomp", f"--root={bundle / 'state'}"]
    runsc += [f"--log={bundle / 'log'}", *_rights(), "run", f"--bundle={bundle}", bundle.name]
    return [*ended_together, *runsc]


def read_failure(bundle: Path) -> str:
    """Return why gVisor did not start, as it says itself; empty where it says nothing."""
    log = bundle / "log"
    lines = log.read_text(errors="replace").splitlines() if log.exists() else []
    return lines[-1].strip() if lines else ""


def _limits(limits: Limits) -> Iterator[dict[str, object]]:
    values = {
        "RLIMIT_AS": limits.address_space_bytes,
        "RLIMIT_NOFILE": limits.open_files,
        "RLIMIT_FSIZE": limits.file_size_bytes,
        "RLIMIT_CORE": 0,
        "RLIMIT_MEMLOCK": 0,
    }
    return ({"type": name, "soft": value, "hard": value} for name, value in values.items())


def _writable_folders(limits: Limits, root: str) -> Iterator[dict[str, object]]:
    if root:
        yield {"destination": f"{root}/dev", "type": "devtmpfs", "source": "devtmpfs"}
    yield _memory(f"{root}/tmp", limits.tmp_bytes)  # noqa: S108 - the sandbox's own
    yield _memory(f"{root}/dev/shm", limits.shm_bytes)  # noqa: S108


def _memory(folder: str, size_bytes: int) -> dict[str, object]:
    options = ["mode=1777", f"size={size_bytes}", "nosuid", "nodev"]
    return {"destination": folder, "type": "tmpfs", "source": "tmpfs", "options": options}


def _rights() -> list[str]:
    return [] if bubblewrap.current_user_isolation() is bubblewrap.UserIsolation.ROOT else ["--rootless"]
