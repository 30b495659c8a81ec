"""`vitac admin evaluation`: single runs of the evaluator."""

from typing import TYPE_CHECKING, Annotated, Any
from uuid import UUID

import typer

from ..service.database import transaction
from ..terminal.output import AsJson, moment, percent, print_json, print_pairs, print_table
from .consent import Yes, consented_transaction
from .submission import known_state

if TYPE_CHECKING:
    from sqlalchemy.orm import Session
    from vitac.server.db.models import Evaluation

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

EvaluationId = Annotated[UUID, typer.Argument(help="Id of the evaluation.")]


@app.command("list")
def list_evaluations(
    state: Annotated[str | None, typer.Option(help="queued, running, completed, failed or cancelled.")] = None,
    limit: Annotated[int, typer.Option(min=1, max=1000, help="At most so many.")] = 50,
    as_json: AsJson = False,
) -> None:
    """List evaluations, newest first."""
    from sqlalchemy import select
    from vitac.server.db.models import Evaluation

    query = select(Evaluation).order_by(Evaluation.created_at.desc()).limit(limit)
    if state is not None:
        query = query.where(Evaluation.state == known_state(state))
    with transaction() as session:
        found = [to_json(evaluation) for evaluation in session.scalars(query)]
    if as_json:
        print_json(found)
        return
    columns = ["id", "team", "submission", "run", "state", "success_rate", "mean_steps", "verdict", "created_at"]
    rows = [[percent(row[key]) if key == "success_rate" else row[key] for key in columns] for row in found]
    print_table(columns, rows, none="No such evaluation.")


@app.command()
def show(
    evaluation: EvaluationId,
    as_json: AsJson = False,
) -> None:
    """Show an evaluation with its shards."""
    with transaction() as session:
        found = _find(session, evaluation)
        shown, shards = to_json(found), [_shard_json(shard) for shard in found.shards]
    if as_json:
        print_json(shown | {"shards": shards})
        return
    print_pairs(shown)
    print()
    columns = ["shard", "task", "episodes", "state", "attempts", "worker"]
    print_table(columns, [[shard[key] for key in columns] for shard in shards], none="It has no shards.")


@app.command()
def requeue(
    evaluation: EvaluationId,
    yes: Yes = False,
) -> None:
    """Start a new run of the same submission, all episodes anew; this evaluation stays as it is."""
    from vitac.server.accounts.principals import CONSOLE
    from vitac.server.submissions import runs

    with consented_transaction(f"Run the submission of evaluation {evaluation} once more?", yes=yes) as session:
        submission_id = runs.run_again(session, CONSOLE, _find(session, evaluation).submission_id).id
    print(f"queued submission {submission_id} again")


@app.command()
def cancel(
    evaluation: EvaluationId,
    yes: Yes = False,
) -> None:
    """Cancel an evaluation that waits or runs."""
    from vitac.server.accounts.principals import CONSOLE
    from vitac.server.errors import ProblemCode, ServiceError
    from vitac.server.evaluations.history import newest_evaluation
    from vitac.server.submissions import runs

    with consented_transaction(f"Cancel evaluation {evaluation}?", yes=yes) as session:
        found = _find(session, evaluation)
        if newest_evaluation(session, found.submission).id != evaluation:
            raise ServiceError(
                ProblemCode.NOT_CANCELLABLE, f"Evaluation {evaluation} has ended; a newer run of its submission exists."
            )
        runs.cancel(session, CONSOLE, found.submission_id)
    print(f"cancelled {evaluation}")


def to_json(evaluation: "Evaluation") -> dict[str, Any]:
    """Return what is shown of an evaluation; over several tasks the score is their combination."""
    from vitac.server.evaluations.scores import combined_score

    combined = combined_score(evaluation)
    return {
        "id": str(evaluation.id),
        "submission": str(evaluation.submission_id),
        "team": evaluation.submission.team.name,
        "track": evaluation.submission.track,
        "run": evaluation.run,
        "state": evaluation.state.value,
        "success_rate": combined.success_rate if combined else None,
        "mean_steps": combined.mean_steps if combined else None,
        "verdict": evaluation.verdict_code,
        "message": evaluation.verdict_message,
        "result_hash": evaluation.result_hash,
        "evaluator_version": evaluation.evaluator_version,
        "platform_class": evaluation.platform_class,
        "created_at": moment(evaluation.created_at),
        "started_at": moment(evaluation.started_at),
        "finished_at": moment(evaluation.finished_at),
    }


def _find(session: "Session", evaluation_id: UUID) -> "Evaluation":
    from vitac.server.db.models import Evaluation
    from vitac.server.errors import not_found

    found = session.get(Evaluation, evaluation_id)
    if found is None:
        raise not_found("evaluation", evaluation_id)
    return found


def _shard_json(shard: Any) -> dict[str, Any]:
    episodes = shard.episodes
    return {
        "shard": shard.number,
        "task": shard.task,
        "episodes": f"{episodes[0]}..{episodes[-1]}",
        "state": shard.state.value,
        "attempts": shard.attempts,
        "worker": str(shard.worker_id) if shard.worker_id is not None else None,
    }
