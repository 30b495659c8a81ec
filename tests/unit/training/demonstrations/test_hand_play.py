"""A person's episodes replay to the bit, are told from an expert's, and are continued."""

from pathlib import Path

import numpy as np
import pytest
from vitac.cli.main import main
from vitac.training.demonstrations.collecting import (
    CollectionRejected,
    DemonstrationKind,
    collect,
    count_outcomes,
    read_demonstrations,
    read_source,
)
from vitac.training.demonstrations.exporting import make_card_of
from vitac.training.demonstrations.frames import make_observed_environment, play_again
from vitac.training.demonstrations.hand_play import HandPlay, NotPlayedByHand

TASK = "peg-insertion"
REST, ASIDE = [0.0, 0.0, 0.0], [1.0, 1.0, 0.5]


def play_to_the_end(played: HandPlay, action: list[float]) -> None:
    while played.end_reason is None:
        played.step(action)


def test_episodes_are_stored_as_demonstrations_that_replay_and_are_continued(tmp_path: Path) -> None:
    played = HandPlay(TASK, tmp_path)
    with played.storing() as path:
        play_to_the_end(played, REST)
        played.begin()
        played.scene_mm()
        play_to_the_end(played, ASIDE)
        played.begin()
        played.step(REST)
    again = HandPlay(TASK, tmp_path)
    with again.storing():
        assert again.number == 3, "the episode that had not ended is begun anew"
        play_to_the_end(again, ASIDE)
    stored, source = list(read_demonstrations(path)), read_source(path)
    assert [each.kind.value for each in stored] == ["human", "human-with-scene", "human"]
    env = make_observed_environment(source.task, ())
    for each in stored:
        assert play_again(env, source, each).rewards.sum() == pytest.approx(each.total_reward, rel=1e-5)
    assert [row["kind"] for row in count_outcomes(path)] == ["human", "human-with-scene"]


def test_what_is_felt_is_the_marker_flow_without_its_padding(tmp_path: Path) -> None:
    played = HandPlay(TASK, tmp_path)
    with played.storing():
        left, right = (np.array(gel) for gel in played.markers_px)
        assert min(len(left), len(right)) > 40
        assert len(np.unique(left, axis=0)) == len(left)
        assert played.motion == [0.0, 0.0, 0.0, 0.0]
        before = np.abs(left[:, 2:] - left[:, :2]).mean()
        played.step([0.0, 1.0, 0.0])
        after = np.array(played.markers_px[0])
        assert np.abs(after[:, 2:] - after[:, :2]).mean() > before


def test_scene_has_both_parts_within_what_is_shown(tmp_path: Path) -> None:
    played = HandPlay("lock-opening", tmp_path)
    with played.storing():
        for loops in played.scene_mm().values():
            corners = np.concatenate([np.array(loop) for loop in loops])
            (low_x, high_x), (low_y, high_y) = played.perspective.section.limits_mm
            assert ((corners >= (low_x, low_y)) & (corners <= (high_x + 30, high_y))).all()


@pytest.mark.parametrize("action", [[0.0, 0.0], [0.0, 0.0, 1.5], [0.0, float("nan"), 0.0]])
def test_actions_that_do_not_fit_are_refused_and_move_nothing(tmp_path: Path, action: list[float]) -> None:
    played = HandPlay(TASK, tmp_path)
    with played.storing():
        with pytest.raises(NotPlayedByHand, match="Expected 3 numbers from -1 to 1"):
            played.step(action)
        assert played.env_steps == 0
        play_to_the_end(played, REST)
        with pytest.raises(NotPlayedByHand, match="has ended"):
            played.step(REST)


def test_an_experts_file_is_not_mixed_with_a_persons(tmp_path: Path) -> None:
    collect(TASK, tmp_path, successes=1)
    with pytest.raises(CollectionRejected, match="another seed, policy or version"), HandPlay(TASK, tmp_path).storing():
        pass


def test_a_task_that_is_not_held_between_gels_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NotPlayedByHand, match="choose another task"):
        HandPlay("pick-cube", tmp_path)


def test_card_says_that_a_person_played_and_what_was_seen(tmp_path: Path) -> None:
    played = HandPlay(TASK, tmp_path, seed=2)
    with played.storing():
        play_to_the_end(played, REST)
    card = make_card_of(tmp_path / TASK)
    assert f"vitac play {TASK} --seed 2 --out DIR" in card
    assert f"| {DemonstrationKind.HUMAN.value} | 1 | 0 |" in card
    assert "An expert" not in card
    with pytest.raises(SystemExit) as ended:
        main(["data", "export", str(tmp_path / TASK), "--to", str(tmp_path / "set"), "--key", "relative_motion"])
    assert ended.value.code == 0
