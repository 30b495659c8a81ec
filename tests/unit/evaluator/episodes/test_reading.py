"""What of an observation is computed and sent, for the keys that a policy reads."""

import numpy as np
import pytest
from vitac.evaluator.agent.protocol.frames import PolicyQuestion, QuestionKind, encode_question
from vitac.evaluator.episodes.episode import EnvironmentBroken, make_environment, public_part
from vitac.evaluator.episodes.reading import make_reading
from vitac.evaluator.tracks import load_track

FUSION = load_track("track_2").tasks["fusion-insertion"]
PEG = load_track("track_1").tasks["peg-insertion"]
SENT = ("relative_motion", "rgb_picture", "depth_picture", "object_point_cloud", "marker_flow")


def test_without_a_list_all_keys_are_read_and_all_but_the_cloud_are_sent() -> None:
    reading = make_reading(FUSION)
    assert reading.keys == tuple(row.name for row in FUSION.observables)
    assert reading.sent == SENT
    assert [(cloud.name, cloud.depth, cloud.keep_depth) for cloud in reading.clouds] == [
        ("point_cloud", "depth_picture", True)
    ]


def test_a_cloud_brings_its_depth_picture_along_but_not_to_the_policy() -> None:
    reading = make_reading(FUSION, ("point_cloud",))
    assert (reading.keys, reading.sent) == (("point_cloud",), ("depth_picture",))
    assert [cloud.keep_depth for cloud in reading.clouds] == [False]


def test_nothing_is_computed_for_a_policy_that_reads_nothing() -> None:
    reading = make_reading(FUSION, ())
    assert (reading.keys, reading.sent, reading.clouds) == ((), (), ())


def test_keys_of_another_task_of_the_submission_are_left_out() -> None:
    assert make_reading(PEG, ("marker_flow", "rgb_picture")).keys == ("marker_flow",)
    assert make_reading(PEG).sent == ("relative_motion", "marker_flow")


def test_an_observation_takes_2_16_megabytes_to_the_policy_instead_of_5_84() -> None:
    arrays = {row.name: np.zeros(row.shape, row.dtype) for row in FUSION.observables}
    reading = make_reading(FUSION)
    question = PolicyQuestion(
        kind=QuestionKind.OBSERVE, arrays={key: arrays[key] for key in reading.sent}, clouds=reading.clouds
    )
    sent = sum(part.nbytes for part in encode_question(1, question))
    whole = sum(part.nbytes for part in encode_question(1, PolicyQuestion(kind=QuestionKind.OBSERVE, arrays=arrays)))
    assert (round(sent / 1e6, 2), round(whole / 1e6, 2)) == (2.16, 5.84)


@pytest.mark.parametrize("key", ["gt_direction", "gt_offset", "segmentation", "rgb_picture"])
def test_a_key_that_is_not_read_never_passes(key: str) -> None:
    reading = make_reading(FUSION, ("relative_motion",))
    observation = {"relative_motion": np.zeros(4, np.float32), key: np.zeros(1, np.float32)}
    with pytest.raises(EnvironmentBroken, match=f"gave observation keys .*{key}.*a policy must never see"):
        public_part(FUSION, reading, observation)


def test_the_environment_is_made_with_the_tracks_depth_and_the_policys_keys() -> None:
    reading = make_reading(FUSION, ("marker_flow",))
    env = make_environment(FUSION, None, reading.sent)
    assert env.settings.depth_mode == "stereo"  # type: ignore[attr-defined]
    assert list(env.observation_space) == ["marker_flow"]  # type: ignore[attr-defined]
    practice = make_environment(load_track("track_2_gt").tasks["fusion-insertion-gt"])
    assert practice.settings.depth_mode == "gt"  # type: ignore[attr-defined]
