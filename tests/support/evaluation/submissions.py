"""Submissions made up for tests: zips with anything in them, folders with a policy."""

import io
import stat
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

MANIFEST = "track: track_1\ntasks: [peg-insertion]\nname: test policy\nentry_point: policy:Policy\n"
POLICY = """
class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        return [0.0, 0.0, 0.0]
"""
FILES = {"submission.yaml": MANIFEST, "policy.py": POLICY}


def entry(name: str, mode: int = stat.S_IFREG | 0o644, *, method: int = zipfile.ZIP_DEFLATED) -> zipfile.ZipInfo:
    """The header of one file of a zip, with a file type and rights."""
    info = zipfile.ZipInfo(name)
    info.external_attr = mode << 16
    info.compress_type = method
    return info


def zip_bytes(contents: Mapping[str | zipfile.ZipInfo, str | bytes]) -> bytes:
    """A zip of names or headers and contents; the same name may come twice through headers."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def submission_zip(files: Mapping[str, str | bytes] = FILES, *, top: str = "Track_1") -> bytes:
    """A well-formed zip of a submission's files; without a top folder, of its content."""
    return zip_bytes({f"{top}/{name}" if top else name: content for name, content in files.items()})


def wheel_bytes(
    name: str = "feelings",
    version: str = "1.0",
    files: Mapping[Any, str | bytes] | None = None,
    *,
    fields: str = "",
) -> bytes:
    """A wheel of one package, whose module says which version it is, with further files and lines of METADATA."""
    info = f"{name}-{version}.dist-info"
    metadata = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n{fields}"
    wheel: dict[str | zipfile.ZipInfo, str | bytes] = {
        f"{name}/__init__.py": f"version = {version!r}\n",
        f"{info}/METADATA": metadata,
        f"{info}/RECORD": "",
    }
    return zip_bytes({**wheel, **(files or {})})


def submission_folder(folder: Path, files: Mapping[str, str | bytes] = FILES) -> Path:
    """A submission's files as a folder."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    return folder
