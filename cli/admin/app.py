"""`vitac admin`: the organizer's commands. They work on the database directly and write the audit log."""

import sys

import structlog
import typer

from . import (
    appeal,
    audit,
    backup,
    evaluation,
    judging,
    notice,
    quota,
    receipt,
    station,
    submission,
    team,
    token,
    worker,
)
from . import rejudging as rejudge
from .competition import advancement as advance
from .competition import competition, results, track
from .messages import announcement, question

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@app.callback()
def log_beside_the_output() -> None:
    """Organize the competition: teams, tokens, submissions, evaluations, workers."""
    # Events go to stderr, so that the output, above all JSON, holds what was asked for and nothing else.
    structlog.configure(logger_factory=lambda *_: structlog.PrintLogger(sys.stderr))


app.add_typer(competition.app, name="competition", help="Competitions: check, apply, show, lists, reveal.")
app.add_typer(advance.app, name="advance", help="Who takes part in a later stage: propose, confirm, list.")
app.add_typer(
    results.app, name="results", help="The end of a competition: freeze, unfreeze, winners, finalize, reopen, publish."
)
app.add_typer(judging.app, name="judging", help="Judges' marks: rubric, mark, conflict, show.")
app.add_typer(receipt.app, name="receipt", help="Receipts of final results: key, witnesses, export.")
app.add_typer(
    rejudge.app,
    name="rejudge",
    help="Evaluate again, and decide whether the new results count: start, list, show, apply, discard.",
)
app.add_typer(track.app, name="track", help="Track files of your own: check.")
app.add_typer(
    team.app,
    name="team",
    help="Teams: add, list, show, accept, refuse, rename, merge, disqualify, reinstate, captain, remove-member, data, "
    "delete.",
)
app.add_typer(quota.app, name="quota", help="Quotas of teams: list, set.")
app.add_typer(token.app, name="token", help="API tokens: add, list, revoke.")
app.add_typer(
    submission.app,
    name="submission",
    help="Submissions: list, show, copies, clear, withdraw-clearance, requeue, cancel, disqualify, reinstate, "
    "remove-description, restore-description.",
)
app.add_typer(
    evaluation.app,
    name="evaluation",
    help="Evaluations: list, show, unserved, restart, restart-unserved, requeue, cancel.",
)
app.add_typer(worker.app, name="worker", help="Workers: list, show, cordon, uncordon, drain.")
app.add_typer(station.app, name="station", help="Laboratories whose agents play trials: add, list, remove.")
app.add_typer(audit.app, name="audit", help="The audit log: list.")
app.add_typer(announcement.app, name="announcement", help="Announcements to everybody: publish, list, withdraw.")
app.add_typer(question.app, name="question", help="Questions of teams: list, answer, hide.")
app.add_typer(appeal.app, name="appeal", help="Appeals of teams: list, show, replay, rule.")
app.add_typer(notice.app, name="notice", help="E-mails and webhooks to teams: list, retry.")
app.command("backup")(backup.back_up)
app.command("restore")(backup.restore)
