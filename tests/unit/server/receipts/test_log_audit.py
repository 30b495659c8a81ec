"""Somebody who has the database, the key and the address rewrites a log; an outsider has public files and one note."""

from collections.abc import Callable, Sequence
from functools import partial

import pytest
from made_logs import LOG_KEY, Files, apply_file, at, change_list, final_board, make_entries, opened, publish
from made_receipts import KEY, a_result, arrival_of, receipt_for
from vitac.errors import VitacError
from vitac.evaluator.tracks.sealed import make_commitment
from vitac.server.receipts.log_audit import audit_log, compare
from vitac.server.receipts.receipt import End, Receipt, WinningEntry
from vitac.server.transparency.entries import Content, LogEntry, RejudgementApplied
from vitac.server.transparency.merkle import make_tree
from vitac.server.transparency.notes import (
    OF_WITNESS,
    Checkpoint,
    InclusionProof,
    VerifierKey,
    cosign,
    make_log_key,
    sign_checkpoint,
)

SIZE, NOTED = 600, 400
HONEST = make_entries(SIZE)
FILES = publish(HONEST)


def checkpoint_of(entries: Sequence[LogEntry], key: bytes = KEY) -> Checkpoint:
    return sign_checkpoint(key, size=len(entries), root=make_tree([entry.leaf_hash for entry in entries]).root())


def other(number: int) -> Content | None:
    """Another result for entry 100."""
    return a_result(9999, issued_at=at(100)) if number == 100 else None


def swapped(number: int) -> Content | None:
    """Entries 100 and 101 in the other order."""
    return {100: a_result(101, issued_at=at(100)), 101: a_result(100, issued_at=at(101))}.get(number)


def forked(number: int) -> Content | None:
    """What came after entry 300 was lost with a disk, and other things came instead."""
    return a_result(number + 5000, issued_at=at(number)) if number > 300 else None


def edited(path: str, change: Callable[[bytes], bytes]) -> Files:
    return FILES | {path: change(FILES[path])}


def flipped(content: bytes) -> bytes:
    return content[:40] + bytes([content[40] ^ 1]) + content[41:]


TAMPERED: dict[str, tuple[Files, str]] = {
    "a row is changed and all hashes above it": (publish(make_entries(SIZE, other)), "the log was rewritten"),
    "the tail is removed": (publish(HONEST[:399]), "the log ends before"),
    "two rows change places": (publish(make_entries(SIZE, swapped)), "the log was rewritten"),
    "all is signed again with another key": (publish(HONEST, key=bytes(32)), "of another log"),
    "a backup is restored and the log grows again": (publish(make_entries(700, forked)), "the log was rewritten"),
    "an old checkpoint is shown again": (FILES | publish(HONEST[:300]), "the log ends before"),
    "a hash in a tile is changed": (edited("tile/0/001", flipped), "Entry 258 is not the one that its tile"),
    "a hash in an upper tile is changed": (edited("tile/1/000.p/2", flipped), "Tile 0 of level 1 has other hashes"),
    "an entry is changed": (edited("tile/entries/000", flipped), "Entry 1 is not the one that its tile"),
    "a tile is cut off": (edited("tile/0/002.p/88", lambda tile: tile[:-1]), "tile/0/002.p/88: expected 88 hashes"),
    "entries are cut off": (edited("tile/entries/001", lambda file: file[:-1]), "ends within an entry"),
    "a tile is missing": ({k: v for k, v in FILES.items() if k != "tile/0/001"}, "The log has no tile/0/001"),
    "a tile and its entries are of another log": (
        FILES | {path: publish(make_entries(SIZE, other))[path] for path in ("tile/0/000", "tile/entries/000")},
        "The 600 entries have the root",
    ),
    "another view is shown to others": (publish(make_entries(NOTED, other)), "the log was rewritten"),
    "an entry is written elsewhere": (publish([*HONEST[:500], HONEST[400]]), "Entry 501 is written as entry 401"),
    "a clock is set back": (
        publish(make_entries(500, lambda n: a_result(n, issued_at=at(1)) if n == 450 else None)),
        "before receipt 449, which it follows",
    ),
}


@pytest.mark.parametrize("way", TAMPERED)
def test_every_way_to_rewrite_a_log_is_found_with_one_earlier_checkpoint(way: str) -> None:
    files, expected = TAMPERED[way]
    try:
        found = audit_log(opened(files), checkpoints=[checkpoint_of(HONEST[:NOTED])]).findings
    except VitacError as error:
        found = [str(error)]
    assert any(expected in finding for finding in found), found


def test_an_untouched_log_is_found_right_and_its_doubts_are_said() -> None:
    noted = [checkpoint_of(HONEST[:size]) for size in (1, 256, NOTED, SIZE)]
    found = audit_log(opened(FILES), checkpoints=noted, held=[a_stored_receipt(100)], roots={1: noted[0].root.hex()})
    assert (found.findings, found.unusual, found.entries) == ([], [], {"result": SIZE})
    assert "no witness has signed it" in found.doubts[0]
    assert not any("your submission is in the log" in doubt for doubt in found.doubts)
    assert any("your submission is in the log" in doubt for doubt in audit_log(opened(FILES)).doubts)
    assert audit_log(opened(FILES), roots={1: "0" * 64}).findings[0].startswith("Expected the noted root 000")


def a_stored_receipt(number: int, *, proof_of: int | None = None, size: int = NOTED) -> Receipt:
    """The receipt of a result with the proof by the checkpoint of the time."""
    result = a_result(number, issued_at=at(number))
    tree = make_tree([entry.leaf_hash for entry in HONEST[:size]])
    index = (proof_of or number) - 1
    proof = InclusionProof(
        index=index, hashes=tuple(tree.prove_inclusion(index)), checkpoint=checkpoint_of(HONEST[:size])
    )
    made = receipt_for(result, number=number)
    return made.model_copy(update={"proofs": (str(proof),)})


def test_a_receipt_with_the_proof_of_another_entry_or_of_a_log_that_is_gone_is_found() -> None:
    (reason,) = audit_log(opened(FILES), held=[a_stored_receipt(100, proof_of=101)]).findings
    assert "Receipt 100 is not in the log of" in reason
    gone, view = audit_log(opened(publish(make_entries(SIZE, other))), held=[a_stored_receipt(100)]).findings
    assert gone == "Receipt 100, which was stored elsewhere, is not in the log."
    assert "the log was rewritten" in view
    assert audit_log(opened(publish(make_entries(SIZE, other))), held=[a_stored_receipt(300)]).findings == [view], (
        "the log is another one before it, which its proof shows"
    )


def test_two_checkpoints_show_a_rollback_and_two_views_to_anybody() -> None:
    first, later, log = checkpoint_of(HONEST[:NOTED]), checkpoint_of(HONEST), opened(FILES)
    view = checkpoint_of(make_entries(NOTED, other))
    assert list(compare(first, later, LOG_KEY, log)) == list(compare(first, first, LOG_KEY)) == []
    assert list(compare(first, later, LOG_KEY)) == [], "without tiles nobody knows"
    assert "was rolled back" in next(compare(later, first, LOG_KEY))
    assert "two views of the log" in next(compare(first, view, LOG_KEY))
    assert "do not show that the 600 entries" in next(compare(view, later, LOG_KEY, log))
    assert "fewer than the 600" in next(compare(first, later, LOG_KEY, opened(publish(HONEST[:500]))))
    assert "not signed by" in next(compare(first, Checkpoint(origin=LOG_KEY.name, size=9, root=bytes(32)), LOG_KEY))
    assert "of another log" in next(compare(first, later, make_log_key(bytes(32))))


def test_witnesses_are_counted_by_what_they_have_signed() -> None:
    names = ("ants.example/v", "bees.example/v")
    keys = [
        VerifierKey(name=name, kind=OF_WITNESS, public_key=bytes.fromhex(LOG_KEY.public_key.hex())) for name in names
    ]
    entries = make_entries(SIZE, lambda number: apply_file(1, *map(str, keys), demanded=2) if number == 1 else None)

    def signed(size: int, *by: str) -> Checkpoint:
        checkpoint = checkpoint_of(entries[:size])
        return checkpoint.with_signatures(cosign(KEY, name, checkpoint, 1_950_000_000) for name in by)

    def doubt(*witnessed: Checkpoint) -> str:
        found = audit_log(opened(publish(entries, witnessed=witnessed)))
        assert found.findings == []
        return f"{found.witnesses} {found.doubts[0]}"

    assert doubt() == doubt(signed(SIZE)), "a checkpoint that no witness signed"
    assert "'bees.example/v': 0} Whether everybody sees this log: no witness" in doubt(signed(SIZE, names[0]))
    assert "the entries after 500: too few" in doubt(signed(500, names[1]), signed(SIZE, names[0]))
    assert "witnesses and organizers work together" in doubt(signed(SIZE, *names))
    view = checkpoint_of(make_entries(SIZE, other))
    view = view.with_signatures([cosign(KEY, names[0], view, 1)])
    assert "the log was rewritten" in audit_log(opened(publish(entries, witnessed=[view]))).findings[0]


def test_secrets_have_to_fit_and_what_needs_a_reason_is_said() -> None:
    secret = "1" * 64
    commitment = make_commitment(bytes.fromhex(secret))
    late = a_result(3, issued_at=at(3), competition="cup", stage="only")
    end = an_end(3)
    contents = [
        apply_file(1),
        change_list(2, "sealed", commitment),
        late,
        RejudgementApplied(
            issued_at=at(4), competition="cup", track="track_1", stage="only", rejudgement=late.evaluation, replaced=2,
            withdrawn=1,
        ),
        change_list(5, "published", commitment, secret),
        final_board(6),
        end,
        end,
    ]  # fmt: skip
    found = audit_log(opened(publish([content.entry(number) for number, content in enumerate(contents, start=1)])))
    assert [finding for finding in found.findings if "before receipt" not in finding] == []
    assert [sentence.partition(": ")[2] for sentence in found.unusual][:1] == [
        "2 results were replaced, 1 withdrawn; ask why."
    ]
    assert "was signed again" in found.unusual[1]
    wrong = [change_list(1, "published", commitment, "2" * 64)]
    findings = audit_log(opened(publish([content.entry(1) for content in wrong]))).findings
    assert "is not the one behind the commitment" in findings[0]
    assert "was not in the log before" in findings[1]


def an_end(number: int, *, reopened: bool = False) -> End:
    """The end of the cup, which the Ants won; reopened it has no winners."""
    result = a_result(1)
    winner = WinningEntry(
        track="track_1", place="first", rank=1, team="Ants", amount=5, currency="USD", submission=result.submission,
        result_hash=result.result_hash, total=None,
    )  # fmt: skip
    return End(
        issued_at=at(number),
        competition="cup",
        finalized_at=None if reopened else at(number),
        reason="an appeal" if reopened else None,
        winners=() if reopened else (winner,),
        judged=(),
    )


def test_arrivals_after_a_deadline_and_what_follows_the_end_are_reported_and_winners_told_by_name() -> None:
    result = partial(a_result, competition="cup", stage="only")
    contents: list[Content] = [
        apply_file(1, closes=4),
        arrival_of(result(2, submitted_at=at(2)), number=2).submission,
        arrival_of(result(3, submitted_at=at(3)), number=3, issued_at=at(5)).submission,  # dated before the close
        an_end(6),
        result(2, issued_at=at(7)),
        an_end(8, reopened=True),
        result(2, issued_at=at(9)),
        an_end(10),
    ]
    found = audit_log(opened(publish([content.entry(number) for number, content in enumerate(contents, start=1)])))
    late = [sentence for sentence in found.unusual if "follows the end" in sentence or "had closed" in sentence]
    assert [sentence.split()[1] for sentence in late] == ["3", "5"]
    assert "a submission arrived" in late[0]
    assert "follows the end of cup, entry 4" in late[1]
    assert found.winners == ["cup, track_1: Ants wins first, 5 USD."]
