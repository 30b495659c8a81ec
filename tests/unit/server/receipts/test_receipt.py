import json
from pathlib import Path

import pytest
from made_receipts import a_receipt, a_result, arrival_of, receipt_for
from vitac.server.receipts.export import ExportRejected, read_receipt
from vitac.server.receipts.receipt import AnyReceipt, Receipt, ReceiptRejected, sign


def changed(receipt: Receipt, *path: str, value: object) -> Receipt:
    """The receipt with another value at a place."""
    content = receipt.model_dump(mode="json")
    part = content
    for key in path[:-1]:
        part = part[key]
    assert part[path[-1]] != value
    part[path[-1]] = value
    return Receipt.model_validate(content)


@pytest.mark.parametrize("receipt", [a_receipt(), arrival_of(a_result(), number=1, previous=None)])
def test_a_receipt_is_valid_after_a_way_through_a_file(tmp_path: Path, receipt: AnyReceipt) -> None:
    file = tmp_path / "receipt.json"
    file.write_text(receipt.model_dump_json(indent=1))
    read = read_receipt(file)
    assert read == receipt
    read.require_valid(receipt.link.public_key)


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        (("result", "combined", "success_rate"), 1.0, "result of receipt 1 was changed"),
        (("result", "salt"), "0" * 32, "result of receipt 1 was changed"),
        (("result", "run"), 2, "result of receipt 1 was changed"),
        (("link", "content_sha256"), "0" * 64, "result of receipt 1 was changed"),
        (("link", "number"), 2, "not signed"),
        (("link", "previous"), "0" * 64, "not signed"),
        (("link", "signature"), "0" * 128, "not signed"),
        (("link", "public_key"), "0" * 64, "not signed"),
        (("link", "board"), "/track_2//model", "another board than its link: expected /track_1//model"),
        (("link", "issued_at"), "2031-02-01T12:30:16Z", "another issued_at than its link"),
        (("link", "content"), "submission", "another content than its link: expected result, got submission"),
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
    other = Receipt(link=sign(bytes(32), number=1, previous=None, content=a_result()), result=a_result())
    other.require_valid()
    with pytest.raises(ReceiptRejected, match="of another service"):
        other.require_valid(a_receipt().link.public_key)


def test_the_same_result_has_another_hash_with_another_salt() -> None:
    assert a_result(1).digest() != a_result(1, salt="f" * 32).digest()
    assert receipt_for(a_result(), number=1, previous=None) == a_receipt(), (
        "a signature of Ed25519 depends on nothing random"
    )


@pytest.mark.parametrize("content", ["", "{}", "[1]", "\0", json.dumps({"format": "vitac-receipt-3"})])
def test_what_is_no_receipt_is_refused_by_name(tmp_path: Path, content: str) -> None:
    file = tmp_path / "receipt.json"
    file.write_text(content)
    with pytest.raises(ExportRejected, match=r"receipt\.json"):
        read_receipt(file)
    with pytest.raises(ExportRejected, match="cannot be read"):
        read_receipt(tmp_path / "missing.json")
