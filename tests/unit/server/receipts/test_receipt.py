import json
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from made_receipts import PUBLIC_KEY, a_receipt, a_result, arrival_of, prove, receipt_for
from vitac.server.receipts.export import ExportRejected, read_receipts
from vitac.server.receipts.receipt import AnyReceipt, Receipt, ReceiptRejected
from vitac.server.transparency.notes import InclusionProof, sign_checkpoint


def changed(receipt: Receipt, *path: str, value: object) -> Receipt:
    """The receipt with another value at a place."""
    content = receipt.model_dump(mode="json")
    part = content
    for key in path[:-1]:
        part = part[key]
    assert part[path[-1]] != value
    part[path[-1]] = value
    return Receipt.model_validate(content)


@pytest.mark.parametrize("receipt", [a_receipt(), arrival_of(a_result(), number=1)])
def test_a_receipt_is_valid_after_a_way_through_a_file(tmp_path: Path, receipt: AnyReceipt) -> None:
    file = tmp_path / "receipt.json"
    file.write_text(receipt.model_dump_json(indent=1))
    [read] = read_receipts(file)
    assert read == receipt
    read.require_valid(receipt.public_key)


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        (("result", "combined", "success_rate"), 1.0, "result of receipt 1 was changed"),
        (("result", "salt"), "0" * 32, "result of receipt 1 was changed"),
        (("result", "run"), 2, "result of receipt 1 was changed"),
        (("entry", "content_sha256"), "0" * 64, "result of receipt 1 was changed"),
        (("entry", "number"), 2, "not in the log of .* by its proof"),
        (("public_key",), "0" * 64, "The checkpoint is of another log"),
        (("entry", "board"), "/track_2//model", "another board than its entry: expected /track_1//model"),
        (("entry", "issued_at"), "2031-02-01T12:30:16Z", "another issued_at than its entry"),
        (("entry", "content"), "submission", "another content than its entry: expected result, got submission"),
        (("entry", "statement"), {"a": 1}, "another statement than its entry: expected None"),
        (("proofs",), [], "has no proof"),
        (("proofs",), ["c2sp.org/tlog-proof@v2"], "Expected a proof that begins with"),
        (("proofs",), list(prove(a_result(2), 1)), "not in the log of .* by its proof"),
        (("proofs",), list(prove(a_result(), 2)), "has the proof of another entry, 2|not in the log"),
        (("result", "team_sha256"), "0" * 64, "result of receipt 1 was changed"),
    ],
)
def test_each_changed_value_is_found(path: tuple[str, ...], value: object, reason: str) -> None:
    with pytest.raises(ReceiptRejected, match=reason):
        changed(a_receipt(), *path, value=value).require_valid()


def test_a_receipt_names_its_team_without_its_name() -> None:
    receipt = a_receipt()
    assert receipt.result.is_of_team("Ants")
    assert not receipt.result.is_of_team("Bees")
    assert "Ants" not in receipt.model_dump_json()
    assert a_result(2).team_sha256 != receipt.result.team_sha256, "salted: two receipts do not show that they are alike"


def test_a_receipt_of_another_key_is_whole_but_not_of_this_service() -> None:
    result, key = a_result(), Ed25519PrivateKey.from_private_bytes(bytes(32)).public_key().public_bytes_raw().hex()
    checkpoint = sign_checkpoint(bytes(32), size=1, root=result.entry(1).leaf_hash)
    proof = str(InclusionProof(index=0, hashes=(), checkpoint=checkpoint))
    other = Receipt(entry=result.entry(1), public_key=key, proofs=(proof,), result=result)
    other.require_valid()
    with pytest.raises(ReceiptRejected, match="of another service"):
        other.require_valid(PUBLIC_KEY)


def test_the_same_result_has_another_hash_with_another_salt() -> None:
    assert a_result(1).digest() != a_result(1, salt="f" * 32).digest()
    assert receipt_for(a_result(), number=1) == a_receipt(), "a signature of Ed25519 depends on nothing random"


@pytest.mark.parametrize("content", ["", "{}", "[1]", "\0", json.dumps({"format": "vitac-receipt-3"})])
def test_what_is_no_receipt_is_refused_by_name(tmp_path: Path, content: str) -> None:
    file = tmp_path / "receipt.json"
    file.write_text(content)
    with pytest.raises(ExportRejected, match=r"receipt\.json"):
        read_receipts(file)
    with pytest.raises(ExportRejected, match="cannot be read"):
        read_receipts(tmp_path / "missing.json")
