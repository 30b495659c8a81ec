from collections.abc import Callable
from copy import deepcopy
from datetime import UTC
from pathlib import Path
from typing import Any

import pytest
from service_factories import TRACK
from vitac.evaluator.strict_model import DocumentRejected
from vitac.evaluator.tracks import ListKind
from vitac.server.competitions.definition import CompetitionDefinition, Judging, read_competition

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


def test_yamls_own_times_are_understood(tmp_path: Path) -> None:
    path = write_competition(tmp_path, make_competition())
    path.write_text(path.read_text().replace(f"'{OPENS.isoformat()}'", "2031-01-01T00:00:00Z"))
    assert "2031-01-01T00:00:00Z" in path.read_text()
    assert read_competition(path).tracks[TRACK].stages[0].opens == OPENS


def set_in(place: Callable[[Content], Content], **values: object) -> Callable[[Content], None]:
    return lambda content: place(content).update(values)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda content: content.update(prices=1), "Unknown key 'prices'"),
        (lambda content: content.pop("title"), "Missing key 'title'"),
        (lambda content: content.update(website="javascript:alert(1)"), "website"),
        (set_in(first, closes=OPENS.isoformat()), "expected a moment after 2031-01-01 00:00:00 UTC"),
        (set_in(first, opens="2031-01-01T00:00:00"), "timezone"),
        (set_in(first, opens="soon"), "opens"),
        (set_in(first, accepts=["model", "film"]), "accepts"),
        (set_in(first, accepts=[]), "stages.stage1.accepts is empty, expected some of model"),
        (set_in(first, qualified={"top": 1}), "first one, so nobody can be qualified"),
        (set_in(second, opens=OPENS.isoformat()), "opens before stage stage1 closes"),
        (set_in(second, name=FIRST), "two stages 'stage1'"),
        (set_in(second, accepts=["log"]), "a sealed list ranks models, and the stage accepts only log"),
        (set_in(second, qualified={"top": 1, "top_share": 0.5}), "exactly one of top, top_share and score_at_least"),
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


def test_the_challenge_of_2025_is_a_valid_competition(repository: Path) -> None:
    found = read_competition(repository / "competitions" / "vitac-2025.yaml")
    pools = {name: sum(prize.amount * prize.winners for prize in track.prizes) for name, track in found.tracks.items()}
    assert pools == {"track_1": 5500, "track_2": 5500, "track_3": 3500}
    assert [stage.quotas.scored_runs for stage in found.tracks["track_1"].stages] == [None, 3]
    assert len(found.tracks["track_3"].stages) == 1
    assert all(track.taken_here for track in found.tracks.values())
    assert found.public_rankings == {}
    assert [stage.title for stage in found.tracks["track_1"].stages][-1] == "Simulated final"
