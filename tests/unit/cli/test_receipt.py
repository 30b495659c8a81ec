import json
from collections.abc import Collection
from pathlib import Path
from uuid import UUID

import pytest
from cli_service import CliService
from service_factories import LOCK, TASK, TRACK, make_principal, play_all, submit
from sqlalchemy.orm import Session
from typer.testing import Result
from vitac.server.accounts import teams
from vitac.server.database.states import Role
from vitac.server.decisions import exporting
from vitac.server.decisions.exporting import read_teams
from vitac.server.principals import Principal
from vitac.server.receipts.export import ExportedTeam

from competitions import make_competition, open_now, put_in_place


@pytest.fixture
def played(service: CliService) -> tuple[CliService, str]:
    """A service, and the id of a submission of its team that has a final result."""
    with service.database.transaction() as session:
        team = teams.find(session, "Team A")
        principal = Principal(role=Role.TEAM, team_id=team.id, team_name=team.name)
        submission = submit(session, principal)
    play_all(service.database, submission)
    return service, str(submission.id)


def refusal(result: Result) -> str:
    assert result.exit_code == 1
    return str(result.exception)


def test_a_receipt_is_verified_at_the_service_and_as_a_file(played: tuple[CliService, str], tmp_path: Path) -> None:
    service, submission_id = played
    for named in (submission_id, f"{service.address}/submissions/{submission_id}"):
        shown = service.run("receipt", "verify", named).stdout
        assert "270 of 270" in shown
        assert "that this key signed" in shown
        assert "Compare the key" not in shown
    told = json.loads(service.run("receipt", "verify", submission_id, "--json").stdout)
    assert told["verified"] is told["key_given"] is True
    assert told["receipt"]["result"]["submission"] == submission_id
    file = tmp_path / "receipt.json"
    file.write_text(json.dumps(told["receipt"]))
    assert "Compare the key" in service.run("receipt", "verify", str(file)).stdout
    key = json.loads(service.run("admin", "receipt", "key", "--json").stdout)
    assert key["receipts"] == 2
    for form in (key["public_key"], key["verifier_key"]):
        assert service.run("receipt", "verify", str(file), "--key", form).exit_code == 0, form
    assert "cannot be read" in refusal(service.run("receipt", "verify", str(tmp_path / "none.json")))
    assert "of another service" in refusal(service.run("receipt", "verify", str(file), "--key", "0" * 64))
    told["receipt"]["result"]["tasks"][0]["successes"] = 1
    file.write_text(json.dumps(told["receipt"]))
    assert "was changed" in refusal(service.run("receipt", "verify", str(file)))


def test_receipts_are_fetched_and_verified_also_as_the_list_that_the_api_gives(
    played: tuple[CliService, str], tmp_path: Path
) -> None:
    service, submission_id = played
    files = json.loads(service.run("receipt", "fetch", submission_id, "--to", str(tmp_path), "--json").stdout)["files"]
    assert len(files) == len({Path(file).name for file in files}) == 2
    for file in files:
        assert "that this key signed" in service.run("receipt", "verify", file).stdout
    listed = tmp_path / "receipts.json"
    listed.write_text(f"[{','.join(Path(file).read_text() for file in files)}]")
    assert service.run("receipt", "verify", str(listed)).stdout.count("that this key signed") == 2
    listed.write_text("[]")
    assert "there is no receipt yet" in refusal(service.run("receipt", "verify", str(listed)))


def test_of_a_submission_without_a_result_the_receipt_of_its_arrival_is_verified(service: CliService) -> None:
    with service.database.transaction() as session:
        team = teams.find(session, "Team A")
        waits = submit(session, Principal(role=Role.TEAM, team_id=team.id, team_name=team.name))
    shown = service.run("receipt", "verify", str(waits.id)).stdout
    assert "that this key signed" in shown
    assert str(waits.id) in shown
    assert "result hash" not in shown


def test_boards_are_exported_and_audited(
    played: tuple[CliService, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where a result gets its receipt while a file is written: that one is not in it."""
    service, _ = played
    files = {task: str(tmp_path / f"{task}.zip") for task in (TASK, LOCK)}
    assert service.run("admin", "receipt", "export", TRACK, files[TASK], "--task", TASK).exit_code == 0

    def with_a_late_result(session: Session, evaluations: Collection[UUID]) -> tuple[ExportedTeam, ...]:
        with service.database.transaction() as other:
            late = submit(other, make_principal(other, "Bees"), tasks=(LOCK,))
        play_all(service.database, late)
        return read_teams(session, evaluations)

    with monkeypatch.context() as patched:
        patched.setattr(exporting, "read_teams", with_a_late_result)
        assert service.run("admin", "receipt", "export", TRACK, files[LOCK], "--task", LOCK).exit_code == 0
    assert json.loads(service.run("admin", "receipt", "key", "--json").stdout)["receipts"] == 4
    key = json.loads(service.run("admin", "receipt", "key", "--json").stdout)["public_key"]
    empty = service.run("receipt", "audit", files[LOCK], "--key", key)
    assert empty.exit_code == 1, "nothing was verified"
    assert "Nothing was verified: the records of no result" in empty.stdout
    assert empty.stdout.index("findings") < empty.stdout.index("Nothing was verified")
    wrong = service.run("receipt", "audit", files[TASK], "--episodes", "0")
    assert wrong.exit_code == 1
    assert "WRONG: Team A, peg-insertion: the records are not those of such an evaluation" in wrong.stdout
    assert wrong.stdout.startswith("What this file alone cannot show:\n  - Whose key signed this log")
    assert "Whether others were shown this log" in wrong.stdout
    told = json.loads(service.run("receipt", "audit", files[TASK], "--episodes", "0", "--json").stdout)
    assert (told["log_entries"], told["entries"], len(told["findings"])) == (2, 1, 1)
    other = json.loads(service.run("receipt", "audit", files[TASK], "--episodes", "0", "--json").stdout)
    assert other["seed"] != told["seed"], "nobody foresees which episodes are run again"
    given = service.run("receipt", "audit", files[TASK], "--episodes", "0", "--seed", "7", "--json").stdout
    assert json.loads(given)["seed"] == 7
    never = service.run("admin", "receipt", "export", TRACK, files[TASK] + ".logs", "--kind", "text_log")
    assert never.exit_code == 2, "of text logs there are no boards"
    assert "'model', 'log'" in never.stderr
    assert "name one of peg-insertion" in refusal(
        service.run("admin", "receipt", "export", TRACK, files[TASK] + ".logs", "--kind", "log")
    )
    assert "Name a new file" in refusal(service.run("admin", "receipt", "export", TRACK, files[TASK]))


def test_the_public_log_is_witnessed_audited_and_compared(
    played: tuple[CliService, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    service, submission_id = played
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    key = service.run("witness", "key", "--name", "ants.example/v").stdout.strip()
    assert "give it as --name" not in refusal(service.run("witness", "run", service.address, "--once")), "not named yet"
    with service.database.transaction() as session:
        put_in_place(session, open_now(make_competition(witnesses=[key])))
    shown = service.run("witness", "run", service.address, "--once").stdout
    assert shown.splitlines()[1].startswith("signed 2 entries, root ")
    stored, receipt = tmp_path / "checkpoint", tmp_path / "receipt.json"
    stored.write_text(next((tmp_path / "vitac" / "witness").glob("*.checkpoint")).read_text())
    told = json.loads(service.run("receipt", "verify", submission_id, "--json").stdout)
    assert list(told["witnessed"]) == ["ants.example/v"]
    receipt.write_text(json.dumps(told["receipt"]))
    verified = service.run("receipt", "verify", str(receipt), "--witness", key).stdout
    assert "1 of 1" in next(line for line in verified.splitlines() if line.startswith("witnessed by"))
    given = ("--receipt", str(receipt), "--noted", str(stored))
    audited = service.run("receipt", "audit", service.address, *given)
    assert audited.exit_code == 0, audited.stdout
    assert "Nothing in the log was changed, removed or moved." in audited.stdout
    assert "  - Whose key it is" in audited.stdout
    listed = json.loads(service.run("admin", "receipt", "witnesses", "--json").stdout)
    assert [(one["witness"], one["size"]) for one in listed] == [(key, 2)]
    log_key = json.loads(service.run("admin", "receipt", "key", "--json").stdout)["verifier_key"]
    same = service.run("receipt", "compare", str(stored), str(stored), "--key", log_key)
    assert (same.exit_code, "nothing in it was changed" in same.stdout) == (0, True)
    with service.database.transaction() as session:
        submit(session, make_principal(session, "Bees"), "more")
    later = tmp_path / "later"
    later.write_text(json.loads(service.run("admin", "receipt", "key", "--json").stdout)["checkpoint"])
    untold = service.run("receipt", "compare", str(stored), str(later), "--key", log_key)
    assert (untold.exit_code, "give the log as --log" in untold.stdout) == (1, True)
    assert service.run("receipt", "compare", str(stored), str(later), "--log", service.address).exit_code == 0
    back = service.run("receipt", "compare", str(later), str(stored), "--log", service.address)
    assert (back.exit_code, "rolled back" in back.stdout) == (1, True)
    wrong = service.run("receipt", "audit", service.address, "--noted", f"1:{'0' * 64}", "--json")
    assert (wrong.exit_code, len(json.loads(wrong.stdout)["findings"])) == (1, 1)
