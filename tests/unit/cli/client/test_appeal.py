import json
from datetime import UTC, datetime
from uuid import uuid4

from cli_service import CliService, evaluated_submission
from service_factories import TASK, make_principal, make_secret, sha256
from vitac.server.database.models import AppealReplay
from vitac.server.database.states import WorkState


def test_an_appeal_is_opened_read_and_withdrawn_from_the_command_line(service: CliService) -> None:
    submission = str(evaluated_submission(service)[1])
    assert "No appeal." in service.run("appeal", "list").stdout
    of_episode = ("--task", TASK, "--episode", "3")
    made = json.loads(service.run("appeal", "open", submission, "Look again.", *of_episode, "--json").stdout)
    assert (made["state"], made["task"], made["episode"], made["text"]) == ("open", TASK, 3, "Look again.")
    number = str(made["id"])
    again = service.run("appeal", "open", submission, "Look again.")
    assert (again.exit_code, "open appeal against this evaluation" in str(again.exception)) == (1, True)
    assert "No episode was played again." in service.run("appeal", "show", number).stdout
    with service.database.transaction() as session:
        session.add(
            AppealReplay(
                appeal_id=int(number), task=TASK, episode=3, policy_sha256=sha256("x"), corrected=False,
                outcome="success", env_steps=3, same_states=True, old_outcome="success", old_env_steps=3,
                owner="appeal:1", requires="1 tactile", priority=2, state=WorkState.DONE, finished_at=datetime.now(UTC),
            )
        )  # fmt: skip
        other = make_secret(session, make_principal(session, "Team B"))
    shown = service.run("appeal", "show", number).stdout
    assert "same_states" in shown
    assert shown.count("success: The task was solved.") == 1
    (replay,) = json.loads(service.run("appeal", "show", number, "--json").stdout)["replays"]
    assert (replay["episode"], replay["same_states"]) == (3, True)
    for verb in ("show", "withdraw"):
        theirs = service.run_with_input("", "appeal", verb, number, token=other)
        assert (theirs.exit_code, "There is no appeal" in str(theirs.exception)) == (1, True)
    assert json.loads(service.run_with_input("", "appeal", "list", "--json", token=other).stdout) == []
    assert json.loads(service.run("appeal", "withdraw", number, "--json").stdout)["state"] == "withdrawn"
    assert "withdrawn already" in str(service.run("appeal", "withdraw", number).exception)
    assert "withdrawn" in service.run("appeal", "list").stdout


def test_what_cannot_be_appealed_against_is_said(service: CliService) -> None:
    assert "There is no submission" in str(service.run("appeal", "open", str(uuid4()), "Look again.").exception)
    assert service.run("appeal", "open", "no id", "Look again.").exit_code == 2
    assert service.run("appeal", "show", "0").exit_code == 2
    assert "There is no appeal" in str(service.run("appeal", "show", "4711").exception)
    assert service.run_with_input("", "appeal", "list", token=None).exit_code == 1
