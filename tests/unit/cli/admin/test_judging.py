import json

from cli_service import CliService
from service_factories import TASK, TRACK, make_principal, make_score, submit_scored
from vitac.cli.client.answers import RequestRefused

from competitions import make_competition, open_now, put_in_place


def test_an_organizer_writes_down_what_judges_say(service: CliService) -> None:
    content = make_competition()
    content["tracks"][TRACK]["judging"] = {
        "criteria": [{"name": "clarity", "title": "The words"}],
        "weights": {"success": 0.5, "judges": 0.5, "figures": 0},
    }
    with service.database.transaction() as session:
        put_in_place(session, open_now(content))
        submission = submit_scored(session, make_principal(session, "Ants"), "Ants", {TASK: make_score(80)})
    shown = service.run("admin", "judging", "rubric", TRACK).stdout
    assert "weights: success 0.5, judges 0.5, figures 0; at least 2 judges" in shown
    assert service.run("admin", "token", "add", "--judge", "--label", "Prof. X").exit_code == 0
    for judge, mark in (("Prof. X", "8"), ("Dr. Y", "6.5")):
        given = ("admin", "judging", "mark", str(submission.id), f"clarity={mark}", "--judge", judge)
        for option in ("--dry-run", "--json"):
            done = service.run(*given, option)
            assert done.exit_code == 0, done.exception
            assert ("no judge with a token is named 'Dr. Y'" in done.stderr) == (judge == "Dr. Y")
            (team,) = json.loads(service.run("admin", "judging", "show", TRACK, "--json").stdout)
            assert (judge in team["judges"]) == (option == "--json")
        assert json.loads(done.stdout) == {"judge": judge, "has_token": judge == "Prof. X"}
    (team,) = json.loads(service.run("admin", "judging", "show", TRACK, "--json").stdout)
    assert (team["mark"], team["judges"], team["total"]) == (7.25, ["Dr. Y", "Prof. X"], 0.5 * 0.4 + 0.5 * 0.725)
    unshown = service.run("admin", "judging", "mark", str(submission.id), "clarity=1", "--judge", "x" * 500)
    assert isinstance(unshown.exception, RequestRefused)
    wrong = service.run("admin", "judging", "mark", str(submission.id), "clarity", "--judge", "X")
    assert wrong.exit_code == 2
    conflict = ("admin", "judging", "conflict", "Ants", "--judge", "Dr. Y", "--reason", "friend")
    assert service.run(*conflict, "--dry-run").stdout.strip() == "Dr. Y does not judge Ants"
    (team,) = json.loads(service.run("admin", "judging", "show", TRACK, "--json").stdout)
    assert (team["judges"], team["conflicts"]) == (["Dr. Y", "Prof. X"], [])
    assert "no judge with a token is named 'Dr. Y'" in service.run(*conflict, "--dry-run").stderr
    noted = json.loads(service.run(*conflict, "--json").stdout)
    assert noted == {"judge": "Dr. Y", "has_token": False}
    assert "Dr. Y" in service.run("admin", "judging", "show", TRACK).stdout
    refused = service.run("admin", "judging", "mark", str(submission.id), "clarity=1", "--judge", "Dr. Y")
    assert isinstance(refused.exception, RequestRefused)
