"""Receipts in the database: one more of a submission or a result, and what is read of them."""

import secrets
from collections.abc import Callable, Iterable, Iterator, Sequence
from datetime import UTC, datetime
from functools import cache, partial
from typing import Any
from uuid import UUID

from sqlalchemy import Select, and_, func, or_, select
from sqlalchemy.orm import Session, defer
from vitac.evaluator.submission_kinds import SubmissionKind, kinds_of_board

from ..competitions.stages import Stage
from ..database.models import Cosignature, Evaluation, ReceiptRow, Submission
from ..transparency.entries import EntryKind, LogEntry
from ..transparency.log import append, make_checkpoint, parse_entry, read_log_key, read_tree
from ..transparency.merkle import Tree
from ..transparency.notes import Checkpoint, InclusionProof
from .receipt import (
    MODELS,
    AnyReceipt,
    Arrival,
    CombinedResult,
    EndReceipt,
    Receipt,
    Result,
    SubmissionReceipt,
    TaskResult,
    board_name,
    end_name,
    team_commitment,
)

_SALT_BYTES = 16
_TASK_FIELDS = tuple(TaskResult.model_fields)


def issue_for_submission(session: Session, submission: Submission) -> None:
    """Add the receipt of a submission that has arrived to the log, in the transaction that stores it; see `append`."""
    append(
        session,
        lambda at: Arrival.model_validate({**_describe_submission(submission, at), "final_of": submission.final_of}),
        submission_id=submission.id,
    )


def issue_for_result(session: Session, evaluation: Evaluation, combined: CombinedResult | None) -> None:
    """Add the receipt of a completed evaluation to the log, in the transaction that completes it; see `append`.

    Args:
        session: of the transaction.
        evaluation: completed, with its scores.
        combined: what it reached in all tasks that count; None where there is no such number.
    """
    append(session, lambda at: _result(evaluation, combined, at), evaluation_id=evaluation.id)


def list_entries(
    session: Session, *, after: int = 0, limit: int | None = None, competition: str | None = None
) -> list[LogEntry]:
    """Return the entries of the log that come after a number, as they are stored; `competition` None: of all."""
    query = select(ReceiptRow).where(ReceiptRow.number > after).options(defer(ReceiptRow.content))
    if competition is not None:
        query = query.where(
            or_(
                ReceiptRow.board.startswith(f"{competition}/", autoescape=True),
                ReceiptRow.board == end_name(competition),
            )
        )
    return [parse_entry(row) for row in session.scalars(query.order_by(ReceiptRow.number).limit(limit))]


def receipts_of_board(session: Session, stage: Stage, kind: SubmissionKind) -> Sequence[Receipt | SubmissionReceipt]:
    """Return the receipts of a stage's submissions and of all their results, on its boards or not.

    Those of a final list come with the arrivals of what was chosen.
    """
    board = board_name(stage.competition, stage.track, stage.name, kind)
    submission_id = func.coalesce(ReceiptRow.submission_id, Evaluation.submission_id)
    chosen = select(Submission.final_of).where(stage.submissions, Submission.final_of.is_not(None))
    receipts = _receipts(
        session,
        select(ReceiptRow)
        .outerjoin(Evaluation, Evaluation.id == ReceiptRow.evaluation_id)
        .outerjoin(Submission, Submission.id == submission_id)
        .where(
            or_(
                and_(stage.submissions, Submission.kind.in_(kinds_of_board(kind))),
                ReceiptRow.board == board,
                ReceiptRow.submission_id.in_(chosen),
            )
        ),
    )
    return [receipt for receipt in receipts if not isinstance(receipt, EndReceipt)]


def receipts_of_submission(session: Session, submission_id: UUID) -> Sequence[Receipt]:
    """Return the receipts of a submission's results, the first one first."""
    of_results = ReceiptRow.evaluation_id.in_(select(Evaluation.id).where(Evaluation.submission_id == submission_id))
    receipts = _receipts(session, select(ReceiptRow).where(of_results))
    return [receipt for receipt in receipts if isinstance(receipt, Receipt)]


def receipt_of_arrival(session: Session, submission_id: UUID) -> SubmissionReceipt | None:
    """Return the receipt that a submission got when it arrived; None where it got none."""
    receipts = _receipts(session, select(ReceiptRow).where(ReceiptRow.submission_id == submission_id))
    return next((receipt for receipt in receipts if isinstance(receipt, SubmissionReceipt)), None)


def receipts_of_ends(session: Session) -> Sequence[EndReceipt]:
    """Return the receipts of the competition's end, one for each time that its winners were decided."""
    receipts = _receipts(session, select(ReceiptRow).where(ReceiptRow.stands_for == EntryKind.END))
    return [receipt for receipt in receipts if isinstance(receipt, EndReceipt)]


def new_salt() -> str:
    """Return a salt for the content of a receipt."""
    return secrets.token_hex(_SALT_BYTES)


def _receipts(session: Session, query: Select[ReceiptRow]) -> list[AnyReceipt]:
    rows = session.scalars(query.where(ReceiptRow.stands_for.in_(MODELS)).order_by(ReceiptRow.number)).all()
    tree, public_key = read_tree(session), read_log_key(session).public_key.hex()
    checkpoint = cache(partial(make_checkpoint, session, tree))  # many receipts are proven by few
    return [_receipt(row, public_key, _prove(session, tree, row.number, checkpoint)) for row in rows]


def _receipt(row: ReceiptRow, public_key: str, proofs: Iterable[InclusionProof]) -> AnyReceipt:
    """Return a receipt. The content's name in it is that of the field which the model adds."""
    model = MODELS[EntryKind(row.stands_for)]
    (field,) = model.model_fields.keys() - {"format", "entry", "public_key", "proofs"}
    content = model.model_fields[field].annotation
    return model.model_validate(
        {
            "entry": parse_entry(row),
            "public_key": public_key,
            "proofs": tuple(map(str, proofs)),
            field: content.model_validate_json(row.content),  # type: ignore[union-attr]
        }
    )


def _prove(
    session: Session, tree: Tree, number: int, checkpoint: Callable[[int], Checkpoint]
) -> Iterator[InclusionProof]:
    """Yield the proof by the newest checkpoint, and by the first of each witness that covers the entry."""
    signed = select(func.min(Cosignature.size)).where(Cosignature.size >= number).group_by(Cosignature.witness)
    for size in sorted({tree.size, *session.scalars(signed)}, reverse=True):
        hashes = tuple(tree.prove_inclusion(number - 1, size))
        yield InclusionProof(index=number - 1, hashes=hashes, checkpoint=checkpoint(size))


def _describe_submission(submission: Submission, issued_at: datetime) -> dict[str, Any]:
    """Return what the receipts of a submission and of its results have in common."""
    salt = new_salt()
    return {
        "salt": salt,
        "issued_at": issued_at,
        "submission": submission.id,
        "submission_digest": submission.digest,
        "competition": submission.competition,
        "track": submission.track,
        "stage": submission.stage,
        "kind": submission.kind,
        "submitted_at": submission.submitted_at.astimezone(UTC),
        "team_sha256": team_commitment(salt, submission.team.name),
    }


def _result(evaluation: Evaluation, combined: CombinedResult | None, issued_at: datetime) -> Result:
    finished_at, scores = evaluation.finished_at, evaluation.scores or []
    return Result.model_validate(
        {
            **_describe_submission(evaluation.submission, issued_at),
            "evaluation": evaluation.id,
            "run": evaluation.run,
            "evaluator_version": evaluation.evaluator_version,
            "evaluator_hash": evaluation.evaluator_hash,
            "platform_class": evaluation.platform_class,
            "commitment": evaluation.commitment,
            "tasks": tuple({name: score[name] for name in _TASK_FIELDS} for score in scores),
            "combined": combined,
            "result_hash": evaluation.result_hash,
            "finished_at": finished_at and finished_at.astimezone(UTC),
        }
    )
