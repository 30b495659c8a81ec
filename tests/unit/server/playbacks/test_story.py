"""What happened in an episode, from its record alone."""

from typing import Any

import numpy as np
import pytest
from recorded_forces import some_forces
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome, EpisodeRecord
from vitac.server.playbacks.story import Mark, tell_story

PEG = "ViTac/PegInsertion-v1"


def a_record(outcome: EpisodeOutcome, *env_steps: tuple[float, float, float]) -> EpisodeRecord:
    """An episode of the peg: of each env step both surfaces' motions and the height of the peg's corners [mm]."""
    infos: list[dict[str, Any]] = [
        {
            "surface_diff_m": [1e-3 * left, 1e-3 * right],
            "peg_relative_z_mm": [height] * 8,
            "gt_offset_mm_deg": [1.0, -2.0, 3.0],
        }
        for left, right, height in env_steps
    ]
    return EpisodeRecord(
        episode=1,
        task="peg-insertion",
        shape="cuboid",
        initial_offset=(1.0, -2.0, 3.0),
        outcome=outcome,
        env_steps=len(infos),
        total_reward=0.0,
        actions=ActionSequence.from_array(np.zeros((len(infos), 3), dtype=np.float32)),
        state_hashes=("0" * 64,) * (len(infos) + 1),
        infos=tuple(infos),
    )


def moments(record: EpisodeRecord) -> list[tuple[int, str]]:
    return [(moment.env_step, moment.mark) for moment in tell_story(record, PEG).moments]


def test_a_solved_episode_says_when_the_peg_touched_and_how_far_gels_moved() -> None:
    record = a_record(EpisodeOutcome.SUCCESS, (0.1, 0.1, 2.0), (0.3, 0.9, 1.0), (0.1, 0.1, -0.4))
    record.infos[-1]["gt_offset_mm_deg"] = [0.5, 0.0, 0.0]
    assert tell_story(record, PEG).sentence == (
        "The peg went in after three moves. It touched at env step 2 (offset x +1.00 mm, y −2.00 mm, θ +3.00°) and "
        "ended at offset x +0.50 mm, y +0.00 mm, θ +0.00°; no gel’s surface moved by more than 0.90 mm."
    )
    assert moments(record) == [(2, Mark.TOUCH), (3, Mark.SLIP), (3, Mark.SOLVED)]


def test_an_episode_that_moved_a_gel_too_far_says_which_and_where_the_peg_was() -> None:
    record = a_record(EpisodeOutcome.TACTILE, (1.7, 0.4, 1.2))
    assert tell_story(record, PEG).sentence == (
        "The left gel was pushed too far after one move: its surface had moved by 1.70 mm (limit 1.5 mm), with the peg "
        "1.5 mm short of its goal (offset x +1.00 mm, y −2.00 mm, θ +3.00°)."
    )
    assert moments(record) == [(1, Mark.TOUCH), (1, Mark.LIMIT)]
    assert tell_story(record, PEG).moments[-1].text == "a gel has moved too far"


@pytest.mark.parametrize(("heights", "stuck"), [((2.0, 1.0, 1.0, 1.0), 2), ((2.0, 1.5, 1.0, 0.5), None)])
def test_an_episode_is_stuck_from_where_the_peg_comes_no_nearer(heights: tuple[float, ...], stuck: int | None) -> None:
    record = a_record(EpisodeOutcome.STEPS, *((0.1, 0.1, height) for height in heights))
    assert [step for step, mark in moments(record) if mark == Mark.STUCK] == ([] if stuck is None else [stuck])
    assert tell_story(record, PEG).sentence.startswith(
        "The peg did not get there: all four moves were used up, with the peg "
    )


def test_a_task_that_cannot_be_drawn_says_how_the_episode_ended() -> None:
    record = a_record(EpisodeOutcome.STEPS, (0.0, 0.0, 0.0))
    story = tell_story(record, "PickCube-v1")
    assert (story.sentence, story.moments) == (EpisodeOutcome.STEPS.sentence, ())


def test_a_record_with_forces_says_the_largest_and_what_the_limit_was() -> None:
    steps = (0.1, 0.1, 2.0), (0.1, 0.1, -0.4)
    solved = a_record(EpisodeOutcome.SUCCESS, *steps).model_copy(update={"forces": some_forces(12.34)})
    assert tell_story(solved, PEG).sentence.endswith("0.10 mm; the largest force on it was 12.3 N.")
    failed = a_record(EpisodeOutcome.FORCE, *steps[:1]).model_copy(update={"forces": some_forces(55.0)})
    assert tell_story(failed, PEG).sentence.startswith(
        "The peg was pressed too hard after one move: the force on it reached 55.0 N (limit 40 N), with the peg 2.3 mm"
    )
