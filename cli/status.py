"""`vitac status`: what became of submissions."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from vitac.envs.errors import VitacError

from .client import client_from
from .evaluation_progress import EvaluationProgress
from .output import percent, print_json, print_pairs, print_table

if TYPE_CHECKING:
    from .client import Client, Json

POLL_S = 0.5
FINISHED = frozenset({"completed", "failed", "cancelled"})


class EvaluationEndedWithoutScore(VitacError):
    """The evaluation failed or was cancelled; the message says why."""


def command(
    submission: Annotated[
        str | None, typer.Argument(help="Id of a submission; without one, the newest are listed.")
    ] = None,
    watch: Annotated[bool, typer.Option("--watch", help="Stay until the evaluation ends.")] = False,
    server: Annotated[str | None, typer.Option(help="Address of the service; default: VITAC_SERVER.")] = None,
    token_file: Annotated[Path | None, typer.Option(help="File with the API token; default: VITAC_TOKEN.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the service's answer as JSON.")] = False,
) -> None:
    """Show your newest submissions, or one of them.

    With --watch the exit code is 0 for a completed evaluation and 1 for one that failed or was cancelled.
    """
    client = client_from(server, token_file)
    if submission is None:
        if watch:
            raise typer.BadParameter("--watch needs the id of a submission")
        show_list(client.submissions(), as_json=as_json)
        return
    if watch:
        follow(client, submission, as_json=as_json)
    elif as_json:
        print_json(client.submission(submission))
    else:
        show(client.submission(submission))


def follow(client: Client, submission_id: str, *, as_json: bool) -> None:
    """Stay until an evaluation ends, then print it.

    Raises:
        EvaluationEndedWithoutScore: it failed or was cancelled.
    """
    found = watch_submission(client, submission_id, quiet=as_json)
    if as_json:
        print_json(found)
    else:
        show(found)
    require_score(found)


def watch_submission(client: Client, submission_id: str, *, quiet: bool = False) -> Json:
    """Show the progress of an evaluation until it ends, and return its last state."""
    with EvaluationProgress(quiet=quiet) as progress:
        while True:
            found = client.submission(submission_id)
            progress.update(found)
            if found["evaluation"]["state"] in FINISHED:
                return found
            time.sleep(POLL_S)


def require_score(found: Json) -> None:
    """Refuse an evaluation that ended without a score.

    Raises:
        EvaluationEndedWithoutScore: it failed or was cancelled.
    """
    evaluation = found["evaluation"]
    if evaluation["state"] == "completed":
        return
    verdict = evaluation["verdict"]
    reason = f": {verdict['title']} {verdict['message']} ({verdict['code']})" if verdict else ""
    raise EvaluationEndedWithoutScore(f"The evaluation {evaluation['state']}{reason}.")


def show_list(found: list[Json], *, as_json: bool) -> None:
    """Print submissions below each other."""
    if as_json:
        print_json(found)
        return
    columns = ["submission", "name", "team", "state", "episodes", "success", "submitted"]
    print_table(columns, [_row(item) for item in found], none="Nothing submitted yet; `vitac submit FOLDER` uploads.")


def show(found: Json) -> None:
    """Print one submission with its score or verdict."""
    evaluation = found["evaluation"]
    done = evaluation["progress"]
    pairs: dict[str, object] = {
        "submission": found["id"],
        "name": found["name"],
        "team": found["team"]["name"],
        "state": evaluation["state"],
        "queue": evaluation["queue_position"],
        "episodes": f"{done['episodes_done']} of {done['episodes_total']}, {done['episodes_reused']} from the store",
    }
    for score in evaluation["scores"]:
        low, high = score["success_rate_interval"]
        pairs |= {
            f"{score['task']}": f"{percent(score['success_rate'])} ({percent(low)} to {percent(high)})",
            "mean steps": score["mean_steps"],
        }
    if found["rank"] is not None:
        pairs["rank"] = f"{found['rank']['rank']} of {found['rank']['of']}"
    if evaluation["result_hash"] is not None:
        pairs["result hash"] = evaluation["result_hash"]
    if evaluation["verdict"] is not None:
        pairs["verdict"] = f"{evaluation['verdict']['code']}: {evaluation['verdict']['message']}"
    print_pairs(pairs)
    if evaluation["log_tail"]:
        print(f"\noutput of the policy, its last lines:\n{evaluation['log_tail']}")


def to_the_second(time: str) -> str:
    """Shorten a time as the service writes it: `2026-11-21T04:56:50.45Z` to `2026-11-21 04:56:50Z`."""
    return f"{time[:19].replace('T', ' ')}Z"


def _row(item: Json) -> list[object]:
    evaluation = item["evaluation"]
    progress, scores = evaluation["progress"], evaluation["scores"]
    rate = scores[0]["success_rate"] if len(scores) == 1 else None
    done = f"{progress['episodes_done']}/{progress['episodes_total']}"
    return [
        item["id"],
        item["name"],
        item["team"]["name"],
        evaluation["state"],
        done,
        percent(rate),
        to_the_second(item["submitted_at"]),
    ]
