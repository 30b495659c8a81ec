"""An uploaded log: from its shards to its verdict, its place among logs, and models that go along with it."""

import io
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from database_work import database_work
from service_client import Service, problem_of, running_service
from service_factories import (
    TASK,
    RecordOf,
    add_result,
    claim,
    finish,
    make_failed_record,
    make_principal,
    make_record,
    make_score,
    make_settings,
    make_upload,
    outdate,
    play,
    play_all,
    sha256,
    shard_ids,
    store,
    take_away,
    take_shard,
)
from sqlalchemy import event, inspect, text, update
from sqlalchemy.exc import IntegrityError
from uploaded_logs import a_log, a_text_log, log_manifest, some_records, upload_log
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome, EpisodeRecord, SampledPicture
from vitac.evaluator.logs.findings import Divergence, Impossibility, ImpossibleReason, LogFinding, OtherPicture
from vitac.evaluator.logs.log import LogReader
from vitac.evaluator.logs.text_2025 import WHY_RATES_DIFFER
from vitac.evaluator.logs.text_2025.scripts import all_scripts
from vitac.evaluator.shards.order import ShardEnd, ShardResult
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.version import evaluator_version
from vitac.server.competitions import sealing
from vitac.server.database.engine import Database
from vitac.server.database.models import Evaluation, Submission, Team
from vitac.server.database.states import WorkState
from vitac.server.evaluations import action_matches, lifecycle
from vitac.server.evaluations.logs import LogClaim
from vitac.server.evaluations.verdicts import find_sentence
from vitac.server.leaderboards import log_boards
from vitac.server.principals import CONSOLE
from vitac.server.queue.leases import Lease
from vitac.server.queue.work import end, report_broken
from vitac.server.submissions import creation

from competitions import shown_stage, stored_stage


@pytest.fixture
def service(database: Database, tmp_path: Path) -> Any:
    with running_service(database, tmp_path) as service:
        yield service


def submission_of(service: Service, identity: str) -> Submission:
    with service.database.transaction() as session:
        return session.get_one(Submission, identity)


def uploaded(service: Service, log: bytes, kind: str = "log", token: str | None = None) -> Submission:
    answer = upload_log(service, log, kind, token)
    assert answer.status_code == 202, answer.text
    return submission_of(service, answer.json()["id"])


def shown(service: Service, submission: Submission, token: str | None = None) -> dict[str, Any]:
    found: dict[str, Any] = service.get(f"/submissions/{submission.id}", token).json()
    return found


def resimulated(
    service: Service, log: bytes, record_of: RecordOf = make_record, token: str | None = None
) -> Submission:
    """A log that was uploaded and whose shards all ran, with these records as result."""
    submission = uploaded(service, log, token=token)
    play_all(service.database, submission, record_of)
    return submission


def elsewhere(record: EpisodeRecord) -> EpisodeRecord:
    """The same episode as another team plays it: with other actions and states."""
    actions = ActionSequence.from_array(record.actions.to_array() + np.float32(0.25))
    states = tuple(sha256(f"B {state}") for state in record.state_hashes)
    return record.model_copy(update={"actions": actions, "state_hashes": states})


def diverged_at(episode: int, env_step: int = 2) -> LogFinding:
    return LogFinding.diverged(
        Divergence(
            episode=episode,
            env_step=env_step,
            recorded_state=sha256("theirs"),
            recorded_info={"is_success": True},
            resimulated_state=sha256("ours"),
            resimulated_info={"is_success": False},
        )
    )


def refute(service: Service, lease: Lease, finding: LogFinding) -> None:
    with service.database.transaction() as session:
        result = ShardResult(
            index=lease.number, end=ShardEnd.REFUTED, manifest=log_manifest(), isolation=None, finding=finding
        )
        lifecycle.finish_shard(session, lease, result)


def leases_of(service: Service, submission: Submission) -> list[Lease]:
    with service.database.transaction() as session:
        ids = shard_ids(session, submission)
    return [claim(service.database, shard_id) for shard_id in ids]


def test_log_whose_states_are_all_met_is_verified(service: Service) -> None:
    log = resimulated(service, a_log())
    found = shown(service, log)
    assert (found["evaluation"]["state"], found["evaluation"]["success_rate"]) == ("completed", 1.0)
    assert (found["log"]["verdict"], found["log"]["reason"]) == ("verified", "all states are equal")
    assert found["log"]["claimed_result_hash"] == found["evaluation"]["result_hash"]


def test_score_is_the_servers_and_never_a_claim(service: Service) -> None:
    """Other states without a finding: as from a task that does not repeat, whose outcomes agree."""

    def ours(episode: int, *, task: str) -> EpisodeRecord:
        return make_record(episode, state_hashes=tuple(sha256(f"ours {episode} {step}") for step in range(4)))

    log = resimulated(service, a_log(platform_class="ieee754-linux"), ours)
    found = shown(service, log)
    assert (found["log"]["verdict"], found["log"]["made_on"]) == ("verified within tolerance", "ieee754-linux")
    assert found["log"]["reason"] == "the environment does not repeat to the last bit; all outcomes are equal"
    assert found["log"]["claimed_result_hash"] != found["evaluation"]["result_hash"]


def test_divergence_fails_the_evaluation_and_shows_both_states(service: Service) -> None:
    log = uploaded(service, a_log())
    first = leases_of(service, log)[0]
    store(service.database, first, [make_record(1), make_record(2)])
    refute(service, first, diverged_at(3))
    found = shown(service, log)
    assert (found["evaluation"]["state"], found["evaluation"]["scores"]) == ("failed", [])
    verdict = found["evaluation"]["verdict"]
    assert (verdict["code"], verdict["message"]) == ("diverged", "diverged at episode 3, env step 2")
    assert (verdict["task"], verdict["episode"]) == ("peg-insertion", 3)
    assert (found["log"]["verdict"], found["log"]["reason"]) == ("diverged", "diverged at episode 3, env step 2")
    divergence = found["log"]["divergence"]
    assert (divergence["recorded_state"], divergence["resimulated_state"]) == (sha256("theirs"), sha256("ours"))
    assert (divergence["recorded_info"], divergence["resimulated_info"]) == (
        {"is_success": True}, {"is_success": False},
    )  # fmt: skip
    assert service.get("/leaderboards/track_1/logs").json()["boards"][0]["entries"] == []


def test_other_pictures_fail_the_evaluation_with_a_sentence_that_says_what_to_do(service: Service) -> None:
    log = uploaded(service, a_log())
    ours = SampledPicture(env_step=4, sha256=sha256("ours"))
    finding = LogFinding.from_picture(OtherPicture(episode=3, recorded=None, resimulated=ours))
    refute(service, leases_of(service, log)[0], finding)
    found = shown(service, log)
    verdict = found["evaluation"]["verdict"]
    assert (verdict["code"], verdict["episode"], verdict["message"]) == ("other_picture", 3, finding.reason)
    assert (found["log"]["verdict"], found["log"]["divergence"]) == ("other_picture", None)
    assert f"expected the pictures {sha256('ours')[:12]}… of env step 4, got no pictures" in found["log"]["reason"]
    assert find_sentence("other_picture", "").endswith("unchanged version of vitac and upload the new log.")
    assert service.get("/leaderboards/track_1/logs").json()["boards"][0]["entries"] == []


@pytest.mark.parametrize("order", [(1, 0), (0, 1)])
def test_verdict_is_the_first_divergence_in_whatever_order_the_shards_end(
    service: Service, order: tuple[int, int]
) -> None:
    log = uploaded(service, a_log())
    leases = leases_of(service, log)
    for number in order:
        if shown(service, log)["evaluation"]["state"] == "running":
            refute(service, leases[number], diverged_at(27 * number + 7))
    assert shown(service, log)["evaluation"]["verdict"]["episode"] == 7


def test_finding_of_a_later_shard_is_not_shown_as_the_verdict_of_machines_that_failed_at_an_earlier_one(
    service: Service,
) -> None:
    log = uploaded(service, a_log())
    first, second, *_ = leases_of(service, log)
    refute(service, second, diverged_at(37))
    with service.database.transaction() as session:
        report_broken(session, make_settings(shard_attempts=1), first, "no disk", give_up=lifecycle.give_up)
    found = shown(service, log)
    assert found["evaluation"]["verdict"]["code"] == "machine_failed"
    assert (found["log"]["verdict"], found["log"]["reason"], found["log"]["divergence"]) == (None, None, None)


def test_log_that_only_a_worker_can_see_to_be_impossible_is_refused_by_name(service: Service) -> None:
    """The mesh: the server does not make one."""
    log = uploaded(service, a_log(mesh_hash="other"))
    message = "Expected a log made with mesh_hash '1234', got 'other'; evaluate again."
    found = Impossibility(reason=ImpossibleReason.OTHER_EVALUATION, message=message)
    refute(service, leases_of(service, log)[0], LogFinding.impossible(found))
    assert shown(service, log)["evaluation"]["verdict"]["code"] == "impossible"
    assert (shown(service, log)["log"]["verdict"], shown(service, log)["log"]["reason"]) == ("impossible", message)


def test_log_that_was_refuted_is_not_resimulated_again_unless_asked_for(service: Service) -> None:
    log = uploaded(service, a_log())
    refute(service, leases_of(service, log)[0], diverged_at(3))
    again = upload_log(service, a_log())
    assert (again.status_code, again.json()["log"]["verdict"]) == (200, "diverged")
    assert upload_log(service, a_log(), query="&again=true").json()["evaluation"]["run"] == 2


def test_killed_worker_costs_no_episode(service: Service) -> None:
    """The records of the lost shard count; whoever takes it up plays the rest."""
    log = uploaded(service, a_log())
    with service.database.transaction() as session:
        ids = shard_ids(session, log)
    lost = claim(service.database, ids[0])
    store(service.database, lost, [make_record(1), make_record(2)])
    take_away(service.database, ids[0])
    for shard_id in ids:
        play(service.database, shard_id)
    assert shown(service, log)["log"]["verdict"] == "verified"


def test_output_that_a_log_names_is_not_shown_as_a_policys(service: Service) -> None:
    def record_of(episode: int, *, task: str = TASK) -> EpisodeRecord:
        failed = episode == 5
        return make_failed_record(episode, output="as if it ran", task=task) if failed else make_record(episode)

    log = uploaded(service, a_log([record_of(n) for n in range(1, 271)]))
    with service.database.transaction() as session:
        first, *others = shard_ids(session, log)
    lease = claim(service.database, first)
    store(service.database, lease, [record_of(episode) for episode in lease.episodes])
    assert "as if it ran" not in service.get(f"/submissions/{log.id}").text
    finish(service.database, lease)
    for shard_id in others:
        play(service.database, shard_id, record_of)
    assert shown(service, log)["evaluation"]["state"] == "completed"
    assert "as if it ran" not in service.get(f"/submissions/{log.id}").text


def test_a_shard_with_a_finding_is_not_done(database: Database) -> None:
    with database.transaction() as session:
        submission = creation.create(session, make_principal(session), make_upload())[0]
        lease = take_shard(session, shard_ids(session, submission)[0])
        session.execute(text("UPDATE shards SET finding = '{}', manifest = '{}' WHERE id = :id"), {"id": lease.work_id})
    with pytest.raises(IntegrityError, match="done without a result"), database.transaction() as session:
        end(session, lease, WorkState.DONE)


# ---- their own ranking ----


def worse(episode: int, *, task: str = TASK) -> EpisodeRecord:
    return make_record(episode, EpisodeOutcome.TACTILE if episode % 2 else EpisodeOutcome.SUCCESS, task)


def test_verified_logs_rank_apart_from_models_and_the_best_of_each_team_counts(service: Service) -> None:
    resimulated(service, a_log([worse(n) for n in range(1, 271)]), worse)
    better = resimulated(service, a_log())
    theirs = [elsewhere(worse(n)) for n in range(1, 271)]
    others = resimulated(
        service, a_log(theirs, "Team B"), lambda n, task: elsewhere(worse(n, task=task)), service.other_token
    )
    assert shown(service, others, service.other_token)["copy_of"] is None
    boards = service.client.get("/api/v1/leaderboards/track_1/logs").json()
    assert {board["label"] for board in boards["boards"]} == {"actions verified, policy not seen"}
    peg, lock = boards["boards"]
    assert [(e["rank"], e["team"], e["success_rate"], e["verdict"]) for e in peg["entries"]] == [
        (1, "Team A", 1.0, "verified"),
        (2, "Team B", 0.5, "verified"),
    ]
    assert peg["entries"][0]["submission_id"] == str(better.id)
    assert (lock["task"], lock["entries"]) == ("lock-opening", [])
    assert service.client.get("/api/v1/leaderboards/track_1").json()["entries"] == []
    assert shown(service, better)["rank"] is None


def test_log_of_an_older_evaluator_stays_visible_without_a_rank(service: Service) -> None:
    log = resimulated(service, a_log())
    with service.database.transaction() as session:
        outdate(session)
    board = service.client.get("/api/v1/leaderboards/track_1/logs").json()["boards"][0]
    assert [(e["rank"], e["stale"], e["submission_id"]) for e in board["entries"]] == [(None, True, str(log.id))]
    assert board["unranked"].startswith("1 of 1 entries has no rank: evaluator ")
    assert board["unranked"].endswith("upload a log of the present evaluator.")


def test_text_log_is_listed_with_both_rates_and_never_ranked(service: Service) -> None:
    log = uploaded(service, a_text_log(), "text_log")
    play_all(service.database, log, worse)
    boards = service.client.get("/api/v1/leaderboards/track_1/logs").json()
    assert all(board["entries"] == [] for board in boards["boards"])
    (entry,) = boards["text_logs"]
    assert (entry["team"], entry["task"], entry["submission_id"]) == ("Team A", "peg-insertion", str(log.id))
    assert (entry["claimed_success_rate"], entry["success_rate"]) == (0.0481, 0.5)
    assert entry["problems"] > 0
    assert shown(service, log)["log"]["verdict"] is None
    assert boards["why_rates_differ"] == shown(service, log)["log"]["reason"] == WHY_RATES_DIFFER


def test_text_log_of_the_track_in_which_teams_bring_sensors_is_listed_there(service: Service) -> None:
    script = next(script for script in all_scripts() if script.track == "Track_3")
    content = a_text_log(
        episodes=[
            {"episode": n, "initial_offset": start.offset, "steps": [{"n": 1, "action": (0.5,) * 3}], "result": "FAIL"}
            for n, start in enumerate(script.starts(), start=1)
        ],
        environment=script.environment,
        totals=("#SUCCESS_RATE: 0", "#AVG_STEP: NA"),
    )
    log = uploaded(service, content, "text_log")
    play_all(service.database, log, worse)
    (entry,) = service.client.get("/api/v1/leaderboards/track_3/logs").json()["text_logs"]
    assert (entry["task"], entry["claimed_success_rate"], entry["success_rate"]) == ("sensor-design", 0.0, 0.5)
    found = shown(service, log)
    assert (found["rank"], found["missing_tasks"], found["evaluation"]["success_rate"]) == (None, [], 0.5)


def test_only_the_newest_text_logs_are_loaded(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_boards, "MAX_TEXT_LOGS", 2)
    claim = LogClaim(team=None, episodes=270, successes=13, success_rate=0.0481, mean_steps=2.0)
    with database.transaction() as session:
        team = session.get_one(Team, make_principal(session).team_id)
        for number, rate in enumerate((0.0481, 0.048, 0.0479)):
            at = datetime(2031, 1, number + 1, tzinfo=UTC)
            made = add_result(session, number, team, {TASK: make_score(13, 270)}, at, kind=SubmissionKind.TEXT_LOG)
            made.submission.manifest = claim.model_copy(update={"success_rate": rate}).stored()
    loaded: list[Evaluation] = []
    with database.transaction() as session:
        event.listen(session, "loaded_as_persistent", lambda _, found: loaded.append(found))
        shown = log_boards.log_boards(session, shown_stage(session, "track_1")).view.text_logs
    assert [entry.claimed_success_rate for entry in shown] == [0.0479, 0.048]
    evaluations = [found for found in loaded if isinstance(found, Evaluation)]
    assert len(evaluations) == 2
    assert all("log_tail" in inspect(found).unloaded for found in evaluations)


# ---- models of the same team ----


def with_model(service: Service, record_of: RecordOf = make_record, content: str = "model") -> Submission:
    with service.database.transaction() as session:
        model = creation.create(session, service.principal, make_upload(content))[0]
    play_all(service.database, model, record_of)
    return model


def parts_from_the_second_step(episode: int, *, task: str = TASK) -> EpisodeRecord:
    if episode != 5:
        return make_record(episode)
    actions = make_record(5).actions.to_array()
    actions[1, 0] = 0.5
    return make_record(5, actions=ActionSequence.from_array(actions))


def test_models_that_give_the_actions_of_a_log_are_told_read_once_and_left_out_where_they_play_another_list(
    service: Service,
) -> None:
    log = resimulated(service, a_log())
    assert service.get(f"/submissions/{log.id}/action-matches").json() == []
    model = with_model(service)
    (match,) = first = service.get(f"/submissions/{log.id}/action-matches").json()
    assert (match["submission_id"], match["submission_name"]) == (str(model.id), "zero")
    assert (match["reproduced"], match["actions"]) == (810, 810)
    assert (match["episodes_reproduced"], match["episodes"], match["others"]) == (270, 270, [])
    with_model(service, parts_from_the_second_step, content="another")
    with service.database.transaction() as session, database_work(session) as work:
        found = action_matches.action_matches(session, CONSOLE, log.id)
    assert work.rows_read["episode_results"] >= 540
    assert [match.reproduced for match in found] == [808, 810]
    assert found[1].model_dump(mode="json") == first[0]
    with service.database.transaction() as session, database_work(session) as work:
        assert action_matches.action_matches(session, CONSOLE, log.id) == found
    assert work.rows_read["episode_results"] == 0
    with service.database.transaction() as session:
        made = sealing.seal(session, CONSOLE, stored_stage(session, model.track, "final"))
        of_model = Evaluation.submission_id == model.id
        session.execute(update(Evaluation).where(of_model).values(commitment=made.commitment))
        left = action_matches.action_matches(session, CONSOLE, log.id)
    assert [match.reproduced for match in left] == [808]


def test_names_the_first_mismatch(service: Service) -> None:
    with_model(service, parts_from_the_second_step)
    log = resimulated(service, a_log())
    (match,) = service.get(f"/submissions/{log.id}/action-matches").json()
    assert (match["reproduced"], match["episodes_reproduced"]) == (808, 269)
    assert match["others"] == [{"episode": 5, "actions": 3, "reproduced": 1, "first_mismatch": 2}]


def test_only_complete_models_of_the_same_team_and_evaluator_are_compared(service: Service) -> None:
    log = resimulated(service, a_log())
    model = with_model(service)
    assert service.get(f"/submissions/{model.id}/action-matches").json() == []
    problem_of(service.get(f"/submissions/{log.id}/action-matches", service.other_token), 404, "not_found")
    others = resimulated(service, a_log(team="Team B"), token=service.other_token)
    assert service.get(f"/submissions/{others.id}/action-matches", service.other_token).json() == []
    with service.database.transaction() as session:
        session.execute(
            text("UPDATE evaluations SET evaluator_version = '0+old' WHERE submission_id = :id"), {"id": model.id}
        )
    assert service.get(f"/submissions/{log.id}/action-matches").json() == []


# ---- the log of an evaluation ----


def test_completed_evaluation_gives_the_log_of_what_was_played(service: Service) -> None:
    model = with_model(service)
    answer = service.get(f"/submissions/{model.id}/log")
    assert answer.headers["content-type"] == "application/x-ndjson"
    reader = LogReader(io.BytesIO(answer.content))
    assert (reader.header.team, reader.header.submission_digest) == ("Team A", model.digest)
    assert reader.header.manifest.evaluator_version == evaluator_version()
    assert [record.record_digest() for record in reader.records()] == [
        record.record_digest() for record in some_records()
    ]


def test_log_of_a_log_can_be_fetched_but_none_of_what_has_no_evaluation(service: Service) -> None:
    log = resimulated(service, a_log())
    reader = LogReader(io.BytesIO(service.get(f"/submissions/{log.id}/log").content))
    assert (reader.header.submission_digest, len(list(reader.records()))) == (None, 270)
    text_log = uploaded(service, a_text_log(), "text_log")
    problem_of(service.get(f"/submissions/{text_log.id}/log"), 409, "no_log")
    waiting = uploaded(service, a_log(team=None))
    problem_of(service.get(f"/submissions/{waiting.id}/log"), 409, "no_log")
    problem_of(service.get(f"/submissions/{log.id}/log?task=lock-opening"), 409, "no_log")
    problem_of(service.get(f"/submissions/{log.id}/log", service.other_token), 404, "not_found")
