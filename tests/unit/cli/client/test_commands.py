import json
import re
from pathlib import Path

from cli_service import CliService, cli_service, submission_folder
from service_factories import TRACK
from vitac.cli.client.account import LoggedIn
from vitac.cli.client.answers import RequestRefused

from competitions import make_competition, open_now, put_in_place

INVITE = "come and see"


def kept(service: CliService) -> Path:
    return Path(service.environment["XDG_CONFIG_HOME"]) / "vitac" / "credentials.json"


def run(service: CliService, *arguments: str, given: str = "") -> str:
    """Runs a command without a token in the environment, and returns what it prints."""
    done = service.run_with_input(given, *arguments, token=None)
    assert done.exit_code == 0, (done.output, done.exception)
    return done.stdout


def test_from_no_token_to_a_submission_with_two_commands(service: CliService, tmp_path: Path) -> None:
    folder = submission_folder(tmp_path / "mine")
    refused = service.run_with_input("", "submit", str(folder), token=None)
    assert "vitac register" in str(refused.exception)
    assert "Newcomers" in run(service, "register", "Newcomers", "--contact", "a@example.org")
    submitted = json.loads(run(service, "submit", str(folder), "--json"))
    assert submitted["team"]["name"] == "Newcomers"
    before = kept(service).read_text()
    refused = service.run_with_input("", "register", "Others", token=None)
    assert isinstance(refused.exception, LoggedIn)
    assert kept(service).read_text() == before
    assert json.loads(service.run("whoami", "--json").stdout)["team"]["name"] == "Team A", "the environment wins"
    with cli_service(tmp_path / "other") as other:
        other.environment["XDG_CONFIG_HOME"] = service.environment["XDG_CONFIG_HOME"]
        assert "missing_credentials" in str(other.run_with_input("", "whoami", token=None).exception)
    service.environment["VITAC_SERVER"] = ""  # that of the last login is meant
    assert "Newcomers" in run(service, "whoami")


def test_login_keeps_a_good_token_and_logout_forgets_it(service: CliService) -> None:
    token = service.environment["VITAC_TOKEN"]
    assert "as Team A" in run(service, "login", given=f"{token}\n")
    assert "Team A" in run(service, "whoami")
    assert "logged out" in run(service, "logout")
    assert isinstance(service.run_with_input("", "whoami", token=None).exception, RequestRefused)
    assert "not logged in" in run(service, "logout")
    assert "as Team A" in run(service, "login", given=f"{token}\n")


def test_login_keeps_nothing_of_a_wrong_token_and_a_broken_file_of_tokens_is_named(
    service: CliService, tmp_path: Path
) -> None:
    wrong = tmp_path / "token"
    wrong.write_text("vitac_" + "x" * 43)
    refused = service.run_with_input("", "login", "--token-file", str(wrong), token=None)
    assert isinstance(refused.exception, RequestRefused)
    assert not kept(service).exists()
    kept(service).parent.mkdir(parents=True, exist_ok=True)
    kept(service).write_text("[]")
    assert str(kept(service)) in str(service.run_with_input("", "whoami", token=None).exception)


def test_logout_can_end_the_token_for_good(service: CliService) -> None:
    token = run(service, "register", "Newcomers", "--json")
    secret = json.loads(token)["token"]["secret"]
    run(service, "logout", "--revoke")
    refused = service.run_with_input(f"{secret}\n", "login", token=None)
    assert "revoked" in str(refused.exception)


def test_whoami_shows_quotas_also_of_an_open_stage(service: CliService) -> None:
    shown = service.run("whoami").stdout
    for word in ("Team A", "tokens", "20", "attempts_per_day"):
        assert word in shown
    assert "stage1" not in shown
    content = make_competition()
    content["tracks"][TRACK]["stages"][0]["quotas"] = {"attempts": 7}
    with service.database.transaction() as session:
        put_in_place(session, open_now(content))
    shown = service.run("whoami").stdout
    assert re.search(r"track_1 +stage1 +attempts +7 +0 ", shown), shown
    (of_runs, _) = json.loads(service.run("whoami", "--json").stdout)["stage_quotas"]
    assert (of_runs["quota"], of_runs["limit"], of_runs["used"]) == ("scored_runs", None, 0)


def test_registration_by_invite_needs_the_code(tmp_path: Path) -> None:
    with cli_service(tmp_path / "state", registration="invite", invite_code=INVITE) as service:
        for wrong in ([], ["--invite", "something else"], ["--invite", ""]):
            refused = service.run_with_input("", "register", "Newcomers", *wrong, token=None)
            assert "invite_required" in str(refused.exception)
            assert "--invite" in str(refused.exception)
        assert "Newcomers" in run(service, "register", "Newcomers", "--invite", INVITE)
