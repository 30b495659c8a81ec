"""Makes the sensor of an unpacked submission in the sandbox; called where submissions are taken in.

A team's STL and mesh are only data, but a reader may have faults: it runs without network, without rights, and within
limits on time and memory.
"""

import contextlib
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import IO, Final

from pydantic import ValidationError
from vitac import envs, errors, evaluator
from vitac.envs.kernel_cache import shared_directory
from vitac.errors import VitacError

from ..agent.isolation import bubblewrap, packages, seccomp
from ..agent.limits import GIB, MIB, Limits
from ..sensors.made import MAX_BYTES, MadeSensor
from ..sensors.making import MakingAnswer
from ..sensors.manifest import SensorRejected

MODULE: Final = "vitac.evaluator.sensors.making"
# Addresses, of which compiled code and its compiler take most; a mesh takes some MiB.
LIMITS: Final = replace(
    Limits(), address_space_bytes=3 * GIB, start_cpu_s=60.0, file_size_bytes=16 * MIB, tmp_bytes=64 * MIB, processes=16
)
WALL_S: Final = 90.0
"""Time for one sensor: some seconds, or with kernels to compile a minute."""


class SensorNotMade(VitacError):
    """The sandbox that makes sensors did not work; this is a fault of ours or of the machine. Try again."""


def make_sensor(
    folder: Path,
    *,
    limits: Limits = LIMITS,
    wall_s: float = WALL_S,
    watch: Callable[["subprocess.Popen[bytes]"], object] = lambda _: None,
) -> MadeSensor:
    """Check and mesh the sensor in a submission's folder, in the sandbox.

    Args:
        folder: of the unpacked submission, readable by every user.
        limits: what the sandbox may use.
        wall_s: time until it is ended.
        watch: gets the process, to end it sooner.

    Raises:
        SensorRejected: a rule is broken, or its surface takes too long; the message says which.
        SensorNotMade: the sandbox did not work.
        SandboxFailed: it cannot be set up.
    """
    tool = bubblewrap.Tool(
        module=MODULE,
        code=tuple(Path(package.__path__[0]) for package in (envs, errors, evaluator)),
        kernels=shared_directory() or Path("/nonexistent"),
        folder=folder,
    )
    uid = bubblewrap.choose_uid()
    with contextlib.ExitStack() as exits:
        filter_file = exits.enter_context(bubblewrap.open_data(seccomp.filter_program()))
        passwd = exits.enter_context(bubblewrap.open_data(bubblewrap.passwd_file(uid)))
        command = bubblewrap.tool_command(
            tool, interpreter=packages.find_interpreter(), limits=limits, uid=uid, seccomp=filter_file, passwd=passwd
        )
        output = exits.enter_context(tempfile.TemporaryFile())
        complaints = exits.enter_context(tempfile.TemporaryFile())
        process = subprocess.Popen(  # noqa: S603 - the command holds paths of ours only
            command,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=complaints,
            pass_fds=(filter_file, passwd),
            env={},
            cwd="/",
        )
        exits.callback(process.wait)
        exits.callback(process.kill)
        watch(process)
        try:
            code = process.wait(wall_s)
        except subprocess.TimeoutExpired as error:
            raise SensorRejected(f"Checking and meshing the gel took longer than {wall_s:g} s; simplify it.") from error
        return _answer(code, _read(output, 2 * MAX_BYTES), _read(complaints, 2000))


def _answer(code: int, output: bytes, complaints: bytes) -> MadeSensor:
    try:
        answer = MakingAnswer.model_validate_json(output)
    except ValidationError as error:
        if code in _OVER_LIMIT or b"MemoryError" in complaints:
            raise SensorRejected("Checking and meshing the gel took too much time or memory; simplify it.") from error
        said = " ".join(complaints.decode("utf-8", "replace").split())[-300:]
        raise SensorNotMade(
            f"The sandbox that makes sensors ended with {code} ({said}); run `vitac doctor`."
        ) from error
    if answer.made is None:
        raise SensorRejected(answer.refused or "The sensor was refused without a reason.")
    return answer.made


def _read(file: IO[bytes], most: int) -> bytes:
    file.seek(0)
    return file.read(most)


# Killed for its CPU time or memory, as the process or as bubblewrap reports it.
_OVER_LIMIT: Final = frozenset({-9, -24, 137, 152})
