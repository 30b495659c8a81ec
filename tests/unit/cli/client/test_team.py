import json

from cli_service import CliService
from service_factories import make_principal, make_secret
from vitac.server.principals import CONSOLE


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
    muted = service.run_with_input("", "team", "mute", "Ann", "deadline", "accepted", "accepted", token=secret)
    assert "Ann gets no notices of: accepted, deadline" in muted.stdout
    shown = json.loads(service.run("team", "show", "--json").stdout)["members"]
    assert [one["muted"] for one in shown] == [[], ["accepted", "deadline"]]
    assert "gets all notices" in service.run_with_input("", "team", "mute", "Ann", token=secret).stdout
    wrong = service.run_with_input("", "team", "mute", "Ann", "everything", token=secret)
    assert "Input should be 'accepted', 'finished'" in str(wrong.exception)
    members = json.loads(service.run("team", "show", "--json").stdout)["members"]
    assert [(one["email"], one["has_password"]) for one in members] == [(None, False), (None, True)]
    assert "is the captain" in service.run("team", "captain", "Ann").stdout
    assert "Captain is no longer" in service.run_with_input("", "team", "remove", "Captain", token=secret).stdout
    renewed = service.run_with_input("", "team", "renew-token", "Ann", token=secret)
    assert "vitac_" in renewed.stdout
    assert service.run_with_input("", "team", "show", token=secret).exit_code == 1


def test_webhooks_are_listed_added_and_removed(service: CliService) -> None:
    assert service.run("team", "webhook", "list").stdout == "No webhook.\n"
    inside = service.run("team", "webhook", "add", "http://127.0.0.1/hook")
    assert inside.exit_code == 1
    assert "https" in str(inside.exception)
    address = "https://team.example.org/hook"
    printed = service.run("team", "webhook", "add", address).stdout
    assert "shown only once" in printed
    made = json.loads(service.run("team", "webhook", "add", address, "--json").stdout)
    assert len(made["secret"]) == 64
    listed = json.loads(service.run("team", "webhook", "list", "--json").stdout)
    assert len(listed) == 2
    assert all("secret" not in hook and hook["address"] == address for hook in listed)
    assert listed[1]["id"] == made["id"]
    assert made["id"] in service.run("team", "webhook", "remove", made["id"]).stdout
    left = service.run("team", "webhook", "list").stdout
    assert listed[0]["id"] in left
    assert made["id"] not in left
    again = service.run("team", "webhook", "remove", made["id"])
    assert again.exit_code == 1
    assert "no webhook" in str(again.exception)
    assert service.run("team", "webhook", "remove", "mine").exit_code == 2
    with service.database.transaction() as session:
        organizer = make_secret(session, CONSOLE)
    nobody = service.run_with_input("", "team", "webhook", "list", token=organizer)
    assert "belongs to no team" in str(nobody.exception)


def test_what_is_not_there_is_named(service: CliService) -> None:
    missing = service.run("team", "captain", "Nobody")
    assert missing.exit_code == 1
    assert "has no member 'Nobody'" in str(missing.exception)
    with service.database.transaction() as session:
        organizer = make_secret(session, CONSOLE)
        make_principal(session, "Team B")
    nobody = service.run_with_input("", "team", "show", token=organizer)
    assert "belongs to no team" in str(nobody.exception)
