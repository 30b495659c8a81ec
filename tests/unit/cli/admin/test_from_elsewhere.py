"""A whole competition by `vitac admin --server`, from another folder, with nothing but an organizer's token."""

import json
import re
from datetime import timedelta
from pathlib import Path
from typing import Any
from uuid import UUID

import pytest
from cli_service import CliService, app_of, submission_folder
from service_factories import TASK, TRACK, complete_scored, make_score
from typer.testing import CliRunner
from vitac.server.accounts import tokens
from vitac.server.database.models import Submission
from vitac.server.database.states import Role
from vitac.server.principals import CONSOLE

from competitions import FIRST, SECOND, make_competition, moved, open_now, write_competition

CONCERN = re.compile(r"^WARNING: ([\w.]+): ", re.MULTILINE)


class Organizer:
    """Somebody at a laptop, who knows an address and has a token."""

    def __init__(self, address: str, token: str, home: Path) -> None:
        self._address, self._home = address, home
        self._environment = {"VITAC_TOKEN": token, "XDG_CONFIG_HOME": str(home), "COLUMNS": "200"}

    def run(self, *arguments: str) -> str:
        words = ["admin", "--server", self._address, *arguments]
        done = CliRunner().invoke(app_of("admin"), words, env=self._environment)
        assert done.exit_code == 0, (arguments, done.output, done.exception)
        return done.stderr if arguments[-1] == "--dry-run" else done.stdout

    def read(self, *arguments: str) -> Any:
        return json.loads(self.run(*arguments, "--json"))

    def apply(self, content: dict[str, Any]) -> None:
        """Looks at what a file changes, and applies it with all that it warns of."""
        file = str(write_competition(self._home, content))
        tried = self.run("competition", "apply", file, "--dry-run")
        confirmed = [word for name in CONCERN.findall(tried) for word in ("--confirm", name)]
        base = ["--base", tried.rpartition("--base ")[2].split(".")[0]] if "--base" in tried else []
        self.run("competition", "apply", file, "--yes", *base, *confirmed)


@pytest.fixture
def organizer(service: CliService, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Organizer:
    def no_machine(*_: object, **__: object) -> None:
        raise AssertionError("nothing of this needs the service's machine")

    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    monkeypatch.setattr("vitac.cli.service.database.open_service", no_machine)
    with service.database.transaction() as session:
        made = tokens.issue(session, CONSOLE, role=Role.ORGANIZER, label="laptop", lifetime=timedelta(days=1))
    return Organizer(service.address, made.secret, tmp_path / "elsewhere")


def play(service: CliService, folder: Path, token: str, successes: int) -> str:
    """A team submits, and gets a result as workers would give it."""
    done = service.run_with_input("", "submit", str(folder), "--json", token=token)
    assert done.exit_code == 0, (done.output, done.exception)
    submission = str(json.loads(done.stdout)["id"])
    with service.database.transaction() as session:
        complete_scored(session, session.get_one(Submission, UUID(submission)), {TASK: make_score(successes)})
    return submission


@pytest.mark.slow
def test_a_whole_competition_is_run_with_a_token_only(
    service: CliService, organizer: Organizer, tmp_path: Path
) -> None:
    content = open_now(make_competition(prizes=[{"place": "first", "amount": 1000}]))
    content["tracks"][TRACK]["stages"][1] |= {"qualified": {"top": 2}, "sealed": "at_once"}
    content["tracks"][TRACK]["judging"] = {
        "criteria": [{"name": "clarity", "title": "The words"}],
        "judges_at_least": 1,
        "weights": {"success": 0.5, "judges": 0.5, "figures": 0},
    }
    organizer.apply(content)
    assert organizer.read("competition", "show")["name"] == "cup"

    teams = {name: organizer.read("team", "add", name)["token"]["secret"] for name in ("Ants", "Bees", "Cats")}
    folders = {name: submission_folder(tmp_path / name) for name in teams}
    for name, folder in folders.items():
        (folder / "name").write_text(name)
    organizer.run("quota", "set", "Ants", "attempts_per_day", "7")
    organizer.run("token", "add", "--judge", "--label", "Prof. X")
    first = {name: play(service, folders[name], teams[name], 80 - 10 * number) for number, name in enumerate(teams)}
    assert {item["id"] for item in organizer.read("submission", "list")["items"]} == set(first.values())
    organizer.run("submission", "disqualify", first["Cats"], "--reason", "copied", "--yes")
    organizer.run("results", "freeze")
    organizer.run("results", "unfreeze", "--yes")
    (answered,) = organizer.read("evaluation", "list")[:1]
    assert organizer.read("evaluation", "show", answered["id"])["team"] in teams

    organizer.apply(open_now(content, stage=1))
    proposed = organizer.read("advance", "propose", TRACK, SECOND)["teams"]
    assert [team["team"] for team in proposed] == ["Ants", "Bees"]
    assert organizer.read("advance", "confirm", TRACK, SECOND, "--yes") == ["Ants", "Bees"]
    final = {name: play(service, folders[name], teams[name], 50) for name in ("Ants", "Bees")}

    organizer.apply(moved(content, days=-100))
    revealed = organizer.read("competition", "reveal", TRACK, SECOND, "--yes")
    assert organizer.read("competition", "lists")[0]["secret"] == revealed["secret"]
    for name, mark in (("Ants", "6"), ("Bees", "9")):
        organizer.run("judging", "mark", final[name], f"clarity={mark}", "--judge", "Prof. X")
    assert [team["team"] for team in organizer.read("judging", "show", TRACK)] == ["Bees", "Ants"]
    assert [winner["team"] for winner in organizer.read("results", "finalize", "--yes")] == ["Bees"]
    assert [winner["team"] for winner in organizer.read("results", "winners")] == ["Bees"]
    files = organizer.read("results", "publish", "results")
    assert sorted(path.rpartition("/")[2] for path in files) == sorted(
        ("certificates.html", "results.csv", "results.html", "results.json")
    )
    assert "Bees" in (tmp_path / "elsewhere" / "results" / "results.csv").read_text()
    organizer.run("receipt", "export", TRACK, "board.zip", "--stage", FIRST)
    organizer.run("announcement", "publish", "The end", "Bees win.", "--notify")
    written = {entry["actor"] for entry in organizer.read("audit", "list", "--limit", "10")}
    assert [actor for actor in written if actor.startswith("organizer:") and actor != "organizer:console"]
    assert "organizer:console" not in written
