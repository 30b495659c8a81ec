"""Signed notes: checkpoints of a log, and what witnesses sign of them.

The forms are https://c2sp.org/signed-note, tlog-checkpoint, tlog-cosignature (Ed25519) and tlog-proof.
"""

import re
from base64 import b64decode, b64encode
from binascii import Error as NotBase64
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Final

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from vitac.errors import VitacError

from .merkle import check_inclusion

OF_LOG: Final = 1
OF_WITNESS: Final = 4
"""Kinds of Ed25519 keys: what they sign has another form."""
MAX_NOTE_CHARS: Final = 16_384
_PROOF: Final = "c2sp.org/tlog-proof@v1"
_NAME = re.compile(r"[^\s+]{1,100}")
_TIME_BYTES = 8
_LATEST_S = 2**37
"""In the year 6325; later ones are no times."""


class NoteRejected(VitacError):
    """A note, a key or a signature does not have its form, or is signed by somebody else."""


@dataclass(frozen=True, kw_only=True)
class VerifierKey:
    """A public key with its name, written `NAME+ID+KEY`; `kind` is OF_LOG or OF_WITNESS."""

    name: str
    kind: int
    public_key: bytes

    @property
    def id(self) -> bytes:
        """The four bytes by which a signature names the key."""
        return sha256(f"{self.name}\n".encode() + bytes([self.kind]) + self.public_key).digest()[:4]

    def __str__(self) -> str:
        return f"{self.name}+{self.id.hex()}+{b64encode(bytes([self.kind]) + self.public_key).decode()}"

    @classmethod
    def parse(cls, text: str) -> "VerifierKey":
        """Read a key.

        Raises:
            NoteRejected: it is none.
        """
        name, *rest = text.strip().split("+", 2)
        try:
            key_id, encoded = rest
            kind, *key = b64decode(encoded, validate=True)
        except (ValueError, NotBase64):
            raise NoteRejected(f"Expected a key as NAME+ID+KEY, got {text[:100]!r}.") from None
        verifier = cls(name=name, kind=kind, public_key=bytes(key))
        if (
            not _NAME.fullmatch(name)
            or kind not in {OF_LOG, OF_WITNESS}
            or len(key) != 32
            or verifier.id.hex() != key_id
        ):
            raise NoteRejected(f"{text[:100]!r} is no Ed25519 key of a log or a witness, or a part of it was changed.")
        return verifier


@dataclass(frozen=True, kw_only=True)
class Signature:
    """A line of a note: who signed, and the bytes."""

    name: str
    key_id: bytes
    content: bytes

    def __str__(self) -> str:
        return f"\N{EM DASH} {self.name} {b64encode(self.key_id + self.content).decode()}\n"

    def is_by(self, key: VerifierKey) -> bool:
        """Return whether it names that key, whatever it signs."""
        return (self.name, self.key_id) == (key.name, key.id)


@dataclass(frozen=True, kw_only=True)
class Checkpoint:
    """What a log says of itself: `origin` is its name; the first `size` entries have the root."""

    origin: str
    size: int
    root: bytes
    signatures: tuple[Signature, ...] = ()

    @property
    def body(self) -> str:
        """What is signed."""
        return f"{self.origin}\n{self.size}\n{b64encode(self.root).decode()}\n"

    def __str__(self) -> str:
        return f"{self.body}\n{''.join(map(str, self.signatures))}"

    @classmethod
    def parse(cls, text: str) -> "Checkpoint":
        """Read a checkpoint, whoever signed it.

        Raises:
            NoteRejected: it is none.
        """
        match = re.fullmatch(
            r"([^\s+]{1,200})\n(0|[1-9]\d{0,15})\n([A-Za-z0-9+/]{43}=)\n\n((?:\N{EM DASH} [^\s+]+ [A-Za-z0-9+/=]+\n)+)",
            text if len(text) <= MAX_NOTE_CHARS else "",
        )
        if match is None:
            raise NoteRejected(f"Expected a checkpoint (origin, size, root, signatures), got {text[:60]!r}.")
        origin, size, root, lines = match.groups()
        return cls(
            origin=origin, size=int(size), root=b64decode(root), signatures=tuple(_signatures(lines.splitlines()))
        )

    def require_signature(self, key: VerifierKey) -> None:
        """Refuse what is not of the log of a key.

        Raises:
            NoteRejected: another origin, or its signature is missing or wrong.
        """
        if self.origin != key.name:
            raise NoteRejected(f"The checkpoint is of another log: expected {key.name}, got {self.origin}.")
        line = next((line for line in self.signatures if line.is_by(key)), None)
        if line is None or not _is_signed(key, line.content, self.body.encode()):
            raise NoteRejected(f"The checkpoint of {self.size} entries is not signed by {key}.")

    def find_witnesses(self, keys: Iterable[VerifierKey]) -> Iterator[tuple[VerifierKey, int]]:
        """Yield those of some keys that have co-signed, with the time [s since 1970]."""
        for key in keys:
            for line in self.signatures:
                if (signed_at := self.read_cosignature(key, line)) is not None:
                    yield key, signed_at
                    break

    def read_cosignature(self, key: VerifierKey, line: Signature) -> int | None:
        """Return when a witness signed this [s since 1970]; None where it did not."""
        if key.kind != OF_WITNESS or not line.is_by(key) or len(line.content) <= _TIME_BYTES:
            return None
        signed_at = int.from_bytes(line.content[:_TIME_BYTES])
        if signed_at > _LATEST_S:
            return None
        return signed_at if _is_signed(key, line.content[_TIME_BYTES:], _cosigned(signed_at, self.body)) else None

    def with_signatures(self, lines: Iterable[Signature]) -> "Checkpoint":
        """Return it with further signatures."""
        return replace(self, signatures=(*self.signatures, *lines))


@dataclass(frozen=True, kw_only=True)
class InclusionProof:
    """Proof that an entry is in a log at an index, from 0; it can be checked without a service."""

    index: int
    hashes: tuple[bytes, ...]
    checkpoint: Checkpoint

    def __str__(self) -> str:
        hashes = "".join(f"{b64encode(each).decode()}\n" for each in self.hashes)
        return f"{_PROOF}\nindex {self.index}\n{hashes}\n{self.checkpoint}"

    @classmethod
    def parse(cls, text: str) -> "InclusionProof":
        """Read a proof.

        Raises:
            NoteRejected: it is none.
        """
        head, _, checkpoint = text.partition("\n\n")
        match = re.fullmatch(
            rf"{re.escape(_PROOF)}\nindex (0|[1-9]\d{{0,15}})((?:\n[A-Za-z0-9+/]{{43}}=){{0,63}})", head
        )
        if match is None:
            raise NoteRejected(f"Expected a proof that begins with {_PROOF!r}, got {text[:40]!r}.")
        hashes = tuple(map(b64decode, match[2].split()))
        return cls(index=int(match[1]), hashes=hashes, checkpoint=Checkpoint.parse(checkpoint))

    def require_valid(self, leaf: bytes, key: VerifierKey) -> None:
        """Refuse a proof that does not lead from a leaf to a root that the log has signed.

        Raises:
            NoteRejected: it is of another log.
            ProofRejected: it leads elsewhere.
        """
        self.checkpoint.require_signature(key)
        check_inclusion(leaf, self.index, self.checkpoint.size, self.hashes, self.checkpoint.root)


def make_log_key(public_key: bytes) -> VerifierKey:
    """Return the key of a log, which is named after it: the name stays where the service moves to another host."""
    return VerifierKey(name=f"vitac.log/{public_key.hex()[:16]}", kind=OF_LOG, public_key=public_key)


def sign_checkpoint(private_key: bytes, *, size: int, root: bytes) -> Checkpoint:
    """Return what a log says of itself; the same for the same entries, whoever asks when."""
    signer = Ed25519PrivateKey.from_private_bytes(private_key)
    key = make_log_key(signer.public_key().public_bytes_raw())
    unsigned = Checkpoint(origin=key.name, size=size, root=root)
    line = Signature(name=key.name, key_id=key.id, content=signer.sign(unsigned.body.encode()))
    return unsigned.with_signatures([line])


def cosign(private_key: bytes, name: str, checkpoint: Checkpoint, signed_at: int) -> Signature:
    """Return the signature of a witness that has seen no other history of the log.

    Args:
        private_key: 32 bytes.
        name: of the witness.
        checkpoint: that it has checked.
        signed_at: now [s since 1970].
    """
    signer = Ed25519PrivateKey.from_private_bytes(private_key)
    key = VerifierKey(name=name, kind=OF_WITNESS, public_key=signer.public_key().public_bytes_raw())
    content = signed_at.to_bytes(_TIME_BYTES) + signer.sign(_cosigned(signed_at, checkpoint.body))
    return Signature(name=name, key_id=key.id, content=content)


def _signatures(lines: Sequence[str]) -> Iterator[Signature]:
    for line in lines:
        _, name, encoded = line.split(" ")
        try:
            content = b64decode(encoded, validate=True)
        except NotBase64:
            raise NoteRejected(f"Expected a signature in base 64, got {encoded[:60]!r}.") from None
        yield Signature(name=name, key_id=content[:4], content=content[4:])


def _cosigned(signed_at: int, body: str) -> bytes:
    return f"cosignature/v1\ntime {signed_at}\n{body}".encode()


def _is_signed(key: VerifierKey, signature: bytes, content: bytes) -> bool:
    try:
        Ed25519PublicKey.from_public_bytes(key.public_key).verify(signature, content)
    except (InvalidSignature, ValueError):
        return False
    return True
