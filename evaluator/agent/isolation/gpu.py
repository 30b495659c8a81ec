"""A container image that plays: its unpacked files, its command, and the GPU of this machine that it may need."""

import re
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ..verdicts import SandboxFailed

_NODES: Final = ("nvidiactl", "nvidia-uvm", "nvidia-uvm-tools", "nvidia[0-9]*")
"""Below /dev; the last are the GPUs."""
_DRIVER: Final = "libcuda.so.1"
_LIBRARY: Final = re.compile(
    r"^\s+((?:libcuda|libcudadebugger|libnvidia-(?:ml|ptxjitcompiler|nvvm|gpucomp|opencl|allocator|pkcs11\S*))"
    r"\.so\.\S+) \(.*\) => (/\S+)$",
    re.MULTILINE,
)
"""A line of the dynamic loader's cache; it lists libraries of 64 bits before those of 32."""


@dataclass(frozen=True, kw_only=True)
class Gpu:
    """What a sandbox gets of it.

    Attributes:
        devices: nodes, below /dev inside as here.
        libraries: files of the driver by the name that programs load.
    """

    devices: tuple[Path, ...]
    libraries: dict[str, Path]


def find_gpu(devices: Path = Path("/dev"), cache: str | None = None) -> Gpu:
    """Return this machine's GPU.

    Args:
        devices: folder of the device nodes.
        cache: what `ldconfig -p` prints; None: ask it.

    Raises:
        SandboxFailed: there is none, or no driver for programs.
    """
    nodes = tuple(sorted(node for pattern in _NODES for node in devices.glob(pattern) if node.is_char_device()))
    libraries = dict(_list_libraries(_print_cache() if cache is None else cache))
    has_gpu = any(node.name.removeprefix("nvidia").isdigit() for node in nodes)
    if not has_gpu or _DRIVER not in libraries:
        missing = _DRIVER if has_gpu else f"{devices}/nvidia0"
        raise SandboxFailed(
            f"The image says `needs: gpu`, but this machine has no {missing}, expected an NVIDIA GPU and its driver. "
            "Play it where there is one; a service does so on workers that were started with `vitac worker --gpu`."
        )
    return Gpu(devices=nodes, libraries=libraries)


def _list_libraries(cache: str) -> Iterator[tuple[str, Path]]:
    seen: set[str] = set()
    for name, path in _LIBRARY.findall(cache):
        if name not in seen:
            seen.add(name)
            yield name, Path(path).resolve()


def _print_cache() -> str:
    try:
        return subprocess.run(
            ["/sbin/ldconfig", "-p"], capture_output=True, text=True, check=True, env={"LC_ALL": "C"}
        ).stdout
    except (OSError, subprocess.CalledProcessError):
        return ""


MOUNT_POINTS: Final = ("dev", "proc", "sys", "tmp")
"""Folders at the top of an image that the sandbox has of its own, or leaves empty."""
CHANNEL: Final = 3
"""Descriptor of the channel that the command inherits."""
CHANNEL_VARIABLE: Final = "VITAC_CHANNEL"


@dataclass(frozen=True, kw_only=True)
class ImageProgram:
    """What is run, and where.

    Attributes:
        root: folder of the unpacked files, with the folders `MOUNT_POINTS`.
        arguments: the command.
        variables: environment variables that the image sets.
        folder: working directory inside.
        gpu: that it needs, of this machine; None: it needs none.
    """

    root: Path
    arguments: tuple[str, ...]
    variables: Mapping[str, str]
    folder: str
    gpu: Gpu | None = None
