"""An organizer makes one slip after the other in a competition of three teams, which is still right at its end."""

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from uuid import UUID

import pytest
from cli_service import CliService
from service_factories import TASK, TRACK, make_principal, make_score, submit_scored
from typer.testing import Result
from vitac.cli.client.answers import RequestRefused
from vitac.server.competitions.competition import Competition
from vitac.server.database.engine import Database
from vitac.server.errors import ProblemCode
from vitac.server.principals import Principal
from vitac.server.submissions import appeals

from competitions import FIRST, PUBLIC_RANKING, SECOND, sealed_competition, write_competition

DAY = timedelta(days=1)
APPLY = ("admin", "competition", "apply")
SCORES = {"Ants": 90, "Bees": 80, "Cats": 70}


def cup(first_closes: datetime, **changes: Any) -> dict[str, Any]:
    """Two stages: the first public, around now or over, the second a sealed final for the two best teams."""
    content = sealed_competition() | {"appeal_days": 30} | changes
    first, second = content["tracks"][TRACK]["stages"]
    first |= {"list": "public", "opens": (first_closes - 20 * DAY).isoformat(), "closes": first_closes.isoformat()}
    second |= {"opens": first_closes.isoformat(), "closes": (first_closes + 10 * DAY).isoformat()}
    second |= {"qualified": {"top": 2}, "sealed": "at_once"}
    content["tracks"][TRACK]["prizes"] = [{"place": "first", "amount": 1000}]
    return content


def refused(result: Result, code: ProblemCode) -> RequestRefused:
    assert isinstance(result.exception, RequestRefused), result.output
    assert result.exception.code == code, result.exception
    return result.exception


def revision(database: Database) -> str:
    with database.transaction() as session:
        return Competition.read(session).revision


def play(service: CliService, scores: dict[str, int], by: dict[str, Principal]) -> dict[str, UUID]:
    with service.database.transaction() as session:
        return {
            name: submit_scored(session, by[name], f"{name} {successes}", {TASK: make_score(successes)}).id
            for name, successes in scores.items()
        }


def move(service: CliService, tmp_path: Path, content: dict[str, Any]) -> None:
    """Time passes: all times of the competition are moved, which its organizer confirms."""
    file = str(write_competition(tmp_path, content))
    dry = service.run(*APPLY, file, "--dry-run")
    names = [line.split(": ")[1] for line in dry.stderr.splitlines() if line.startswith("WARNING: tracks.")]
    confirmed = [option for name in names for option in ("--confirm", name)]
    done = service.run(*APPLY, file, "--yes", "--base", revision(service.database), *confirmed)
    assert done.exit_code == 0, done.exception


@pytest.mark.slow
def test_a_competition_whose_organizer_slips_at_every_step_is_right_at_its_end(
    service: CliService, tmp_path: Path
) -> None:
    now = datetime.now(UTC)
    empty = tmp_path / "empty.yaml"
    empty.write_text("")
    assert "is empty, expected a document with the keys name" in str(service.run(*APPLY, str(empty), "--yes").exception)
    content = cup(now + DAY)
    file = str(write_competition(tmp_path, content))
    refused(service.run(*APPLY, file, "--yes"), ProblemCode.CONFIRMATION_NEEDED)  # teams advance by a public list
    assert service.run(*APPLY, file, "--yes", "--confirm", PUBLIC_RANKING).exit_code == 0
    base = revision(service.database)

    # Two organizers edit the same file; a stage is made public by mistake, and sealed again.
    (sealed,) = json.loads(service.run("admin", "competition", "lists", "--json").stdout)
    first = str(write_competition(tmp_path, content | {"title": "The first cup"}))
    assert service.run(*APPLY, first, "--yes", "--base", base).exit_code == 0
    second = str(write_competition(tmp_path, content | {"summary": "By touch."}))
    assert "The cup -> The first cup" in str(
        refused(service.run(*APPLY, second, "--yes", "--base", base), ProblemCode.CHANGED_MEANWHILE)
    )
    content |= {"title": "The first cup", "summary": "By touch."}
    public = json.loads(json.dumps(content))
    public["tracks"][TRACK]["stages"][1] |= {"list": "public", "sealed": None}
    file, place = str(write_competition(tmp_path, public)), f"tracks.{TRACK}.stages.{SECOND}.list"
    refused(service.run(*APPLY, file, "--yes", "--base", revision(service.database)), ProblemCode.CONFIRMATION_NEEDED)
    options = ("--yes", "--base", revision(service.database), "--confirm", place, "--confirm", f"tracks.{TRACK}.prizes")
    assert service.run(*APPLY, file, *options).exit_code == 0
    (withdrawn,) = json.loads(service.run("admin", "competition", "lists", "--json").stdout)
    assert (withdrawn["commitment"], withdrawn["withdrawn_at"] is not None) == (sealed["commitment"], True)
    move(service, tmp_path, content)
    (again,) = json.loads(service.run("admin", "competition", "lists", "--json").stdout)
    assert (again["commitment"], again["withdrawn_at"]) == (sealed["commitment"], None)

    # Teams submit; the closing time slips before their submissions, and the ranking rule is changed.
    with service.database.transaction() as session:
        by = {name: make_principal(session, name) for name in SCORES}
    early = play(service, SCORES, by)
    for slip, name in (
        (cup(now - DAY, title="The first cup", summary="By touch."), f"tracks.{TRACK}.stages.{FIRST}.closes"),
        (content | {"appeal_days": 1}, "appeal_days"),
    ):
        error = refused(
            service.run(*APPLY, str(write_competition(tmp_path, slip)), "--yes", "--base", revision(service.database)),
            ProblemCode.CONFIRMATION_NEEDED,
        )
        assert name in str(error)

    # The wrong submission is disqualified, and reinstated; two confirm who advances.
    disqualify = ("admin", "submission", "disqualify", str(early["Ants"]), "--reason", "copied", "--yes")
    assert service.run(*disqualify).exit_code == 0
    move(service, tmp_path, cup(now - DAY, title="The first cup", summary="By touch."))
    confirm = ("admin", "advance", "confirm", TRACK, SECOND, "--yes")
    assert json.loads(service.run(*confirm, "--json").stdout) == ["Bees", "Cats"]
    assert service.run("admin", "submission", "reinstate", str(early["Ants"]), "--yes").exit_code == 0
    error = refused(service.run(*confirm), ProblemCode.CHANGED_MEANWHILE)
    assert "add Ants and remove Cats" in str(error)
    assert service.run(*confirm, "--base", str(error).rpartition("--base ")[2].split(".")[0]).exit_code == 0

    # The final is played, its secret published, and its file would open it again.
    final = play(service, {"Ants": 60, "Bees": 75}, by)
    over = cup(now - 20 * DAY, title="The first cup", summary="By touch.")
    move(service, tmp_path, over)
    assert service.run("admin", "competition", "reveal", TRACK, SECOND, "--yes").exit_code == 0
    reopened = str(write_competition(tmp_path, cup(now - DAY, title="The first cup", summary="By touch.")))
    error = refused(
        service.run(*APPLY, reopened, "--yes", "--base", revision(service.database)), ProblemCode.STAGE_IN_USE
    )
    assert "never opens again" in str(error)

    # It is ended while an appeal is open; the appeal was right, so the end is taken back.
    with service.database.transaction() as session:
        appeal = appeals.open_appeal(session, by["Ants"], final["Ants"], "It was in the hole.").id
    finalize = ("admin", "results", "finalize", "--yes")
    error = refused(service.run(*finalize), ProblemCode.CONFIRMATION_NEEDED)
    assert "open_appeals" in str(error)
    assert "appeal_time" in str(error)
    confirmed = ("--confirm", "open_appeals", "--confirm", "appeal_time")
    assert service.run(*finalize, *confirmed).exit_code == 0
    with service.database.transaction() as session:
        assert appeals.find(session, by["Ants"], appeal).state == "rejected"
    assert service.run("admin", "results", "reopen", "--reason", "an appeal was right", "--yes").exit_code == 0
    done = service.run(*finalize, "--confirm", "appeal_time", "--json")
    assert [(winner["team"], winner["success_rate"]) for winner in json.loads(done.stdout)] == [("Bees", 0.375)]
    with service.database.transaction() as session:
        boards = {board["stage"]: board["entries"] for board in Competition.read(session).row.boards or ()}
    assert [entry["team"] for entry in boards[FIRST]] == ["Ants", "Bees", "Cats"]
    assert [entry["team"] for entry in boards[SECOND]] == ["Bees", "Ants"]
