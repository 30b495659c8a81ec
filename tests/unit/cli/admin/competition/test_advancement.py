import json

import pytest
from cli_service import CliService
from service_factories import TASK, TRACK, make_principal, make_score, outdate, submit_scored
from vitac.cli.client.answers import RequestRefused
from vitac.cli.client.verbs import ConsentMissing
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


def confirmed(service: CliService) -> object:
    return json.loads(service.run("admin", "advance", "list", TRACK, SECOND, "--json").stdout)


def test_a_proposal_names_rule_teams_and_border(played: CliService) -> None:
    shown = played.run("admin", "advance", "propose", TRACK, SECOND).stdout
    assert "the best team of the stage before, by the board of stage1" in shown
    assert shown.count("at the border") == 2
    found = json.loads(played.run("admin", "advance", "propose", TRACK, SECOND, "--json").stdout)
    assert [(team["team"], team["advances"]) for team in found["teams"]] == [("Ants", True), ("Bees", False)]


def test_nobody_is_confirmed_without_consent_or_in_a_dry_run(played: CliService) -> None:
    arguments = ("admin", "advance", "confirm", TRACK, SECOND)
    assert isinstance(played.run(*arguments).exception, ConsentMissing)
    dry = played.run(*arguments, "--dry-run")
    assert (dry.exit_code, dry.stdout.strip()) == (0, "stage2 of track_1: Ants")
    assert confirmed(played) == []
    assert "Nobody was confirmed." in played.run("admin", "advance", "list", TRACK, SECOND).stdout


def test_the_proposal_and_the_organizers_own_choice_are_confirmed(played: CliService) -> None:
    arguments = ("admin", "advance", "confirm", TRACK, SECOND, "--yes")
    assert json.loads(played.run(*arguments, "--json").stdout) == ["Ants"]
    base = played.run("admin", "advance", "list", TRACK, SECOND).stderr.split()[-1]
    assert played.run(*arguments, "--add", "bees", "--without", "Ants", "--base", base).exit_code == 0
    assert confirmed(played) == ["Bees"]


def test_the_second_of_two_who_confirm_from_the_same_list_is_refused_with_the_difference(played: CliService) -> None:
    arguments = ("admin", "advance", "confirm", TRACK, SECOND, "--yes")
    assert played.run(*arguments).exit_code == 0
    base = played.run("admin", "advance", "list", TRACK, SECOND).stderr.split()[-1]
    assert played.run(*arguments, "--add", "Bees", "--base", base).exit_code == 0
    for made_from in ((), ("--base", base)):
        refused = played.run(*arguments, *made_from)
        assert isinstance(refused.exception, RequestRefused)
        assert refused.exception.code == ProblemCode.CHANGED_MEANWHILE
        assert "Yours would add nobody and remove Bees" in str(refused.exception)
    assert confirmed(played) == ["Ants", "Bees"]
    assert played.run(*arguments, "--add", "Bees").exit_code == 0, "it changes nothing"


def test_results_of_another_version_are_named(played: CliService) -> None:
    with played.database.transaction() as session:
        outdate(session)
    shown = played.run("admin", "advance", "propose", TRACK, SECOND).stdout
    assert "No team is ranked in stage1." in shown
    assert "made by another evaluator version: Ants, Bees" in shown


def test_a_stage_without_any_team_is_warned_of(played: CliService) -> None:
    arguments = ("admin", "advance", "confirm", TRACK, SECOND, "--without", "Ants")
    for way in ("--dry-run", "--yes"):
        done = played.run(*arguments, way, "--json")
        assert (done.exit_code, json.loads(done.stdout)) == (0, [])
        assert "WARNING: no team takes part in stage2 of track_1" in done.stderr
    assert played.run("admin", "advance", "confirm", TRACK, SECOND, "--yes").stderr == ""
