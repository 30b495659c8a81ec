"""Routes of evaluations, and of copies among what they played, for organizers."""

from http import HTTPStatus
from typing import Annotated
from uuid import UUID

from fastapi import APIRouter, Query
from pydantic import BaseModel

from ..database.states import EvaluationState
from ..evaluations import superseding, view
from ..evaluations.near_copies import compare_archives, list_archive_copies, list_near_copies
from ..submissions import runs
from ..submissions.listing import get
from ..views.evaluations import ArchiveCopyView, EvaluationDetailView, EvaluationRowView, NearCopyView
from ..views.submissions import SubmissionView
from .access import ChangingServicesOf, CompetitionOrganizerOf, OrganizerOf, ServicesOf
from .problems import RESPONSES

router = APIRouter(tags=["evaluations"], responses=RESPONSES)


class Copies(BaseModel):
    """Submissions that are like another team's earlier one."""

    near: list[NearCopyView]
    archives: list[ArchiveCopyView]


class Restarted(BaseModel):
    """Evaluations that begin again."""

    restarted: list[UUID]


@router.get("/evaluations")
def list_evaluations(
    services: ServicesOf,
    principal: OrganizerOf,  # noqa: ARG001 - says who may
    *,
    state: Annotated[EvaluationState | None, Query(description="Only evaluations in this state.")] = None,
    unserved: Annotated[
        bool, Query(description="Only those that wait for an evaluator that no running worker has.")
    ] = False,
    limit: Annotated[int, Query(ge=1, le=1000, description="Maximum number of rows.")] = 50,
) -> list[EvaluationRowView]:
    """List evaluations, newest first.

    Alarms: episodes that were played again with another result. Copied: episodes of a log with the states of an earlier
    submission of another team.
    """
    conditions = [superseding.is_unserved(services.settings)] if unserved else []
    with services.database.reading() as session:
        return view.list_evaluations(session, *conditions, state=state, limit=limit)


@router.post("/evaluations/restart-unserved")
def restart_unserved(services: ChangingServicesOf, principal: OrganizerOf) -> Restarted:
    """Restart all evaluations whose evaluator no running worker has with the present one; up to 200 at once."""
    with services.database.transaction() as session:
        return Restarted(restarted=superseding.restart_unserved(session, principal, services.settings))


@router.get("/evaluations/{evaluation_id}")
def get_evaluation(
    services: ServicesOf,
    principal: OrganizerOf,  # noqa: ARG001
    evaluation_id: UUID,
) -> EvaluationDetailView:
    """Show an evaluation with its shards, and with the episodes that were played again with another result."""
    with services.database.reading() as session:
        return view.show_evaluation(session, services.settings, evaluation_id)


@router.post("/evaluations/{evaluation_id}/requeue", status_code=HTTPStatus.ACCEPTED)
def requeue_evaluation(services: ChangingServicesOf, principal: OrganizerOf, evaluation_id: UUID) -> SubmissionView:
    """Run all episodes of the same submission again; this evaluation does not change."""
    with services.database.transaction() as session:
        submission = runs.run_again(session, principal, view.find(session, evaluation_id).submission_id)
        return get(session, services.settings, principal, submission.id)


@router.post("/evaluations/{evaluation_id}/cancel")
def cancel_evaluation(
    services: ChangingServicesOf, principal: OrganizerOf, evaluation_id: UUID
) -> EvaluationDetailView:
    """Cancel an evaluation that waits or runs."""
    with services.database.transaction() as session:
        runs.cancel_evaluation(session, principal, view.find(session, evaluation_id))
        return view.show_evaluation(session, services.settings, evaluation_id)


@router.post("/evaluations/{evaluation_id}/restart")
def restart_evaluation(services: ChangingServicesOf, principal: OrganizerOf, evaluation_id: UUID) -> SubmissionView:
    """Restart an evaluation of another evaluator with the present one; it costs its team nothing."""
    with services.database.transaction() as session:
        evaluation = view.find(session, evaluation_id)
        superseding.restart(session, principal, evaluation_id)
        return get(session, services.settings, principal, evaluation.submission_id)


@router.get("/copies")
def list_copies(services: ServicesOf, principal: CompetitionOrganizerOf) -> Copies:
    """List submissions that are near copies of another team's earlier one, and models with similar archives.

    Near are episodes in which no action of the first eight env steps, or no motion commanded until then, differs by
    more than 0.02, or the states on the way by more than 0.1 mm. With half of the episodes or more a submission is
    listed, and not ranked until you clear it. An archive is listed with weights that correlate by 0.98 or, without
    weights, 80 % of common code; such a submission stays ranked.
    """
    with services.database.transaction() as session:
        return Copies(
            near=compare_archives(session, principal, list_near_copies(session, principal)),
            archives=list_archive_copies(session, principal),
        )
