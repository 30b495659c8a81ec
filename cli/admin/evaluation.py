"""`vitac admin evaluation`: single runs of the evaluator."""

from typing import Annotated
from uuid import UUID

import typer
from sqlalchemy.orm import Session
from vitac.server.database.states import EvaluationState
from vitac.server.evaluations import listing, superseding
from vitac.server.principals import CONSOLE
from vitac.server.submissions import runs
from vitac.server.submissions.listing import get
from vitac.server.views.evaluations import DifferingEpisodeView, EvaluationDetailView, EvaluationRowView, ShardView
from vitac.server.views.submissions import SubmissionView

from ..service.database import load_settings, transaction
from ..terminal.output import AsJson, moment, percent, print_json, print_pairs, print_table
from .verbs import change, list_records

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

EvaluationId = Annotated[UUID, typer.Argument(help="Id of the evaluation.")]
COLUMNS = ("id", "team", "submission", "run", "state", "success", "steps", "verdict", "alarms", "copied", "created")


@app.command("list")
def list_evaluations(
    state: Annotated[EvaluationState | None, typer.Option(help="Only evaluations in this state.")] = None,
    limit: Annotated[int, typer.Option(min=1, max=1000, help="Maximum number of rows.")] = 50,
    as_json: AsJson = False,
) -> None:
    """List evaluations, newest first.

    Alarms: episodes that were played again with another result. Copied: episodes of a log with the states of an earlier
    submission of another team.
    """
    with transaction() as session:
        found = listing.list_evaluations(session, state=state, limit=limit)
    if as_json:
        print_json([row.model_dump(mode="json") for row in found])
    else:
        print_table(COLUMNS, [_row(row) for row in found], none="No such evaluation.")


@app.command()
def show(evaluation: EvaluationId, as_json: AsJson = False) -> None:
    """Show an evaluation with its shards, and with the episodes that were played again with another result."""
    with transaction() as session:
        found = listing.show_evaluation(session, load_settings(), evaluation)
    if as_json:
        print_json(found.model_dump(mode="json"))
        return
    print_pairs(_pairs(found))
    print()
    columns = ("shard", "task", "episodes", "state", "attempts", "worker")
    print_table(columns, [_shard(shard) for shard in found.shards], none="It has no shards.")
    if repeats := _repeats(found.shards):
        print()
        print_table(("shard", "queued again", "cause", "reason"), repeats, none="")
    if found.differing_episodes:
        _print_alarms(found.differing_episodes)


@change(
    app,
    question="Run the submission of evaluation {evaluation} again?",
    done="queued the submission of {evaluation} again",
)
def requeue(session: Session, evaluation: EvaluationId) -> SubmissionView:
    """Run all episodes of the same submission again; this evaluation does not change."""
    submission = runs.run_again(session, CONSOLE, listing.find(session, evaluation).submission_id)
    return get(session, load_settings(), CONSOLE, submission.id)


@change(app, question="Cancel evaluation {evaluation}?", done="cancelled {evaluation}")
def cancel(session: Session, evaluation: EvaluationId) -> EvaluationDetailView:
    """Cancel an evaluation that waits or runs."""
    runs.cancel_evaluation(session, CONSOLE, listing.find(session, evaluation))
    return listing.show_evaluation(session, load_settings(), evaluation)


@list_records(
    app,
    *("id", "team", "submission_id", "state", "evaluator_version", "created_at"),
    none="No evaluation waits for an evaluator that no running worker has.",
    name="unserved",
)
def list_unserved(session: Session) -> list[EvaluationRowView]:
    """List the evaluations that wait because no running worker has the evaluator with which they began.

    Start a worker of that release, or restart them with the present evaluator.
    """
    return listing.list_evaluations(session, superseding.is_unserved(load_settings()), limit=1000)


@change(
    app,
    question="Restart evaluation {evaluation} with the present evaluator?",
    done="evaluation {evaluation} begins again with the present evaluator",
)
def restart(session: Session, evaluation: EvaluationId) -> SubmissionView:
    """Restart an evaluation of another evaluator with the present one; it costs its team nothing."""
    superseding.restart(session, CONSOLE, evaluation)
    return get(session, load_settings(), CONSOLE, listing.find(session, evaluation).submission_id)


@change(app, question="Restart all evaluations whose evaluator no running worker has, with the present one?")
def restart_unserved(session: Session) -> dict[str, object]:
    """Restart all evaluations whose evaluator no running worker has with the present one; up to 200 at once."""
    return {"restarted": [str(found) for found in superseding.restart_unserved(session, CONSOLE, load_settings())]}


def _row(row: "EvaluationRowView") -> list[object]:
    return [
        row.id,
        row.team,
        row.submission_id,
        row.run,
        row.state.value,
        percent(row.success_rate),
        row.mean_steps,
        row.verdict.code if row.verdict else None,
        row.differing_episodes or None,
        row.copied_episodes or None,
        moment(row.created_at),
    ]


def _pairs(found: "EvaluationDetailView") -> dict[str, object]:
    progress, verdict = found.progress, found.verdict
    return {
        "evaluation": found.id,
        "submission": found.submission_id,
        "team": found.team,
        "track": found.track,
        "run": found.run,
        "state": found.state.value,
        "episodes": f"{progress.episodes_done} of {progress.episodes_total}, {progress.successes} successes",
        "success": percent(found.success_rate),
        "steps": found.mean_steps,
        "verdict": f"{verdict.code}: {verdict.message}" if verdict else None,
        "result hash": found.result_hash,
        "evaluator": found.evaluator_version,
        "platform class": found.platform_class,
        "isolation": "; ".join(found.isolation),
        "packages": "; ".join(f"{len(seen.versions)}, digest {seen.digest}" for seen in found.packages),
        "created": moment(found.created_at),
        "started": moment(found.started_at),
        "finished": moment(found.finished_at),
    }


def _shard(shard: "ShardView") -> list[object]:
    episodes = f"{shard.episodes[0]}..{shard.episodes[-1]}"
    return [shard.number, shard.task, episodes, shard.state.value, shard.attempts, shard.worker_id]


def _repeats(shards: "list[ShardView]") -> list[list[object]]:
    return [[shard.number, each.at, each.cause.value, each.reason] for shard in shards for each in shard.repeats]


def _print_alarms(alarms: "list[DifferingEpisodeView]") -> None:
    print("\nALARM: episodes were played again with another result than the stored one, which counts.")
    print("The policy or a machine is not deterministic.\n")
    columns = ("task", "episode", "stored record", "other record", "worker", "seen")
    rows = [
        [
            alarm.task,
            alarm.episode,
            alarm.stored_digest[:8],
            alarm.differing_digest[:8],
            alarm.worker_id,
            moment(alarm.seen_at),
        ]
        for alarm in alarms
    ]
    print_table(columns, rows, none="")
