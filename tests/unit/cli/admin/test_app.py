import json
from pathlib import Path
from typing import Any

import pytest
import structlog
from cli_service import CliService, submission_folder
from service_factories import claim, make_record, shard_ids, store
from typer.testing import Result
from vitac.cli.client.answers import RequestRefused
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.server.database.models import Submission, Worker
from vitac.server.database.states import WorkerState

from competitions import make_competition, open_now, put_in_place


def admin(service: CliService, *arguments: str) -> Result:
    return service.run("admin", *arguments)


def read(service: CliService, *arguments: str) -> object:
    done = admin(service, *arguments, "--json")
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


@pytest.fixture
def submission_id(service: CliService, tmp_path: Path) -> str:
    answer = json.loads(service.run("submit", str(submission_folder(tmp_path / "mine")), "--json").stdout)
    return str(answer["id"])


def evaluation_of(service: CliService) -> str:
    found = read(service, "evaluation", "list")
    assert isinstance(found, list)
    return str(found[0]["id"])


# ---- teams and tokens ----


def test_an_added_team_can_submit_with_the_printed_token(service: CliService, tmp_path: Path) -> None:
    added = json.loads(admin(service, "team", "add", "Bears", "--contact", "b@example.org", "--json").stdout)
    token = tmp_path / "token"
    token.write_text(added["token"]["secret"])
    folder = submission_folder(tmp_path / "mine")
    assert service.run("submit", str(folder), "--token-file", str(token)).exit_code == 0
    shown: Any = read(service, "team", "show", "bears")
    assert [member["role"] for member in shown.pop("members")] == ["captain"]
    assert {name: shown[name] for name in added["team"]} == added["team"]
    assert "Bears" in admin(service, "team", "list").stdout


def test_what_is_taken_or_unknown_is_refused_and_a_token_is_for_a_team_or_for_organizers(service: CliService) -> None:
    nothing = "00000000-0000-4000-8000-000000000000"
    for words in (("team", "add", "TEAM  a"), ("team", "show", "nobody"), ("evaluation", "show", nothing)):
        assert isinstance(admin(service, *words).exception, RequestRefused)
    assert "vitac admin team list" in str(admin(service, "team", "show", "nobody").exception)
    for arguments in ((), ("Team A", "--organizer")):
        assert admin(service, "token", "add", *arguments).exit_code == 2


def test_an_organizers_token_sees_all_and_a_revoked_one_no_longer_works(
    service: CliService, submission_id: str, tmp_path: Path
) -> None:
    token = tmp_path / "token"
    organizer = json.loads(admin(service, "token", "add", "--organizer", "--days", "1", "--json").stdout)
    assert organizer["role"] == "organizer"
    token.write_text(organizer["secret"])
    assert submission_id in service.run("status", "--token-file", str(token)).stdout
    added = json.loads(admin(service, "token", "add", "Team A", "--json").stdout)
    token.write_text(added["secret"])
    assert service.run("status", "--token-file", str(token)).exit_code == 0
    assert admin(service, "token", "revoke", added["id"], "--yes").exit_code == 0
    assert service.run("status", "--token-file", str(token)).exit_code == 1
    tokens = {row["id"]: row for row in read(service, "token", "list")}  # type: ignore[attr-defined]
    assert tokens[added["id"]]["revoked_at"] is not None
    assert added["secret"] not in admin(service, "token", "list").stdout


def test_a_dry_run_shows_no_secret_that_is_not_kept(service: CliService) -> None:
    added = json.loads(admin(service, "team", "add", "Bears", "--dry-run", "--json").stdout)
    assert (added["team"]["name"], added["team"]["id"], added["token"]["secret"]) == ("Bears", None, None)
    shown = admin(service, "token", "add", "--organizer", "--dry-run").stdout
    assert "organizer" in shown
    assert "vitac_" not in shown
    assert "not shown again" not in shown + admin(service, "team", "add", "Bears", "--dry-run").stdout
    assert isinstance(admin(service, "team", "add", "Team A", "--dry-run").exception, RequestRefused)
    assert [token["role"] for token in read(service, "token", "list")] == ["team"]  # type: ignore[attr-defined]
    assert "Bears" not in admin(service, "team", "list").stdout


# ---- submissions and evaluations ----


def test_lists_submissions_by_team_and_state_and_counts_or_prints_the_data_of_a_team(
    service: CliService, submission_id: str
) -> None:
    assert submission_id in admin(service, "submission", "list", "--team", "Team A", "--state", "queued").stdout
    assert "No such submission." in admin(service, "submission", "list", "--state", "completed").stdout
    assert admin(service, "submission", "list", "--state", "asleep").exit_code == 2
    listed, found = read(service, "submission", "list"), read(service, "team", "data", "Team A")
    assert isinstance(listed, dict)
    assert [item["id"] for item in listed["items"]] == [submission_id]
    assert isinstance(found, dict)
    assert [submission["id"] for submission in found["submissions"]] == [submission_id]
    counted = dict(line.rsplit(None, 1) for line in admin(service, "team", "data", "Team A").stdout.splitlines()[1:-2])
    assert (counted["members"], counted["submissions"], counted["webhooks"]) == ("1", "1", "0")
    assert submission_id not in str(counted)


def test_an_evaluation_is_shown_with_its_shards_and_an_alarm_for_episodes_that_differ_from_the_stored_ones(
    service: CliService, submission_id: str
) -> None:
    found = read(service, "evaluation", "show", evaluation_of(service))
    assert isinstance(found, dict)
    assert (found["submission_id"], len(found["shards"])) == (submission_id, 10)
    shown = admin(service, "evaluation", "show", evaluation_of(service)).stdout
    assert ("1..27" in shown, "ALARM" in shown) == (True, False)
    with service.database.transaction() as session:
        first = shard_ids(session, session.get_one(Submission, submission_id))[0]
    store(service.database, claim(service.database, first), [make_record(1), make_record(1, EpisodeOutcome.STEPS)])
    shown = admin(service, "evaluation", "show", evaluation_of(service)).stdout
    assert "ALARM" in shown
    assert make_record(1).record_digest()[:8] in shown
    listed = read(service, "evaluation", "list")
    assert isinstance(listed, list)
    assert [row["differing_episodes"] for row in listed] == [1]
    headings, row = admin(service, "evaluation", "list").stdout.splitlines()
    assert row[headings.index("alarms") :].split()[0] == "1"


def test_requeues_and_cancels_by_evaluation(service: CliService, submission_id: str) -> None:
    first = evaluation_of(service)
    cancelled = json.loads(admin(service, "evaluation", "cancel", first, "--yes", "--json").stdout)
    assert cancelled == read(service, "evaluation", "show", first)
    assert admin(service, "evaluation", "requeue", first, "--dry-run").exit_code == 0
    assert evaluation_of(service) == first
    queued = json.loads(admin(service, "evaluation", "requeue", first, "--yes", "--json").stdout)
    assert (queued["id"], queued["evaluation"]["state"]) == (submission_id, "queued")
    assert queued["evaluation"]["id"] == evaluation_of(service) != first
    refused = admin(service, "evaluation", "cancel", first, "--yes")
    assert isinstance(refused.exception, RequestRefused)
    assert "a newer run" in str(refused.exception)


def test_events_are_logged_beside_the_output(service: CliService, capsys: pytest.CaptureFixture[str]) -> None:
    admin(service, "team", "list")
    structlog.get_logger().info("something_happened")
    printed = capsys.readouterr()
    assert "something_happened" in printed.err
    assert printed.out == ""


# ---- workers ----


def test_lists_and_shows_workers(service: CliService) -> None:
    assert "vitac worker" in admin(service, "worker", "list").stdout
    with service.database.transaction() as session:
        worker = Worker(
            host="box",
            pid=17,
            slots=1,
            state=WorkerState.REFUSING,
            evaluator_version="1",
            platform_class="x86_64-linux",
            isolation="none",
            message="no bubblewrap",
        )
        session.add(worker)
        session.flush()
        worker_id = str(worker.id)
    assert "no bubblewrap" in admin(service, "worker", "list").stdout
    shown = read(service, "worker", "show", worker_id)
    assert isinstance(shown, dict)
    assert (shown["host"], shown["state"]) == ("box", "refusing")
    assert isinstance(
        admin(service, "worker", "show", "00000000-0000-4000-8000-000000000000").exception, RequestRefused
    )


def test_an_organizer_of_one_competition_signs_in_and_sees_only_that(service: CliService, tmp_path: Path) -> None:
    with service.database.transaction() as session:
        for name in ("cup", "class"):
            put_in_place(session, open_now(make_competition(name=name, title=f"The {name}")))
    for competition in ("cup", "class"):
        made = service.run("submit", str(submission_folder(tmp_path / competition)), "--competition", competition)
        assert made.exit_code == 0, made.output
    added = service.run("admin", "token", "add", "--organizer", "--competition", "class", "--json")
    token = tmp_path / "token"
    token.write_text(json.loads(added.stdout)["secret"])
    assert "organizer of class" in service.run("whoami", "--token-file", str(token)).stdout
    listed = json.loads(service.run("status", "--json", "--token-file", str(token)).stdout)
    assert [one["competition"] for one in listed] == ["class"]
    assert service.run("admin", "token", "add", "Team A", "--competition", "class").exit_code == 2
