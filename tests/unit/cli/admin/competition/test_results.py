import json
import sys
from pathlib import Path
from typing import Any

import pytest
import typer
from cli_service import CliService
from service_factories import TASK, TRACK, make_principal, make_score, submit_scored
from sqlalchemy.orm import Session
from vitac.cli.client import verbs
from vitac.cli.client.answers import RequestRefused
from vitac.cli.client.verbs import NOTHING_CHANGED, ConsentMissing
from vitac.server.accounts import teams
from vitac.server.principals import CONSOLE

from competitions import make_competition, moved, open_now, put_in_place


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


def test_boards_are_frozen_and_unfrozen_files_published_and_the_end_comes_once(
    played: CliService, tmp_path: Path
) -> None:
    assert json.loads(played.run("admin", "results", "freeze", "--dry-run", "--json").stdout) == {"frozen": True}
    assert played.run("admin", "results", "freeze").stdout.strip() == "boards are frozen"
    assert played.run("admin", "results", "unfreeze", "--dry-run").stdout.strip() == "boards show all results"
    assert json.loads(played.run("admin", "results", "unfreeze", "--yes", "--json").stdout) == {"frozen": False}
    folder = tmp_path / "published"
    written = json.loads(played.run("admin", "results", "publish", str(folder), "--json").stdout)
    assert sorted(Path(path).name for path in written) == sorted(path.name for path in folder.iterdir())
    assert played.run("admin", "results", "publish", str(folder)).exit_code == 1, "into a new folder only"
    shown = played.run("admin", "results", "winners").stdout
    assert ("Ants" in shown, "Bees" in shown) == (True, False)
    done = played.run("admin", "results", "finalize", "--yes", "--json")
    assert [winner["team"] for winner in json.loads(done.stdout)] == ["Ants"]
    again = played.run("admin", "results", "finalize", "--yes")
    assert isinstance(again.exception, RequestRefused)
    assert "has been final since" in str(again.exception)


@pytest.mark.slow
def test_a_final_result_is_decided_again_without_a_team_that_was_disqualified(
    played: CliService, tmp_path: Path
) -> None:
    results = ("admin", "results")
    early = played.run(*results, "finalize", "--again", "--yes")
    assert "is not final yet" in str(early.exception)
    assert played.run("admin", "team", "disqualify", "Bees", "--reason", "late", "--yes").stderr == ""
    played.run("admin", "team", "reinstate", "Bees", "--yes")
    played.run(*results, "finalize", "--yes")
    disqualify = ("admin", "team", "disqualify", "Ants", "--reason", "two accounts")
    tried = played.run(*disqualify, "--dry-run")
    assert (tried.exit_code, "struck through" in tried.stderr) == (0, True)
    out = played.run(*disqualify, "--yes")
    assert "WARNING: the results are final: a disqualified Ants is struck through there" in out.stderr
    kept = played.run(*results, "winners")
    assert "Ants" in kept.stdout
    assert "WARNING: disqualified after the end: Ants." in kept.stderr
    refused = played.run(*results, "publish", str(tmp_path / "published"))
    assert "finalize --again" in str(refused.exception)
    assert not (tmp_path / "published").exists()
    assert isinstance(played.run(*results, "finalize", "--again").exception, ConsentMissing)
    for way in ("--dry-run", "--yes"):
        done = played.run(*results, "finalize", "--again", way, "--json")
        assert [winner["team"] for winner in json.loads(done.stdout)] == ["Bees"]
    assert played.run(*results, "winners").stderr == ""
    assert played.run(*results, "publish", str(tmp_path / "published")).exit_code == 0


def test_an_end_without_winners_is_warned_of(played: CliService) -> None:
    assert "WARNING" not in played.run("admin", "results", "finalize", "--dry-run").stderr
    with played.database.transaction() as session:
        for name in ("Ants", "Bees"):
            teams.disqualify(session, CONSOLE, teams.find(session, name), "two accounts")
    for way in ("--dry-run", "--yes"):
        done = played.run("admin", "results", "finalize", way)
        assert (done.exit_code, done.stdout.strip()) == (0, "Nobody wins.")
        assert "WARNING: track_1: nobody wins 1 x first.\n" in done.stderr


def test_each_prize_without_a_winner_is_named(played: CliService) -> None:
    content = make_competition(prizes=[{"place": place, "amount": 1, "winners": 2} for place in ("first", "second")])
    del content["tracks"][TRACK]["stages"][1]
    content["tracks"]["track_2"] = content["tracks"][TRACK] | {"taken_here": False}
    with played.database.transaction() as session:
        put_in_place(session, moved(content, days=-20000))
    for verb in (("winners",), ("finalize", "--dry-run")):
        done = played.run("admin", "results", *verb)
        assert done.stderr.splitlines()[-2:] == [
            "WARNING: track_1: nobody wins 2 x second.",
            "WARNING: track_2: nobody wins 2 x first, 2 x second; this service does not hold the track.",
        ]
        assert done.stdout.count("first") == 2
    content["tracks"] = {TRACK: content["tracks"][TRACK] | {"prizes": []}}
    with played.database.transaction() as session:
        put_in_place(session, moved(content, days=0))
    assert "the competition has no prizes" in played.run("admin", "results", "finalize", "--yes").stderr


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
