import json

import pytest
from cli_service import CliService
from service_factories import TASK, TRACK, make_principal, make_score, outdate, submit_scored
from vitac.cli.client.answers import RequestRefused
from vitac.server.errors import ProblemCode

from competitions import SECOND, make_competition, open_now, put_in_place


@pytest.fixture
def played(service: CliService) -> CliService:
    """Two scored teams, a place in the second stage for one."""
    with service.database.transaction() as session:
        put_in_place(session, open_now(make_competition()))
        for name, successes in (("Ants", 80), ("Bees", 78)):
            submit_scored(session, make_principal(session, name), name, {TASK: make_score(successes)})
        put_in_place(session, open_now(make_competition(), stage=1))
    return service


def test_a_proposal_is_shown_and_confirmed_with_the_organizers_own_choice_and_by_one_of_two(played: CliService) -> None:
    shown = played.run("admin", "advance", "propose", TRACK, SECOND).stdout
    assert "the best team of the stage before, by the board of stage1" in shown
    assert shown.count("at the border") == 2
    found = json.loads(played.run("admin", "advance", "propose", TRACK, SECOND, "--json").stdout)
    assert [(team["team"], team["advances"]) for team in found["teams"]] == [("Ants", True), ("Bees", False)]
    arguments = ("admin", "advance", "confirm", TRACK, SECOND)
    assert played.run(*arguments, "--dry-run").stdout.strip() == "stage2 of track_1: Ants"
    assert "Nobody was confirmed." in played.run("admin", "advance", "list", TRACK, SECOND).stdout
    confirm = (*arguments, "--yes")
    assert json.loads(played.run(*confirm, "--json").stdout) == ["Ants"]
    base = played.run("admin", "advance", "list", TRACK, SECOND).stderr.split()[-1]
    assert played.run(*confirm, "--add", "bees", "--without", "Ants", "--base", base).exit_code == 0
    for made_from in ((), ("--base", base)):
        refused = played.run(*confirm, *made_from)
        assert isinstance(refused.exception, RequestRefused)
        assert refused.exception.code == ProblemCode.CHANGED_MEANWHILE
        assert "Yours would add Ants and remove Bees" in str(refused.exception)
    assert played.run(*confirm, "--add", "Bees", "--without", "Ants").exit_code == 0, "it changes nothing"
    assert json.loads(played.run("admin", "advance", "list", TRACK, SECOND, "--json").stdout) == ["Bees"]


def test_a_stage_without_any_team_and_results_of_another_version_are_warned_of(played: CliService) -> None:
    arguments = ("admin", "advance", "confirm", TRACK, SECOND, "--without", "Ants")
    for way in ("--dry-run", "--yes"):
        done = played.run(*arguments, way, "--json")
        assert (done.exit_code, json.loads(done.stdout)) == (0, [])
        assert "WARNING: no team takes part in stage2 of track_1" in done.stderr
    assert played.run("admin", "advance", "confirm", TRACK, SECOND, "--yes").stderr == ""
    with played.database.transaction() as session:
        outdate(session)
    shown = played.run("admin", "advance", "propose", TRACK, SECOND).stdout
    assert "No team is ranked in stage1." in shown
    assert "made by another evaluator version: Ants, Bees" in shown
