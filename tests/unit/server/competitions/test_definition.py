from collections.abc import Callable
from copy import deepcopy
from datetime import UTC
from pathlib import Path
from typing import Any

import pytest
from service_factories import TRACK
from vitac.evaluator.strict_model import DocumentRejected
from vitac.evaluator.tracks import ListKind, load_track
from vitac.server.competitions.definition import (
    CompetitionDefinition,
    Judging,
    read_competition,
)

from competitions import CLOSES, FIRST, OPENS, SECOND, make_competition, write_competition

Content = dict[str, Any]


def first(content: Content) -> Content:
    stage: Content = content["tracks"][TRACK]["stages"][0]
    return stage


def second(content: Content) -> Content:
    stage: Content = content["tracks"][TRACK]["stages"][1]
    return stage


def test_a_file_is_read_with_times_in_utc_and_sealed_by_default(tmp_path: Path) -> None:
    content = make_competition()
    first(content)["opens"] = "2031-01-01T01:00:00+01:00"
    found = read_competition(write_competition(tmp_path, content))
    stages = found.tracks[TRACK].stages
    assert [stage.name for stage in stages] == [FIRST, SECOND]
    assert (stages[0].opens, stages[0].opens.tzinfo) == (OPENS, UTC)
    assert [stage.list for stage in stages] == [ListKind.PUBLIC, ListKind.SEALED]
    assert CompetitionDefinition.model_validate(found.model_dump(mode="json")) == found


def set_in(place: Callable[[Content], Content], **values: object) -> Callable[[Content], None]:
    return lambda content: place(content).update(values)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda content: content.update(prices=1), "Unknown key 'prices'"),
        (lambda content: content.pop("title"), "Missing key 'title'"),
        (lambda content: content.update(website="javascript:alert(1)"), "website"),
        (set_in(first, closes=OPENS.isoformat()), "expected a moment after 2031-01-01 00:00:00 UTC"),
        (set_in(first, opens="2031-01-01T00:00:00"), "it has no time zone; write 2031-01-01T00:00:00Z for UTC"),
        (set_in(first, opens="soon"), "opens"),
        (set_in(first, accepts=["model", "film"]), "accepts"),
        (set_in(first, accepts=[]), "stages.stage1.accepts is empty, expected some of model"),
        (set_in(first, qualified={"top": 1}), "first one, so nobody can be qualified"),
        (
            set_in(second, qualified={"top": 1, "after": "track_2/stage1"}),
            "is for teams of track_2/stage1, expected a stage that is played here, one of track_1/stage1,",
        ),
        (
            set_in(first, qualified={"top": 1, "after": "track_1/stage2"}),
            "stage stage1 of track_1 opens before track_1/stage2 closes",
        ),
        (set_in(second, qualified={"top": 1, "after": "stage1"}), "String should match pattern"),
        (set_in(second, qualified={"committee": True, "after": "track_1/stage1"}), "leave out after: track_1/stage1"),
        (set_in(second, opens=OPENS.isoformat()), "opens before stage stage1 closes"),
        (set_in(second, name=FIRST), "two stages 'stage1'"),
        (set_in(second, accepts=["log"]), "a sealed list ranks models, and the stage accepts only log"),
        (
            set_in(second, qualified={"top": 1, "top_share": 0.5}),
            "exactly one of top, top_share, score_at_least and committee",
        ),
        (set_in(second, qualified={}), "exactly one of"),
        (set_in(second, qualified={"top": 0}), "greater than 0"),
        (set_in(second, qualified={"top_share": 1.5}), "less than or equal to 1"),
        (set_in(second, quotas={"scored_runs": 0}), "greater than 0"),
        (lambda content: content["tracks"].update(track_9=content["tracks"].pop(TRACK)), "there is no such track"),
        (lambda content: content["tracks"][TRACK].update(ranking=["success_rate"]), "must end with submitted_at"),
        (
            lambda content: content["tracks"][TRACK].update(ranking=["submitted_at"] * 2),
            "ranking names submitted_at twice",
        ),
        (
            lambda content: content["tracks"][TRACK].update(prizes=[{"place": "first", "amount": 1}] * 2),
            "two prizes 'first'",
        ),
        (lambda content: content["tracks"].clear(), "tracks"),
        (
            lambda content: content["tracks"][TRACK].update(picture="peg-insertoin"),
            "tracks.track_1.picture: There is no task 'peg-insertoin'; did you mean peg-insertion?",
        ),
        (
            lambda content: content["tracks"][TRACK].update(judging={"criteria": [{"name": "a", "title": "A"}]}),
            "judging.weights.figures: expected 0, got 0.2; teams bring no sensors to this track",
        ),
        (
            lambda content: content["tracks"][TRACK].update(
                judging={"criteria": [{"name": "a", "title": "A"}], "weights": {"success": 0.5, "judges": 0.5}}
            ),
            "expected weights that add up to 1, got 0.5 for success, 0.5 for judges and 0.2 for figures",
        ),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, spoil: Callable[[Content], object], said: str) -> None:
    content = deepcopy(make_competition())
    spoil(content)
    with pytest.raises(DocumentRejected) as refused:
        read_competition(write_competition(tmp_path, content))
    assert said in str(refused.value)


EXPECTED = "expected a moment with its time zone, such as 2025-02-01T00:00:00Z; "


@pytest.mark.parametrize(
    ("written", "remedy", "got"),
    [
        ("12:30", "write a whole date with its time and zone", "12:30"),
        ("20250101", "write a whole date with its time and zone", "20250101"),
        ("no", "write a whole date with its time and zone", "no, which YAML reads as false"),
        ("", "write one after the colon", "nothing"),
        ("2031-02-30T00:00:00Z", "February 2031 has 28 days; write one of them", None),
        ("2031-13-01T00:00:00Z", "there is no month 13; write YYYY-MM-DD", None),
        ("2031-01-01", "it has no time and zone; write 2031-01-01T00:00:00Z for the first moment", None),
        ("2031-01-01 7:05", "it has no time zone; write 2031-01-01T07:05:00Z for UTC, or an offset", None),
        ("2031-01-01T12:30 PM", "write the hours from 00 to 23, without AM or PM", None),
        ("2031-12-31 24:00 +01:00", "a day ends where the next one begins; write 2032-01-01T00:00:00+01:00", None),
        ("2031-01-01T25:00:00Z", "hours go from 00 to 23", None),
        ("2031/01/01 12:00:00Z", "write the date as YYYY-MM-DD", None),
        ("01.02.2031 12:00", "write the date as YYYY-MM-DD", None),
        ("2031-01-01T12.30.00Z", "write the time as HH:MM:SS, after a T", None),
        ("2031-01-01 00:00 UTC", "write 2031-01-01T00:00:00Z", None),
        ("2031-01-01 00:00 Europe/Berlin", "write the zone as Z for UTC or as +01:00", None),
        ("2031-01-01T00:00:00+25:00", "an offset goes from -23:59 to +23:59", None),
        ("9999-12-31T23:59:59-23:00", "years go from 1900 to 9998", None),
        ("2031–01–01T00:00:00Z", "write it with plain characters", None),
        ("soon", "write it in this form", None),
    ],
)
def test_a_wrong_moment_is_shown_as_it_was_written_with_what_to_write(
    tmp_path: Path, written: str, remedy: str, got: str | None
) -> None:
    path = write_competition(tmp_path, make_competition())
    path.write_text(path.read_text().replace(f"'{OPENS.isoformat()}'", written))
    with pytest.raises(DocumentRejected) as refused:
        read_competition(path)
    assert f"stages.0.opens: {EXPECTED}{remedy}" in str(refused.value)
    assert str(refused.value).endswith(f" (got: {repr(written) if got is None else got})."), "nothing follows"


@pytest.mark.parametrize(
    "written", ["2031-01-01T00:00:00Z", "2031-01-01T00:00Z", "2031-1-1 0:00:00 +00", "2031-01-01T01:00:00.000+0100"]
)
def test_a_moment_may_be_written_in_every_usual_form(tmp_path: Path, written: str) -> None:
    path = write_competition(tmp_path, make_competition())
    path.write_text(path.read_text().replace(f"'{OPENS.isoformat()}'", written))
    assert read_competition(path).tracks[TRACK].stages[0].opens == OPENS


@pytest.mark.parametrize(
    ("line", "written", "said"),
    [
        ("title: The cup", "title: 12:30", 'title: expected text; put it in quotes, "12:30" (got: 12:30).'),
        ("name: cup", "name: no", 'name: expected text; put it in quotes, "no" (got: no, which YAML reads as false).'),
        ("name: cup", "name: 010", 'name: expected text; put it in quotes, "010" (got: 010).'),
        ("title: The cup", "title:", "title: expected text after the colon (got: nothing)."),
        ("title: The cup", "anonymous: 12:30", "anonymous: Input should be a valid boolean (got: 12:30)."),
        ("title: Touch", "title: yes", 'put it in quotes, "yes" (got: yes, which YAML reads as true).'),
        ("scored_runs: 2", "scored_runs: yes", "scored_runs: Input should be a valid integer (got: yes, which YAML"),
        ("scored_runs: 2", "scored_runs: 010", "write a number of base 10 without zeros before it (got: 010)."),
        ("title: The cup", "title: a: b", "in line 3: 'title: a: b'. Correct the file. Text with a colon"),
        (
            "- model\n",
            "- no\n",
            "accepts.0: Input should be 'model', 'image', 'log', 'remote' or 'text_log' (got: no, which YAML",
        ),
    ],
)
def test_a_wrong_value_is_shown_as_it_was_written(tmp_path: Path, line: str, written: str, said: str) -> None:
    path = write_competition(tmp_path, make_competition())
    assert line in path.read_text()
    path.write_text("\n" + path.read_text().replace(line, written, 1))
    with pytest.raises(DocumentRejected) as refused:
        read_competition(path)
    assert said in str(refused.value)


def test_a_track_may_take_its_submissions_elsewhere(tmp_path: Path) -> None:
    content = make_competition()
    content["tracks"]["track_9"] = {
        "title": "Sensors by mail",
        "taken_here": False,
        "stages": [{"name": FIRST, "title": "Design", "opens": OPENS.isoformat(), "closes": CLOSES.isoformat()}],
    }
    found = read_competition(write_competition(tmp_path, content))
    assert not found.tracks["track_9"].taken_here


def test_a_file_that_is_not_there_or_no_text_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DocumentRejected, match="cannot be read"):
        read_competition(tmp_path / "none.yaml")
    (tmp_path / "bytes.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DocumentRejected, match="cannot be read"):
        read_competition(tmp_path / "bytes.yaml")


@pytest.mark.parametrize(
    ("rule", "sentence"),
    [
        ({"top": 3}, "the best 3 teams of the stage before"),
        ({"top_share": 0.25}, "the best 25 % of the registered teams, by the stage before"),
        ({"score_at_least": 0.5}, "every team with a success rate of 50 % or more in the stage before"),
        ({"top": 1, "after": "track_1/stage1"}, "the best team of stage stage1 of track_1"),
    ],
)
def test_a_rule_is_said_in_words(rule: Content, sentence: str) -> None:
    content = make_competition()
    second(content)["qualified"] = rule
    found = CompetitionDefinition.model_validate(content).tracks[TRACK].stages[1]
    assert found.qualified is not None
    assert found.qualified.sentence == sentence


def test_judging_is_said_in_words() -> None:
    criteria = [{"name": "idea", "title": "The idea"}, {"name": "proof", "title": "Its proof"}]
    weights = {"success": 0.75, "judges": 0.25, "figures": 0}
    found = Judging.model_validate({"criteria": criteria, "judges_at_least": 1, "weights": weights})
    assert found.sentence == (
        "At least 1 judge gives marks from 0 to 10 for: The idea, Its proof. The total, by which prizes go, is 75 % "
        "the success rate, 25 % the judges' mean mark."
    )
    assert "2 judges give" in Judging.model_validate({"criteria": criteria}).sentence
    assert "20 % the figures of the sensor" in Judging.model_validate({"criteria": criteria}).sentence


def test_the_challenge_of_2024_is_over_and_plays_the_tasks_of_2024(repository: Path) -> None:
    found = read_competition(repository / "competitions" / "vitac-2024.yaml")
    assert [stage.closes.year for track in found.tracks.values() for stage in track.stages] == [2024]
    assert [list(load_track(name).tasks) for name in found.tracks] == [["peg-insertion-2024", "lock-opening-2024"]]
    assert found.public_rankings == {}


def test_the_final_of_2025_is_played_on_stations_by_a_plan(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VITAC_TRACKS_DIR", str(repository / "competitions" / "tracks"))
    file = tmp_path / "cup.yaml"
    file.write_text(
        (repository / "competitions" / "vitac-2025.yaml").read_text().replace("    taken_here: false\n", "")
    )
    found = read_competition(file)
    stages = [found.tracks[name].stages[0] for name in ("station", "station_fusion")]
    assert [stage.quotas.attempts for stage in stages] == [3, 3]
    assert [stage.qualified.after for stage in stages if stage.qualified] == ["track_1/stage1", "track_2/stage1"]
    assert all(stage.plan is not None for stage in stages)
    tasks = [task for name in ("station", "station_fusion") for task in load_track(name).tasks.values()]
    assert [len(task.episodes) for task in tasks] == [150, 150]


def test_the_challenge_of_2025_is_a_valid_competition(repository: Path) -> None:
    found = read_competition(repository / "competitions" / "vitac-2025.yaml")
    pools = {name: sum(prize.amount * prize.winners for prize in track.prizes) for name, track in found.tracks.items()}
    assert {name: pool for name, pool in pools.items() if pool} == {"track_1": 5500, "track_2": 5500, "track_3": 3500}
    assert [stage.quotas.scored_runs for stage in found.tracks["track_1"].stages] == [None, 3]
    assert len(found.tracks["track_3"].stages) == 1
    elsewhere = [name for name, track in found.tracks.items() if not track.taken_here]
    assert elsewhere == ["station", "station_fusion"], "a service without stations takes the rest"
    assert found.public_rankings == {}
    assert [stage.title for stage in found.tracks["track_1"].stages][-1] == "Simulated final"
