"""The two command lines that put a policy into its sandbox: for a normal user and for root."""

import json
import math
import os
import secrets
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Final

from vitac.envs.vision import optics

from ..limits import Limits
from ..verdicts import SandboxFailed
from .gpu import CHANNEL, CHANNEL_VARIABLE, Gpu, ImageProgram
from .packages import Interpreter

OWN_PROCESSES: Final = 3
"""Processes of ours in a sandbox at once: the first, the loader or an episode's, the loaded copy."""
INSIDE_SUBMISSION: Final = "/submission"
INSIDE_RUNTIME: Final = "/opt/vitac/agent.py"
INSIDE_BACK_PROJECTION: Final = "/opt/vitac/back_projection.py"
INSIDE_IMAGE_RUNTIME: Final = "/opt/vitac/image.py"
INSIDE_IMAGE: Final = "/image"
INSIDE_CODE: Final = "/opt/vitac/code"
INSIDE_KERNELS: Final = "/opt/vitac/kernels"
INSIDE_DRIVER: Final = "/dev/gpu"
"""Libraries of the GPU's driver, in the one folder of an image in which the sandbox can make names."""
_RUNTIME: Final = Path(__file__).parents[1] / "runtime" / "agent.py"
_IMAGE_RUNTIME: Final = _RUNTIME.with_name("image.py")
_BACK_PROJECTION: Final = Path(optics.__file__)
DEVICES: Final = ("/dev/null", "/dev/zero", "/dev/full", "/dev/random", "/dev/urandom")
"""Devices that hold nothing, so that a policy may keep them open."""
_FIRST_UID: Final = 1_000_000_000
_UIDS: Final = 1 << 30
_NOBODY: Final = 65534
_INSTALL: Final = (
    "install bubblewrap (Debian, Ubuntu: `apt-get install bubblewrap`; without root: `apt-get download bubblewrap`, "
    "`dpkg -x` it and name the program in VITAC_BWRAP), then run `vitac doctor`"
)
TOP_FOLDERS: Final = ("/bin", "/lib", "/lib32", "/lib64", "/libx32", "/sbin")
"""Links into /usr on most systems."""
_OWN_FOLDERS: Final = {"HOME": "/tmp", "TMPDIR": "/tmp"}  # noqa: S108 - the sandbox's own tmpfs
ENVIRONMENT: Final = {
    **_OWN_FOLDERS,
    "LANG": "C.UTF-8",
    "PATH": "/usr/bin",
    "PYTHONHASHSEED": "0",
    **dict.fromkeys(
        ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
    ),
}


_NAMESPACES: Final = (
    *("--unshare-ipc", "--unshare-pid", "--unshare-net", "--unshare-uts", "--unshare-cgroup-try"),
    *("--hostname", "sandbox", "--die-with-parent", "--new-session", "--as-pid-1", "--clearenv"),
)


class UserIsolation(StrEnum):
    """The user whose rights the policy has."""

    ROOT = "root"
    """Started by root, dropped to a real uid of its own, no user namespace."""
    USER_NAMESPACE = "user-namespace"
    """Started by a normal user, nobody inside a user namespace."""
    NONE = "none"
    """The same user, without a sandbox."""


@dataclass(frozen=True, kw_only=True)
class Descriptors:
    """Descriptors of bubblewrap's own; the runtime finds channel and status pipe by itself."""

    seccomp: int
    passwd: int
    info: int
    """bubblewrap writes the outside pid of the first process here."""


@dataclass(frozen=True, kw_only=True)
class Tool:
    """A program of ours that works on untrusted files.

    Attributes:
        module: run with `python -m`, with the folder and that of the kernels as arguments.
        code: folders of ours that it imports, each as `vitac.<name>`.
        kernels: folder of compiled kernels, only read; may be missing.
        folder: what it works on.
    """

    module: str
    code: tuple[Path, ...]
    kernels: Path
    folder: Path


def current_user_isolation() -> UserIsolation:
    """Return the command line that fits this process."""
    return UserIsolation.ROOT if os.geteuid() == 0 else UserIsolation.USER_NAMESPACE


def choose_uid() -> int:
    """Return the uid inside: under root a random one for each sandbox, so that it reveals nothing about the machine.

    RLIMIT_NPROC counts per uid, so that two policies of one uid could starve each other.
    """
    if current_user_isolation() is UserIsolation.USER_NAMESPACE:
        return _NOBODY
    return _FIRST_UID + secrets.randbelow(_UIDS)


def find_program() -> Path:
    """Return bubblewrap: VITAC_BWRAP, else the PATH, else the project's `.system` folder that the launcher fills.

    Raises:
        SandboxFailed: there is none. Nothing ever runs unsandboxed instead.
    """
    named = os.environ.get("VITAC_BWRAP")
    if named:
        if not os.access(named, os.X_OK):
            raise SandboxFailed(f"VITAC_BWRAP names {named}, which is not a program; {_INSTALL}.")
        return Path(named)
    program = shutil.which("bwrap")
    candidates = [Path(program)] if program else []
    candidates += [folder / ".system" / "bin" / "bwrap" for folder in Path(__file__).resolve().parents[:5]]
    for candidate in candidates:
        if os.access(candidate, os.X_OK):
            return candidate
    raise SandboxFailed(f"The sandbox needs the program bwrap, which is not on the PATH; {_INSTALL}.")


def passwd_file(uid: int) -> bytes:
    """Return the /etc/passwd of the sandbox; libraries look up the name of the user they run as."""
    return f"agent:x:{uid}:{uid}:agent:/tmp:/usr/sbin/nologin\n".encode()


OWN_FILES: Final = (
    (_RUNTIME, INSIDE_RUNTIME),
    (_IMAGE_RUNTIME, INSIDE_IMAGE_RUNTIME),
    (_BACK_PROJECTION, INSIDE_BACK_PROJECTION),
)
"""(outside, inside) of our files that every policy's process runs."""


def command(
    *,
    program: Path,
    submission: Path,
    interpreter: Interpreter,
    limits: Limits,
    uid: int,
    descriptors: Descriptors,
    system: Path | None = None,
    image: ImageProgram | None = None,
) -> list[str]:
    """Return the whole command line, from bubblewrap to the runtime.

    Args:
        program: bubblewrap.
        submission: folder of the policy, or of an image's files.
        interpreter: Python and its packages.
        limits: what the policy may use.
        uid: of the sandbox.
        descriptors: that the command inherits.
        system: folder in memory with all files of system, Python and packages; None: they are bound from the disk.
        image: what is run in place of a policy's class.
    """
    if system is None:
        files = [*_system_files(descriptors.passwd), *_writable_folders(limits), *_python_files(interpreter)]
    else:
        files = [*_files_in_memory(system, descriptors.passwd), *_writable_folders(limits)]
    inside = inside_folder(image)
    files += ["--ro-bind", str(submission.resolve()), inside, "--chdir", inside]
    if image is not None:
        files += _writable_folders(limits, inside, image.gpu)
    own_uid = uid if current_user_isolation() is UserIsolation.ROOT else None
    return [
        str(program),
        *_privileges(uid, *(() if image is None else ("CAP_SYS_CHROOT",))),
        *_NAMESPACES,
        *("--json-status-fd", str(descriptors.info), "--seccomp", str(descriptors.seccomp)),
        *files,
        *("--remount-ro", "/"),
        *_environment(interpreter),
        "--",
        *([] if image is not None else _drop_privileges(uid)),  # of an image the runtime does so, once it is inside
        *_process_limits(limits, has_gpu=image is not None and image.gpu is not None),
        *inside_command(interpreter, limits, image=image, own_uid=own_uid),
    ]


def inside_folder(image: ImageProgram | None) -> str:
    """Return where the policy's own files lie in a sandbox."""
    return INSIDE_SUBMISSION if image is None else INSIDE_IMAGE


def inside_command(
    interpreter: Interpreter, limits: Limits, *, image: ImageProgram | None, own_uid: int | None
) -> list[str]:
    """Return the command line of what runs inside: the runtime of policies, or that of images.

    Args:
        interpreter: Python and its packages.
        limits: what the policy may use.
        image: what is run in place of a policy's class.
        own_uid: user that an image's program becomes; None: it is that already.
    """
    run = partial(runtime_command, limits, program=interpreter.executable, packages=interpreter.packages)
    if image is None:
        return run()
    return run(runtime=INSIDE_IMAGE_RUNTIME, submission=_image_order(image, own_uid))


def _image_order(image: ImageProgram, own_uid: int | None) -> str:
    """Return what the runtime of images is to do, as JSON."""
    variables = {**ENVIRONMENT, **image.variables, **_OWN_FOLDERS, CHANNEL_VARIABLE: str(CHANNEL)}
    if image.gpu is not None:
        variables["LD_LIBRARY_PATH"] = ":".join(filter(None, (INSIDE_DRIVER, variables.get("LD_LIBRARY_PATH"))))
    what = {"arguments": image.arguments, "variables": variables, "folder": image.folder}
    return json.dumps({"root": INSIDE_IMAGE, "uid": own_uid, **what})


def empty_command() -> list[str]:
    """Return the command line of a sandbox in which nothing is done, which fails where there can be none."""
    uid = choose_uid()
    sandbox = [str(find_program()), *_privileges(uid), *_NAMESPACES, "--ro-bind", "/", "/"]
    return [*sandbox, "--", *_drop_privileges(uid), "/bin/true"]


def tool_command(
    tool: Tool, *, interpreter: Interpreter, limits: Limits, uid: int, seccomp: int, passwd: int
) -> list[str]:
    """Return the command line of a tool of ours that reads a folder of a team's, with no more rights than a policy.

    Args:
        tool: what is run, and what it sees.
        interpreter: Python and its packages.
        limits: what it may use.
        uid: of the sandbox.
        seccomp: descriptor of the filter.
        passwd: descriptor of the sandbox's /etc/passwd.
    """
    code = [part for folder in (INSIDE_CODE, f"{INSIDE_CODE}/vitac") for part in ("--perms", "0755", "--dir", folder)]
    _require_readable(tool.code)
    for folder in tool.code:
        code += ["--ro-bind", str(folder), f"{INSIDE_CODE}/vitac/{folder.name}"]
    python_path = ":".join([INSIDE_CODE, *map(str, interpreter.packages)])
    return [
        str(find_program()),
        *_privileges(uid),
        *_NAMESPACES,
        *("--seccomp", str(seccomp)),
        *_system_files(passwd),
        *_writable_folders(limits),
        *_python_files(interpreter),
        *code,
        *("--ro-bind-try", str(tool.kernels), INSIDE_KERNELS),
        *(
            "--ro-bind",
            str(tool.folder.resolve()),
            INSIDE_SUBMISSION,
            "--chdir",
            INSIDE_SUBMISSION,
            "--remount-ro",
            "/",
        ),
        *_environment(interpreter),
        *("--setenv", "PYTHONPATH", python_path, "--setenv", "VITAC_CACHE_DIR", "/tmp/cache"),  # noqa: S108
        "--",
        *_drop_privileges(uid),
        *_process_limits(limits),
        *("/usr/bin/prlimit", f"--cpu={math.ceil(limits.start_cpu_s)}", "--"),
        *(str(interpreter.executable), "-P", "-s", "-B", "-m", tool.module, INSIDE_SUBMISSION, INSIDE_KERNELS),
    ]


def _privileges(uid: int, *capabilities: str) -> list[str]:
    added = [part for capability in capabilities for part in ("--cap-add", capability)]
    if current_user_isolation() is UserIsolation.ROOT:
        # No user namespace: inside one, root's RLIMIT_NPROC would not be enforced. setpriv needs these two to drop.
        return ["--cap-drop", "ALL", "--cap-add", "CAP_SETUID", "--cap-add", "CAP_SETGID", *added]
    return ["--unshare-user", "--uid", str(uid), "--gid", str(uid), "--disable-userns", "--cap-drop", "ALL", *added]


def _system_files(passwd: int) -> list[str]:
    """Bind the system's programs and libraries; there is no /proc, no /sys and hardly an /etc."""
    arguments = ["--ro-bind", "/usr", "/usr"]
    for folder in ("/etc", "/opt", "/opt/vitac", "/opt/vitac/packages"):
        arguments += ["--perms", "0755", "--dir", folder]
    for system in map(Path, TOP_FOLDERS):
        if system.is_symlink():
            arguments += ["--symlink", str(system.readlink()), str(system)]
        elif system.is_dir():
            arguments += ["--ro-bind", str(system), str(system)]
    for optional in ("/etc/ld.so.cache", "/etc/alternatives"):
        arguments += ["--ro-bind-try", optional, optional]
    return [*arguments, "--perms", "0444", "--file", str(passwd), "/etc/passwd"]


def _files_in_memory(root: Path, passwd: int) -> list[str]:
    """Bind what `memory_files` has copied; nothing else of the host is visible."""
    arguments = ["--ro-bind", str(root / "usr"), "/usr", "--ro-bind", str(root / "opt"), "/opt"]
    for system in map(Path, TOP_FOLDERS):
        if system.is_symlink():
            arguments += ["--symlink", str(system.readlink()), str(system)]
        else:
            arguments += ["--ro-bind-try", str(root / system.name), str(system)]
    arguments += ["--perms", "0755", "--dir", "/etc"]
    arguments += ["--ro-bind-try", str(root / "etc" / "ld.so.cache"), "/etc/ld.so.cache"]
    return [*arguments, "--perms", "0444", "--file", str(passwd), "/etc/passwd"]


def _writable_folders(limits: Limits, root: str = "", gpu: Gpu | None = None) -> list[str]:
    return [
        *("--dev", f"{root}/dev"),
        # Terminals would be one more place where a mode or time stays changed.
        *("--tmpfs", f"{root}/dev/pts", "--remount-ro", f"{root}/dev/pts"),
        *("--perms", "1777", "--size", str(limits.shm_bytes), "--tmpfs", f"{root}/dev/shm"),  # noqa: S108
        *([] if gpu is None else _gpu_files(gpu, root)),
        *("--remount-ro", f"{root}/dev"),
        *("--perms", "1777", "--size", str(limits.tmp_bytes), "--tmpfs", f"{root}/tmp"),  # noqa: S108
    ]


def _gpu_files(gpu: Gpu, root: str) -> Iterator[str]:
    for node in gpu.devices:
        yield from ("--dev-bind", str(node), f"{root}/dev/{node.name}")
    yield from ("--perms", "0755", "--dir", f"{root}{INSIDE_DRIVER}")
    for name, file in gpu.libraries.items():
        yield from ("--ro-bind", str(file), f"{root}{INSIDE_DRIVER}/{name}")


def _python_files(interpreter: Interpreter) -> list[str]:
    arguments = []
    for folder in _folders_above(interpreter):
        arguments += ["--perms", "0755", "--dir", str(folder)]
    _require_readable([*(outside for outside, _ in interpreter.read_only_binds), *(file for file, _ in OWN_FILES)])
    for outside, inside in interpreter.read_only_binds:
        arguments += ["--ro-bind", str(outside), str(inside)]
    for folder in interpreter.masked:
        arguments += ["--tmpfs", str(folder), "--remount-ro", str(folder)]
    for file, path in OWN_FILES:
        arguments += ["--ro-bind", str(file), path]
    return arguments


def _require_readable(paths: Iterable[Path]) -> None:
    """Refuse what was installed under a umask such as 077, since root's sandboxes have users of their own.

    Raises:
        SandboxFailed: others cannot read a file or folder.
    """
    for path in filter(Path.exists, paths) if current_user_isolation() is UserIsolation.ROOT else ():
        mode, needed = path.stat().st_mode, 0o005 if path.is_dir() else 0o004
        if mode & needed != needed:
            raise SandboxFailed(
                f"Policies run as another user, who cannot read {path} (mode {mode & 0o777:o}, as under umask 077). "
                f"Run `chmod -R go+rX {_INSTALLED if path.is_relative_to(_INSTALLED) else path}`."
            )


_INSTALLED: Final = Path(__file__).resolve().parents[3]
"""Folder of the checkout, or of the installed package."""


def _folders_above(interpreter: Interpreter) -> list[Path]:
    """Return the folders of packages and of their parts that no bind makes; bubblewrap would close them to others."""
    above = {parent for _, inside in interpreter.read_only_binds for parent in inside.parents}
    return sorted(
        {*interpreter.packages, *(parent for parent in above if set(parent.parents) & {*interpreter.packages})}
    )


def environment(interpreter: Interpreter) -> dict[str, str]:
    """Return all environment variables inside."""
    folder = interpreter.library_folder
    return {**ENVIRONMENT, **({} if folder is None else {"LD_LIBRARY_PATH": str(folder)})}


def _environment(interpreter: Interpreter) -> list[str]:
    return [part for name, value in environment(interpreter).items() for part in ("--setenv", name, value)]


def _drop_privileges(uid: int) -> list[str]:
    if current_user_isolation() is UserIsolation.USER_NAMESPACE:
        return []
    # The change of uid clears the parent-death signal that bubblewrap has set, so it is set again.
    return ["/usr/bin/setpriv", "--reuid", str(uid), "--regid", str(uid), "--clear-groups", "--pdeathsig", "KILL", "--"]


def _process_limits(limits: Limits, *, has_gpu: bool = False) -> list[str]:
    # The control group is to refuse first, for it counts refusals; RLIMIT_NPROC stands in where there is none.
    return [
        "/usr/bin/prlimit",
        # A GPU's memory and the machine's have addresses in each program that uses it, whatever it takes of them.
        f"--as={'unlimited' if has_gpu else limits.address_space_bytes}",
        f"--nproc={limits.processes + OWN_PROCESSES + 4}",
        f"--nofile={limits.open_files}",
        f"--fsize={limits.file_size_bytes}",
        "--core=0",
        "--memlock=0",
        "--",
    ]


def runtime_command(
    limits: Limits,
    *,
    program: Path,
    packages: Iterable[Path],
    runtime: str = INSIDE_RUNTIME,
    submission: str = INSIDE_SUBMISSION,
) -> list[str]:
    """Return the command line of the runtime.

    Args:
        limits: what the policy may use.
        program: Python.
        packages: folders of packages.
        runtime: file of the runtime.
        submission: folder of the policy, or the order of an image.
    """
    # Not -I: it would ignore PYTHONHASHSEED. The environment holds nothing but what is set above.
    return [
        *(str(program), "-P", "-s", "-B", "-u", runtime, *_cpu_limits(limits), submission),
        *map(str, packages),
    ]


def _cpu_limits(limits: Limits) -> tuple[str, str]:
    """Return soft and hard limit of the loader [s]; its copies' soft limit is set from outside."""
    return str(math.ceil(limits.start_cpu_s)), str(math.ceil(limits.start_cpu_s + limits.episode_cpu_s) + 1)


@contextmanager
def open_data(data: bytes) -> Iterator[int]:
    """Return a descriptor from which bubblewrap reads data."""
    descriptor = os.memfd_create("vitac")
    try:
        os.write(descriptor, data)
        os.lseek(descriptor, 0, os.SEEK_SET)
        yield descriptor
    finally:
        os.close(descriptor)
