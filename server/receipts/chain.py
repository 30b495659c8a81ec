"""The chain of receipts in the database: its key, one more receipt, and what is read of it."""

import secrets
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any
from uuid import UUID

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from sqlalchemy import Select, and_, func, or_, select
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import Session, defer
from vitac.evaluator.submission_kinds import SubmissionKind

from ..contest.stages import Stage
from ..db.advisory_locks import AdvisoryLock, wait_for_turn
from ..db.models import Evaluation, ReceiptKey, ReceiptRow, Submission
from .receipt import (
    AnyReceipt,
    Arrival,
    CombinedResult,
    Content,
    EndReceipt,
    Link,
    LinkContent,
    Receipt,
    Result,
    SubmissionReceipt,
    TaskResult,
    board_name,
    end_name,
    parse_receipt,
    sign,
    team_commitment,
)

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


def issue_for_submission(session: Session, submission: Submission) -> None:
    """Add the receipt of a submission that has arrived to the chain, in the transaction that stores it; see `issue`."""
    issue(session, lambda at: Arrival.model_validate(_describe_submission(submission, at)), submission_id=submission.id)


def issue_for_result(session: Session, evaluation: Evaluation, combined: CombinedResult | None) -> None:
    """Add the receipt of a completed evaluation to the chain, in the transaction that completes it; see `issue`.

    Args:
        session: of the transaction.
        evaluation: completed, with its scores.
        combined: what it reached in all tasks that count; None where there is no such number.
    """
    issue(session, lambda at: _result(evaluation, combined, at), evaluation_id=evaluation.id)


def issue(
    session: Session,
    make: Callable[[datetime], Content],
    *,
    submission_id: UUID | None = None,
    evaluation_id: UUID | None = None,
) -> None:
    """Add a receipt to the chain.

    From here to the end of the transaction no other receipt is issued: this is the last thing that it locks. The clock
    is the database's, which has also dated the submission.

    Args:
        session: of the transaction.
        make: returns what the receipt says, from the moment at which it is issued, which is never before the last one.
        submission_id: of the submission that has arrived.
        evaluation_id: of the evaluation whose result it is.
    """
    session.flush()
    key = ensure_key(session)
    wait_for_turn(session, AdvisoryLock.RECEIPTS, "")
    last = session.scalar(select(ReceiptRow).order_by(ReceiptRow.number.desc()).limit(1))
    now = session.scalars(select(func.clock_timestamp())).one().astimezone(UTC)
    content = make(max(now, last.issued_at.astimezone(UTC)) if last else now)
    link = sign(
        bytes.fromhex(key.private_key),
        number=last.number + 1 if last else 1,
        previous=last.digest if last else None,
        content=content,
    )
    session.add(
        ReceiptRow(
            **link.model_dump(exclude={"content"}),
            digest=link.digest,
            stands_for=link.content,
            content=content.model_dump_json(),
            submission_id=submission_id,
            evaluation_id=evaluation_id,
        )
    )
    session.flush()


def chain_state(session: Session) -> ChainState:
    """Return key, length and end of the chain."""
    number, last = session.execute(
        select(ReceiptRow.number, ReceiptRow.digest).order_by(ReceiptRow.number.desc()).limit(1)
    ).one_or_none() or (0, None)
    return ChainState(public_key=ensure_key(session).public_key, receipts=number, last=last)


def links(session: Session, *, after: int = 0, limit: int | None = None, contest: str | None = None) -> list[Link]:
    """Return the links of the chain that come after a number, as they are stored; `contest` None: of all."""
    query = select(ReceiptRow).where(ReceiptRow.number > after).options(defer(ReceiptRow.content))
    if contest is not None:
        query = query.where(
            or_(ReceiptRow.board.startswith(f"{contest}/", autoescape=True), ReceiptRow.board == end_name(contest))
        )
    return [_link(row) for row in session.scalars(query.order_by(ReceiptRow.number).limit(limit))]


def receipts_of_board(session: Session, stage: Stage, kind: SubmissionKind) -> Sequence[Receipt | SubmissionReceipt]:
    """Return the receipts of a stage's submissions and of all their results, on its boards or not, oldest first."""
    board = board_name(stage.contest, stage.track, stage.name, kind)
    submission_id = func.coalesce(ReceiptRow.submission_id, Evaluation.submission_id)
    found = _receipts(
        session,
        select(ReceiptRow)
        .outerjoin(Evaluation, Evaluation.id == ReceiptRow.evaluation_id)
        .outerjoin(Submission, Submission.id == submission_id)
        .where(or_(and_(stage.submissions, Submission.kind == kind), ReceiptRow.board == board)),
    )
    return [receipt for receipt in found if not isinstance(receipt, EndReceipt)]


def receipts_of_submission(session: Session, submission_id: UUID) -> Sequence[Receipt]:
    """Return the receipts of a submission's results, the first one first."""
    of_results = ReceiptRow.evaluation_id.in_(select(Evaluation.id).where(Evaluation.submission_id == submission_id))
    found = _receipts(session, select(ReceiptRow).where(of_results))
    return [receipt for receipt in found if isinstance(receipt, Receipt)]


def receipt_of_arrival(session: Session, submission_id: UUID) -> SubmissionReceipt | None:
    """Return the receipt that a submission got when it arrived; None where it got none."""
    found = _receipts(session, select(ReceiptRow).where(ReceiptRow.submission_id == submission_id))
    return next((receipt for receipt in found if isinstance(receipt, SubmissionReceipt)), None)


def receipts_of_ends(session: Session) -> Sequence[EndReceipt]:
    """Return the receipts of the competition's end, one for each time that its winners were decided."""
    found = _receipts(session, select(ReceiptRow).where(ReceiptRow.stands_for == LinkContent.END))
    return [receipt for receipt in found if isinstance(receipt, EndReceipt)]


def new_salt() -> str:
    """Return a salt for the content of a receipt."""
    return secrets.token_hex(_SALT_BYTES)


def _receipts(session: Session, query: Select[ReceiptRow]) -> list[AnyReceipt]:
    return [parse_receipt(_link(row), row.content) for row in session.scalars(query.order_by(ReceiptRow.number))]


def _link(row: ReceiptRow) -> Link:
    values = {name: getattr(row, name) for name in Link.model_fields}
    return Link(**values | {"content": row.stands_for, "issued_at": row.issued_at.astimezone(UTC)})


def _describe_submission(submission: Submission, issued_at: datetime) -> dict[str, Any]:
    """Return what the receipts of a submission and of its results have in common."""
    salt = new_salt()
    return {
        "salt": salt,
        "issued_at": issued_at,
        "submission": submission.id,
        "submission_digest": submission.digest,
        "contest": submission.contest,
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
