from pathlib import Path
from typing import Any

import pytest
from service_client import Service, make_archive, problem_of
from service_factories import LOCK, TASK, TRACK, RecordOf, make_score, play_all, submit_scored, successes_below
from vitac.evaluator.tracks import registry
from vitac.server.accounts import teams
from vitac.server.database.models import Submission
from vitac.server.database.states import Role
from vitac.server.leaderboards.baselines import HUMAN
from vitac.server.principals import Principal


def evaluated(service: Service, token: str, policy: str, record_of: RecordOf) -> str:
    answer = service.upload(make_archive(policy=policy), token)
    with service.database.transaction() as session:
        submission = session.get_one(Submission, answer.json()["id"])
    play_all(service.database, submission, record_of)
    return str(submission.id)


def test_tracks_tell_tasks_and_limits_to_everybody(service: Service) -> None:
    listed = service.client.get("/api/v1/tracks").json()["items"]
    track = next(item for item in listed if item["name"] == TRACK)
    assert service.client.get(f"/api/v1/tracks/{TRACK}").json() == track
    assert next(task["episodes"] for task in track["tasks"] if task["name"] == TASK) == 270
    assert track["limits"]["archive_packed_bytes"] == service.settings.limits.archive_packed_bytes
    problem_of(service.client.get("/api/v1/tracks/none"), 404, "unknown_track")


def test_the_file_of_a_track_is_for_everybody(
    service: Service, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    own = (Path(registry.__file__).parent / f"{TRACK}.yaml").read_text().replace(f"name: {TRACK}", "name: own", 1)
    (tmp_path / "own.yaml").write_text(own)
    monkeypatch.setenv("VITAC_TRACKS_DIR", str(tmp_path))
    assert service.client.get("/api/v1/tracks/own/file").text == own
    assert f"name: {TRACK}" in service.client.get(f"/api/v1/tracks/{TRACK}/file").text
    problem_of(service.client.get("/api/v1/tracks/none/file"), 404, "unknown_track")


def test_empty_leaderboard_has_no_entries_and_unknown_one_is_refused(service: Service) -> None:
    board = service.client.get(f"/api/v1/leaderboards/{TRACK}").json()
    assert (board["entries"], board["teams"], board["track"]) == ([], 0, TRACK)
    problem_of(service.client.get("/api/v1/leaderboards/none"), 404, "unknown_track")
    problem = problem_of(service.client.get(f"/api/v1/leaderboards/{TRACK}?task=none"), 404, "unknown_task")
    assert problem["tasks"] == [TASK, LOCK]


def test_leaderboard_shows_the_best_completed_entry_of_each_team(service: Service) -> None:
    evaluated(service, service.token, "x = 1", successes_below(100))
    best = evaluated(service, service.token, "x = 2", successes_below(200))
    evaluated(service, service.token, "x = 3", successes_below(50))
    winner = evaluated(service, service.other_token, "x = 4", successes_below(201))
    service.upload(make_archive(policy="x = 5"), service.other_token)
    board = service.client.get(f"/api/v1/leaderboards/{TRACK}?task={TASK}").json()
    assert [(entry["rank"], entry["submission_id"]) for entry in board["entries"]] == [(1, winner), (2, best)]
    first = board["entries"][0]
    assert first["list_kind"] == "public"
    assert (first["team"], first["episodes"], first["successes"], first["mean_steps"]) == ("Team B", 270, 200, 3.0)
    low, high = first["success_rate_interval"]
    assert low < first["success_rate"] < high
    assert [shape["episodes"] for shape in first["scores"][0]["shapes"]] == [90, 90, 90]


def test_a_leaderboard_is_sent_in_pages_and_searched(service: Service) -> None:
    with service.database.transaction() as session:
        bees = Principal(role=Role.TEAM, team_id=teams.find(session, "Team B").id, team_name="Team B")
        for by, successes in ((service.principal, 40), (bees, 41)):
            submit_scored(session, by, by.team_name or "", {TASK: make_score(successes)})
    address = f"/api/v1/leaderboards/{TRACK}?task={TASK}"
    first, second = (service.client.get(f"{address}&limit=1&after={after}").json() for after in (0, 1))
    assert [(entry["rank"]) for page in (first, second) for entry in page["entries"]] == [1, 2]
    assert [(page["teams"], page["next_after"]) for page in (first, second)] == [(2, 1), (2, None)]
    assert service.client.get(f"{address}&limit=1&after=5").json()["entries"] == []
    assert service.client.get(f"/api/v1/leaderboards/{TRACK}/logs?limit=1").json()["next_after"] is None
    problem_of(service.client.get(f"/api/v1/leaderboards/{TRACK}?limit=501"), 422, "invalid_request")
    found = service.client.get(f"{address}&q=team+a").json()
    assert [(entry["rank"], entry["team"]) for entry in found["entries"]] == [(2, "Team A")]
    assert (found["teams"], found["baselines"]) == (2, [])
    assert service.client.get(f"{address}&until=2020-01-01").json()["entries"] == []
    baselines = service.client.get(f"{address}&rows=baselines").json()
    assert (baselines["entries"], len(baselines["baselines"])) == ([], 2)
    assert service.client.get(f"/api/v1/leaderboards/{TRACK}/logs?q=nobody&since=2020-01-01").json()["text_logs"] == []
    problem_of(service.client.get(f"{address}&since=yesterday"), 422, "invalid_request")


def test_leaderboard_that_a_client_has_is_not_sent_again_until_it_changes(service: Service) -> None:
    address = f"/api/v1/leaderboards/{TRACK}"
    evaluated(service, service.token, "x = 1", successes_below(100))
    first = service.client.get(address)
    assert first.headers["etag"] == f'W/"{first.json()["revision"]}"'
    again = service.client.get(address, headers={"If-None-Match": f'"other", {first.headers["etag"]}'})
    assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", first.headers["etag"])
    assert service.client.get(f"{address}?task={TASK}").headers["etag"] != first.headers["etag"]
    evaluated(service, service.token, "x = 2", successes_below(50))  # worse: changes nothing
    assert service.client.get(address).content == first.content
    evaluated(service, service.token, "x = 3", successes_below(101))
    changed = service.client.get(address, headers={"If-None-Match": first.headers["etag"]})
    assert (changed.status_code, changed.json()["entries"][0]["successes"]) == (200, 100)


def test_what_people_solve_by_hand_stands_beside_a_boards_entries_until_it_is_removed(service: Service) -> None:
    address, board = f"/api/v1/tracks/{TRACK}/tasks/{TASK}/human-baseline", f"/api/v1/leaderboards/{TRACK}?task={TASK}"
    organizer = {"Authorization": f"Bearer {service.organizer_token}"}

    def publish(*episodes: tuple[str, bool, int], **measures: float) -> Any:
        listed = [
            {"shape": shape, "is_solved": solved, "env_steps": steps, "measures": measures}
            for shape, solved, steps in episodes
        ]
        return service.client.put(address, json={"episodes": listed}, headers=organizer)

    def shown() -> list[tuple[str, int, int, float | None]]:
        rows = service.client.get(board).json()["baselines"]
        return [(one["name"], one["successes"], one["episodes"], one["mean_steps"]) for one in rows if one["is_human"]]

    assert shown() == []
    revision = service.client.get(board).json()["revision"]
    assert publish(("cuboid", False, 5)).json()["mean_steps"] is None
    assert shown() == [(HUMAN, 0, 1, None)]
    assert service.client.get(board).json()["revision"] != revision
    publish(("cuboid", True, 4), ("cuboid", False, 12), ("concave1", True, 6))
    assert shown() == [(HUMAN, 2, 3, 5.0)]
    trained, human, heuristic = service.client.get(board).json()["baselines"]
    assert [one["is_human"] for one in (trained, human, heuristic)] == [False, True, False]
    low, high = human["success_rate_interval"]
    assert low < 2 / 3 < high
    problem_of(publish(("cube", True, 4)), 422, "invalid_request")
    problem_of(publish(("cuboid", True, 4), height=1.0), 422, "invalid_request")
    assert publish(("cuboid", True, 4), surface_diff_mm=0.5).json()["measures"] == {"surface_diff_mm": 0.5}
    publish(("cuboid", True, 4), ("cuboid", False, 12), ("concave1", True, 6))
    problem_of(publish(), 422, "invalid_request")
    assert shown() == [(HUMAN, 2, 3, 5.0)]
    assert service.client.delete(address, headers=organizer).status_code == 204
    assert shown() == []
    problem_of(service.client.delete(address, headers=organizer), 404, "not_found")
