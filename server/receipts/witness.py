"""A witness: signs a log only where it continues what it has signed before. Called by `vitac witness`."""

import fcntl
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import NoReturn

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from vitac.errors import VitacError

from ..transparency.merkle import EMPTY_ROOT, ProofRejected, check_consistency
from ..transparency.notes import OF_WITNESS, Checkpoint, NoteRejected, Signature, VerifierKey, cosign
from ..transparency.tiles import PublishedLog


class HistoryRewritten(VitacError):
    """A log is not the continuation of what the witness has signed; the message says where both checkpoints are."""


class OtherSizeSigned(VitacError):
    """What the witness has signed last of a log has another size: prove the continuation from there."""

    def __init__(self, size: int) -> None:
        super().__init__(f"The witness has signed {size} entries of this log.")
        self.size = size


class WitnessUnusable(VitacError):
    """The folder of a witness cannot be used, or it has no name yet."""


class Witness:
    """A witness, whose key and last checkpoints are in a folder.

    Raises:
        WitnessUnusable: the folder cannot be written, or it has no key yet and no name is given.
    """

    def __init__(self, folder: Path, name: str | None = None) -> None:
        self._folder = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with self._locked():
                self._private_key, self.key = self._load_key(name)
        except OSError as error:
            raise WitnessUnusable(f"{folder} cannot be used as the folder of a witness: {error.strerror}.") from error

    def known_key(self, address: str) -> str | None:
        """Return the key that the log at an address had before, which is the only one that it may have; or None."""
        path = self._key_path(address)
        return path.read_text().strip() if path.exists() else None

    def observe(self, log: PublishedLog, address: str) -> Checkpoint:
        """Check that a log continues what was signed of it, store its checkpoint, and return that with a signature.

        Nothing is signed before it is on the disk, so that a witness that is killed never signs less than before.

        Raises:
            HistoryRewritten: the log has fewer entries than before, or other ones.
            ProofRejected: its tiles are not those of its checkpoint.
            TileMissing: a file of it is not there.
        """
        with self._locked():
            path, new = self._checkpoint_path(log.key), log.checkpoint
            if path.exists():
                self._require_continued(Checkpoint.parse(path.read_text()), log, path)
            elif log.tree.root() != new.root:
                raise ProofRejected(f"The tiles of the log do not have the root of its {new.size} entries.")
            _write_for_good(self._key_path(address), f"{log.key}\n")
            return new.with_signatures([self._sign(new, path)])

    def sign_next(self, key: VerifierKey, old_size: int, proof: Sequence[bytes], new: Checkpoint) -> Signature:
        """Return the signature of a log's checkpoint if it continues the one that was signed last, and store it before.

        Args:
            key: of the log; its signature is checked already.
            old_size: of the one that was signed last; 0: none was.
            proof: that the new one continues it.
            new: the checkpoint.

        Raises:
            OtherSizeSigned: another size was signed last.
            HistoryRewritten: the size is the same, and the entries are other ones.
            ProofRejected: the proof shows something else.
        """
        with self._locked():
            path = self._checkpoint_path(key)
            known = Checkpoint.parse(path.read_text()) if path.exists() else None
            old = known or Checkpoint(origin=key.name, size=0, root=EMPTY_ROOT)
            if old.size != old_size:
                raise OtherSizeSigned(old.size)
            if known and new.size == old.size and new.root != old.root:
                self._refuse(old, new, path)
            check_consistency(old.size, new.size, proof, old.root, new.root)
            return self._sign(new, path)

    def _sign(self, new: Checkpoint, path: Path) -> Signature:
        _write_for_good(path, str(new))
        return cosign(self._private_key, self.key.name, new, int(time.time()))

    def _checkpoint_path(self, key: VerifierKey) -> Path:
        return self._folder / f"{key.public_key.hex()[:16]}.checkpoint"

    def _key_path(self, address: str) -> Path:
        return self._folder / f"{sha256(address.encode()).hexdigest()[:16]}.key"

    def _require_continued(self, old: Checkpoint, log: PublishedLog, path: Path) -> None:
        new = log.checkpoint
        if new.size >= old.size and not (new.size == old.size and new.root != old.root):
            proof = log.tree.prove_consistency(old.size)
            try:
                check_consistency(old.size, new.size, proof, old.root, new.root)
            except ProofRejected:
                pass
            else:
                return
        self._refuse(old, new, path)

    def _refuse(self, old: Checkpoint, new: Checkpoint, path: Path) -> NoReturn:
        evidence = path.with_suffix(f".{new.size}-{new.root.hex()[:8]}.rewritten")
        _write_for_good(evidence, str(new))
        what = "was rolled back" if new.size < old.size else "shows another history"
        raise HistoryRewritten(
            f"The log {what}: {old.size} entries were signed with the root {old.root.hex()}, now it has {new.size} "
            f"with {new.root.hex()}. Nothing was signed. The checkpoints {path} and {evidence} prove it: publish them."
        )

    def _load_key(self, name: str | None) -> tuple[bytes, VerifierKey]:
        path = self._folder / "key"
        if not path.exists():
            if name is None:
                raise WitnessUnusable(
                    "The witness has no key yet: name it with --name, by an address that is yours, such as "
                    "witness.example.org/vitac."
                )
            _write_for_good(path, f"{name}\n{Ed25519PrivateKey.generate().private_bytes_raw().hex()}\n")
        stored, private_key = path.read_text().split()
        if name not in {None, stored}:
            raise WitnessUnusable(f"The witness in {self._folder} has the name {stored}, expected {name}.")
        secret = bytes.fromhex(private_key)
        public_key = Ed25519PrivateKey.from_private_bytes(secret).public_key().public_bytes_raw()
        key = VerifierKey(name=stored, kind=OF_WITNESS, public_key=public_key)
        try:
            return secret, VerifierKey.parse(str(key))
        except NoteRejected as error:
            path.unlink()
            raise WitnessUnusable(f"{stored!r} is no name: expected one word without '+'.") from error

    @contextmanager
    def _locked(self) -> Iterator[None]:
        """Let no other process use the folder while the block runs."""
        with (self._folder / "lock").open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            yield


def _write_for_good(path: Path, content: str) -> None:
    """Write a file that only its owner reads, whole or not at all, and on the disk before this returns."""
    unfinished = path.with_suffix(".unfinished")
    with os.fdopen(os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    unfinished.replace(path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
