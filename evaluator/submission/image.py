"""Unpacks a container image, as `docker save`, `podman save`, `skopeo copy` and Kaniko write it, and reads its command.

Called where `archive` is: by the upload, by workers and by `vitac check`. Every digest that an image gives is verified.
"""

import gzip
import hashlib
import io
import platform
import re
import shutil
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO, Final, TypeVar

import msgspec

from ..agent.isolation.gpu import ImageProgram
from ..agent.limits import Limits
from ..tracks import list_tracks, load_track
from .layers import EntryType, ImageFiles, TarEntry, damaged, read_tar
from .manifest import ManifestRejected, SubmissionManifest, load_manifest
from .names import MANIFEST_NAME, ArchiveFault, ArchiveRejected, listed

_PROGRAM_NAME: Final = "image.json"
_ROOT_NAME: Final = "root"
_JSON_BYTES: Final = 4 << 20
_MAX_FILES: Final = 10_000
"""Files of a saved image, a few for each layer."""
_MAX_LAYERS: Final = 500
_MAX_INDEXES: Final = 3
_COMMAND_BYTES: Final = 64 << 10
_GZIP: Final = b"\x1f\x8b"
_ZSTD: Final = b"\x28\xb5\x2f\xfd"
_BUFFER_BYTES: Final = 1 << 20
_RATIO_FREE_BYTES: Final = 64 << 20
"""Up to this size a layer may compress as well as it does."""
_MACHINES: Final = {"x86_64": "amd64", "aarch64": "arm64"}
_INDEX_TYPES: Final = ("index.v1+json", "manifest.list.v2+json")
_DIGEST: Final = re.compile(r"sha256:[0-9a-f]{64}")
_NAMED_DIGEST: Final = re.compile(r"(?:^blobs/sha256/|^sha256:|^)([0-9a-f]{64})(?:\.json|\.tar|\.tar\.gz)?$")
"""Names of the files of a saved image that are the digest of what is in them."""


class _Platform(msgspec.Struct):
    architecture: str = ""
    os: str = ""


class _Descriptor(msgspec.Struct):
    digest: str
    media_type: str = msgspec.field(default="", name="mediaType")
    platform: _Platform | None = None


class _Index(msgspec.Struct):
    manifests: list[_Descriptor]


class _OciManifest(msgspec.Struct):
    config: _Descriptor
    layers: list[_Descriptor]


class _DockerManifest(msgspec.Struct):
    config: str = msgspec.field(name="Config")
    layers: list[str] = msgspec.field(name="Layers")


class _Process(msgspec.Struct):
    variables: list[str] | None = msgspec.field(default=None, name="Env")
    entry_point: list[str] | None = msgspec.field(default=None, name="Entrypoint")
    command: list[str] | None = msgspec.field(default=None, name="Cmd")
    folder: str = msgspec.field(default="", name="WorkingDir")


class _Layers(msgspec.Struct):
    diff_ids: list[str]


class _Config(msgspec.Struct):
    rootfs: _Layers
    architecture: str = ""
    os: str = ""
    config: _Process | None = None


class _StoredProgram(msgspec.Struct, frozen=True):
    """The file `image.json` beside the unpacked files."""

    arguments: tuple[str, ...]
    variables: dict[str, str]
    folder: str


_Document = TypeVar("_Document")


def unpack_image(source: Path, destination: Path, limits: Limits | None = None) -> Path:
    """Unpack an image into a new folder; on a rejection nothing of it is left.

    Args:
        source: the tar.
        destination: folder that does not exist yet, or is empty.
        limits: sizes and counts.

    Returns:
        A folder with the image's submission.yaml, readable by every user; `load_program` reads what else is there.

    Raises:
        ArchiveRejected: a rule is broken.
        ManifestRejected: the image has no submission.yaml at its top, or a wrong one.
    """
    limits = limits or Limits()
    destination.mkdir(mode=0o755, parents=True, exist_ok=True)
    folder, contents = destination / "image", destination / "contents"
    try:
        folder.mkdir()
        folder.chmod(0o755)
        contents.mkdir()
        with _opened(source, limits) as saved:
            config = saved.config()
            program = _find_program(config)
            files = ImageFiles(contents, limits)
            for layer in saved.layers(config):
                files.add_layer(layer)
        files.write(folder / _ROOT_NAME)
        (folder / _PROGRAM_NAME).write_bytes(msgspec.json.encode(program))
        _check_size(_take_manifest(folder).track, max(saved.n_bytes, saved.layer_bytes), limits)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    finally:
        shutil.rmtree(contents, ignore_errors=True)
    return folder


def largest_image_bytes(limits: Limits) -> int:
    """Return the size of the largest image that any track takes [bytes]: an image says at its end which it is for."""
    return max(limits.image_bytes, *(load_track(name).image_bytes or 0 for name in list_tracks()))


def list_layers(source: Path, limits: Limits | None = None) -> list[tuple[int, int]]:
    """Return where the layers of an image lie in its file, as (start, length).

    Raises:
        ArchiveRejected: it is none, or damaged.
    """
    with _opened(source, limits or Limits()) as saved:
        return saved.layer_places()


def image_digest(source: Path, limits: Limits | None = None) -> str:
    """Return the id of an image: SHA-256 of its configuration, which names every layer by that of its content.

    Raises:
        ArchiveRejected: it is none, or damaged.
    """
    with _opened(source, limits or Limits()) as saved:
        return hashlib.sha256(saved.config_bytes()).hexdigest()


def load_program(folder: Path) -> ImageProgram:
    """Return what `unpack_image` has found to run."""
    stored = msgspec.json.decode((folder / _PROGRAM_NAME).read_bytes(), type=_StoredProgram)
    return ImageProgram(
        root=folder / _ROOT_NAME, arguments=stored.arguments, variables=stored.variables, folder=stored.folder
    )


def _take_manifest(folder: Path) -> SubmissionManifest:
    """Copy submission.yaml out of the unpacked files and check it."""
    inside = folder / _ROOT_NAME / MANIFEST_NAME
    if inside.is_symlink() or not inside.is_file():
        raise ManifestRejected(
            f"The image has no file /{MANIFEST_NAME}; add it to the Dockerfile: `COPY {MANIFEST_NAME} /`."
        )
    shutil.copyfile(inside, folder / MANIFEST_NAME)
    manifest = load_manifest(folder)
    if unused := {"entry_point", "remote"} & manifest.model_fields_set:
        raise ManifestRejected(
            f"{MANIFEST_NAME}: {' and '.join(sorted(unused))} is not of an image, whose command plays; leave it out."
        )
    return manifest


def _check_size(track: str, n_bytes: int, limits: Limits) -> None:
    most = load_track(track).image_bytes or limits.image_bytes
    if n_bytes > most:
        raise ArchiveRejected(
            ArchiveFault.UNPACKED_TOO_LARGE,
            f"The image has {n_bytes} bytes, packed or unpacked, expected at most {most}, which {track} takes; "
            "install less.",
        )


@contextmanager
def _opened(source: Path, limits: Limits) -> "Iterator[_Saved]":
    with source.open("rb") as file:
        yield _Saved(file, replace(limits, image_bytes=largest_image_bytes(limits)))


class _Saved:
    """A saved image: its files, and which of them are its configuration and layers."""

    def __init__(self, file: BinaryIO, limits: Limits) -> None:
        self._file = file
        self._limits = limits
        self._check_packed()
        self._places: dict[str, tuple[int, int]] = {}
        """Where the content of each file begins, and its length."""
        links: dict[str, str] = {}
        for entry in read_tar(file.read, "The image"):
            path = PurePosixPath(entry.path)
            if entry.type is EntryType.FILE:
                self._places[str(path)] = (file.tell(), entry.n_bytes)
            elif entry.type is EntryType.SYMLINK:  # layers that an image has twice
                links[str(path)] = _below(path.parent, entry.link)
            if len(self._places) + len(links) > _MAX_FILES:
                raise _rejected(f"The tar has more than {_MAX_FILES} files, expected a saved image; save it again.")
        self._places |= {name: self._places[to] for name, to in links.items() if to in self._places}
        self._config_name, self._layer_names = self._find_parts()

    def _check_packed(self) -> None:
        self.n_bytes = self._file.seek(0, io.SEEK_END)
        if self.n_bytes > self._limits.image_bytes:
            raise ArchiveRejected(
                ArchiveFault.TOO_LARGE,
                f"The image has {self.n_bytes} bytes, expected at most {self._limits.image_bytes}.",
            )
        self._file.seek(0)
        if self._file.read(len(_GZIP)) == _GZIP:
            raise _rejected(
                "The image is packed as a whole, expected a tar, whose layers may be: unpack it (`gunzip`)."
            )
        self._file.seek(0)

    def layer_places(self) -> list[tuple[int, int]]:
        """Return where the layers lie in the file, as (start, length)."""
        return [self._places[name] for name in self._layer_names if name in self._places]

    def config_bytes(self) -> bytes:
        """Return the configuration as it is stored."""
        return self._read(self._config_name)

    def config(self) -> _Config:
        """Return the configuration, for this machine.

        Raises:
            ArchiveRejected: it is for another one.
        """
        config = _decode(self.config_bytes(), _Config, "its configuration")
        expected = _MACHINES.get(platform.machine(), platform.machine())
        if (config.os or "linux", config.architecture or expected) != ("linux", expected):
            raise _rejected(
                f"The image is for {config.os} {config.architecture}, expected linux {expected}: "
                f"`docker build --platform linux/{expected}`."
            )
        if len(config.rootfs.diff_ids) != len(self._layer_names):
            raise damaged(
                "The image", f"it has {len(self._layer_names)} layers and {len(config.rootfs.diff_ids)} digests of them"
            )
        return config

    def layers(self, config: _Config) -> Iterator[Iterator[TarEntry]]:
        """Yield the entries of each layer from the lowest on; a layer is read to its end before the next."""
        left = self._limits.image_bytes
        self.layer_bytes = 0
        for number, (name, diff_id) in enumerate(zip(self._layer_names, config.rootfs.diff_ids, strict=True), 1):
            layer = _Layer(self._open(name), what=f"Layer {number}", left=left, limits=self._limits)
            yield layer.entries()
            layer.finish(diff_id, _digest_in(name))
            left, self.layer_bytes = layer.left, self.layer_bytes + left - layer.left

    def _find_parts(self) -> tuple[str, list[str]]:
        """Return the names of the configuration and of the layers, from the lowest on."""
        if "manifest.json" in self._places:
            images = _decode(self._read("manifest.json"), list[_DockerManifest], "manifest.json")
            if len(images) != 1:
                raise _rejected(f"The tar holds {len(images)} images, expected one; save the one that plays.")
            config, layers = images[0].config, [str(PurePosixPath(name)) for name in images[0].layers]
        elif "index.json" in self._places:
            manifest = _decode(self._read(self._choose_image()), _OciManifest, "its manifest")
            config, layers = _blob(manifest.config), [_blob(layer) for layer in manifest.layers]
        else:
            raise _rejected(
                f"The tar holds {listed(self._places)}, expected a saved image with manifest.json or index.json; save "
                "one with `docker save -o policy.tar IMAGE`."
            )
        if len(layers) > _MAX_LAYERS:
            raise _rejected(f"The image has {len(layers)} layers, expected at most {_MAX_LAYERS}; build it in fewer.")
        return config, layers

    def _choose_image(self) -> str:
        """Return the name of the manifest for this machine out of the indexes of an OCI layout."""
        name, machine = "index.json", _MACHINES.get(platform.machine(), platform.machine())
        for _ in range(_MAX_INDEXES):
            index = _decode(self._read(name), _Index, "its index")
            fitting = [
                each
                for each in index.manifests
                if each.platform is None or (each.platform.os, each.platform.architecture) == ("linux", machine)
            ]
            if len(fitting) != 1:
                raise _rejected(
                    f"The tar holds {len(fitting)} images for linux {machine}, expected one; save the one that plays."
                )
            name = _blob(fitting[0])
            if not fitting[0].media_type.endswith(_INDEX_TYPES):
                return name
        raise _rejected(
            f"The tar holds indexes of indexes, more than {_MAX_INDEXES}, expected an image; save it again."
        )

    def _read(self, name: str) -> bytes:
        """Return a small file, its digest verified where its name is one."""
        with self._open(name) as file:
            data = file.read(_JSON_BYTES + 1)
        if len(data) > _JSON_BYTES:
            raise damaged("The image", f"{name!r:.100} has more than {_JSON_BYTES} bytes")
        _verify(f"{name!r:.100}", hashlib.sha256(data).hexdigest(), _digest_in(name))
        return data

    def _open(self, name: str) -> BinaryIO:
        if name not in self._places:
            raise damaged("The image", f"{name!r:.100} is missing")
        return io.BufferedReader(_Part(self._file, *self._places[name]), _BUFFER_BYTES)


class _Part(io.RawIOBase):
    """A part of a file as a file; nothing else reads the file meanwhile."""

    def __init__(self, file: BinaryIO, start: int, n_bytes: int) -> None:
        file.seek(start)
        self._file = file
        self._left = n_bytes

    def readable(self) -> bool:
        """Return that it can be read."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Read what comes next."""
        data = self._file.read(min(len(buffer), self._left))
        buffer[: len(data)] = data
        self._left -= len(data)
        return len(data)


class _Layer:
    """One layer, unpacked as it is read; all that is read is counted and hashed."""

    def __init__(self, packed: BinaryIO, *, what: str, left: int, limits: Limits) -> None:
        self._packed = _Hashed(packed)
        self._unpacked = _unpacked(self._packed, packed.peek(len(_ZSTD)))  # type: ignore[attr-defined]
        self._hash = hashlib.sha256()
        self._what = what
        self._limits = limits
        self._n_bytes = 0
        self.left = left
        """Bytes that this layer and those above may still have."""

    def entries(self) -> Iterator[TarEntry]:
        """Yield what the layer holds; of a file that is too large nothing is read."""
        for entry in read_tar(self._read, self._what):
            if entry.n_bytes > self.left:
                raise self._too_large()
            yield entry

    def finish(self, diff_id: str, digest: str | None) -> None:
        """Read to the end, and compare digests: that of the content, and that of the packed bytes if there is one."""
        while self._read(_BUFFER_BYTES):
            pass
        self._packed.read_all()
        if not _DIGEST.fullmatch(diff_id):
            raise damaged(self._what, f"its digest is {diff_id!r:.100}, expected sha256 and 64 digits")
        _verify(self._what, self._hash.hexdigest(), diff_id.removeprefix("sha256:"))
        _verify(f"{self._what}, packed,", self._packed.hexdigest(), digest)

    def _read(self, n_bytes: int) -> bytes:
        try:
            data: bytes = self._unpacked.read(n_bytes)
        except (OSError, EOFError, zlib.error, _zstd_error()) as error:
            raise damaged(self._what, f"it cannot be unpacked ({error})") from error
        self._hash.update(data)
        self._n_bytes += len(data)
        self.left -= len(data)
        if self.left < 0:
            raise self._too_large()
        if self._n_bytes > max(_RATIO_FREE_BYTES, self._packed.n_bytes * self._limits.archive_ratio):
            raise ArchiveRejected(
                ArchiveFault.COMPRESSED_TOO_MUCH,
                f"{self._what} unpacks to more than {self._limits.archive_ratio:g} times its size; leave out what "
                "compresses like that.",
            )
        return data

    def _too_large(self) -> ArchiveRejected:
        return ArchiveRejected(
            ArchiveFault.UNPACKED_TOO_LARGE,
            f"The layers of the image are larger than {self._limits.image_bytes} bytes together; install less.",
        )


class _Hashed(io.RawIOBase):
    """Passes on what it reads, and hashes it."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._hash = hashlib.sha256()
        self.n_bytes = 0

    def readable(self) -> bool:
        """Return that it can be read."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Read what comes next."""
        data = self._file.read(len(buffer))
        buffer[: len(data)] = data
        self._hash.update(data)
        self.n_bytes += len(data)
        return len(data)

    def read_all(self) -> None:
        """Read to the end."""
        while data := self._file.read(_BUFFER_BYTES):
            self._hash.update(data)

    def hexdigest(self) -> str:
        """Return the digest of all that was read."""
        return self._hash.hexdigest()


def _unpacked(packed: _Hashed, start: bytes) -> BinaryIO:
    if start.startswith(_GZIP):
        return gzip.GzipFile(fileobj=packed)  # type: ignore[return-value]
    if start.startswith(_ZSTD):
        return io.BufferedReader(_open_zstd(packed), _BUFFER_BYTES)
    return io.BufferedReader(packed, _BUFFER_BYTES)


def _open_zstd(packed: Any) -> Any:
    try:
        from compression.zstd import ZstdFile  # type: ignore[import-not-found]  # of Python 3.14
    except ImportError:
        import zstandard

        return zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
    return ZstdFile(packed)


def _zstd_error() -> type[Exception]:
    try:
        from compression.zstd import ZstdError
    except ImportError:
        from zstandard import ZstdError
    error: type[Exception] = ZstdError
    return error


def _find_program(config: _Config) -> _StoredProgram:
    """Return the image's command with what it sets around it."""
    process = config.config or _Process()
    arguments = (*(process.entry_point or ()), *(process.command or ()))
    pairs = [variable.partition("=") for variable in process.variables or ()]
    texts = [*arguments, *(text for pair in pairs for text in pair), process.folder]
    if not arguments:
        raise _rejected('The image has no command; give it one in the Dockerfile: `CMD ["python3", "/policy.py"]`.')
    if any("\0" in text for text in texts) or sum(map(len, texts)) > _COMMAND_BYTES:
        raise _rejected(
            f"The image's command and variables have a NUL or more than {_COMMAND_BYTES} characters; make them shorter."
        )
    variables = {name: value for name, _, value in pairs if name}
    return _StoredProgram(arguments=arguments, variables=variables, folder=process.folder or "/")


def _decode(data: bytes, of: type[_Document], what: str) -> _Document:
    try:
        return msgspec.json.decode(data, type=of)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise damaged("The image", f"{what} cannot be read ({error!s:.200})") from error


def _blob(descriptor: _Descriptor) -> str:
    if not _DIGEST.fullmatch(descriptor.digest):
        raise damaged("The image", f"it has the digest {descriptor.digest!r:.100}, expected sha256 and 64 digits")
    return f"blobs/{descriptor.digest.replace(':', '/')}"


def _digest_in(name: str) -> str | None:
    """Return the digest that a file has for its name, None where the name is none."""
    match = _NAMED_DIGEST.search(name)
    return match[1] if match else None


def _verify(what: str, got: str, expected: str | None) -> None:
    if expected is not None and got != expected:
        raise damaged(what, f"it has the digest sha256:{got}, expected sha256:{expected}")


def _below(folder: PurePosixPath, target: str) -> str:
    """Return the path that a link in a folder of the tar leads to."""
    parts: list[str] = []
    for part in (folder / target).parts:
        parts = parts[:-1] if part == ".." else [*parts, part]
    return "/".join(parts)


def _rejected(message: str) -> ArchiveRejected:
    return ArchiveRejected(ArchiveFault.IMAGE, message)
