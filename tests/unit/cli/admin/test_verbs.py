"""The verbs are made of the API as it is, and what is asked about is what happens, or nothing."""

import json
import sys
from pathlib import Path
from runpy import run_path
from typing import Any

import pytest
import typer
from cli_service import CliService
from service_factories import TASK, TRACK, make_principal, make_score, make_settings, submit_scored
from sqlalchemy.orm import Session
from vitac.cli.admin import competition, files
from vitac.cli.admin.app import app
from vitac.cli.admin.verbs import NOUNS
from vitac.cli.client import verbs
from vitac.cli.client.answers import RequestRefused
from vitac.cli.client.verbs import NOTHING_CHANGED, ConsentMissing, find_operation, require_consent
from vitac.server.accounts import teams
from vitac.server.api.app import API_PREFIX, create_app
from vitac.server.leaderboards.baselines import HUMAN
from vitac.server.principals import CONSOLE, Audience
from vitac.training.demonstrations.frames import DemonstrationDiffers
from vitac.training.demonstrations.hand_play import HandPlay

from competitions import make_competition, moved, open_now, put_in_place

ORGANIZERS = {Audience.ORGANIZERS, Audience.COMPETITION_ORGANIZERS}
BY_HAND = {
    competition.APPLY,
    files.HUMAN_BASELINE,
    files.STAGE_SUBMISSIONS,
    "GET /competitions/{competition}/results",
    "GET /leaderboards/{track}/receipts",
}


def test_operations_are_those_of_the_api(repository: Path) -> None:
    document = run_path(str(repository / "setup" / "describe_api.py"))["document"]
    text = (repository / "cli" / "client" / "operations.json").read_text()
    assert text == document(), "run .venv/bin/python setup/describe_api.py"


def test_everything_that_only_organizers_may_do_is_a_verb() -> None:
    paths = create_app(make_settings()).openapi()["paths"]
    routes = {
        f"{method.upper()} {path.removeprefix(API_PREFIX)}"
        for path, methods in paths.items()
        for method, route in methods.items()
        for needed in route.get("security", ())
        if path.startswith(API_PREFIX) and ORGANIZERS & set(needed["HTTPBearer"])
    }
    assert len(routes) > 50
    assert routes - {verb.operation for noun in NOUNS.values() for verb in noun.verbs} == BY_HAND


def test_a_script_gives_yes_to_every_verb_that_changes_something() -> None:
    for noun, group in typer.main.get_command(app).commands.items():  # type: ignore[attr-defined]
        for name, verb in getattr(group, "commands", {}).items():
            options = {option for parameter in verb.params for option in parameter.opts}
            assert "--dry-run" not in options or "--yes" in options, f"{noun} {name}"


def test_a_table_names_fields_that_there_are() -> None:
    for noun in NOUNS.values():
        for verb in noun.verbs:
            fields = {field.name for field in find_operation(verb.operation).fields}
            named = {
                *verb.fixed,
                *verb.usual,
                *(verb.only or ()),
                *verb.arguments,
                *verb.words,
                *verb.needed,
                *verb.parse,
            }
            assert named <= fields, verb.operation


def test_consent_is_needed_where_nobody_can_be_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    with pytest.raises(ConsentMissing, match="--yes"):
        require_consent("Cancel?", yes=False)
    require_consent("Cancel?", yes=True)


@pytest.fixture
def played(service: CliService) -> CliService:
    """A competition of one stage, over, with two scored teams and one prize."""
    content = make_competition(prizes=[{"place": "first", "amount": 2000}])
    del content["tracks"][TRACK]["stages"][1]
    with service.database.transaction() as session:
        put_in_place(session, open_now(content))
        for name, successes in (("Ants", 80), ("Bees", 78)):
            submit_scored(session, make_principal(session, name), name, {TASK: make_score(successes)})
        put_in_place(session, moved(content, days=-100))
    return service


def asked(service: CliService, monkeypatch: pytest.MonkeyPatch, *, meanwhile: Any = None, answer: bool = True) -> Any:
    """Ends the competition as somebody at a terminal; something may happen while they read."""

    def confirm(question: str, *, abort: bool) -> None:
        assert (question, abort) == ("End the competition with these winners?", True)
        if meanwhile is not None:
            with service.database.transaction() as session:
                meanwhile(session)
        if not answer:
            raise typer.Abort

    with monkeypatch.context() as patch:
        patch.setattr(typer, "confirm", confirm)
        patch.setattr(
            verbs, "sys", type("Terminal", (), {"stdin": type("", (), {"isatty": lambda: True}), "stderr": sys.stderr})
        )
        return service.run("admin", "results", "finalize")


def disqualify_ants(session: Session) -> None:
    teams.disqualify(session, CONSOLE, teams.find(session, "Ants"), "two accounts")


def test_what_was_shown_is_done_or_nothing(played: CliService, monkeypatch: pytest.MonkeyPatch) -> None:
    refused = asked(played, monkeypatch, answer=False)
    assert (refused.exit_code, "Ants" in refused.stdout) == (1, True)
    others = asked(played, monkeypatch, meanwhile=disqualify_ants)
    assert isinstance(others.exception, RequestRefused)
    assert "the winners became others, and nothing was done" in str(others.exception)
    done = asked(played, monkeypatch)
    assert (done.exit_code, "Bees" in done.stdout, "Ants" in done.stdout) == (0, True, False)
    assert NOTHING_CHANGED not in done.stderr
    (winner,) = json.loads(played.run("admin", "results", "winners", "--json").stdout)
    assert winner["team"] == "Bees"


def test_what_people_solve_by_hand_is_played_again_and_published(service: CliService, tmp_path: Path) -> None:
    played = HandPlay(TASK, tmp_path)
    with played.storing() as path:
        for looks in (False, True):
            played.begin()
            if looks:
                played.scene_mm()
            while played.end_reason is None:
                played.step([0.0, 0.0, 0.0])
    (felt, seen), folder = path.read_text().splitlines(keepends=True)[1:], str(path.parent)
    assert service.run("admin", "baseline", "publish", folder, "--dry-run", "--json").exit_code == 0
    published = json.loads(service.run("admin", "baseline", "publish", folder, "--json").stdout)
    assert published["measures"].keys() == {"surface_diff_mm"}
    assert (published["name"], published["episodes"]) == (HUMAN, 1), "who has looked at the scene did not play by touch"
    assert service.run("admin", "baseline", "remove", TRACK, TASK, "--yes").exit_code == 0
    head = path.read_text().splitlines(keepends=True)[0]
    path.write_text(head + seen)
    refused = service.run("admin", "baseline", "publish", folder)
    assert "no episode that was played by marker flow alone" in str(refused.exception)
    hashes = json.loads(felt)["state_hashes"]
    path.write_text(head + felt.replace(hashes[-1], hashes[0]))
    refused = service.run("admin", "baseline", "publish", folder)
    assert isinstance(refused.exception, DemonstrationDiffers)
