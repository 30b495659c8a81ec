import json

from cli_service import CliService
from service_factories import make_principal, make_secret
from vitac.server.accounts.principals import CONSOLE


def test_a_team_is_run_from_the_command_line(service: CliService) -> None:
    shown = service.run("team", "show").stdout
    assert "takes part" in shown
    assert "Captain" in shown
    assert json.loads(service.run("team", "data").stdout)["team"]["name"] == "Team A"
    code = json.loads(service.run("team", "invite", "--json").stdout)["code"]
    assert code.startswith("vitac-join-")
    joined = json.loads(service.run("team", "join", code, "Ann", "--email", "ann@example.org", "--json").stdout)
    secret = joined["token"]["secret"]
    ann = service.run_with_input("", "team", "show", "--json", token=secret)
    assert [one["name"] for one in json.loads(ann.stdout)["members"]] == ["Captain", "Ann"]
    assert service.run_with_input("a good password\n", "team", "password", "Ann", token=secret).exit_code == 0
    assert "notices of ann: none" in service.run_with_input("", "team", "email", "ann", token=secret).stdout
    members = json.loads(service.run("team", "show", "--json").stdout)["members"]
    assert [(one["email"], one["has_password"]) for one in members] == [(None, False), (None, True)]
    assert "is the captain" in service.run("team", "captain", "Ann").stdout
    assert "Captain is no longer" in service.run_with_input("", "team", "remove", "Captain", token=secret).stdout
    renewed = service.run_with_input("", "team", "renew-token", "Ann", token=secret)
    assert "vitac_" in renewed.stdout
    assert service.run_with_input("", "team", "show", token=secret).exit_code == 1


def test_what_is_not_there_is_named(service: CliService) -> None:
    missing = service.run("team", "captain", "Nobody")
    assert missing.exit_code == 1
    assert "has no member 'Nobody'" in str(missing.exception)
    with service.database.transaction() as session:
        organizer = make_secret(session, CONSOLE)
        make_principal(session, "Team B")
    nobody = service.run_with_input("", "team", "show", token=organizer)
    assert "belongs to no team" in str(nobody.exception)
