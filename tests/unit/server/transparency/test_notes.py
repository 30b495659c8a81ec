import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from made_receipts import KEY, PUBLIC_KEY
from vitac.server.transparency.merkle import EMPTY_ROOT, ProofRejected, hash_leaf
from vitac.server.transparency.notes import (
    OF_LOG,
    OF_WITNESS,
    Checkpoint,
    InclusionProof,
    NoteRejected,
    Signature,
    VerifierKey,
    cosign,
    make_log_key,
    sign_checkpoint,
)

GO_KEY = "PeterNeumann+c74f20a3+ARpc2QcUPDhMQegwxbzhKqiBfsVkmqq/LDE4izWy10TW"
"""From the documentation of Go's signed notes (golang.org/x/mod/sumdb/note), which the standard is of."""
WITNESS_KEY = "remora.n621.de+da77ade7+BOvN63jn/bLvkieywe8R6UYAtVtNbZpXh34x7onlmtw2"
"""A public witness's, from the tests of github.com/transparency-dev/formats."""
PUBLISHED = """\
example.com/behind-the-sofa
20852163
CsUYapGGPo4dkMgIAUqom/Xajj7h2fB2MPA3j2jxq2I=

\N{EM DASH} example.com/behind-the-sofa Az3grlgtzPICa5OS8npVmf1Myq/5IZniMp+ZJurmRDeOoRDe4URYN7u5/Zhcyv2q1gGzGku9nTo+zyWE+xeMcTOAYQ8=
\N{EM DASH} witness.example.com/w1 jWbPPwAAAABkGFDLEZMHwSRaJNiIDoe9DYn/zXcrtPHeolMI5OWXEhZCB9dlrDJsX3b2oyin1nPZqhf5nNo0xUe+mbIUBkBIfZ+qnA==
"""  # noqa: E501
"""Example of c2sp.org/tlog-cosignature, which gives no keys, and below the message that is signed."""
PUBLISHED_MESSAGE = """\
cosignature/v1
time 1679315147
example.com/behind-the-sofa
20852163
CsUYapGGPo4dkMgIAUqom/Xajj7h2fB2MPA3j2jxq2I=
"""
LOG_KEY = make_log_key(bytes.fromhex(PUBLIC_KEY))
EMPTY = sign_checkpoint(KEY, size=0, root=EMPTY_ROOT)
WITNESS = VerifierKey(name="ants.example/v", kind=OF_WITNESS, public_key=LOG_KEY.public_key)


def test_a_published_key_is_read_and_written_as_it_is() -> None:
    key = VerifierKey.parse(GO_KEY)
    assert (key.name, key.kind, key.id.hex(), str(key)) == ("PeterNeumann", OF_LOG, "c74f20a3", GO_KEY)


def test_a_published_key_of_a_witness_is_read_and_written_as_it_is() -> None:
    key = VerifierKey.parse(WITNESS_KEY)
    assert (key.name, key.kind, key.id.hex(), str(key)) == ("remora.n621.de", OF_WITNESS, "da77ade7", WITNESS_KEY)


def test_a_published_cosignature_has_the_form_of_ours() -> None:
    published = Checkpoint.parse(PUBLISHED)
    assert str(published) == PUBLISHED
    line = published.signatures[1]
    assert (line.name, line.key_id.hex(), len(line.content)) == ("witness.example.com/w1", "8d66cf3f", 72)
    ours = cosign(KEY, line.name, published, int.from_bytes(line.content[:8]))
    assert ours.content[:8] == line.content[:8]
    signed_by = Ed25519PublicKey.from_public_bytes(bytes.fromhex(PUBLIC_KEY))
    signed_by.verify(ours.content[8:], PUBLISHED_MESSAGE.encode())


@pytest.mark.parametrize(
    "text", ["", "a+b", "a b+c74f20a3+AAAA", GO_KEY[:-4], GO_KEY.replace("c74f", "c74e"), GO_KEY.replace("+A", "+C", 1)]
)
def test_what_is_no_key_is_refused(text: str) -> None:
    with pytest.raises(NoteRejected):
        VerifierKey.parse(text)


def test_a_checkpoint_is_the_same_after_a_way_through_its_text() -> None:
    signed = EMPTY.with_signatures([cosign(KEY, "ants.example/v", EMPTY, 1_950_000_000)])
    read = Checkpoint.parse(str(signed))
    assert read == signed
    read.require_signature(LOG_KEY)
    assert dict(read.find_witnesses([WITNESS])) == {WITNESS: 1_950_000_000}
    assert str(EMPTY) == str(sign_checkpoint(KEY, size=0, root=EMPTY_ROOT)), "whoever asks gets the same"
    assert str(signed).splitlines()[:4] == [LOG_KEY.name, "0", "47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU=", ""]


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n0\n", "\n1\n"),
        lambda text: text.replace("47DE", "48DE"),
        lambda text: text.replace(" Z", " Y", 1) if " Z" in text else text.replace("/", "+", 1),
        lambda text: text.partition("\n\n")[0] + "\n\n",
        lambda text: text.replace("\n0\n", "\n00\n"),
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text + "\n",
        lambda text: text * 200,
        lambda text: "",
    ],
)
def test_a_changed_checkpoint_is_refused(change: object) -> None:
    assert callable(change)
    with pytest.raises(NoteRejected):
        Checkpoint.parse(change(str(EMPTY))).require_signature(LOG_KEY)


def test_a_witness_is_not_taken_for_a_log_or_another_witness() -> None:
    """One key signs both forms here, which say different things."""
    line = cosign(KEY, "ants.example/v", EMPTY, 7)
    as_log = Signature(name=LOG_KEY.name, key_id=LOG_KEY.id, content=line.content[8:])
    with pytest.raises(NoteRejected):
        Checkpoint(origin=EMPTY.origin, size=0, root=EMPTY_ROOT, signatures=(as_log,)).require_signature(LOG_KEY)
    renamed = VerifierKey(name="bees.example/v", kind=OF_WITNESS, public_key=LOG_KEY.public_key)
    later = Signature(name=line.name, key_id=line.key_id, content=(8).to_bytes(8) + line.content[8:])
    assert EMPTY.read_cosignature(WITNESS, line) == 7
    assert EMPTY.read_cosignature(renamed, line) is EMPTY.read_cosignature(WITNESS, later) is None
    assert EMPTY.read_cosignature(LOG_KEY, EMPTY.signatures[0]) is None
    assert EMPTY.read_cosignature(WITNESS, cosign(KEY, WITNESS.name, EMPTY, 2**62)) is None, "no time of this world"


def test_a_proof_leads_from_its_entry_to_what_the_log_signed() -> None:
    leaf = hash_leaf(b"entry")
    checkpoint = sign_checkpoint(KEY, size=1, root=leaf)
    proof = InclusionProof.parse(str(InclusionProof(index=0, hashes=(), checkpoint=checkpoint)))
    proof.require_valid(leaf, LOG_KEY)
    with pytest.raises(ProofRejected, match="does not lead from entry 0"):
        proof.require_valid(hash_leaf(b"other"), LOG_KEY)
    assert str(proof).splitlines()[:3] == ["c2sp.org/tlog-proof@v1", "index 0", ""]
