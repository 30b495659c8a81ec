"""`vitac status`: the state and results of submissions."""

import sys
import time
from collections.abc import Callable
from typing import Annotated, TypeVar

import typer
from vitac.errors import VitacError

from ..terminal.output import AsJson, Server, TokenFile, percent, print_json, print_pairs, print_table
from .answers import RequestRefused, ServiceUnreachable
from .http import Client, Json, make_client
from .pieces import PAUSES_S, is_transient
from .progress import EvaluationProgress, missing_tasks, nobody

AnswerT = TypeVar("AnswerT")

POLL_S = 0.5
_ENDED = frozenset({"completed", "failed", "cancelled"})

Pause = Callable[[], object]
"""Called between two requests for the state of an evaluation; raises to stop following."""


def has_ended(submission: Json) -> bool:
    """Return whether the newest evaluation of a submission has ended."""
    return submission["evaluation"]["state"] in _ENDED


def follow(
    client: Client, submission_id: str, progress: EvaluationProgress, pause: Pause = lambda: time.sleep(POLL_S)
) -> Json:
    """Show the progress of an evaluation until it ends, and return its last state."""
    with progress:
        while True:
            submission = ask_patiently(lambda: client.submission(submission_id))
            progress.update(submission)
            if has_ended(submission):
                return submission
            pause()


def ask_patiently(ask: Callable[[], AnswerT], *, pause: Callable[[float], object] = time.sleep) -> AnswerT:
    """Return what is answered; a service that is down, or starts, is waited for as an upload waits.

    Raises:
        RequestRefused: the service refuses it.
        ServiceUnreachable: nothing answered for about a minute.
    """
    for number, pause_s in enumerate(PAUSES_S):
        try:
            return ask()
        except (RequestRefused, ServiceUnreachable) as error:
            if isinstance(error, RequestRefused) and not is_transient(error):
                raise
            if number == 0:
                print(f"{error} Trying again for about a minute.", file=sys.stderr)
        pause(pause_s)
    return ask()


class EvaluationEndedWithoutScore(VitacError):
    """The evaluation failed or was cancelled; the message says why."""


def command(
    submission: Annotated[
        str | None,
        typer.Argument(help="Id of a submission; by default the newest ones are listed, and --watch takes the newest."),
    ] = None,
    watch: Annotated[bool, typer.Option("--watch", help="Wait until the evaluation ends.")] = False,
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Show your newest submissions, or one of them.

    With --watch the exit code is 0 for a completed evaluation and 1 for one that failed or was cancelled.
    """
    client = make_client(server, token_file)
    ask = ask_patiently if watch else lambda ask: ask()
    newest = ask(client.submissions) if submission is None else []
    if submission is None and (not watch or not newest):
        show_list(newest, as_json=as_json)
        return
    submission = submission or str(newest[0]["id"])
    if watch:
        show_when_ended(client, submission, as_json=as_json)
    elif as_json:
        print_json(client.submission(submission))
    else:
        show(client.submission(submission))


def show_when_ended(client: Client, submission_id: str, *, as_json: bool) -> None:
    """Wait until an evaluation ends, then print it.

    Raises:
        EvaluationEndedWithoutScore: it failed or was cancelled.
    """
    submission = follow(client, submission_id, EvaluationProgress(quiet=as_json))
    if as_json:
        print_json(submission)
    else:
        show(submission)
    require_score(submission)


def require_score(submission: Json) -> None:
    """Raise an error if an evaluation ended without a score.

    Raises:
        EvaluationEndedWithoutScore: it failed or was cancelled.
    """
    evaluation = submission["evaluation"]
    if evaluation["state"] == "completed":
        return
    verdict = evaluation["verdict"]
    reason = f": {verdict['title']} {verdict['message']} ({verdict['code']})" if verdict else ""
    raise EvaluationEndedWithoutScore(f"The evaluation {evaluation['state']}{reason}.")


def show_list(submissions: list[Json], *, as_json: bool) -> None:
    """Print a table of submissions."""
    if as_json:
        print_json(submissions)
        return
    columns = ["submission", "name", "team", "state", "episodes", "success", "submitted"]
    print_table(
        columns, [_row(item) for item in submissions], none="Nothing submitted yet; upload with `vitac submit FOLDER`."
    )


def show(submission: Json) -> None:
    """Print one submission with its score or verdict."""
    evaluation = submission["evaluation"]
    done = evaluation["progress"]
    pairs: dict[str, object] = {
        "submission": submission["id"],
        "name": submission["name"],
        "team": submission["team"]["name"],
        "track": submission["track"]
        if submission["stage"] is None
        else f"{submission['track']}, {submission['stage']}",
        "state": evaluation["state"],
        **({"disqualified": submission["disqualified_for"]} if submission.get("disqualified_for") else {}),
        **({"rank": submission["unranked"]} if submission.get("unranked") else {}),
        "queue": evaluation["queue_position"],
        "episodes": f"{done['episodes_done']} of {done['episodes_total']}, {done['episodes_reused']} reused",
    }
    if waits := nobody(submission):
        pairs["waits"] = waits
    if submission["log"]:
        pairs |= _log(submission["log"])
    pairs |= _scores(submission) if evaluation["scores"] else _progress_of_tasks(done)
    if missing := missing_tasks(submission):
        pairs["not submitted"] = missing
    if evaluation["verdict"] is not None:
        pairs["verdict"] = _verdict(evaluation["verdict"])
    print_pairs(pairs)
    if evaluation["log_tail"]:
        print(f"\nlast lines of the policy's output:\n{evaluation['log_tail']}")


def _log(log: Json) -> dict[str, object]:
    """Return a log's claims and its verification; why it failed is in the evaluation's verdict."""
    claimed = f"{percent(log['claimed_success_rate'])}, {log['claimed_successes']} of {log['claimed_episodes']}"
    lines: dict[str, object] = {"kind": log["label"], "claimed": claimed}
    if log["verdict"] is not None and log["verdict"].startswith("verified"):
        lines["log"] = f"{log['verdict']}: {log['reason']}"
    elif log["verdict"] is None and log["reason"]:
        lines["note"] = log["reason"]
    if log["divergence"] is not None:
        lines["state in the log"] = log["divergence"]["recorded_state"]
        lines["re-simulated state"] = log["divergence"]["resimulated_state"]
    if log["problems"]:
        lines["problems"] = f"{len(log['problems'])}, the first: {log['problems'][0]}"
    return lines


def _scores(submission: Json) -> dict[str, object]:
    """Return score, rank and result hash of each task, and of all together where the track has several."""
    evaluation, ranks = submission["evaluation"], submission["task_ranks"]
    lines: dict[str, object] = {
        score["task"]: _score(score, ranks.get(score["task"])) for score in evaluation["scores"]
    }
    for practice in evaluation.get("practice_scores") or ():
        lines[f"{practice['task']}, practice"] = practice["sentence"]
    several = len(submission["tasks"]) + len(submission["missing_tasks"]) > 1
    if several and evaluation["success_rate"] is not None:  # a sensor without a policy has none
        lines["all tasks"] = _score(evaluation, submission["rank"])
    if len(evaluation["scores"]) > 1:
        lines |= {f"hash, {score['task']}": score["result_hash"] for score in evaluation["scores"]}
    return lines | {"result hash": evaluation["result_hash"]}


def _score(score: Json, rank: Json | None) -> str:
    low, high = score["success_rate_interval"]
    if score["mean_steps"] is None:  # of all tasks it is a mean over tasks, of which each needs a success
        steps = "not every task has a success" if score["success_rate"] else "no success"
    else:
        steps = f"{score['mean_steps']:.2f} env steps"
    place = "" if rank is None else f", rank {rank['rank']} of {rank['of']}"
    return f"{percent(score['success_rate'])} ({percent(low)} to {percent(high)}), {steps}{place}"


def _progress_of_tasks(progress: Json) -> dict[str, object]:
    """Return the progress of each task, where there are several."""
    tasks = progress["tasks"]
    return {
        task["task"]: f"{task['episodes_done']} of {task['episodes_total']}, {task['successes']} successes"
        for task in tasks
        if len(tasks) > 1
    }


def _verdict(verdict: Json) -> str:
    where = f" ({verdict['task']}, episode {verdict['episode']})" if verdict["task"] else ""
    return f"{verdict['code']}: {verdict['message']}{where}"


def format_time(time: str) -> str:
    """Format a time of the API to the second: `2026-11-21T04:56:50.45Z` as `2026-11-21 04:56:50Z`."""
    return f"{time[:19].replace('T', ' ')}Z"


def _row(item: Json) -> list[object]:
    evaluation = item["evaluation"]
    progress = evaluation["progress"]
    rates = [f"{score['task']} {percent(score['success_rate'])}" for score in evaluation["scores"]]
    done = f"{progress['episodes_done']}/{progress['episodes_total']}"
    return [
        item["id"],
        item["name"],
        item["team"]["name"],
        evaluation["state"],
        done,
        ", ".join(rates),
        format_time(item["submitted_at"]),
    ]
