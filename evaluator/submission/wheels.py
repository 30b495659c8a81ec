"""Wheels that a submission brings or names, and the registries that they are fetched from."""

import hashlib
import os
import platform
import re
import secrets
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cache
from http import HTTPStatus
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, Final

import msgspec
from packaging.metadata import Metadata
from packaging.requirements import InvalidRequirement, Requirement
from packaging.tags import Tag, sys_tags
from packaging.utils import InvalidWheelFilename, canonicalize_name, parse_wheel_filename
from packaging.version import Version
from vitac.envs.kernel_cache import cache_root

from ..agent.limits import MIB, Limits
from ..agent.runtime.agent import WHEELS_FOLDER
from ..package_sets import locked_versions, shown_sets
from ..tracks import load_track
from .archive import ArchiveEntry, packed_files, unpacked_too_large, write
from .manifest import load_manifest
from .names import REQUIREMENTS_NAME, ArchiveFault, ArchiveRejected, NamedEntry, check_names, listed

if TYPE_CHECKING:
    import httpx


PACKED_FOLDER: Final = "wheels"
HOUSE_VARIABLE: Final = "VITAC_WHEEL_HOUSE"
"""Names a folder with the wheels that requirements.txt may name."""
_DISTRIBUTIONS: Final = (".whl", ".tar.gz", ".tar.bz2", ".tgz", ".zip", ".egg")
_MAX_WHEELS: Final = 100
_METADATA_BYTES: Final = MIB
_REQUIREMENTS_BYTES: Final = MIB
_MAX_NEEDS: Final = 1000
"""Packages that one wheel may need, under any condition."""
_MAX_EXTRAS: Final = 100
"""Extras (`name[extra]`) that may be asked for."""
_OPTION: Final = re.compile(r"\s--hash[= ](\S+)")
_COMMENT: Final = re.compile(r"(^|\s)#.*")
_IMPORTED_PARTS: Final = ("purelib", "platlib")
"""Parts of a wheel's `.data` folder that belong into the folder of packages; scripts, headers and data are left out."""


@dataclass(frozen=True, kw_only=True)
class _Requirement:
    """A line of requirements.txt."""

    requirement: Requirement
    hashes: frozenset[str]

    @property
    def name(self) -> str:
        return canonicalize_name(self.requirement.name)

    def is_met_by(self, file_name: str) -> bool:
        """Return whether a file of this name is a wheel of the right version, for this machine."""
        try:
            name, version, _, tags = parse_wheel_filename(file_name)
        except InvalidWheelFilename:
            return False
        is_version = self.requirement.specifier.contains(version, prereleases=True)
        return name == self.name and is_version and not tags.isdisjoint(_machine_tags())


@dataclass(frozen=True, kw_only=True)
class _Wheel:
    """A wheel for this Python and machine, opened."""

    file: str
    metadata: Metadata
    sha256: str
    entries: tuple[ArchiveEntry, ...]
    """Its files, where they belong in the folder of packages."""

    @property
    def name(self) -> str:
        return canonicalize_name(self.metadata.name)


def unpack_wheels(submission_dir: Path, limits: Limits) -> None:
    """Unpack the wheels of an unpacked submission into its folder `WHEELS_FOLDER`, and remove them packed.

    Where a policy server plays, the folder's own code and its packages are not looked at.

    Args:
        submission_dir: what `archive.unpack` returned.
        limits: sizes and counts, for the wheels' files and the archive's together.

    Raises:
        ArchiveRejected: a wheel is missing, for another machine, not as its hash says, or breaks a rule of archives.
        ManifestRejected: the manifest is missing or wrong.
    """
    manifest = load_manifest(submission_dir)
    if manifest.remote is not None:
        return
    packed = _list_packed(submission_dir / PACKED_FOLDER)
    requirements = _read_requirements(submission_dir / REQUIREMENTS_NAME)
    if (submission_dir / WHEELS_FOLDER).exists():
        raise _rejected(f"{WHEELS_FOLDER}/ is where wheels are unpacked; give that folder another name.")
    if not packed and not requirements:
        return
    shown = locked_versions(shown_sets(load_track(manifest.track).packages))
    with ExitStack() as exits:
        wheels: dict[str, _Wheel] = {}
        for path in packed:
            _add(wheels, _open(path, f"{PACKED_FOLDER}/{path.name}", limits, exits))
        for required in requirements:
            with _reading(REQUIREMENTS_NAME):
                if not _is_met(required, wheels, shown):
                    _add(wheels, _open_required(required, limits, exits))
        _check_dependencies(wheels, requirements, shown)
        for path in packed:
            path.unlink()
        entries = [entry for wheel in wheels.values() for entry in wheel.entries]
        _check_together(entries, submission_dir, limits)
        write(entries, submission_dir, WHEELS_FOLDER, limits)


def _rejected(message: str) -> ArchiveRejected:
    return ArchiveRejected(ArchiveFault.WHEEL, message)


def _list_packed(folder: Path) -> list[Path]:
    """Return the wheels of the folder `wheels`; a folder of that name without distributions is the policy's own."""
    files = sorted(path for path in folder.glob("*") if path.is_file())
    if not any(path.name.lower().endswith(_DISTRIBUTIONS) for path in files):
        return []
    if others := [path.name for path in files if path.suffix != ".whl"]:
        raise _rejected(
            f"{PACKED_FOLDER}/ holds {listed(others)}, expected wheels only: source distributions are not built here. "
            f"Download wheels with `{_download('PACKAGE')}`."
        )
    return files


def _download(package: str) -> str:
    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    return (
        f"pip download --dest {PACKED_FOLDER} --only-binary :all: --python-version {python} "
        f"--platform manylinux_2_28_{platform.machine()} {package}"
    )


def _add(wheels: dict[str, _Wheel], wheel: _Wheel) -> None:
    if wheel.name in wheels:
        raise _rejected(f"{wheels[wheel.name].file} and {wheel.file} are the same package; leave one of them.")
    if len(wheels) == _MAX_WHEELS:
        raise _rejected(f"The submission has more than {_MAX_WHEELS} wheels; leave out what it does not import.")
    wheels[wheel.name] = wheel


# requirements.txt
def _read_requirements(file: Path) -> list[_Requirement]:
    """Return what requirements.txt names for this Python and machine."""
    if not file.is_file():
        return []
    if file.stat().st_size > _REQUIREMENTS_BYTES:
        raise _rejected(f"{REQUIREMENTS_NAME} is larger than {_REQUIREMENTS_BYTES} bytes; make it smaller.")
    text = file.read_text(encoding="utf-8", errors="replace").replace("\\\r\n", " ").replace("\\\n", " ")
    lines = filter(None, (_COMMENT.sub("", line).strip() for line in text.splitlines()))
    with _reading(REQUIREMENTS_NAME):
        requirements = [_parse_requirement(line) for line in lines]
        return [each for each in requirements if _applies(each.requirement)]


def _applies(requirement: Requirement, extra: str = "") -> bool:
    """Return whether the condition of a requirement holds here."""
    return requirement.marker is None or requirement.marker.evaluate({"extra": extra})


@contextmanager
def _reading(file: str) -> Iterator[None]:
    """Refuse a file whose names, versions or conditions cannot be read; some show only when they are compared."""
    try:
        yield
    except (ExceptionGroup, ValueError, RecursionError) as error:
        raise _rejected(f"{file} has a name, version or condition that cannot be read ({error!s:.200}).") from error


def _parse_requirement(line: str) -> _Requirement:
    shown = f"{REQUIREMENTS_NAME} has the line {line!r:.120}"
    try:
        requirement = Requirement(_OPTION.sub("", line).strip())
    except InvalidRequirement as error:
        raise _rejected(f"{shown}, expected NAME==VERSION --hash=sha256:DIGEST and no other options.") from error
    if requirement.url or [each.operator for each in requirement.specifier] not in (["=="], ["==="]):
        raise _rejected(f"{shown}, expected one version, as in NAME==VERSION --hash=sha256:DIGEST.")
    hashes = frozenset(_OPTION.findall(line))
    if not hashes or not all(re.fullmatch("sha256:[0-9a-f]{64}", each) for each in hashes):
        raise _rejected(
            f"{shown}, expected --hash=sha256:DIGEST with it; `pip hash FILE` prints the hash of a wheel, and "
            "`uv pip compile --generate-hashes` or `pip-compile --generate-hashes` writes such a file."
        )
    return _Requirement(requirement=requirement, hashes=hashes)


def _is_met(required: _Requirement, wheels: Mapping[str, _Wheel], shown: Mapping[str, tuple[str, ...]]) -> bool:
    """Return whether a wheel of the archive is what is required, or every policy sees that package anyway."""
    wheel = wheels.get(required.name)
    if wheel is None:
        return any(required.requirement.specifier.contains(version) for version in shown.get(required.name, ()))
    if not required.requirement.specifier.contains(wheel.metadata.version, prereleases=True):
        raise _rejected(
            f"{wheel.file} is {wheel.metadata.version}, but {REQUIREMENTS_NAME} has {required.requirement}."
        )
    if f"sha256:{wheel.sha256}" not in required.hashes:
        raise _other_hash(wheel, required)
    return True


def _other_hash(wheel: _Wheel, required: _Requirement) -> ArchiveRejected:
    return _rejected(
        f"{wheel.file} has the hash sha256:{wheel.sha256}, which {REQUIREMENTS_NAME} does not have for "
        f"{required.requirement}; take the file that was meant, or add its hash."
    )


def _open_required(required: _Requirement, limits: Limits, exits: ExitStack) -> _Wheel:
    """Return the wheel that a line names, from the wheel house or a registry."""
    house, registries = os.environ.get(HOUSE_VARIABLE), os.environ.get(REGISTRIES_VARIABLE)
    remedy = f"put its wheel into {PACKED_FOLDER}/: `{_download(str(required.requirement))}`"
    if not (house or registries):
        raise _rejected(
            f"{REQUIREMENTS_NAME} names {required.requirement}, but there is no wheel house here; {remedy}."
        )
    rejection = _rejected(
        f"{REQUIREMENTS_NAME} names {required.requirement}, of which {'the wheel house' if house else 'no registry'} "
        f"has {'no' if house else 'a'} wheel for {_describe_machine()}; ask the organizers, or {remedy}."
    )
    for path in sorted(Path(house).glob("*.whl")) if house else ():
        if not required.is_met_by(path.name):
            continue
        wheel = _open(path, path.name, limits, exits)
        if f"sha256:{wheel.sha256}" in required.hashes:
            return wheel
        rejection = _other_hash(wheel, required)
    digests = {each.removeprefix("sha256:") for each in required.hashes}
    fetched = fetch_wheel(required.name, digests, required.is_met_by, limits.archive_packed_bytes)
    if fetched is None:
        raise rejection
    return _open(fetched, fetched.name, limits, exits)


# Wheels
@cache
def _machine_tags() -> frozenset[Tag]:
    return frozenset(sys_tags())


def _describe_machine() -> str:
    return f"Python {sys.version_info.major}.{sys.version_info.minor} on {sys.platform} {platform.machine()}"


def _open(path: Path, file: str, limits: Limits, exits: ExitStack) -> _Wheel:
    """Open a wheel and check its name, directory and metadata."""
    try:
        name, version, _, tags = parse_wheel_filename(path.name)
    except InvalidWheelFilename as error:
        raise _rejected(
            f"{file} is not named as wheels are ({error}); keep the name that it was published with."
        ) from error
    if tags.isdisjoint(_machine_tags()):
        raise _rejected(
            f"{file} is for another Python or platform, expected {_describe_machine()}: "
            f"`{_download(f'{name}=={version}')}`."
        )
    stream = exits.enter_context(path.open("rb"))
    sha256 = hashlib.file_digest(stream, "sha256").hexdigest()
    try:
        entries = tuple(_place(packed_files(stream, limits, exits)))
        metadata = _read_metadata(entries, file)
    except ArchiveRejected as error:
        if error.code is ArchiveFault.WHEEL:
            raise
        raise ArchiveRejected(error.code, f"{file} cannot be unpacked. {error.message}") from error
    if (canonicalize_name(metadata.name), metadata.version) != (name, version):
        raise _rejected(f"{file} holds {metadata.name} {metadata.version}; keep the name that it was published with.")
    with _reading(file):
        python = metadata.requires_python
        is_for_another = python is not None and not python.contains(platform.python_version(), prereleases=True)
    if is_for_another:
        raise _rejected(f"{file} needs Python {python}, expected a version for {_describe_machine()}.")
    return _Wheel(file=file, metadata=metadata, sha256=sha256, entries=entries)


def _place(entries: Iterable[ArchiveEntry]) -> Iterator[ArchiveEntry]:
    """Yield what belongs into a folder of packages, without what would act beyond it: scripts, data, `.pth` files."""
    for entry in entries:
        first, _, rest = entry.path.partition("/")
        part, _, inside = rest.partition("/")
        path = entry.path
        if first.endswith(".data"):
            if part not in _IMPORTED_PARTS:
                continue
            path = inside
        if "/" in path or not path.endswith(".pth"):
            yield replace(entry, path=path)


def _read_metadata(entries: Iterable[ArchiveEntry], file: str) -> Metadata:
    """Return the metadata; the folder that holds it has the name by which the package is listed."""
    by_path = {entry.path: entry for entry in entries if re.fullmatch(r"[^/]+\.dist-info/[^/]+", entry.path)}
    folders = {path.partition("/")[0] for path in by_path}
    folder = next(iter(folders), "")
    entry = by_path.get(f"{folder}/METADATA")
    if len(folders) != 1 or entry is None:
        raise _rejected(f"{file} is no wheel: expected one folder .dist-info with METADATA, got {listed(folders)}.")
    if entry.n_bytes > _METADATA_BYTES:
        raise _rejected(f"{file} has METADATA of {entry.n_bytes} bytes, expected at most {_METADATA_BYTES}.")
    data = b"".join(entry.chunks())
    if len(re.findall(rb"^requires-dist", data, re.IGNORECASE | re.MULTILINE)) > _MAX_NEEDS:
        raise _rejected(f"{file} needs more than {_MAX_NEEDS} packages; take another version.")
    with _reading(file):
        metadata = Metadata.from_email(data, validate=False)
        name, _, version = folder.removesuffix(".dist-info").rpartition("-")
        is_named = (canonicalize_name(name), Version(version)) == (canonicalize_name(metadata.name), metadata.version)
        _ = metadata.requires_python, metadata.requires_dist  # which raise here if they cannot be read
    if not is_named:
        raise _rejected(f"{file} has the folder {folder}, expected {metadata.name}-{metadata.version}.dist-info.")
    return metadata


# All of them together
def _check_dependencies(
    wheels: Mapping[str, _Wheel], requirements: Iterable[_Requirement], shown: Mapping[str, tuple[str, ...]]
) -> None:
    """Refuse wheels that need what is neither among them nor shown to every policy.

    Raises:
        ArchiveRejected: the first package that is missing, and which wheel needs it.
    """
    asked = [(name, "") for name in wheels]
    asked += [(each.name, extra) for each in requirements for extra in each.requirement.extras]
    for name, extra in asked:  # which grows
        if name not in wheels:
            continue
        with _reading(wheels[name].file):
            asked += set(_find_extras(wheels[name], extra, wheels, shown)) - set(asked)
        if len(asked) > len(wheels) + _MAX_EXTRAS:
            raise _rejected(f"The wheels ask for more than {_MAX_EXTRAS} extras; leave out what is not imported.")


def _find_extras(
    wheel: _Wheel, extra: str, wheels: Mapping[str, _Wheel], shown: Mapping[str, tuple[str, ...]]
) -> Iterator[tuple[str, str]]:
    """Yield the extras that a wheel asks of others, each of which must be there."""
    for needed in wheel.metadata.requires_dist or ():
        if not _applies(needed, extra):
            continue
        name = canonicalize_name(needed.name)
        versions = (str(wheels[name].metadata.version),) if name in wheels else shown.get(name, ())
        if not any(needed.specifier.contains(version, prereleases=True) for version in versions):
            has = f"{' or '.join(versions)} is here" if versions else "which is not here"
            package = f"{needed.name}{needed.specifier}"
            raise _rejected(f"{wheel.file} needs {package}, {has}; add it: `{_download(repr(package))}`.")
        yield from ((name, each) for each in needed.extras)


def _check_together(entries: Iterable[ArchiveEntry], submission_dir: Path, limits: Limits) -> None:
    """Hold the files of all wheels and the submission's own to the limits of one archive."""
    own = [path for path in submission_dir.rglob("*") if path.is_file()]
    paths = [path.relative_to(submission_dir).as_posix() for path in own]
    paths += [f"{WHEELS_FOLDER}/{entry.path}" for entry in entries]
    check_names((NamedEntry(path=f"{submission_dir.name}/{path}", is_folder=False) for path in paths), limits)
    if (
        sum(path.stat().st_size for path in own) + sum(entry.n_bytes for entry in entries)
        > limits.archive_unpacked_bytes
    ):
        raise unpacked_too_large(limits)


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
