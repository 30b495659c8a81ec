"""`vitac team`, `question` and `appeal`: what a team does at a service; most verbs are requests, listed in tables."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from ..terminal.output import AsJson, Server, TokenFile, existing_file, print_json, print_meanings, print_pairs
from .answers import decode
from .http import make_client, store_token
from .verbs import HELPS, OWN_TEAM, PREFIX, Door, Given, Verb, add_verbs, print_fields, print_rows

MemberName = Annotated[str, typer.Argument(help="The member's name, as `vitac team show` prints it.")]
Kinds = Annotated[
    list[str] | None,
    typer.Argument(
        help="Kinds of notices to mute: accepted, finished, failed, promoted, deadline or announcement; without any, "
        "you get all."
    ),
]
MEMBER = "/teams/{team_id}/members/{member_id}"
OWN = {"team_id": OWN_TEAM}


@contextmanager
def open_door(_: object, server: str | None, token_file: Path | None) -> Iterator[Door]:
    """Open the service that options or environment name, else that of the last login."""
    yield Door(client=make_client(server, token_file))


def _noun(verbs: Sequence[Verb]) -> typer.Typer:
    app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)
    add_verbs(app, verbs, open_door)
    return app


def _print_invitation(answer: Any, _: Given) -> None:
    print_fields({"code": answer["code"], "until": answer["expires_at"]})
    print("\nThe code is shown only once, and is valid for one person: `vitac team join CODE NAME`.")


def _print_webhook(answer: Any, _: Given) -> None:
    print_pairs({name: answer[name] for name in ("id", "address", "secret")})
    print("\nThe secret is shown only once; the receiver checks each notice with it.")


def print_appeal(answer: Any, _: Given) -> None:
    """Print an appeal with what was played again for it."""
    print_fields({name: value for name, value in answer.items() if name != "replays"})
    print()
    columns = ("task", "episode", "corrected", "old_outcome", "outcome", "old_env_steps", "env_steps", "same_states")
    print_rows(answer["replays"], columns, none="No episode was played again.")
    print_meanings(end for replay in answer["replays"] for end in (replay["old_outcome"], replay["outcome"]))


question = _noun(
    [
        Verb(
            "list",
            "GET /questions",
            help="List the team's questions and the public ones with their answers, newest first.",
            only=(),
            of="items",
            columns=("id", "team", "public", "text", "answer"),
            none="No question.",
        ),
        Verb(
            "ask",
            "POST /questions",
            help="Ask the organizers.",
            arguments=("text",),
            usual={"public": False},
            words={"public": "--public/--private"},
        ),
    ]
)
appeal = _noun(
    [
        Verb(
            "list",
            "GET /appeals",
            help="List the team's appeals, newest first.",
            only=(),
            of="items",
            columns=("id", "state", "submission_name", "task", "episode", "opened_at", "ruling"),
            none="No appeal.",
        ),
        Verb(
            "open",
            "POST /appeals",
            help="Appeal against the newest evaluation of a submission.",
            arguments=("submission_id", "text"),
            only_json=("replays",),
        ),
        Verb(
            "show",
            "GET /appeals/{appeal_id}",
            help="Show an appeal, its ruling, and what was played again for it.",
            show=print_appeal,
        ),
        Verb(
            "withdraw",
            "POST /appeals/{appeal_id}/withdraw",
            help="Withdraw an appeal that is not decided yet.",
            only_json=("replays",),
        ),
    ]
)
app = _noun(
    [
        Verb(
            "data",
            "GET /teams/{team_id}/data",
            help="Print all data that the service stores about the team, as JSON.",
            fixed=OWN,
            show=lambda answer, _: print_json(answer),
        ),
        Verb(
            "invite",
            "POST /teams/{team_id}/invitations",
            help="Print a code with which one person joins the team; for its captain.",
            fixed=OWN,
            unknown=("id", "code"),
            show=_print_invitation,
        ),
        Verb(
            "remove",
            f"DELETE {MEMBER}",
            help="Remove a member, whose token ends at once; for the captain, or to leave the team.",
            fixed=OWN,
            done="{member} is no longer in the team",
        ),
        Verb(
            "captain",
            "PUT /teams/{team_id}/captain",
            help="Make another member the captain.",
            fixed=OWN,
            arguments=("member_id",),
            done="{member} is the captain",
        ),
        Verb(
            "confirm-email",
            f"PATCH {MEMBER}",
            help="Confirm the address for your notices with the code of the e-mail that asks for it.",
            fixed=OWN,
            only=("email_code",),
            arguments=("email_code",),
            needed=("email_code",),
            done="notices of {member} are sent from now on",
        ),
    ]
)
webhook = _noun(
    [
        Verb(
            "list",
            "GET /teams/{team_id}/webhooks",
            help="List the team's webhooks, oldest first.",
            fixed=OWN,
            of="items",
            columns=("id", "address", "created_at"),
            none="No webhook.",
        ),
        Verb(
            "add",
            "POST /teams/{team_id}/webhooks",
            help="Post the team's notices to an address, and print the secret that signs them.",
            fixed=OWN,
            arguments=("address",),
            unknown=("id", "secret"),
            show=_print_webhook,
        ),
        Verb(
            "remove",
            "DELETE /teams/{team_id}/webhooks/{webhook_id}",
            help="Post no further notices to an address.",
            fixed=OWN,
            done="{webhook} no longer gets notices",
        ),
    ]
)
app.add_typer(webhook, name="webhook", help="Addresses that get the team's notices: list, add, remove.")


@app.command()
def show(server: Server = None, token_file: TokenFile = None, as_json: AsJson = False) -> None:
    """Show the team, its members and its open invitations."""
    own = Door(client=make_client(server, token_file)).call("GET /teams/{team_id}", OWN)
    if as_json:
        print_json(own)
        return
    print_pairs({"team": own["name"], "state": _state(own), "open invitations": len(own["invitations"])})
    print()
    present = [member for member in own["members"] if member["left_at"] is None]
    print_rows(present, ("name", "role", "email", "has_password", "joined_at"), none="")


@app.command()
def brief(
    document: Annotated[Path, typer.Argument(callback=existing_file, help="The brief, as PDF.")],
    track: Annotated[str, typer.Option(help=HELPS["track"])],
    stage: Annotated[str, typer.Option(help=HELPS["stage"])],
    competition: Annotated[str | None, typer.Option(help=HELPS["competition"])] = None,
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Hand in the team's brief for a stage, in place of an earlier one; a committee reads it."""
    door = Door(client=make_client(server, token_file))
    place = {"competition": door.find_competition(competition), "track": track, "stage": stage}
    headers = {"Content-Type": "application/pdf"}
    with document.open("rb") as content:
        answer = door.client.send("PUT", f"{PREFIX}/briefs/own", headers=headers, params=place, content=content)
    received = decode(answer)
    if as_json:
        print_json(received)
    else:
        print_pairs({name: received[name] for name in ("team", "pages", "received_at", "sha256")})


@app.command()
def join(
    code: Annotated[str, typer.Argument(help="Code of the captain's invitation.")],
    name: Annotated[str, typer.Argument(help="Your name, for the team and the organizers.")],
    email: Annotated[str | None, typer.Option(help="Your e-mail address for notices.")] = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Join a team, print your token, which is shown only once, and store it for the other commands."""
    client = make_client(server, None, with_token=False)
    answer = Door(client=client).call("POST /teams/join", {"code": code, "name": name, "email": email})
    secret = answer["token"]["secret"]
    if as_json:
        print_json(answer)
    else:
        print_pairs({"team": answer["team"]["name"], "server": client.server, "token": secret})
    store_token(client.server, secret)


@app.command()
def email(
    member: MemberName,
    address: Annotated[str | None, typer.Argument(help="E-mail address; leave it out to get no e-mails.")] = None,
    server: Server = None,
    token_file: TokenFile = None,
) -> None:
    """Set the address to which your notices are sent."""
    _change_member(server, token_file, member, {"email": address})
    print(f"notices of {member}: {address or 'none'}")
    if address is not None:
        print("A code was sent there; `vitac team confirm-email` with it, and notices follow.")


@app.command()
def mute(member: MemberName, kinds: Kinds = None, server: Server = None, token_file: TokenFile = None) -> None:
    """Choose the notices that you do not want by e-mail; replaces the earlier choice."""
    muted = sorted(set(kinds or ()))
    _change_member(server, token_file, member, {"muted": muted})
    print(f"{member} gets no notices of: {', '.join(muted)}" if muted else f"{member} gets all notices")


@app.command()
def password(member: MemberName, server: Server = None, token_file: TokenFile = None) -> None:
    """Set your password; an empty one removes it.

    It is read from a prompt, or from the first line of standard input; the second line is the old one if you have one.
    """
    if sys.stdin.isatty():
        old = typer.prompt("Old password (empty if you have none)", hide_input=True, default="", show_default=False)
        given = typer.prompt("New password", hide_input=True, confirmation_prompt=True, default="", show_default=False)
    else:
        given, old = (sys.stdin.readline().rstrip("\n") for _ in range(2))
    _change_member(server, token_file, member, {"password": given or None, "old_password": old or None})
    print(f"{member} {'has a new' if given else 'has no'} password")


@app.command("renew-token")
def renew_token(
    member: MemberName, server: Server = None, token_file: TokenFile = None, as_json: AsJson = False
) -> None:
    """Replace your token: print and store a new one; the old one ends."""
    client = make_client(server, token_file)
    made = Door(client=client).call(f"POST {MEMBER}/token", OWN | {"member_id": member})
    if as_json:
        print_json(made)
    else:
        print_pairs({"token": made["secret"], "expires": made["expires_at"]})
    store_token(client.server, made["secret"])


def _change_member(server: str | None, token_file: Path | None, member: str, body: dict[str, object]) -> None:
    """Change a member by exactly this input, in which null takes something away."""
    client = make_client(server, token_file)
    door = Door(client=client)
    path = f"/api/v1/teams/{door.find_team(OWN_TEAM)}/members/{door.find_member(OWN_TEAM, member)}"
    client.call("PATCH", path, body)


def _state(team: dict[str, Any]) -> str:
    if team["disqualified_for"]:
        return f"disqualified: {team['disqualified_for']}"
    if team["refused_for"]:
        return f"refused: {team['refused_for']}"
    return "takes part" if team["approved_at"] else "waits until an organizer accepts it"
