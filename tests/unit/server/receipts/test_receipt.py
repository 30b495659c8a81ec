import json
from pathlib import Path

import pytest
from made_receipts import KEY, a_receipt, a_result
from vitac.server.receipts.export import ExportRejected, read_receipt
from vitac.server.receipts.receipt import Receipt, ReceiptRejected, sign

FIRST_FORMAT = """
{"format": "vitac-receipt-1", "link": {"number": 1, "previous": null,
"result_sha256": "48b54090d243d5e41c15289f8467a5f6c3a05b637a6ff6c5175c6a1550071f4e",
"public_key": "03a107bff3ce10be1d70dd18e74bc09967e4d6309ba50d5f1ddc8664125531b8",
"signature":
"0f1865cf3aaa1cb6323b6d75f8c8dc64a9b09d2a8b5bb02581711d17b8f3d8bb4d92278d5dd9c234efdae702dcdaf411ee03912ec29140978772604127019b00"
}, "result": {"salt": "00000000000000000000000000000001",
"evaluation": "00000000-0000-0000-0000-000000000001", "submission": "00000000-0000-0000-0000-0000000003e9",
"submission_digest": "abababababababababababababababababababababababababababababababab", "track": "track_1",
"stage": "", "kind": "model", "run": 1, "evaluator_version": "1.0+abcdef",
"evaluator_hash": "cdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcd", "platform_class": "linux-x86_64",
"commitment": null, "tasks": [{"task": "peg-insertion", "episodes": 270, "successes": 180,
"success_rate": 0.6666666666666666, "mean_steps": 4.1,
"result_hash": "9f3b9f3b9f3b9f3b9f3b9f3b9f3b9f3b9f3b9f3b9f3b9f3b9f3b9f3b9f3b9f3b"}],
"combined": {"success_rate": 0.3333333333333333, "mean_steps": null},
"result_hash": "9f3b9f3b9f3b9f3b9f3b9f3b9f3b9f3b9f3b9f3b9f3b9f3b9f3b9f3b9f3b9f3b",
"submitted_at": "2031-02-01T12:30:15.250000Z", "finished_at": "2031-02-01T12:30:15.250000Z",
"issued_at": "2031-02-01T12:30:15.250000Z"}}
"""


def changed(receipt: Receipt, *path: str, value: object) -> Receipt:
    """The receipt with another value at a place."""
    content = receipt.model_dump(mode="json")
    part = content
    for key in path[:-1]:
        part = part[key]
    assert part[path[-1]] != value
    part[path[-1]] = value
    return Receipt.model_validate(content)


def test_a_receipt_is_valid_after_a_way_through_a_file(tmp_path: Path) -> None:
    receipt = a_receipt()
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
        (("link", "result_sha256"), "0" * 64, "result of receipt 1 was changed"),
        (("link", "number"), 2, "not signed"),
        (("link", "previous"), "0" * 64, "not signed"),
        (("link", "signature"), "0" * 128, "not signed"),
        (("link", "public_key"), "0" * 64, "not signed"),
        (("link", "board"), "track_2//model", "is of another board"),
        (("result", "team_sha256"), "0" * 64, "result of receipt 1 was changed"),
    ],
)
def test_each_changed_value_is_found(path: tuple[str, ...], value: object, reason: str) -> None:
    with pytest.raises(ReceiptRejected, match=reason):
        changed(a_receipt(), *path, value=value).require_valid()


def test_a_receipt_names_its_team_without_its_name_and_one_of_the_first_format_none() -> None:
    receipt = a_receipt()
    assert receipt.format == "vitac-receipt-2"
    assert receipt.result.is_of_team("Ants")
    assert not receipt.result.is_of_team("Bees")
    assert "Ants" not in receipt.model_dump_json()
    assert a_result(2).team_sha256 != receipt.result.team_sha256, "salted: two receipts do not tell of one team"
    old = sign(KEY, number=1, previous=None, result=a_result(team_sha256=None))
    assert (old.format, old.link.board) == ("vitac-receipt-1", None)
    old.require_valid()
    assert not old.result.is_of_team("Ants")


def test_a_receipt_of_the_first_format_that_was_issued_then_still_verifies() -> None:
    """Written by the version before receipts named teams."""
    receipt = Receipt.model_validate_json(FIRST_FORMAT)
    receipt.require_valid()
    for part, key in (("result", "team_sha256"), ("link", "board")):
        content = json.loads(FIRST_FORMAT)
        content[part][key] = "0" * 64
        with pytest.raises(ValueError, match="expected team and board in vitac-receipt-2"):
            Receipt.model_validate(content)


def test_a_receipt_of_another_key_is_whole_but_not_of_this_service() -> None:
    other = sign(bytes(32), number=1, previous=None, result=a_result())
    other.require_valid()
    with pytest.raises(ReceiptRejected, match="of another service"):
        other.require_valid(a_receipt().link.public_key)


def test_the_same_result_has_another_hash_with_another_salt() -> None:
    assert a_result(1).digest() != a_result(1, salt="f" * 32).digest()
    one = sign(KEY, number=1, previous=None, result=a_result())
    assert one == a_receipt(), "a signature of Ed25519 depends on nothing random"


@pytest.mark.parametrize("content", ["", "{}", "[1]", "\0", json.dumps({"format": "vitac-receipt-3"})])
def test_what_is_no_receipt_is_refused_by_name(tmp_path: Path, content: str) -> None:
    file = tmp_path / "receipt.json"
    file.write_text(content)
    with pytest.raises(ExportRejected, match=r"receipt\.json"):
        read_receipt(file)
    with pytest.raises(ExportRejected, match="cannot be read"):
        read_receipt(tmp_path / "missing.json")
