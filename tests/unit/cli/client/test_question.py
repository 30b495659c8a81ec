import json
from pathlib import Path
from uuid import uuid4

from cli_service import CliService
from service_factories import make_principal, make_secret
from vitac.server.accounts import messages
from vitac.server.principals import CONSOLE


def test_a_question_is_asked_and_its_answer_read_from_the_command_line(service: CliService) -> None:
    assert "No question." in service.run("question", "list").stdout
    made = json.loads(service.run("question", "ask", "Is <b>this</b> public?", "--public", "--json").stdout)
    assert (made["public"], made["text"]) == (True, "Is <b>this</b> public?")
    private = service.run("question", "ask", "Is this not?")
    assert "Is this not?" in private.stdout
    with service.database.transaction() as session:
        other = make_secret(session, make_principal(session, "Team B"))
    assert json.loads(service.run_with_input("", "question", "list", "--json", token=other).stdout) == []
    with service.database.transaction() as session:
        for question in messages.list_questions(session, CONSOLE):
            messages.answer_question(session, CONSOLE, question.id, "Yes.", public=question.public)
    (seen,) = json.loads(service.run_with_input("", "question", "list", "--json", token=other).stdout)
    assert (seen["id"], seen["team"], seen["answer"]) == (made["id"], None, "Yes.")
    assert service.run("question", "list").stdout.count("Yes.") == 2


def test_a_token_file_says_who_asks_appeals_and_leads(service: CliService, tmp_path: Path) -> None:
    with service.database.transaction() as session:
        secret = make_secret(session, make_principal(session, "Team F"))
    file = tmp_path / "token"
    file.write_text(f"{secret}\n")
    named = ("--token-file", str(file))
    made = json.loads(service.run("question", "ask", "From a file?", *named, "--json").stdout)
    (listed,) = [
        one for one in json.loads(service.run("question", "list", *named, "--json").stdout) if not one["public"]
    ]
    assert (listed["id"], listed["team"]) == (made["id"], "Team F")
    assert "No appeal." in service.run("appeal", "list", *named).stdout
    for command in (("show", "1"), ("withdraw", "1"), ("open", str(uuid4()), "Why?")):
        assert "not_found" in str(service.run("appeal", *command, *named).exception), command
    assert json.loads(service.run("team", "show", *named, "--json").stdout)["name"] == "Team F"
    assert json.loads(service.run("team", "data", *named).stdout)["team"]["name"] == "Team F"
    file.write_text("")
    assert "got nothing" in str(service.run("team", "show", *named).exception)
