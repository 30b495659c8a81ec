"""Receipts for tests, signed by a key of their own."""

from datetime import UTC, datetime
from typing import Any
from uuid import UUID

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.receipts.receipt import (
    Arrival,
    CombinedResult,
    Receipt,
    Result,
    SubmissionReceipt,
    TaskResult,
    team_commitment,
)
from vitac.server.transparency.entries import Content
from vitac.server.transparency.merkle import hash_leaf, make_tree
from vitac.server.transparency.notes import InclusionProof, sign_checkpoint

KEY = bytes(range(32))
PUBLIC_KEY = Ed25519PrivateKey.from_private_bytes(KEY).public_key().public_bytes_raw().hex()
WHEN = datetime(2031, 2, 1, 12, 30, 15, 250_000, tzinfo=UTC)


def a_result(number: int = 1, **changes: Any) -> Result:
    """The result of an evaluation of one task."""
    task = TaskResult(
        task="peg-insertion",
        episodes=270,
        successes=180,
        success_rate=180 / 270,
        mean_steps=4.1,
        result_hash="9f3b" * 16,
    )
    values: dict[str, Any] = {
        "salt": f"{number:032x}",
        "evaluation": UUID(int=number),
        "submission": UUID(int=1000 + number),
        "submission_digest": "ab" * 32,
        "competition": "",
        "track": "track_1",
        "stage": "",
        "kind": SubmissionKind.MODEL,
        "run": 1,
        "evaluator_version": "1.0+abcdef",
        "evaluator_hash": "cd" * 32,
        "platform_class": "linux-x86_64",
        "commitment": None,
        "tasks": (task,),
        "combined": CombinedResult(success_rate=90 / 270, mean_steps=None),
        "result_hash": task.result_hash,
        "submitted_at": WHEN,
        "finished_at": WHEN,
        "issued_at": WHEN,
    }
    values["team_sha256"] = team_commitment(changes.get("salt", values["salt"]), "Ants")
    return Result(**(values | changes))


def a_receipt(**changes: Any) -> Receipt:
    """The only receipt of a log."""
    return receipt_for(a_result(**changes), number=1)


def receipt_for(result: Result, *, number: int) -> Receipt:
    """The receipt of a result, in a log whose other entries are of nothing."""
    return Receipt(entry=result.entry(number), public_key=PUBLIC_KEY, proofs=prove(result, number), result=result)


def arrival_of(result: Result, *, number: int, **changes: object) -> SubmissionReceipt:
    """The receipt of the submission that a result is of."""
    values = {name: getattr(result, name) for name in Arrival.model_fields.keys() & Result.model_fields}
    arrival = Arrival(**(values | {"issued_at": result.submitted_at} | changes))
    entry = arrival.entry(number)
    return SubmissionReceipt(entry=entry, public_key=PUBLIC_KEY, proofs=prove(arrival, number), submission=arrival)


def prove(content: Content, number: int) -> tuple[str]:
    """The proof that it is the last entry of a log of so many."""
    tree = make_tree([hash_leaf(b"")] * (number - 1) + [content.entry(number).leaf_hash])
    checkpoint = sign_checkpoint(KEY, size=number, root=tree.root())
    proof = InclusionProof(index=number - 1, hashes=tuple(tree.prove_inclusion(number - 1)), checkpoint=checkpoint)
    return (str(proof),)
