"""Receipts for tests, signed by a key of their own."""

from datetime import UTC, datetime
from typing import Any
from uuid import UUID

from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.receipts.receipt import (
    Arrival,
    CombinedResult,
    Receipt,
    Result,
    SubmissionReceipt,
    TaskResult,
    sign,
    team_commitment,
)

KEY = bytes(range(32))
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
        "contest": "",
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
    """The first receipt of a chain."""
    return receipt_for(a_result(**changes), number=1, previous=None)


def receipt_for(result: Result, *, number: int, previous: str | None) -> Receipt:
    """The receipt of a result."""
    return Receipt(link=sign(KEY, number=number, previous=previous, content=result), result=result)


def arrival_of(result: Result, *, number: int, previous: str | None, **changes: object) -> SubmissionReceipt:
    """The receipt of the submission that a result is of."""
    values = {name: getattr(result, name) for name in Arrival.model_fields}
    arrival = Arrival(**(values | {"issued_at": result.submitted_at} | changes))
    return SubmissionReceipt(link=sign(KEY, number=number, previous=previous, content=arrival), submission=arrival)
