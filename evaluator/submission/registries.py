"""Fetches wheels by their hash from the registries that an operator allows; called by `wheels`.

A registry answers as "Simple repository API" (PEP 691) in JSON. A wheel is stored by its digest and fetched once.
"""

import hashlib
import os
import secrets
from collections.abc import Callable, Collection, Iterator, Mapping
from http import HTTPStatus
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, Final

import msgspec
from vitac.envs.kernel_cache import cache_root

from .names import ArchiveFault, ArchiveRejected

if TYPE_CHECKING:
    import httpx

REGISTRIES_VARIABLE: Final = "VITAC_WHEEL_REGISTRIES"
"""Names the addresses, separated by commas; without it nothing is fetched."""
_ACCEPT: Final = {"Accept": "application/vnd.pypi.simple.v1+json"}
_LIST_BYTES: Final = 32 << 20
_KEPT_BYTES: Final = 20 << 30
_STILL_S: Final = 20.0
_WHEEL_S: Final = 300.0


def fetch_wheel(name: str, digests: Collection[str], is_meant: Callable[[str], bool], max_bytes: int) -> Path | None:
    """Return the file of a wheel, from an earlier time or a registry; None where no registry has it.

    Args:
        name: of the package, as registries write it.
        digests: SHA-256 [hex] of the files that are meant.
        is_meant: returns whether a file of this name is a wheel of the right version, for this machine.
        max_bytes: of the file.

    Raises:
        ArchiveRejected: a registry does not answer as one, or its wheel is too large or not as its hash says.
    """
    registries = [
        each.strip().rstrip("/") for each in os.environ.get(REGISTRIES_VARIABLE, "").split(",") if each.strip()
    ]
    if not registries:
        return None
    stored = (path for digest in digests for path in (_folder() / digest).glob("*.whl"))
    if (path := next(stored, None)) is not None:
        os.utime(path)
        return path
    import httpx  # here, since nobody else needs it who checks or plays

    for registry in registries:
        try:
            with httpx.Client(headers=_ACCEPT, follow_redirects=True, timeout=_STILL_S) as client:
                address = httpx.URL(f"{registry}/{name}/")
                for file_name, digest, url in _list_files(client, address):
                    if digest in digests and is_meant(file_name):
                        _make_room()
                        return _fetch(client, address.join(url), file_name, digest, max_bytes)
        except (httpx.HTTPError, httpx.InvalidURL, msgspec.DecodeError, msgspec.ValidationError) as error:
            raise _rejected(
                f"The registry {registry} could not be asked for {name} ({error!s:.200}). Try again later, or put its "
                "wheel into wheels/."
            ) from error
    return None


def _folder() -> Path:
    return cache_root() / "wheels"


def _make_room() -> None:
    """Remove the wheels that were used longest ago, where there are too many; whoever reads one still can."""
    sizes = {path: path.stat() for path in _folder().glob("*/*.whl")}
    kept_bytes = sum(each.st_size for each in sizes.values())
    for path in sorted(sizes, key=lambda path: sizes[path].st_mtime):
        if kept_bytes <= _KEPT_BYTES:
            return
        path.unlink(missing_ok=True)
        kept_bytes -= sizes[path].st_size


def _list_files(client: "httpx.Client", address: "httpx.URL") -> Iterator[tuple[str, str, str]]:
    """Yield name, SHA-256 and address of the files of a package; none of one that the registry does not know."""
    with client.stream("GET", address) as answer:
        if answer.status_code == HTTPStatus.NOT_FOUND:
            return
        answer.raise_for_status()
        content = b"".join(_limited(answer, _LIST_BYTES, f"The list of {address}"))
    for file in msgspec.json.decode(content, type=Mapping[str, Any]).get("files", ()):
        match file:
            case {"filename": str(name), "url": str(url), "hashes": {"sha256": str(digest)}}:
                yield name, digest, url


def _fetch(client: "httpx.Client", address: "httpx.URL", name: str, digest: str, max_bytes: int) -> Path:
    """Store a wheel, whole or not at all."""
    folder = _folder() / digest
    folder.mkdir(parents=True, exist_ok=True)
    part = folder / f"part-{secrets.token_hex(8)}"
    hashed = hashlib.sha256()
    try:
        with client.stream("GET", address) as answer, part.open("wb") as file:
            answer.raise_for_status()
            for piece in _limited(answer, max_bytes, name):
                hashed.update(piece)
                file.write(piece)
        if hashed.hexdigest() != digest:
            raise _rejected(f"{name} of {address.host} has the hash {hashed.hexdigest()}, the registry said {digest}.")
        return part.rename(folder / name)
    finally:
        part.unlink(missing_ok=True)


def _limited(answer: "httpx.Response", max_bytes: int, what: str) -> Iterator[bytes]:
    deadline_s, left = monotonic() + _WHEEL_S, max_bytes
    for piece in answer.iter_bytes():
        left -= len(piece)
        if left < 0:
            raise _rejected(f"{what} is larger than {max_bytes} bytes; take another one.")
        if monotonic() > deadline_s:
            raise _rejected(f"{what} did not arrive within {_WHEEL_S:g} s; try again later.")
        yield piece


def _rejected(message: str) -> ArchiveRejected:
    return ArchiveRejected(ArchiveFault.WHEEL, message)
