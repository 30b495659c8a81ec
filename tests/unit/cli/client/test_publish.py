import json
from pathlib import Path
from uuid import UUID

from cli_service import CliService, submission_folder
from service_factories import TASK, complete_scored, make_score
from vitac.cli.client.verbs import ConsentMissing
from vitac.server.database.models import Submission


def test_publishes_and_takes_back(service: CliService, tmp_path: Path) -> None:
    submission_id = json.loads(service.run("submit", str(submission_folder(tmp_path / "mine")), "--json").stdout)["id"]
    address = f"{service.address}/submissions/{submission_id}"
    assert service.run("publish", submission_id).stdout == f"public as soon as its evaluation is complete: {address}\n"
    with service.database.transaction() as session:
        complete_scored(session, session.get_one(Submission, UUID(submission_id)), {TASK: make_score(80)})
    assert service.run("publish", submission_id).stdout == f"public: {address}\n"
    assert json.loads(service.run("publish", submission_id, "--off", "--json").stdout)["public"] is False
    assert "only your team" in service.run("publish", submission_id, "--off").stdout
    missing = service.run("publish", str(UUID(int=0)))
    assert missing.exit_code == 1
    assert "There is no submission" in str(missing.exception)


def test_a_submission_is_withdrawn_put_back_and_deleted(service: CliService, tmp_path: Path) -> None:
    submission_id = json.loads(service.run("submit", str(submission_folder(tmp_path / "ours")), "--json").stdout)["id"]
    assert service.run("withdraw", submission_id).stdout == "withdrawn: it is on no board\n"
    assert service.run("withdraw", submission_id, "--undo").stdout == "it is on the boards again\n"
    assert isinstance(service.run("withdraw", submission_id, "--delete").exception, ConsentMissing)
    assert service.run("withdraw", submission_id, "--undo", "--delete").exit_code == 2
    assert service.run("withdraw", submission_id, "--delete", "--yes").stdout.startswith("deleted: ")
    assert "is deleted; upload" in str(service.run("withdraw", submission_id, "--undo").exception)
