"""The chain of receipts in the database: its key, one more receipt, and what is read of it."""

import secrets
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from uuid import UUID

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from sqlalchemy import and_, or_, select
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import Session, defer
from vitac.evaluator.submission_kinds import SubmissionKind

from ..contest.stages import Stage
from ..db.advisory_locks import AdvisoryLock, wait_for_turn
from ..db.models import Evaluation, ReceiptKey, ReceiptRow, Submission
from .receipt import CombinedResult, Link, Receipt, Result, TaskResult, board_name, sign, team_commitment

_SALT_BYTES = 16
_TASK_FIELDS = tuple(TaskResult.model_fields)


@dataclass(frozen=True, kw_only=True)
class ChainState:
    """How far the chain is: number and digest of its last receipt, 0 and None without one."""

    public_key: str
    receipts: int
    last: str | None


def ensure_key(session: Session) -> ReceiptKey:
    """Return the key that signs receipts, made at the first call of all."""
    found = session.get(ReceiptKey, 1)
    if found is None:
        made = Ed25519PrivateKey.generate()
        values = {
            "private_key": made.private_bytes_raw().hex(),
            "public_key": made.public_key().public_bytes_raw().hex(),
        }
        session.execute(insert(ReceiptKey).values(id=1, **values).on_conflict_do_nothing())
        found = session.get_one(ReceiptKey, 1)
    return found


def issue(session: Session, evaluation: Evaluation, combined: CombinedResult | None) -> Receipt:
    """Add the receipt of a completed evaluation to the chain, in the transaction that completes it.

    From here to the end of the transaction no other receipt is issued: this is the last thing that it locks.

    Args:
        session: of the transaction.
        evaluation: completed, with its scores.
        combined: what it reached in all tasks that count; None where there is no such number.
    """
    session.flush()
    key = ensure_key(session)
    wait_for_turn(session, AdvisoryLock.RECEIPTS, "")
    last = session.execute(select(ReceiptRow.number, ReceiptRow.digest).order_by(ReceiptRow.number.desc()).limit(1))
    number, previous = last.one_or_none() or (0, None)
    receipt = sign(
        bytes.fromhex(key.private_key), number=number + 1, previous=previous, result=_result(evaluation, combined)
    )
    session.add(
        ReceiptRow(
            **receipt.link.model_dump(),
            digest=receipt.link.digest,
            evaluation_id=evaluation.id,
            result=receipt.result.model_dump_json(),
        )
    )
    session.flush()
    return receipt


def chain_state(session: Session) -> ChainState:
    """Return key, length and end of the chain."""
    number, last = session.execute(
        select(ReceiptRow.number, ReceiptRow.digest).order_by(ReceiptRow.number.desc()).limit(1)
    ).one_or_none() or (0, None)
    return ChainState(public_key=ensure_key(session).public_key, receipts=number, last=last)


def links(session: Session, *, after: int = 0, limit: int | None = None) -> list[Link]:
    """Return the links of the chain that come after a number, as they are stored."""
    rows = session.scalars(
        select(ReceiptRow)
        .where(ReceiptRow.number > after)
        .options(defer(ReceiptRow.result))
        .order_by(ReceiptRow.number)
        .limit(limit)
    )
    return [_link(row) for row in rows]


def receipts_of(session: Session, evaluations: Collection[UUID]) -> Mapping[UUID, Receipt]:
    """Return the receipts of some evaluations, by evaluation; those without one are left out."""
    rows = session.scalars(select(ReceiptRow).where(ReceiptRow.evaluation_id.in_(evaluations)))
    return {row.evaluation_id: _receipt(row) for row in rows}


def receipts_of_board(session: Session, stage: Stage, kind: SubmissionKind) -> Sequence[Receipt]:
    """Return the receipts of all results of a stage, on its boards or not, the first one first."""
    board = board_name(stage.track, stage.name, kind)
    rows = session.scalars(
        select(ReceiptRow)
        .outerjoin(Evaluation, Evaluation.id == ReceiptRow.evaluation_id)
        .outerjoin(Submission, Submission.id == Evaluation.submission_id)
        .where(or_(and_(stage.submissions, Submission.kind == kind), ReceiptRow.board == board))
        .order_by(ReceiptRow.number)
    )
    return [_receipt(row) for row in rows]


def receipts_of_submission(session: Session, submission_id: UUID) -> Sequence[Receipt]:
    """Return the receipts of a submission's evaluations, the first one first."""
    ids = session.scalars(select(Evaluation.id).where(Evaluation.submission_id == submission_id)).all()
    return sorted(receipts_of(session, ids).values(), key=lambda receipt: receipt.link.number)


def _receipt(row: ReceiptRow) -> Receipt:
    return Receipt.of(_link(row), Result.model_validate_json(row.result))


def _link(row: ReceiptRow) -> Link:
    return Link(**{name: getattr(row, name) for name in Link.model_fields})


def _result(evaluation: Evaluation, combined: CombinedResult | None) -> Result:
    submission, finished_at = evaluation.submission, evaluation.finished_at
    salt = secrets.token_hex(_SALT_BYTES)
    scores = evaluation.scores or []
    return Result.model_validate(
        {
            "salt": salt,
            "evaluation": evaluation.id,
            "submission": submission.id,
            "submission_digest": submission.digest,
            "track": submission.track,
            "stage": submission.stage,
            "kind": submission.kind,
            "run": evaluation.run,
            "evaluator_version": evaluation.evaluator_version,
            "evaluator_hash": evaluation.evaluator_hash,
            "platform_class": evaluation.platform_class,
            "commitment": evaluation.commitment,
            "tasks": tuple({name: score[name] for name in _TASK_FIELDS} for score in scores),
            "combined": combined,
            "result_hash": evaluation.result_hash,
            "submitted_at": submission.submitted_at.astimezone(UTC),
            "finished_at": finished_at and finished_at.astimezone(UTC),
            "issued_at": datetime.now(UTC),
            "team_sha256": team_commitment(salt, submission.team.name),
        }
    )
