"""Every command of participants, with the real answers of a service that says more than this release reads.

Those of organizers are in `admin/test_audit` and `admin/test_from_elsewhere`.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
import typer
from cli_service import CliService, evaluated_submission, submission_folder
from gates import gate
from sqlalchemy import select
from vitac.cli.client.http import Client
from vitac.cli.main import NOUNS, build_app
from vitac.server.accounts import tokens
from vitac.server.database.models import Member

from competitions import make_competition, open_now, put_in_place

BESIDE = {"receipt audit", "witness run"}
"""Take the address of a service as an argument."""


class Story:
    """Runs commands, each as a person reads it, and reads as a program does too; remembers which."""

    def __init__(self, service: CliService) -> None:
        self.service = service
        self.told: set[str] = set()

    def run(self, command: str, *arguments: str, given: str = "", token: str | None = "") -> str:
        done = self.service.run_with_input(given, *command.split(), *arguments, token=token)
        assert done.exit_code == 0, (command, done.output, done.exception)
        self.told.add(command)
        return done.stdout

    def be_refused(self, command: str, *arguments: str) -> str:
        done = self.service.run_with_input("", *command.split(), *arguments)
        assert done.exit_code == 1, (command, done.output, done.exception)
        self.told.add(command)
        return str(done.exception)

    def read(self, command: str, *arguments: str, token: str | None = "") -> Any:
        self.run(command, *arguments, token=token)
        return json.loads(self.run(command, *arguments, "--json", token=token))


def commands_of_a_service() -> Iterator[str]:
    def walk(name: str, command: Any) -> Iterator[str]:
        if isinstance(command, typer.core.TyperGroup):
            for verb, inner in command.commands.items():
                yield from walk(f"{name} {verb}", inner)
        elif "server" in {param.name for param in command.params}:
            yield name

    for noun in (noun for noun in NOUNS if noun.name != "admin"):
        app = typer.main.get_command(build_app([noun.name]))
        assert isinstance(app, typer.core.TyperGroup)
        yield from walk(noun.name, app.commands[noun.name])


def say_more(value: Any, *, within: bool = True) -> Any:
    """The same JSON with a key more in each object."""
    if isinstance(value, list):
        return [say_more(each, within=within) for each in value]
    if not isinstance(value, dict):
        return value
    inner = {name: say_more(each) for name, each in value.items()} if within else value
    return inner | {"said_since_the_next_release": {"and": ["more"]}}


@contextmanager
def newer_service(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    send = Client.send

    def sent(self: Client, method: str, path: str, **arguments: Any) -> httpx.Response:
        answer = send(self, method, path, **arguments)
        if answer.headers.get("content-type") != "application/json":
            return answer
        is_signed = path.endswith(("/receipts", "/arrival"))  # what is signed stays as it is
        content = say_more(answer.json(), within=not is_signed)
        headers = {
            name: text for name, text in answer.headers.items() if name not in {"content-length", "content-encoding"}
        }
        return httpx.Response(answer.status_code, headers=headers, json=content, request=answer.request)

    with monkeypatch.context() as patch:
        patch.setattr(Client, "send", sent)
        yield


def tell(story: Story, folder: Path) -> None:
    service = story.service
    token = service.environment["VITAC_TOKEN"]
    story.run("login", given=f"{token}\n", token=None)
    story.read("whoami")
    story.run("logout")
    story.read("status")
    with service.playing():
        submitted = json.loads(story.run("submit", str(submission_folder(folder / "mine")), "--watch", "--json"))
        story.run("submit", str(folder / "mine"))
        story.run("status", submitted["id"], "--watch")
    tell_of_a_policy_that_dials_in(story, folder)
    first = submitted["id"]
    tell_of_receipts(story, first, folder / "witness")
    second = str(evaluated_submission(service)[1])
    story.read("status")
    assert story.read("status", first)["evaluation"]["state"] == "completed"
    assert story.read("compare", first, second)["pairs"][0]["episodes"] > 0
    assert story.read("leaderboard", "track_1")["entries"]
    story.read("publish", first)
    story.read("describe", first, "--text", "Ours.")
    assert "plays none" in story.be_refused("choose", first), "its stage has no final list"
    story.read("withdraw", second)
    story.read("withdraw", second, "--undo")
    appeal = str(json.loads(story.run("appeal open", second, "Look again.", "--json"))["id"])
    story.read("appeal show", appeal)
    story.read("appeal list")
    story.run("appeal withdraw", appeal)
    story.run("question ask", "When?", "--public")
    story.read("question list")
    tell_of_team(story)
    tell_of_a_brief(story, folder / "brief.pdf")
    story.run("logout")
    story.run("register", "Newcomers", token=None)
    assert set(commands_of_a_service()) | BESIDE == story.told


def tell_of_a_policy_that_dials_in(story: Story, folder: Path) -> None:
    manifest = "track: track_1\ntasks: [peg-insertion]\nname: far\nremote: {protocol: openpi, address: connect}\n"
    arguments = (str(submission_folder(folder / "far", manifest)), "--remote", "ws://127.0.0.1:1")
    with gate(find=lambda _: "Team A") as (policies, _):
        assert "no gate" in story.be_refused("remote connect", *arguments, "--gate", policies)


def tell_of_a_brief(story: Story, document: Path) -> None:
    now = datetime.now(UTC)
    times = {"opens": (now - timedelta(days=1)).isoformat(), "closes": (now + timedelta(days=1)).isoformat()}
    stage = {"name": "brief", "title": "Brief", "brief": {"min_pages": 1}, **times}
    content = open_now(make_competition())
    content["tracks"]["robots"] = {"title": "Robots", "taken_here": False, "stages": [stage]}
    with story.service.database.transaction() as session:
        put_in_place(session, content)
    document.write_bytes(b"%PDF-1.4 1 0 obj << /Type /Page >> endobj")
    assert story.read("team brief", str(document), "--track", "robots", "--stage", "brief")["pages"] == 1


def tell_of_receipts(story: Story, submission: str, folder: Path) -> None:
    witness = ("--folder", str(folder), "--name", "ants.example/v")
    key = story.service.run("witness", "key", *witness).stdout.strip()
    with story.service.database.transaction() as session:
        put_in_place(session, open_now(make_competition(witnesses=[key])))
    story.run("witness run", story.service.address, "--once", *witness)
    assert list(story.read("receipt verify", submission)["witnessed"]) == ["ants.example/v"]
    story.read("receipt fetch", submission, "--to", str(folder))
    story.read("receipt audit", story.service.address)


def tell_of_team(story: Story) -> None:
    story.read("team show")
    json.loads(story.run("team data"))
    hook = json.loads(story.run("team webhook add", "https://team.example.org/hook", "--json"))["id"]
    story.read("team webhook list")
    story.run("team webhook remove", hook)
    code = story.read("team invite")["code"]
    ann = json.loads(story.run("team join", code, "Ann", "--json"))["token"]["secret"]
    story.run("team password", "Ann", given="a good password\n", token=ann)
    story.run("team mute", "Ann", "deadline", token=ann)
    story.run("team email", "Ann", "ann@example.org", token=ann)
    with story.service.database.transaction() as session:
        session.scalars(select(Member).where(Member.name == "Ann")).one().email_code_sha256 = tokens.hash_secret("sent")
    story.run("team confirm-email", "Ann", "sent", token=ann)
    story.run("team captain", "Ann")
    story.run("team remove", "Captain", token=ann)
    story.run("team renew-token", "Ann", token=ann)


@pytest.mark.slow
def test_every_command_reads_what_a_newer_service_answers(
    service: CliService, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with newer_service(monkeypatch):
        tell(Story(service), tmp_path)
