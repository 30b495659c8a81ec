"""Container images as `docker save` and `skopeo copy` write them, of this machine's Python, without a registry."""

import functools
import gzip
import hashlib
import io
import json
import re
import subprocess
import sys
import sysconfig
import tarfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import zstandard

Pack = Callable[[bytes], bytes]
Files = Mapping[str, bytes | Path]
POLICY_FILE = Path(__file__).parents[3] / "examples/image_in_python/vitac_policy.py"
LEFT_OUT = {
    "site-packages",
    "test",
    "tests",
    "idlelib",
    "ensurepip",
    "lib2to3",
    "pydoc_data",
    "turtledemo",
    "__pycache__",
}


def as_is(layer: bytes) -> bytes:
    return layer


def gzipped(layer: bytes) -> bytes:
    return gzip.compress(layer, 1)


def zstd(layer: bytes) -> bytes:
    return zstandard.ZstdCompressor(level=1).compress(layer)


def entry(name: str, content: bytes = b"", **attributes: Any) -> tuple[tarfile.TarInfo, bytes]:
    """Return an entry of a tar; attributes such as `type`, `linkname` and `mode` are those of `TarInfo`."""
    info = tarfile.TarInfo(name)
    info.size = len(content)
    for attribute, value in attributes.items():
        setattr(info, attribute, value)
    return info, content


def tar_bytes(entries: Iterable[tuple[tarfile.TarInfo, bytes]], how: int = tarfile.PAX_FORMAT) -> bytes:
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w", format=how) as tar:
        for info, content in entries:
            tar.addfile(info, io.BytesIO(content))
    return stream.getvalue()


def layer(files: Files) -> bytes:
    """Return a layer of files, with their modes and times where they are of this machine."""
    return tar_bytes(_file(name, content) for name, content in files.items())


def _file(name: str, content: bytes | Path) -> tuple[tarfile.TarInfo, bytes]:
    if isinstance(content, bytes):
        return entry(name, content, mode=0o755)
    state = content.stat()
    return entry(name, content.read_bytes(), mode=state.st_mode & 0o777, mtime=int(state.st_mtime))


def config_bytes(layers: Sequence[bytes], command: Sequence[str], **process: Any) -> bytes:
    diff_ids = [f"sha256:{hashlib.sha256(each).hexdigest()}" for each in layers]
    config = {"Cmd": list(command), "WorkingDir": "/app", **process}
    return json.dumps(
        {"architecture": "amd64", "os": "linux", "config": config, "rootfs": {"type": "layers", "diff_ids": diff_ids}}
    ).encode()


def docker_archive(layers: Sequence[bytes], config: bytes, pack: Pack = as_is) -> bytes:
    """Return what `docker save` writes."""
    packed = {f"{number}/layer.tar": pack(each) for number, each in enumerate(layers)}
    name = f"{hashlib.sha256(config).hexdigest()}.json"
    manifest = [{"Config": name, "RepoTags": ["policy:latest"], "Layers": list(packed)}]
    return tar_bytes(
        entry(path, content)
        for path, content in {**packed, name: config, "manifest.json": json.dumps(manifest).encode()}.items()
    )


def oci_layout(layers: Sequence[bytes], config: bytes, pack: Pack = gzipped) -> bytes:
    """Return what `skopeo copy ... oci-archive:policy.tar` writes."""
    blobs: dict[str, bytes] = {}

    def add(data: bytes, media_type: str) -> dict[str, Any]:
        digest = hashlib.sha256(data).hexdigest()
        blobs[f"blobs/sha256/{digest}"] = data
        return {"mediaType": media_type, "digest": f"sha256:{digest}", "size": len(data)}

    manifest = {
        "schemaVersion": 2,
        "config": add(config, "application/vnd.oci.image.config.v1+json"),
        "layers": [add(pack(each), "application/vnd.oci.image.layer.v1.tar") for each in layers],
    }
    index = {"manifests": [add(json.dumps(manifest).encode(), "application/vnd.oci.image.manifest.v1+json")]}
    files = {"oci-layout": b'{"imageLayoutVersion": "1.0.0"}', "index.json": json.dumps(index).encode(), **blobs}
    return tar_bytes(entry(path, content) for path, content in files.items())


@functools.cache
def python_layers(prefix: str) -> tuple[bytes, ...]:
    """Return the layers of an image with this Python and NumPy below a prefix such as `usr/local` or `opt/conda`."""
    standard = Path(sysconfig.get_path("stdlib"))
    program = Path(sys._base_executable).resolve()  # type: ignore[attr-defined]
    files = {f"{prefix}/lib/{standard.name}/{name}": path for name, path in _tree(standard)}
    files[f"{prefix}/bin/python3"] = program
    shared = sysconfig.get_config_var("LDLIBRARY") or ""
    for library in Path(sysconfig.get_config_var("LIBDIR")).glob(f"{shared}*" if ".so" in shared else "-"):
        files[f"{prefix}/lib/{library.name}"] = library
    numpy = Path(np.__file__).parent
    packages = {
        f"{prefix}/lib/{standard.name}/site-packages/{folder.name}/{name}": path
        for folder in (numpy, numpy.with_name("numpy.libs"))
        for name, path in _tree(folder)
    }
    linked = _libraries(
        [path for path in (*files.values(), *packages.values()) if ".so" in path.name or path == program]
    )
    return layer(linked), layer(files), layer(packages)


def _tree(folder: Path) -> Iterator[tuple[str, Path]]:
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder)
        if path.is_file() and not LEFT_OUT.intersection(name.parts) and not str(name).startswith("config-"):
            yield str(name), path


def _libraries(programs: Sequence[Path]) -> dict[str, Path]:
    """Return the system's libraries that programs are linked with."""
    listed = subprocess.run(["ldd", *map(str, programs)], capture_output=True, text=True, check=False).stdout
    paths = set(re.findall(r"^\s+(?:\S+ => )?(/(?:usr/)?lib\S+) \(0x", listed, re.MULTILINE))
    return {path.lstrip("/"): Path(path) for path in sorted(paths)}
