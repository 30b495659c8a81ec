"""What of an observation is computed and sent, for the keys that a policy reads."""

import base64
import hashlib
import json
from typing import Any

import numpy as np
import pytest
from evaluation_records import make_failure, make_manifest, make_record
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from vitac.evaluator.agent.protocol import PolicyQuestion, QuestionKind, encode_question
from vitac.evaluator.agent.verdicts import VerdictCode
from vitac.evaluator.episodes.episode import EnvironmentBroken, make_environment, public_part
from vitac.evaluator.episodes.records import (
    ActionSequence,
    EpisodeOutcome,
    EpisodeRecord,
    FailureStage,
    PolicyFailure,
    RecordsDisagree,
    SampledPicture,
    Timings,
    canonical_json,
    counted_env_steps,
    digest_of_stored,
    make_reading,
    result_hash,
    sort_records,
)
from vitac.evaluator.tracks import load_track

RECORDS = [make_record(number) for number in (1, 2, 3)]


def test_record_survives_json() -> None:
    record = make_record(5, EpisodeOutcome.POLICY_FAILED, failure=make_failure(code=VerdictCode.CPU_TIME))
    assert EpisodeRecord.model_validate_json(record.model_dump_json()) == record


def test_output_and_timings_change_no_digest() -> None:
    quiet = make_record(5)
    loud = quiet.model_copy(update={"output": "I am thinking.", "timings": Timings(wall_s=3.0)})
    assert loud.record_digest() == quiet.record_digest()
    assert result_hash(make_manifest(), [loud]) == result_hash(make_manifest(), [quiet])
    assert make_record(6).record_digest() != quiet.record_digest()
    for left_out in ({"output"}, {"output", "timings"}, set()):
        assert digest_of_stored(loud.model_dump(mode="json", exclude=left_out)) == quiet.record_digest()


@given(st.lists(st.lists(st.floats(width=32, allow_nan=False, allow_infinity=False), min_size=3, max_size=3)))
def test_actions_survive_to_the_last_bit(rows: list[list[float]]) -> None:
    actions = np.array(rows, dtype=np.float32).reshape(len(rows), 3)
    packed = ActionSequence.model_validate_json(ActionSequence.from_array(actions).model_dump_json())
    assert packed.to_array().tobytes() == actions.tobytes()
    assert packed.to_array().shape == actions.shape


@pytest.mark.parametrize(
    ("shape", "data", "message"),
    [
        ((2, 3), "AAAA", "expected 4 x 2 x 3"),
        ((1, 3), "A" * 22 + "==", "expected 4 x 1 x 3"),
        ((0, 3), "!!", "not base64"),
        ((0, 2**62), "", "less than or equal to 64"),
        ((0, 65), "", "less than or equal to 64"),
        ((0, 0), "", "greater than or equal to 1"),
        ((-1, 3), "", "greater than or equal to 0"),
        ((1_000_001, 1), "", "less than or equal to 1000000"),
    ],
)
def test_actions_must_fit_their_shape(shape: tuple[int, int], data: str, message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        ActionSequence(shape=shape, float32_base64=data)


@pytest.mark.parametrize("shape", [(0, 1), (1, 1), (2, 64), (1_000_000, 1)])
def test_actions_may_have_any_size_up_to_the_limits(shape: tuple[int, int]) -> None:
    assert ActionSequence.from_array(np.zeros(shape, np.float32)).to_array().shape == shape


@pytest.mark.parametrize(
    "changes",
    [
        {"env_steps": 4, "actions": RECORDS[0].actions},
        {"actions": ActionSequence.from_array(np.zeros((4, 3), np.float32))},
        {"state_hashes": (*RECORDS[0].state_hashes, "0" * 64)},
        {"infos": (*RECORDS[0].infos, {})},
        {"state_hashes": RECORDS[0].state_hashes[:-1]},
        {"infos": ()},
    ],
)
def test_steps_actions_hashes_and_infos_must_agree(changes: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match="all four must agree"):
        make_record(**{"infos": RECORDS[0].infos, "state_hashes": RECORDS[0].state_hashes, **changes})


def test_an_episode_may_end_before_its_first_env_step_but_not_before_its_reset() -> None:
    assert make_record(1, EpisodeOutcome.POLICY_FAILED, 0).env_steps == 0
    with pytest.raises(ValidationError, match="state_hashes"):
        make_record(1, EpisodeOutcome.POLICY_FAILED, 0, state_hashes=())


@pytest.mark.parametrize("outcome", EpisodeOutcome)
def test_every_outcome_can_be_recorded_and_one_is_a_success(outcome: EpisodeOutcome) -> None:
    assert make_record(1, outcome).success == (outcome.value == "success")


def test_times_that_were_not_taken_are_zero() -> None:
    assert set(Timings().model_dump(exclude={"answers_s"}).values()) == {0.0}
    assert Timings().answers_s == ()


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_what_is_no_number_has_no_json(number: float) -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        canonical_json({"value": number})


@pytest.mark.parametrize(
    ("outcome", "failure"), [(EpisodeOutcome.POLICY_FAILED, None), (EpisodeOutcome.SUCCESS, make_failure())]
)
def test_failure_belongs_to_a_failed_policy_only(outcome: EpisodeOutcome, failure: object) -> None:
    with pytest.raises(ValidationError, match="do not belong together"):
        make_record(outcome=outcome, failure=failure)


@pytest.mark.parametrize(
    "changes", [{"total_reward": float("nan")}, {"episode": 0}, {"state_hashes": ("A" * 64,) * 4}, {"surprise": 1}]
)
def test_impossible_values_are_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        make_record(**changes)


def test_digest_ignores_timings_only() -> None:
    record = make_record()
    assert record.model_copy(update={"timings": Timings(wall_s=9)}).record_digest() == record.record_digest()
    for changes in ({"episode": 2}, {"total_reward": 2.0}, {"shape": "other"}, {"initial_offset": (0.0, 0.0, 0.0)}):
        assert record.model_copy(update=changes).record_digest() != record.record_digest()


def test_result_hash_ignores_times_output_and_machine() -> None:
    first = make_record(1, EpisodeOutcome.POLICY_FAILED, failure=make_failure(output_tail="at 10:31"))
    other = make_record(
        1, EpisodeOutcome.POLICY_FAILED, failure=make_failure(output_tail="at 10:32"), timings=Timings(wall_s=3)
    )
    assert result_hash(make_manifest(), [first]) == result_hash(make_manifest(platform_class="arm64-linux"), [other])


def test_result_hash_changes_with_the_reason_of_a_failure_but_not_with_its_message() -> None:
    def hash_of(**changes: Any) -> str:
        failed = make_record(1, EpisodeOutcome.POLICY_FAILED, failure=make_failure(**changes))
        return result_hash(make_manifest(), [failed])

    assert hash_of(code=VerdictCode.CRASHED) != hash_of(code=VerdictCode.CPU_TIME)
    assert hash_of(message="It ended with signal 11.") == hash_of(message="It ended with signal 9.")


def test_episode_twice_is_refused() -> None:
    with pytest.raises(RecordsDisagree, match="got episode 2 twice"):
        result_hash(make_manifest(), [*RECORDS, make_record(2, env_steps=4)])


def test_record_of_another_task_is_refused() -> None:
    with pytest.raises(RecordsDisagree, match="'lock-opening', expected 'peg-insertion'"):
        result_hash(make_manifest(), [make_record(task="lock-opening")])
    with pytest.raises(RecordsDisagree, match="'peg-insertion', expected 'lock-opening'"):
        result_hash(make_manifest(task="lock-opening"), RECORDS)


def test_result_hash_follows_the_documented_recipe() -> None:
    """docs/logs.md, in other words than the code's."""
    manifest = make_manifest()
    keys = ["evaluator_version", "list_seed", "mesh_hash", "solver_version", "task", "track"]
    lines = [json.dumps({key: getattr(manifest, key) for key in keys}, separators=(",", ":"))]
    for record in RECORDS:
        actions = {"float32_base64": record.actions.float32_base64, "shape": list(record.actions.shape)}
        content = {
            "actions": actions,
            "episode": record.episode,
            "failure": None,
            "outcome": record.outcome.value,
            "state_hashes": list(record.state_hashes),
        }
        lines.append(json.dumps(content, separators=(",", ":")))
    recipe = hashlib.sha256("".join(f"{line}\n" for line in lines).encode()).hexdigest()
    assert result_hash(manifest, reversed(RECORDS)) == recipe


def test_words_that_stored_records_and_hashes_hold_stay() -> None:
    assert [outcome.value for outcome in EpisodeOutcome] == [
        "success", "force", "tactile", "error", "steps", "not_converged", "policy_failed", "actions_ended",
    ]  # fmt: skip
    assert [stage.value for stage in FailureStage] == ["load", "episode"]


PICTURE = SampledPicture(env_step=2, sha256="a" * 64)


def test_records_without_pictures_keep_the_bytes_and_hashes_that_they_had_before_there_were_any() -> None:
    records = [
        make_record(number, outcome, steps, initial_offset=(1.0, -3.0, -4.0))
        for number, outcome, steps in ((1, EpisodeOutcome.SUCCESS, 3), (2, EpisodeOutcome.POLICY_FAILED, 2))
    ]
    assert [record.record_digest()[:12] for record in records] == ["3cd85540f10a", "0191639b72d7"]
    assert result_hash(make_manifest(), records)[:12] == "3f1c404d8a50"
    assert all(not {"picture", "forces"} & record.model_dump(mode="json").keys() for record in records)


def test_a_picture_is_part_of_the_record_its_digest_and_the_result_hash() -> None:
    plain, seen = make_record(1), make_record(1, picture=PICTURE)
    other = make_record(1, picture=PICTURE.model_copy(update={"sha256": "b" * 64}))
    assert EpisodeRecord.model_validate_json(seen.model_dump_json()) == seen
    assert len({record.record_digest() for record in (plain, seen, other)}) == 3
    assert len({result_hash(make_manifest(), [record]) for record in (plain, seen, other)}) == 3


def test_a_picture_is_of_an_env_step_of_the_episode() -> None:
    make_record(1, env_steps=2, picture=PICTURE)
    with pytest.raises(ValidationError, match="picture is of env step 2, expected at most 1"):
        make_record(1, env_steps=1, picture=PICTURE)
    with pytest.raises(ValidationError, match="sha256"):
        make_record(1, picture={"env_step": 1, "sha256": "short"})


def test_every_outcome_is_explained_in_a_sentence_of_its_own() -> None:
    sentences = {outcome.value: outcome.sentence for outcome in EpisodeOutcome}
    assert sentences == {
        "success": "The task was solved.",
        "force": "The force on the held part was above the task's limit.",
        "tactile": "The gel surface of a sensor moved too far.",
        "error": "The gripper or the part left its range.",
        "steps": "All env steps were used up.",
        "not_converged": "The physics found no solution for an IPC step, even in smaller pieces.",
        "policy_failed": "The policy crashed, broke a limit or answered wrongly.",
        "actions_ended": "The recorded actions of a 2025 text log ended before the episode did.",
    }


@pytest.mark.parametrize("dtype", [">f4", "<f8", "<i4"])
def test_actions_of_any_type_are_stored_as_little_endian_float32(dtype: str) -> None:
    values = np.array([[1, -2], [3, 0]])
    stored = ActionSequence.from_array(values.astype(dtype))
    assert stored == ActionSequence.from_array(values.astype(np.float32))
    assert base64.b64decode(stored.float32_base64) == values.astype("<f4").tobytes()


def test_actions_of_every_second_row_are_stored_as_rows() -> None:
    values = np.arange(12, dtype=np.float32).reshape(4, 3)
    assert ActionSequence.from_array(values[::2]).to_array().tolist() == [[0, 1, 2], [6, 7, 8]]
    assert ActionSequence.from_array(values.T).to_array().tolist() == values.T.tolist()


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ("AAA", "actions are not base64: Incorrect padding"),
        ("AAAAAA==", "actions hold 4 bytes, expected 4 x 1 x 2"),
        ("AADAfwAAAAA=", "actions hold NaN or infinity; every action must be finite"),
    ],
)
def test_actions_that_cannot_be_are_refused_in_a_sentence(data: str, message: str) -> None:
    with pytest.raises(ValidationError) as refused:
        ActionSequence(shape=(1, 2), float32_base64=data)
    assert refused.value.errors()[0]["msg"] == f"Value error, {message}"


def test_disagreeing_lengths_are_told_in_a_sentence() -> None:
    with pytest.raises(ValidationError) as refused:
        make_record(env_steps=3, infos=({},), state_hashes=("0" * 64,) * 3)
    assert refused.value.errors()[0]["msg"] == (
        "Value error, env_steps is 3, but there are 3 actions, 2 state hashes after the reset's and 1 infos; "
        "all four must agree"
    )


def test_records_that_disagree_are_told_in_a_sentence() -> None:
    with pytest.raises(RecordsDisagree) as twice:
        sort_records("peg-insertion", [make_record(1), make_record(3), make_record(1)])
    assert str(twice.value) == "Expected each episode once, got episode 1 twice."
    with pytest.raises(RecordsDisagree) as other:
        sort_records("lock-opening", [make_record(2)])
    assert str(other.value) == "Episode 2 is of task 'peg-insertion', expected 'lock-opening'."


@given(st.permutations(range(1, 7)))
def test_records_are_put_in_the_order_of_their_numbers(numbers: list[int]) -> None:
    ordered = sort_records("peg-insertion", (make_record(number) for number in numbers))
    assert [record.episode for record in ordered] == sorted(numbers)


@given(st.dictionaries(st.text(max_size=5), st.integers() | st.text(max_size=5) | st.booleans(), max_size=5))
def test_the_json_of_equal_content_is_equal_in_any_order_of_its_keys(content: dict[str, Any]) -> None:
    text = canonical_json(content)
    assert canonical_json(dict(reversed(list(content.items())))) == text
    assert json.loads(text) == content
    assert text.isascii()


def test_the_json_has_no_blanks_and_sorted_keys_inside_too() -> None:
    assert canonical_json({"b": {"d": 1, "c": [1, 2]}, "a": "ü"}) == b'{"a":"\\u00fc","b":{"c":[1,2],"d":1}}'


@pytest.mark.parametrize(
    ("message", "told"),
    [
        ("Looking up P raised AttributeError: no attribute 'P'", "no attribute 'P'. The entry point"),
        ("Action has shape (2,), expected (3,).", "expected (3,). The entry point"),
        ("act() raised ValueError: (why)\n", "ValueError: (why). The entry point"),
        ("Importing policy raised SyntaxError: bad (policy.py, line 3)", "(policy.py, line 3). The entry point"),
        ("More than 3 GiB were used. (act() raised MemoryError.)", "MemoryError.) The entry point"),
    ],
)
def test_a_failure_is_reported_in_sentences_with_what_to_do(message: str, told: str) -> None:
    failure = PolicyFailure(stage=FailureStage.LOAD, code=VerdictCode.IMPORT_ERROR, message=message)
    assert told in failure.sentence
    assert failure.sentence.endswith(VerdictCode.IMPORT_ERROR.sentence)


def test_one_env_step_is_told_as_one() -> None:
    assert [counted_env_steps(number) for number in (0, 1, 2)] == ["0 env steps", "1 env step", "2 env steps"]


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
