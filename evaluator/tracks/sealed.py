"""Episode lists derived from a secret; used where an organizer evaluates on a list that nobody knows.

Before, the commitment is published; afterwards the secret, from which anybody derives the same list. Every number is
taken from HMAC-SHA256 alone, so that no version of a library changes a list.
"""

import hashlib
import hmac
import os
import re
import secrets
from collections.abc import Iterator
from pathlib import Path
from pkgutil import resolve_name
from typing import TypeVar

from vitac.errors import VitacError

from .definition import EpisodeBlock, EpisodeList, Start, Task, Track
from .registry import load_track

SECRET_BYTES = 32
_SECRET = re.compile(r"[0-9a-f]{64}")
_COMMITTED = b"vitac-sealed-list-1\n"
_DIGITS = 3
"""Decimals of an offset: micrometres and thousandths of a degree."""
_ATTEMPTS = 1000


ModelT = TypeVar("ModelT", Task, Track)


class SecretRejected(VitacError):
    """The secret of a sealed list cannot be read or written, or no list follows from it; the message says why."""


def new_secret(path: Path) -> bytes:
    """Write a new secret to a file that only its owner can read, and return it.

    Raises:
        SecretRejected: the file exists already or cannot be written.
    """
    secret = secrets.token_bytes(SECRET_BYTES)
    try:
        write_secret(path, secret)
    except OSError as error:
        raise SecretRejected(f"The secret cannot be written to {path}: {error.strerror}. Name a new file.") from error
    return secret


def write_secret(path: Path, secret: bytes) -> None:
    """Write a secret to a new file that only its owner can read, as `read_secret` reads it.

    Raises:
        OSError: the file exists already or cannot be written.
    """
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "w", encoding="ascii") as file:
        file.write(secret.hex() + "\n")


def read_secret(path: Path) -> bytes:
    """Return the secret in a file.

    Raises:
        SecretRejected: there is none in it.
    """
    try:
        with path.open("rb") as file:
            text = file.read(2 * SECRET_BYTES + 16).decode("ascii", "replace").strip()
    except OSError as error:
        raise SecretRejected(f"The secret cannot be read from {path}: {error.strerror}.") from error
    if not _SECRET.fullmatch(text):
        raise SecretRejected(f"{path} is no secret: expected {2 * SECRET_BYTES} hexadecimal digits (vitac seeds new).")
    return bytes.fromhex(text)


def make_commitment(secret: bytes) -> str:
    """Return the SHA-256 [hex] that is published before a list is used: it fixes the list and reveals nothing of it."""
    return hashlib.sha256(_COMMITTED + secret).hexdigest()


def load_played_track(name: str, secret: bytes | None) -> Track:
    """Return a track with the lists that are played: those of a secret, or the public ones for None.

    Raises:
        UnknownTrack: no such track.
        SecretRejected: as `sealed_track`.
    """
    track = load_track(name)
    return track if secret is None else sealed_track(track, secret)


def sealed_track(track: Track, secret: bytes) -> Track:
    """Return the track with lists derived from a secret: as many episodes of each shape, in the same order and blocks.

    Every number of an offset is uniform over the range that it has in the public list, for each shape.

    Raises:
        SecretRejected: a task refuses every start that was drawn.
    """
    tasks = {name: _copy_with(task, episode_list=_derived(track, task, secret)) for name, task in track.tasks.items()}
    return _copy_with(track, tasks=tasks)


def _copy_with(model: ModelT, **changes: object) -> ModelT:
    """Return the model with other fields, and without what the given one has computed and kept."""
    return type(model)(**({name: getattr(model, name) for name in type(model).model_fields} | changes))


def _derived(track: Track, task: Task, secret: bytes) -> EpisodeList:
    public = task.episode_list
    ranges = {shape: _ranges(public, shape) for shape in public.shapes}
    number = 0
    blocks = []
    for block in public.blocks:
        starts = []
        for start in block.starts:
            number += 1
            label = f"{track.name}\n{task.name}\nstart {number}"
            starts.append(_start(task, start.shape, ranges[start.shape], _fractions(secret, label)))
        blocks.append(EpisodeBlock(repeats=block.repeats, starts=tuple(starts)))
    seed = _digest(secret, f"{track.name}\n{task.name}\nlist seed")
    return EpisodeList(
        list_seed=int.from_bytes(seed[:8], "big") >> 1,
        offset_option=public.offset_option,
        blocks=tuple(blocks),
        commitment=make_commitment(secret),
    )


def _ranges(public: EpisodeList, shape: str) -> list[tuple[float, float]]:
    """Return the smallest and largest value of each number of the offset."""
    columns = zip(*(start.offset for start in public.starts if start.shape == shape), strict=True)
    return [(min(column), max(column)) for column in columns]


def _start(task: Task, shape: str, ranges: list[tuple[float, float]], fractions: Iterator[float]) -> Start:
    """Return the first start that the task accepts."""
    accepts = resolve_name(task.definition.accepts_start) if task.definition.accepts_start else None
    for _ in range(_ATTEMPTS):
        offset = tuple(round(low + (high - low) * next(fractions), _DIGITS) for low, high in ranges)
        if accepts is None or accepts(shape, offset):
            return Start(shape=shape, offset=offset)
    raise SecretRejected(f"{task.name} accepted none of {_ATTEMPTS} starts of {shape}; widen its public list.")


def _fractions(secret: bytes, label: str) -> Iterator[float]:
    """Yield numbers from 0 to below 1: 53 bits of each 8 bytes of HMAC-SHA256(secret, label and a counter)."""
    counter = 0
    while True:
        digest = _digest(secret, f"{label}\n{counter}")
        for begin in range(0, len(digest), 8):
            yield (int.from_bytes(digest[begin : begin + 8], "big") >> 11) * 2.0**-53
        counter += 1


def _digest(secret: bytes, label: str) -> bytes:
    return hmac.digest(secret, label.encode(), "sha256")
