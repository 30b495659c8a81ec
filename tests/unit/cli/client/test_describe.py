import json
from pathlib import Path

import httpx
from cli_service import CliService, submission_folder


def test_describes_a_public_result_and_keeps_what_is_not_named(service: CliService, tmp_path: Path) -> None:
    submission = json.loads(service.run("submit", str(submission_folder(tmp_path / "mine")), "--json").stdout)["id"]
    private = service.run("describe", submission, "--text", "A network.")
    assert private.exit_code == 1
    assert "Make it public first, on its page or with `vitac publish`" in str(private.exception)
    service.run("publish", submission)
    code = "https://github.com/bears/policy"
    assert service.run("describe", submission, "--text", "A network.", "--code", code).exit_code == 0
    shown = json.loads(service.run("describe", submission, "--paper", "https://arxiv.org/abs/1", "--json").stdout)
    assert (shown["text"], shown["code"], shown["paper"]) == ("A network.", code, "https://arxiv.org/abs/1")
    assert json.loads(service.run("describe", submission, "--code", "", "--json").stdout)["code"] == ""
    insecure = service.run("describe", submission, "--code", "http://github.com/bears")
    assert "The link to code 'http://github.com/bears' cannot be used: expected https" in str(insecure.exception)
    assert "A network." in service.run("describe", submission).stdout
    removed = service.run("admin", "submission", "remove-description", submission, "--reason", "No.", "--yes")
    assert removed.exit_code == 0, removed.output
    assert "No." in service.run("describe", submission).stdout
    assert service.run("describe", submission, "--text", "Again.").exit_code == 1
    assert service.run("admin", "submission", "restore-description", submission, "--yes").exit_code == 0
    card = httpx.get(
        f"{service.address}/api/v1/submissions/{submission}/card",
        headers={"Authorization": f"Bearer {service.environment['VITAC_TOKEN']}"},
    ).json()
    assert card["contents"]["frameworks"] == ["numpy"]
