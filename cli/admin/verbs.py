"""The verbs of `vitac admin`, noun by noun: which operation of the API each calls, and what is added to it.

A new verb of an organizer is a route of the API and an entry here. Those that do more than one request are in
`competition`, `token` and `files`, those that need the machine in `machine`.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from ..client.team import print_appeal
from ..client.verbs import Verb
from . import views


@dataclass(frozen=True, kw_only=True)
class AdminNoun:
    """A noun of `vitac admin`; `further` are verbs made elsewhere, in the order of the help."""

    title: str
    verbs: Sequence[Verb]
    further: Sequence[str] = ()


def _marks(texts: list[str]) -> dict[str, float]:
    by_criterion: dict[str, float] = {}
    for text in texts:
        name, _, mark = text.partition("=")
        try:
            by_criterion[name] = float(mark)
        except ValueError:
            raise typer.BadParameter(f"expected NAME=NUMBER such as structure=7.5, got {text!r}") from None
    return by_criterion


def _limit(text: str) -> int | None:
    if text == "unlimited":
        return None
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise typer.BadParameter(f"expected a number or unlimited, got {text!r}")
    return int(text)


def _read_file(path: str) -> str:
    try:
        return Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise typer.BadParameter(f"{path} cannot be read: {error}; expected a CSV file in UTF-8") from None


def _warn_of_stranger(answer: Any) -> Iterator[str]:
    """Warn of a judge without a token: a name that is written in another way counts as one judge more."""
    if not answer["has_token"]:
        yield (
            f"no judge with a token is named {answer['judge']!r}; check the spelling: another name is another judge."
        )


def _warn_of_results(answer: Any) -> Iterator[str]:
    if answer["is_in_final_results"]:
        yield (
            f"the results are final: a disqualified {answer['name']} is struck through there; `results finalize "
            "--again` decides without it."
        )


def _warn_of_winners(answer: Any) -> Iterator[str]:
    yield from answer["without_winner"]
    if not answer["items"] and not answer["without_winner"]:
        yield "nobody wins: the competition has no prizes."
    if answer["disqualified"]:
        yield (
            f"disqualified after the end: {', '.join(answer['disqualified'])}. `results finalize --again` decides "
            "without them."
        )


def _warn_of_empty_stage(answer: Any) -> Iterator[str]:
    if not answer["confirmed"]:
        yield (
            f"no team takes part in {answer['stage']} of {answer['track']}; `vitac admin advance propose` shows the "
            "board before."
        )


STAGE = "/competitions/{competition}/tracks/{track}/stages/{stage}"
SUBMISSION = "/submissions/{submission_id}"
TEAM_COLUMNS = ("name", "contact", "created_at", "approved_at", "refused_for", "disqualified_for", "id")


NOUNS: Mapping[str, AdminNoun] = {
    "competition": AdminNoun(
        title="Competitions",
        further=("check", "apply"),
        verbs=[
            Verb("show", "GET /competitions/{competition}/definition", of="definition", show=views.print_definition),
            Verb(
                "lists",
                "GET /competitions/{competition}/lists",
                columns=("track", "stage", "commitment", "withdrawn_at", "revealed_at", "secret"),
                none="No stage plays a sealed list.",
            ),
            Verb(
                "play-final",
                f"POST {STAGE}/final",
                asks="Have the chosen submissions play the final list of {stage} of {track}, once?",
                done="the final list is played",
            ),
            Verb(
                "begin-trials",
                f"POST {STAGE}/trials",
                asks="Let the stations play the trials of {stage} of {track} by its plan?",
            ),
            Verb(
                "trials",
                f"GET {STAGE}/trials",
                columns=("position", "station", "twin", "submission_id", "task", "episode", "state"),
                none="No trial is planned.",
            ),
            Verb(
                "reveal",
                f"POST {STAGE}/reveal",
                asks="Publish the episodes of stage {stage} of {track}? This cannot be undone.",
            ),
        ],
    ),
    "advance": AdminNoun(
        title="Who takes part in a later stage",
        verbs=[
            Verb("propose", f"GET {STAGE}/advancement", show=views.print_proposal),
            Verb(
                "confirm",
                f"PUT {STAGE}/advancement",
                help="Confirm the teams that take part in a stage: those proposed, with --add and --without.",
                words={"revision": "--base"},
                asks="Let these teams take part in {stage} of {track}?",
                tries=True,
                of="confirmed",
                show=views.print_confirmed,
                warns=_warn_of_empty_stage,
            ),
            Verb(
                "list",
                f"GET {STAGE}/advancement",
                help="List the teams that were confirmed for a stage.",
                of="confirmed",
                show=views.print_teams,
            ),
        ],
    ),
    "results": AdminNoun(
        title="The end of a competition",
        further=("publish",),
        verbs=[
            Verb(
                "freeze", "POST /competitions/{competition}/freeze", done="boards are frozen", answers={"frozen": True}
            ),
            Verb(
                "unfreeze",
                "POST /competitions/{competition}/unfreeze",
                asks="Show all results on the boards again?",
                done="boards show all results",
                answers={"frozen": False},
            ),
            Verb(
                "winners",
                "GET /competitions/{competition}/winners",
                of="items",
                show=views.print_winners,
                warns=_warn_of_winners,
            ),
            Verb(
                "finalize",
                "POST /competitions/{competition}/finalize",
                asks="End the competition with these winners?",
                tries=True,
                of="items",
                show=views.print_winners,
                warns=_warn_of_winners,
            ),
            Verb(
                "reopen",
                "POST /competitions/{competition}/reopen",
                asks="Reopen the competition? Its page shows this, with your reason.",
                done="the results are open again",
            ),
        ],
    ),
    "judging": AdminNoun(
        title="Judges' marks",
        verbs=[
            Verb("rubric", "GET /competitions/{competition}/judging/{track}/rubric", show=views.print_rubric),
            Verb(
                "mark",
                f"PUT {SUBMISSION}/marks",
                arguments=("marks",),
                parse={"marks": _marks},
                needed=("judge",),
                done="marks of {judge} for {submission}",
                warns=_warn_of_stranger,
            ),
            Verb(
                "conflict",
                "POST /judging/conflicts",
                arguments=("team",),
                needed=("judge",),
                done="{judge} does not judge {team}",
                warns=_warn_of_stranger,
            ),
            Verb(
                "show",
                "GET /judging/{track}",
                help="Show each team's marks with their spread, its figures and its total.",
                show=views.print_judged,
            ),
        ],
    ),
    "brief": AdminNoun(
        title="Briefs of teams, and what the committee decides",
        verbs=[
            Verb(
                "list",
                f"GET {STAGE}/briefs",
                columns=("team", "team_id", "pages", "received_at", "accepted", "reason"),
                none="No team has handed in a brief.",
            ),
            Verb(
                "decide",
                f"PUT {STAGE}/briefs/{{team_id}}/decision",
                words={"accepted": "--accept/--decline"},
                done="the committee has decided about {team}",
            ),
        ],
    ),
    "result": AdminNoun(
        title="Results of attempts that were played elsewhere",
        verbs=[
            Verb(
                "enter",
                f"PUT {STAGE}/results",
                arguments=("points",),
                parse={"points": _marks},
                of="entries",
                columns=("rank", "team", "total", "attempt", "attempts", "evidence"),
            ),
            Verb(
                "show",
                f"GET {STAGE}/results",
                of="entries",
                columns=("rank", "team", "total", "attempt", "attempts", "evidence", "prize"),
                none="No result was entered.",
            ),
        ],
    ),
    "baseline": AdminNoun(
        title="What people solve of a task by marker flow alone, beside the entries of its boards",
        further=("publish",),
        verbs=[
            Verb(
                "remove",
                "DELETE /tracks/{track}/tasks/{task}/human-baseline",
                asks="Show no longer what people solve of {task}?",
                done="what people solve of {task} is no longer shown",
            ),
        ],
    ),
    "receipt": AdminNoun(
        title="Receipts of final results",
        further=("export",),
        verbs=[
            Verb(
                "key",
                "GET /receipts",
                help="Show the public key that signs the log of receipts, the log's length, root and checkpoint.",
                fixed={"limit": 1},
                only=(),
                only_json=("items", "witnesses", "next_after"),
            ),
            Verb(
                "witnesses",
                "GET /receipts",
                help="List the witnesses that the competitions name, and how far each has signed the log.",
                fixed={"limit": 1},
                only=(),
                of="witnesses",
                columns=("witness", "size", "behind", "behind_s", "signed_at"),
                none="No competition names witnesses.",
            ),
        ],
    ),
    "rejudge": AdminNoun(
        title="Evaluate again, and decide whether the new results count",
        verbs=[
            Verb(
                "start",
                "POST /rejudgements",
                help="Evaluate submissions again with the present evaluator. Only organizers see it, and no result "
                "changes.",
                words={"submissions": "--submission"},
                unknown=("id",),
                show=views.print_started,
            ),
            Verb(
                "list",
                "GET /rejudgements",
                columns=("id", "track", "stage", "reason", "started_at", "applied_at", "discarded_at"),
                none="There is none.",
            ),
            Verb(
                "show",
                "GET /rejudgements/{rejudgement_id}",
                help="Show which scores and ranks would change.",
                of="submissions",
                show=views.print_rejudged,
            ),
            Verb(
                "apply",
                "POST /rejudgements/{rejudgement_id}/apply",
                help="Replace the present results by the new ones.",
                asks="Replace the present results by these?",
                tries=True,
                looks=True,
                of="submissions",
                show=views.print_rejudged,
            ),
            Verb(
                "discard",
                "POST /rejudgements/{rejudgement_id}/discard",
                asks="Discard the new results?",
                done="discarded {rejudgement}",
                answers={"discarded": True},
            ),
        ],
    ),
    "track": AdminNoun(title="Track files of your own", further=("check",), verbs=[]),
    "team": AdminNoun(
        title="Teams",
        verbs=[
            Verb(
                "add",
                "POST /teams",
                help="Add a team and print its API token, which is shown only once.",
                arguments=("name",),
                only=("name", "contact"),
                unknown=("team.id", "token.id", "token.secret"),
                show=views.print_added_team,
            ),
            Verb(
                "import",
                "POST /teams/import",
                help="Add the teams of a CSV file and print an invitation for each captain, shown only once.",
                arguments=("csv",),
                parse={"csv": _read_file},
                columns=("name", "contact", "code", "expires_at"),
            ),
            Verb(
                "bulk",
                "POST /teams/changes",
                help="Do the same with several teams, all or none; --reason is for refuse and disqualify, --title and "
                "--text for message.",
                arguments=("action", "teams"),
                asks="{action} {teams}?",
                columns=TEAM_COLUMNS,
            ),
            Verb(
                "message",
                "POST /teams/{team_id}/messages",
                help="Send a message to one team: on its page of announcements, and as a notice.",
                arguments=("title", "text"),
                unknown=("id",),
            ),
            Verb(
                "note",
                "PUT /teams/{team_id}/note",
                arguments=("note",),
                done="note of {team}: {note}",
            ),
            Verb(
                "invite",
                "POST /teams/{team_id}/invitations",
                help="Print an invitation; of a team for which nobody can act yet, whoever joins with it leads it.",
                unknown=("id", "code"),
            ),
            Verb(
                "list",
                "GET /teams",
                only=("state", "search", "competition"),
                columns=("name", "state", "contact", "members", "submissions", "created_at", "note", "id"),
                none="No such team; `vitac admin team add NAME` makes one.",
            ),
            Verb("show", "GET /teams/{team_id}", help="Show one team with its members.", show=views.print_team),
            Verb(
                "accept",
                "PATCH /teams/{team_id}",
                help="Accept a team that waits or was refused; it may submit then.",
                fixed={"accepted": True},
                only=(),
                only_json=("members", "invitations"),
            ),
            Verb(
                "refuse",
                "PATCH /teams/{team_id}",
                help="Refuse a team that waits to be accepted.",
                fixed={"accepted": False},
                only=("reason",),
                needed=("reason",),
                only_json=("members", "invitations"),
            ),
            Verb(
                "rename",
                "PATCH /teams/{team_id}",
                help="Give a team another name.",
                arguments=("name",),
                only=("name",),
                needed=("name",),
                only_json=("members", "invitations"),
            ),
            Verb(
                "merge",
                "POST /teams/{team_id}/merge",
                arguments=("into",),
                help="Merge two teams: join their submissions and members, and add up what they used of quotas.",
                asks="Merge {team} into {into}? This cannot be undone.",
                only_json=("members", "invitations"),
            ),
            Verb(
                "disqualify",
                "PUT /teams/{team_id}/disqualification",
                help="Remove a team from all boards and refuse its submissions; `reinstate` undoes it.",
                asks="Disqualify {team}?",
                warns=_warn_of_results,
            ),
            Verb(
                "reinstate",
                "DELETE /teams/{team_id}/disqualification",
                asks="Reinstate {team}, with all its results on the boards?",
            ),
            Verb(
                "captain",
                "PUT /teams/{team_id}/captain",
                arguments=("member_id",),
                only_json=("members", "invitations"),
            ),
            Verb(
                "remove-member",
                "DELETE /teams/{team_id}/members/{member_id}",
                help="Remove a member from a team; their token ends at once.",
                asks="Remove {member} from {team}?",
                done="{member} is no longer in {team}",
            ),
            Verb(
                "data",
                "GET /teams/{team_id}/data",
                help="Show how much data the service stores about a team; --json prints all of it.",
                show=views.print_data,
            ),
            Verb(
                "delete",
                "DELETE /teams/{team_id}",
                help="Remove a team's name, members, texts and uploads permanently; its scores stay.",
                asks="Remove {team} with all that it uploaded permanently?",
                done="{team} is removed",
            ),
        ],
    ),
    "quota": AdminNoun(
        title="Quotas of teams",
        verbs=[
            Verb("list", "GET /teams/{team_id}/quotas", columns=("quota", "limit", "used", "opens_at")),
            Verb(
                "set",
                "PUT /teams/{team_id}/quotas/{quota}",
                arguments=("limit",),
                parse={"limit": _limit},
                done="{quota} of {team}: {limit}",
            ),
            Verb(
                "reset",
                "DELETE /teams/{team_id}/quotas/{quota}",
                done="{quota} of {team}: that of the service's settings",
            ),
        ],
    ),
    "token": AdminNoun(
        title="API tokens",
        further=("add",),
        verbs=[
            Verb(
                "list",
                "GET /tokens",
                help="List all tokens, without their secrets.",
                of="items",
                columns=("id", "role", "team", "competition", "label", "expires_at", "revoked_at", "last_used_at"),
                none="No token yet.",
            ),
            Verb(
                "revoke",
                "DELETE /tokens/{token_id}",
                help="Revoke a token; this cannot be undone.",
                asks="Revoke token {token}? This cannot be undone.",
                done="revoked {token}",
            ),
        ],
    ),
    "submission": AdminNoun(
        title="Submissions",
        further=("download",),
        verbs=[
            Verb("list", "GET /submissions", help="List submissions, newest first.", show=views.print_submissions),
            Verb(
                "show",
                f"GET {SUBMISSION}",
                help="Show a submission with its newest evaluation.",
                show=views.print_submission,
            ),
            Verb("copies", "GET /copies", show=views.print_copies),
            Verb(
                "clear",
                f"PUT {SUBMISSION}/clearance",
                help="Put a submission that was found to be a copy back on the boards. `withdraw-clearance` undoes it.",
                asks="Rank submission {submission} although it was found to be a copy?",
                done="cleared {submission}",
            ),
            Verb(
                "withdraw-clearance",
                f"DELETE {SUBMISSION}/clearance",
                help="Withdraw the clearance of a submission: it counts as a copy again.",
                asks="Count submission {submission} as a copy again?",
                done="withdrew the clearance of {submission}",
            ),
            Verb(
                "requeue",
                f"POST {SUBMISSION}/requeue",
                help="Evaluate all episodes of a submission again. Earlier results stay; the newest run is shown.",
                asks="Evaluate submission {submission} again?",
                done="queued {submission} again",
            ),
            Verb(
                "cancel",
                f"POST {SUBMISSION}/cancel",
                help="Cancel the evaluation of a submission; its workers stop within seconds.",
                asks="Cancel the evaluation of submission {submission}?",
                done="cancelled {submission}",
            ),
            Verb(
                "disqualify",
                f"PUT {SUBMISSION}/disqualification",
                help="Remove one submission from all boards; its team takes part as before. `reinstate` undoes it.",
                asks="Take submission {submission} off all boards?",
                done="disqualified {submission}",
            ),
            Verb(
                "reinstate",
                f"DELETE {SUBMISSION}/disqualification",
                help="Put a disqualified submission back on the boards.",
                asks="Put submission {submission} back on the boards?",
                done="reinstated {submission}",
            ),
            Verb(
                "remove-description",
                f"PUT {SUBMISSION}/description/removal",
                help="Hide what a team wrote about its result from others. `restore-description` undoes it.",
                asks="Hide the description of {submission} from others?",
                done="removed it from {submission}",
            ),
            Verb(
                "restore-description",
                f"DELETE {SUBMISSION}/description/removal",
                help="Let others see a removed description again.",
                asks="Let others see the description of {submission} again?",
                done="restored it of {submission}",
            ),
        ],
    ),
    "evaluation": AdminNoun(
        title="Evaluations",
        verbs=[
            Verb("list", "GET /evaluations", only=("state", "limit"), show=views.print_evaluations),
            Verb("show", "GET /evaluations/{evaluation_id}", show=views.print_evaluation),
            Verb(
                "unserved",
                "GET /evaluations",
                help="List the evaluations that wait because no running worker has the evaluator with which they "
                "began.\n\nStart a worker of that release, or restart them with the present evaluator.",
                fixed={"unserved": True, "limit": 1000},
                only=(),
                columns=("id", "team", "submission_id", "state", "evaluator_version", "created_at"),
                none="No evaluation waits for an evaluator that no running worker has.",
            ),
            Verb(
                "restart",
                "POST /evaluations/{evaluation_id}/restart",
                asks="Restart evaluation {evaluation} with the present evaluator?",
                done="evaluation {evaluation} begins again with the present evaluator",
            ),
            Verb(
                "restart-unserved",
                "POST /evaluations/restart-unserved",
                asks="Restart all evaluations whose evaluator no running worker has, with the present one?",
            ),
            Verb(
                "requeue",
                "POST /evaluations/{evaluation_id}/requeue",
                asks="Run the submission of evaluation {evaluation} again?",
                done="queued the submission of {evaluation} again",
            ),
            Verb(
                "cancel",
                "POST /evaluations/{evaluation_id}/cancel",
                asks="Cancel evaluation {evaluation}?",
                done="cancelled {evaluation}",
            ),
        ],
    ),
    "worker": AdminNoun(
        title="Workers",
        verbs=[
            Verb("list", "GET /workers", show=views.print_workers),
            Verb("show", "GET /workers/{worker_id}", show=views.print_worker),
            Verb(
                "cordon",
                "PUT /workers/{worker_id}/order",
                fixed={"order": "cordon"},
                help="Have a worker take no new shards; it finishes those that it runs.",
                done="worker {worker} takes no new shards, from its next heartbeat on",
            ),
            Verb(
                "uncordon",
                "PUT /workers/{worker_id}/order",
                fixed={"order": "work"},
                help="Have a worker take shards again.",
                done="worker {worker} takes shards, from its next heartbeat on",
            ),
            Verb(
                "drain",
                "PUT /workers/{worker_id}/order",
                fixed={"order": "drain"},
                help="Have a worker finish the shards that it runs, take no others, and end.",
                done="worker {worker} ends after the shards that it runs",
            ),
        ],
    ),
    "station": AdminNoun(
        title="Laboratories whose agents play trials",
        verbs=[
            Verb(
                "add",
                "POST /stations",
                arguments=("name",),
                unknown=("key",),
                help="Add a station and print its key, which is shown once: `vitac station run` needs it.",
            ),
            Verb(
                "list",
                "GET /stations",
                columns=("name", "twin", "worker_id", "created_at"),
                none="No station; `vitac admin station add` adds one.",
            ),
            Verb(
                "remove",
                "DELETE /stations/{name}",
                asks="Remove the station {name}? Its key is refused afterwards.",
                done="station {name} is removed",
            ),
        ],
    ),
    "audit": AdminNoun(
        title="The audit log, which nobody can change",
        verbs=[
            Verb("list", "GET /audit", show=views.print_audit),
            Verb(
                "digests",
                "GET /audit/digests",
                columns=("entry", "issued_at", "first", "last", "lines", "agrees"),
                none="The public log has no digest of the audit log yet.",
            ),
        ],
    ),
    "announcement": AdminNoun(
        title="Announcements to everybody",
        verbs=[
            Verb(
                "publish",
                "POST /announcements",
                help="Show an announcement to everybody.",
                arguments=("title", "text"),
                unknown=("id",),
            ),
            Verb(
                "list",
                "GET /announcements",
                help="List the announcements that everybody sees.",
                of="items",
                columns=("id", "published_at", "title"),
                none="No announcement.",
            ),
            Verb(
                "withdraw",
                "DELETE /announcements/{announcement_id}",
                help="Withdraw an announcement: nobody sees it any longer.",
                done="announcement {announcement} is withdrawn",
                answers={"withdrawn": True},
            ),
        ],
    ),
    "question": AdminNoun(
        title="Questions of teams",
        verbs=[
            Verb(
                "list",
                "GET /questions",
                help="List the questions of all teams, newest first.",
                of="items",
                columns=("id", "team", "asked_at", "public", "answered_at", "text"),
                none="No question.",
            ),
            Verb(
                "answer",
                "PUT /questions/{question_id}/answer",
                arguments=("text",),
                help="Answer a question, or replace its answer.",
                usual={"public": False},
                words={"public": "--public/--private"},
            ),
            Verb(
                "hide",
                "DELETE /questions/{question_id}",
                help="Hide a question: only its team sees it, and it needs no answer.",
                done="question {question} is hidden",
                answers={"hidden": True},
            ),
        ],
    ),
    "appeal": AdminNoun(
        title="Appeals of teams",
        further=("replay",),
        verbs=[
            Verb(
                "list",
                "GET /appeals",
                help="List the appeals of all teams, newest first.",
                of="items",
                only=("open",),
                columns=("id", "state", "team", "submission_name", "task", "episode", "opened_at"),
                none="No appeal.",
            ),
            Verb(
                "show",
                "GET /appeals/{appeal_id}",
                help="Show an appeal, and what was played again for it.",
                show=print_appeal,
            ),
            Verb(
                "rule",
                "PUT /appeals/{appeal_id}/ruling",
                arguments=("text",),
                help="Decide an appeal. No result changes; `vitac admin submission requeue` evaluates again.",
                words={"upheld": "--uphold/--reject"},
                only_json=("replays",),
            ),
        ],
    ),
    "notice": AdminNoun(
        title="E-mails and webhooks to teams",
        verbs=[
            Verb(
                "list",
                "GET /notices",
                columns=(
                    "created_at",
                    "kind",
                    "channel",
                    "target",
                    "attempts",
                    "sent_at",
                    "given_up_at",
                    "problem",
                    "id",
                ),
                none="No notice.",
            ),
            Verb("retry", "POST /notices/{notice_id}/retry"),
        ],
    ),
}
