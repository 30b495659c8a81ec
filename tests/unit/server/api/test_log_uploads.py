"""What comes in the place of a log, and how each is refused: by a stable code, the line and the reason."""

import gzip
import json
import resource
from collections.abc import Iterator
from pathlib import Path

import pytest
from service_client import Service, problem_of, running_service
from service_factories import TRACK, make_failed_record, make_principal, make_record, make_secret
from text_log_writer import text_log
from uploaded_logs import a_log, a_text_log, packed, some_records, upload_log
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.evaluator.logs.text_2025 import Script
from vitac.evaluator.logs.text_2025.scripts import all_scripts
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import load_track
from vitac.evaluator.tracks.definition import cut
from vitac.evaluator.version import platform_class
from vitac.server import tracks
from vitac.server.database.engine import Database

LOG = a_log()
LINES = LOG.splitlines(keepends=True)
TEXT_LOG = a_text_log()
TEXT_LINES = TEXT_LOG.splitlines(keepends=True)
GIGABYTE = 1 << 30


def failures(episodes: set[int]) -> list[EpisodeRecord]:
    return [make_failed_record(n) if n in episodes else make_record(n) for n in range(1, 271)]


def test_log_is_accepted_with_its_claims_and_jobs_and_packed_the_same_submission(service: Service) -> None:
    answer = upload_log(service, LOG)
    assert answer.status_code == 202, answer.text
    found = answer.json()
    assert (found["kind"], found["tasks"], found["evaluation"]["state"]) == ("log", ["peg-insertion"], "queued")
    claimed = found["log"]
    assert (claimed["label"], claimed["verdict"]) == ("actions verified, policy not seen", None)
    assert (claimed["claimed_episodes"], claimed["claimed_success_rate"]) == (270, 1.0)
    assert (claimed["team_named"], claimed["made_on"]) == ("Team A", platform_class())
    assert service.count("work") == len(cut(load_track(TRACK).tasks["peg-insertion"]))
    again = upload_log(service, packed(LOG))
    assert (again.status_code, again.json()["id"]) == (200, found["id"])
    assert service.count("evaluations") == 1


def test_log_may_name_no_team_or_its_own_in_another_spelling_and_its_policy_may_fail(service: Service) -> None:
    for log in (a_log(team=None), a_log(team="  team  a "), a_log(failures({1, 2, 31}))):
        assert upload_log(service, log).status_code == 202


def test_log_that_names_another_team_is_refused_also_from_an_organizer(service: Service) -> None:
    for token, query in ((service.other_token, ""), (service.organizer_token, "&team=Team B")):
        problem = problem_of(upload_log(service, LOG, token=token, query=query), 422, "log_team_mismatch")
        assert problem["line"] == 1
        assert "'Team A'" in problem["detail"]
        assert "'Team B'" in problem["detail"]
    service.assert_nothing_left()
    assert upload_log(service, LOG, token=service.organizer_token, query="&team=Team A").status_code == 202


def test_damaged_log_is_refused_by_line_and_reason(service: Service) -> None:
    for log, reason, line in [
        (b"\x00\xff\xfe\x80" * 100, "not_a_log", 1),
        (LOG.replace(LINES[5], LINES[5].replace(b'"total_reward":1.0', b'"total_reward":NaN')), "not_json", 6),
        (b"".join(LINES[:100]), "truncated", 101),
        (packed(LOG)[:-100], "damaged", None),
    ]:
        problem = problem_of(upload_log(service, log), 422, "log_rejected")
        assert (problem["reason"], problem["line"]) == (reason, line), problem["detail"]
        assert line is None or problem["detail"].startswith(f"Line {line}: ")
        service.assert_nothing_left()


def test_log_that_no_evaluation_can_have_made_is_refused_at_once(service: Service) -> None:
    for log, reason, line, episode in [
        (a_log(evaluator_version="0+old"), "other_evaluation", 1, None),
        (a_log(some_records()[1:]), "episode_missing", 271, 1),
        (a_log(failures({1, 2, 3})), "broken_policy", 272, 1),
    ]:
        problem = problem_of(upload_log(service, log), 422, "log_impossible")
        assert (problem["reason"], problem["line"], problem["episode"]) == (reason, line, episode), problem["detail"]
        service.assert_nothing_left()


def endless_line() -> Iterator[bytes]:
    piece = b'{"format":"vitac-log",' + b" " * (1 << 20)
    for _ in range(GIGABYTE // len(piece)):
        yield piece


def peak_bytes() -> int:
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def test_line_of_a_gigabyte_is_cut_off_at_the_limit_on_disk_and_in_memory(service: Service) -> None:
    before = peak_bytes()
    problem = problem_of(upload_log(service, endless_line()), 413, "upload_too_large")
    assert problem["limit_bytes"] == service.settings.log_bytes
    assert peak_bytes() - before < 100 << 20
    service.assert_nothing_left()


def test_size_that_is_announced_is_refused_before_the_body(service: Service) -> None:
    problem = problem_of(upload_log(service, endless_line(), Content_Length=str(GIGABYTE)), 413, "upload_too_large")
    assert str(GIGABYTE) in problem["detail"]


@pytest.mark.parametrize(("kind", "reason"), [("log", "line_too_long"), ("text_log", "not_a_text_log")])
def test_line_of_a_gigabyte_hidden_in_a_small_gzip_is_refused_in_little_memory(
    service: Service, kind: str, reason: str
) -> None:
    bomb = gzip.compress(b"{" * (1 << 20)) * 1024
    before = peak_bytes()
    problem = problem_of(upload_log(service, bomb, kind), 422, "log_rejected")
    assert (problem["reason"], problem["line"]) == (reason, 1)
    assert peak_bytes() - before < 100 << 20
    service.assert_nothing_left()


def test_gzip_that_unpacks_to_more_than_the_limit_is_refused(database: Database, tmp_path: Path) -> None:
    with running_service(database, tmp_path, log_bytes=len(LOG) - 1) as service:
        problem = problem_of(upload_log(service, packed(LOG)), 422, "log_rejected")
        assert (problem["reason"], problem["line"]) == ("too_large", None)
        service.assert_nothing_left()


def test_wrong_content_type_says_which_are_right(service: Service) -> None:
    problem = problem_of(service.upload(LOG, query="?kind=log"), 415, "unsupported_content_type")
    assert problem["supported"] == ["application/x-ndjson", "application/jsonl", "application/gzip"]


def test_request_and_log_must_agree_on_the_track(service: Service) -> None:
    problem_of(upload_log(service, LOG, query="&track=track_9"), 404, "unknown_track")
    assert upload_log(service, LOG, query="&track=track_1").status_code == 202


def test_kinds_that_a_track_does_not_take_are_refused_by_name(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    only_models = load_track(TRACK).model_copy(update={"accepts": (SubmissionKind.MODEL,)})
    monkeypatch.setattr(tracks, "load_track", lambda _: only_models)
    for query in ("&track=track_1", ""):
        problem = problem_of(upload_log(service, LOG, query=query), 422, "unsupported_submission_kind")
        assert problem["supported"] == ["model"]
    service.assert_nothing_left()


# ---- 2025 text logs ----


def test_text_log_is_accepted_with_what_it_claims_and_what_is_wrong_with_it(service: Service) -> None:
    answer = upload_log(service, TEXT_LOG, "text_log")
    assert answer.status_code == 202, answer.text
    found = answer.json()
    assert (found["kind"], found["tasks"]) == ("text_log", ["peg-insertion"])
    assert (found["log"]["label"], found["log"]["verdict"]) == ("2025 text log", None)
    assert (found["log"]["claimed_success_rate"], found["log"]["claimed_mean_steps"]) == (0.0481, 2.0)
    assert any("the action does not lead to offset" in problem for problem in found["log"]["problems"])
    assert upload_log(service, packed(TEXT_LOG), "text_log").json()["id"] == found["id"]


def changed_test(number: int, old: bytes, new: bytes) -> bytes:
    """The text log with something replaced in one test."""
    before, mark, after = TEXT_LOG.partition(f"#### Test No. {number} ####".encode())
    return before + mark + after.replace(old, new, 1)


def test_text_log_that_is_not_one_whole_evaluation_or_of_another_team_is_refused(service: Service) -> None:
    for log, code, reason in [
        (b"\x00\xff" * 100, "log_rejected", "not_a_text_log"),
        (b"".join(TEXT_LINES[:-2]), "log_rejected", "truncated"),
        (changed_test(3, b"0.25", b"1.25"), "log_impossible", "wrong_action"),
        (a_text_log(totals=(), episodes=[]), "log_impossible", "episode_missing"),
        (a_text_log(team="Touch"), "log_team_mismatch", None),
    ]:
        problem = problem_of(upload_log(service, log, "text_log"), 422, code)
        assert problem.get("reason") == reason, problem["detail"]
        service.assert_nothing_left()


def test_problems_of_a_text_log_are_kept_short_and_printable(service: Service) -> None:
    control = rb"'\x00\ud800\x1b[2J" + b"A" * 1000 + b"'"
    digits = b"[" + (b"9" * 308 + b", ") * 3 + b"]"
    log = changed_test(3, b"'steps': 1", b"'steps': " + control).replace(
        b"'gt_offset_mm_deg': array([-4., -4., -8.])", b"'gt_offset_mm_deg': array(" + digits + b")", 1
    )
    answer = upload_log(service, log, "text_log")
    assert answer.status_code == 202, answer.text
    found = answer.json()["log"]["problems"]
    assert any(r"in info steps, got '\x00\ud800\x1b[2J" in problem for problem in found)
    assert all(problem.isprintable() and len(problem) <= 200 for problem in found)
    assert any(len(problem) == 200 for problem in found)


# ---- the organizers' own logs ----

LOGS = {
    "track 1 peg insertion": ("track_1", "peg-insertion", "track1_peg_insertion"),
    "track 1 lock opening": ("track_1", "lock-opening", "track1_open_lock"),
    "track 2 peg insertion": ("track_2", "fusion-insertion", "track2_peg_insertion_v2"),
    "track 3 peg insertion": ("track_3", "sensor-design", "track3_peg_insertion"),
    "peg insertion of 2024": ("vitac_2024", "peg-insertion-2024", ""),
    "lock opening of 2024": ("vitac_2024", "lock-opening-2024", ""),
}


@pytest.fixture
def team_1(service: Service) -> str:
    """The token of the team that the organizers' logs name."""
    with service.database.transaction() as session:
        return make_secret(session, make_principal(session, "1"))


@pytest.mark.parametrize("script", all_scripts(), ids=lambda script: script.name)
def test_a_log_of_each_script_goes_in_without_a_track(service: Service, team_1: str, script: Script) -> None:
    track, task, _ = LOGS[script.name]
    tests = [
        {"episode": number, "steps": [{"n": 1, "action": (0.5,) * script.action_size}], "result": "FAIL"}
        | ({"initial_offset": start.offset} if script.logs_offsets else {})
        for number, start in enumerate(script.starts(), start=1)
    ]
    totals = ("#SUCCESS_RATE: 0", "#AVG_STEP: NA")
    log = text_log(tests, script.environment, next(iter(script.md5), ""), totals, team="1").encode()
    answer = upload_log(service, log, "text_log", team_1)
    assert answer.status_code == 202, answer.text
    found = answer.json()
    assert (found["track"], found["tasks"], found["log"]["team_named"]) == (track, [task], "1")
    assert "systematically" in found["log"]["reason"]


def test_the_organizers_vision_log_goes_in_unchanged(service: Service, team_1: str, reference_dir: Path) -> None:
    log = (reference_dir / "logs" / "track2_peg_insertion_v2.log").read_bytes()
    found = upload_log(service, log, "text_log", team_1).json()
    assert (found["track"], found["log"]["claimed_success_rate"], found["log"]["problems"]) == ("track_2", 0.0, [])


@pytest.mark.parametrize(
    ("name", "rate", "mean_steps"),
    [
        ("track 1 peg insertion", 0.1481, 4.5),
        ("track 1 lock opening", 0.9062, 6.34),
        ("track 3 peg insertion", 0.1593, 5.86),
    ],
)
def test_the_organizers_other_logs_go_in_as_far_as_the_reference_holds_them(
    service: Service, reference_dir: Path, name: str, rate: float, mean_steps: float
) -> None:
    """It holds one repeat of each, and header and totals: here every repeat has the actions of the first."""
    script = next(script for script in all_scripts() if script.name == name)
    track, task, file = LOGS[name]
    header = json.loads((reference_dir / "logs" / f"{file}.header.json").read_text())
    lines = (reference_dir / "logs" / f"{file}.repeat0.jsonl").read_text().splitlines()
    first = {(line["shape"], *line["initial_offset"][:3]): line for line in map(json.loads, lines)}
    tests = []
    for number, start in enumerate(script.starts(), start=1):
        logged = first[start.part, *start.offset[:3]]
        offset = {"initial_offset": logged["initial_offset"]} if script.logs_offsets else {}
        tests.append({"episode": number, "steps": logged["steps"], "result": logged["result"]} | offset)
    totals = (header["success_rate_line"], header["avg_step_line"])
    team = header["team_key"]
    with service.database.transaction() as session:
        token = make_secret(session, make_principal(session, team))
    log = text_log(tests, header["env"], header["script_md5"], totals, team=team).encode()
    answer = upload_log(service, log, "text_log", token)
    assert answer.status_code == 202, answer.text
    found = answer.json()
    assert (found["track"], found["tasks"]) == (track, [task])
    claims = found["log"]
    assert (claims["claimed_success_rate"], claims["claimed_mean_steps"]) == (pytest.approx(rate), mean_steps)
