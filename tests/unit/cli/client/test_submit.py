import json
import re
from pathlib import Path

import pytest
from cli_service import CliService, submission_folder, zip_of
from quick_worker import record_of
from service_factories import TASK
from sqlalchemy import func, select
from text_log_writer import text_log
from uploaded_logs import EPISODES, a_log, a_text_log, packed
from vitac.cli.client.answers import RequestRefused, ServiceUnreachable
from vitac.cli.client.submit import find_kind
from vitac.evaluator.logs.text_2025.scripts import all_scripts
from vitac.evaluator.submission.sources import NoSubmission
from vitac.server.database.models import PartialUpload

from competitions import make_competition, open_now, put_in_place


def test_submits_a_folder_watches_to_the_end_and_says_of_the_same_content_that_it_is_not_new(
    service: CliService, tmp_path: Path
) -> None:
    folder = str(submission_folder(tmp_path / "mine"))
    first = service.run("submit", folder).stdout
    submission_id = first.split()[1]
    for shown in (f"{service.address}/submissions/{submission_id}", "number 1 in the queue"):
        assert shown in first
    assert "tasks       peg-insertion\nnot played  lock-opening (counts as 0 %" in first
    assert "again" not in first
    waiting = service.run("submit", folder).stdout
    assert "again       you submitted this content on 20" in waiting
    assert "it is evaluated already, and nothing else was started" in waiting
    service.run("admin", "submission", "cancel", submission_id, "--yes")
    with service.playing():
        done = service.run("submit", folder, "--watch")
    assert done.exit_code == 0, done.output
    for shown in ("completed", "result hash"):
        assert shown in done.stdout
    assert "; nothing was started (--again runs it)" in service.run("submit", folder).stdout


def test_the_team_that_an_organizer_names_and_the_name_of_the_folder_are_sent_along(
    service: CliService, tmp_path: Path
) -> None:
    token = tmp_path / "token"
    added = json.loads(service.run("admin", "token", "add", "--organizer", "--json").stdout)
    token.write_text(added["secret"])
    folder = submission_folder(tmp_path / "Ants-Track_1-stage1-result")
    assert "file_name_mismatch" in str(service.run("submit", str(folder)).exception)
    mine = str(folder.rename(tmp_path / "Team_A-Track_1-stage1-result"))
    assert "team_required" in str(service.run("submit", mine, "--token-file", str(token)).exception)
    made = service.run("submit", mine, "--token-file", str(token), "--json", "--team", "team a")
    assert json.loads(made.stdout)["team"]["name"] == "Team A"


def test_what_is_refused_says_why_and_what_to_do(
    service: CliService, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("vitac.cli.client.pieces.PAUSES_S", ())  # waits for a service that is away
    folder, archive, token, log = (tmp_path / name for name in ("mine", "bad.zip", "token", "mine.jsonl"))
    submission_folder(folder)
    archive.write_bytes(zip_of(**{"other/policy.py": ""}))
    token.write_text("vitac_" + "x" * 43)
    log.write_bytes(a_log()[:-500])
    for arguments, kind, parts in (
        ([archive, "--track", "track_1"], RequestRefused, ("422", "archive_rejected", "vitac check")),
        ([folder, "--token-file", token], RequestRefused, ("invalid_credentials", "ask an organizer")),
        ([folder, "--track", "track_9"], RequestRefused, ("unknown_track",)),
        ([log], RequestRefused, ("log_rejected", "Line 271", "vitac evaluate --log")),
        ([folder, "--server", "http://127.0.0.1:9"], ServiceUnreachable, ("vitac serve",)),
        ([tmp_path], NoSubmission, ("submission.yaml",)),
    ):
        refused = service.run("submit", *map(str, arguments))
        assert isinstance(refused.exception, kind), refused.output
        for part in parts:
            assert part in str(refused.exception)
    assert service.run("submit", str(tmp_path / "none")).exit_code == 2


def test_every_command_explains_itself(service: CliService) -> None:
    for command in ["submit", "status", "serve", "worker", "admin", "demo"]:
        done = service.run(command, "--help")
        assert done.exit_code == 0
        assert "Usage" in done.stdout


@pytest.mark.parametrize(
    ("name", "content", "shown"),
    [
        (
            "mine.jsonl.gz",
            packed(a_log([record_of(episode, task=TASK) for episode in EPISODES])),
            ("actions verified, policy not seen", "verified: all states are equal", "66.7 %, 180 of 270"),
        ),
        (
            "mine.log",
            a_text_log(),
            ("2025 text log", "4.8 %, 13 of 270", "66.7 %", "problems", "differ systematically"),
        ),
    ],
)
def test_submits_a_log_and_shows_its_verdict_or_both_rates(
    service: CliService, tmp_path: Path, name: str, content: bytes, shown: tuple[str, ...]
) -> None:
    (tmp_path / name).write_bytes(content)
    with service.playing():
        done = service.run("submit", str(tmp_path / name), "--watch")
    assert done.exit_code == 0, done.output
    for text in shown:
        assert text in done.stdout
    (item,) = json.loads(service.run("status", "--json").stdout)
    assert (item["kind"], item["log"]["verdict"]) == (
        ("log", "verified") if name.endswith("gz") else ("text_log", None)
    )


def test_the_service_finds_the_track_of_a_text_log(service: CliService, tmp_path: Path) -> None:
    script = next(script for script in all_scripts() if script.track == "Track_2")
    tests = [
        {"episode": n, "initial_offset": s.offset, "steps": [{"n": 1, "action": (0.5,) * 4}], "result": "FAIL"}
        for n, s in enumerate(script.starts(), start=1)
    ]
    log = tmp_path / "vision.log"
    totals = ("#SUCCESS_RATE: 0", "#AVG_STEP: NA")
    log.write_text(text_log(tests, script.environment, script.md5[0], totals, team="Team A"))
    done = service.run("submit", str(log), "--json")
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["track"] == "track_2"
    refused = service.run("submit", str(log), "--track", "track_1")
    assert "the log is of 'track_2'" in str(refused.exception)


@pytest.mark.parametrize(
    ("name", "kind"),
    [("a.zip", "model"), ("a", "model"), ("a.jsonl", "log"), ("a.JSONL.gz", "log"), ("a.log", "text_log"),
     ("a.log.gz", "text_log"), ("a.txt", "text_log"), ("a.gz", "model")],
)  # fmt: skip
def test_a_file_is_told_by_its_name(tmp_path: Path, name: str, kind: str) -> None:
    assert find_kind(tmp_path / name) == kind


def test_a_submission_says_its_competition_where_two_take_it(service: CliService, tmp_path: Path) -> None:
    with service.database.transaction() as session:
        for name in ("cup", "class"):
            put_in_place(session, open_now(make_competition(name=name, title=f"The {name}")))
    folder = str(submission_folder(tmp_path / "mine"))
    refused = service.run("submit", folder)
    assert "competition_required" in str(refused.exception)
    assert "Several competitions take submissions to track_1 now: class, cup." in str(refused.exception)
    with service.database.transaction() as session:
        assert session.scalar(select(func.count()).select_from(PartialUpload)) == 0
    assert "expected one of class, cup" in str(service.run("submit", folder, "--competition", "cap").exception)
    made = [
        json.loads(service.run("submit", folder, "--competition", name, "--json").stdout) for name in ("cup", "class")
    ]
    assert [answer["competition"] for answer in made] == ["cup", "class"]
    assert re.search(r"class +track_1 +stage1 +attempts", service.run("whoami").stdout)
