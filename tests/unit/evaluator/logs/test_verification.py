import re
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from evaluation_fakes import FakeEnvironment, FakeSession, action, fail, small_track, succeed
from vitac.evaluator.episodes.episode import resimulate, run_episode
from vitac.evaluator.episodes.records import (
    ActionSequence,
    EpisodeOutcome,
    EpisodeRecord,
    Manifest,
    Timings,
    make_manifest,
    result_hash,
)
from vitac.evaluator.logs import verification
from vitac.evaluator.logs.findings import VerificationResult, comparable
from vitac.evaluator.logs.log import LogHeader
from vitac.evaluator.logs.verification import Verification, verify
from vitac.evaluator.scoring.score import score
from vitac.evaluator.tracks.definition import environment_definition

TRACK = small_track(offsets=1)
TASK = TRACK.tasks["peg-insertion"]


def evaluated(camera: str | None = None) -> tuple[LogHeader, list[EpisodeRecord]]:
    """A log of a solved episode, one that used up its steps, and one in which the policy crashed at the third step."""
    env = FakeEnvironment(camera)
    answers = (succeed, lambda *_: action(0.25), lambda _, step: action(0.5) if step < 3 else fail())
    records = []
    for episode, answer in zip(TASK.episodes, answers, strict=True):
        session = FakeSession(answer)
        session.open = True
        opened = partial(lambda session: session, session)
        records.append(run_episode(env=env, task=TASK, episode=episode, open_session=opened))
    return LogHeader(team="Touch", manifest=make_manifest(TRACK, TASK, env)), records


HEADER, RECORDS = evaluated()


def check(
    records: list[EpisodeRecord] = RECORDS, header: LogHeader = HEADER, camera: str | None = None, **options: Any
) -> Verification:
    return verify(env=FakeEnvironment(camera), track=TRACK, task=TASK, header=header, records=records, **options)


def with_record(number: int, **changes: Any) -> list[EpisodeRecord]:
    content = {**dict(RECORDS[number - 1]), **changes}
    changed = EpisodeRecord(**content)
    return [changed if record.episode == number else record for record in RECORDS]


def made_elsewhere(**changes: Any) -> LogHeader:
    return HEADER.model_copy(update={"manifest": Manifest(**{**dict(HEADER.manifest), **changes})})


def test_true_log_is_verified_with_the_score_and_hash_of_its_evaluation() -> None:
    assert [record.outcome for record in RECORDS] == ["success", "steps", "policy_failed"]
    verification = check()
    assert (verification.verdict, verification.divergence) == (VerificationResult.VERIFIED, None)
    assert verification.reason == "all states are equal"
    assert verification.score == score(RECORDS, TASK.definition.measures)
    assert result_hash(verification.manifest, verification.records) == result_hash(HEADER.manifest, RECORDS)


def test_each_record_is_told_as_it_is_verified() -> None:
    told: list[EpisodeRecord] = []
    assert list(check(on_episode=told.append).records) == told


def test_claims_beside_the_states_are_replaced_by_ours() -> None:
    lie = with_record(1, total_reward=1000.0, infos=({"steps": 99},) * RECORDS[0].env_steps)
    assert [record.record_digest() for record in check(lie).records] == [
        record.record_digest() for record in check().records
    ]
    assert check(lie).records[0].record_digest() == RECORDS[0].record_digest()


def test_messages_of_a_failed_policy_are_not_taken_over() -> None:
    failure = check().records[2].failure
    assert failure is not None
    assert (failure.code, failure.output_tail) == ("crashed", "")
    assert failure.message == "Claimed by the log; the policy was not seen."


@pytest.mark.parametrize("step", [0, 2])
def test_other_state_is_named_by_episode_and_env_step_with_both_states(step: int) -> None:
    hashes = list(RECORDS[1].state_hashes)
    hashes[step] = "f" * 64
    verification = check(with_record(2, state_hashes=tuple(hashes)))
    assert (verification.verdict, verification.reason) == (
        VerificationResult.DIVERGED, f"diverged at episode 2, env step {step}",
    )  # fmt: skip
    assert verification.divergence is not None
    assert verification.divergence.recorded_state == "f" * 64
    assert verification.divergence.resimulated_state == RECORDS[1].state_hashes[step]
    assert verification.divergence.resimulated_info == (RECORDS[1].infos[step - 1] if step else None)
    assert verification.divergence.recorded_info == verification.divergence.resimulated_info
    assert (verification.score, verification.records) == (None, ())


def test_at_a_divergence_the_claims_of_the_log_stand_beside_ours_in_our_form() -> None:
    hashes, infos = list(RECORDS[1].state_hashes), list(RECORDS[1].infos)
    hashes[2] = "f" * 64
    infos[1] = {**infos[1], "steps": 99, "is_success": "yes", "surface_diff_m": [0.1], "note": "<script>"}
    found = check(with_record(2, state_hashes=tuple(hashes), infos=tuple(infos))).divergence
    assert found is not None
    assert found.resimulated_info == RECORDS[1].infos[1]
    assert found.recorded_info == {**RECORDS[1].infos[1], "steps": 99, "is_success": None, "surface_diff_m": None}


def test_an_impossible_log_is_not_re_simulated() -> None:
    env = FakeEnvironment()
    told: list[EpisodeRecord] = []
    verification = verify(env=env, track=TRACK, task=TASK, header=HEADER, records=RECORDS[:2], on_episode=told.append)
    assert verification.verdict is VerificationResult.IMPOSSIBLE
    assert (env.ipc_steps, told, verification.divergence, verification.records) == (0, [], None, ())


def test_verification_stops_at_the_first_divergence() -> None:
    told: list[EpisodeRecord] = []
    lie = with_record(2, outcome=EpisodeOutcome.SUCCESS)
    assert check(lie, on_episode=told.append).verdict is VerificationResult.DIVERGED
    assert [record.episode for record in told] == [1]


@pytest.mark.usefixtures("not_repeating")
def test_of_several_tolerated_differences_the_first_is_told() -> None:
    records = [
        record.model_copy(update={"state_hashes": (*record.state_hashes[:-1], "f" * 64)})
        if record.episode > 1
        else record
        for record in RECORDS
    ]
    found = check(records).divergence
    assert found is not None
    assert (found.episode, found.env_step) == (2, RECORDS[1].env_steps)


def test_other_action_diverges_where_it_was_taken() -> None:
    actions = RECORDS[1].actions.to_array()
    actions[1, 2] = 0.125
    verification = check(with_record(2, actions=ActionSequence.from_array(actions)))
    assert verification.reason == "diverged at episode 2, env step 2"


def test_false_success_diverges_even_where_all_states_are_equal() -> None:
    verification = check(with_record(2, outcome=EpisodeOutcome.SUCCESS))
    assert verification.verdict is VerificationResult.DIVERGED


def test_success_cannot_be_passed_off_as_a_failed_policy() -> None:
    lie = with_record(1, outcome=EpisodeOutcome.POLICY_FAILED, failure=RECORDS[2].failure)
    assert check(lie).verdict is VerificationResult.DIVERGED


def test_actions_after_the_end_diverge() -> None:
    solved = RECORDS[0]
    actions = np.vstack([solved.actions.to_array(), action(0.5)])
    longer = with_record(
        1,
        actions=ActionSequence.from_array(actions),
        env_steps=solved.env_steps + 1,
        state_hashes=(*solved.state_hashes, "0" * 64),
        infos=(*solved.infos, {}),
    )
    verification = check(longer)
    assert (verification.verdict, verification.divergence is None) == (VerificationResult.DIVERGED, False)


@pytest.fixture
def not_repeating(monkeypatch: pytest.MonkeyPatch) -> None:
    """A task whose states differ from run to run, as ManiSkill's on a GPU."""
    monkeypatch.setattr(
        "vitac.evaluator.tracks.definition.environment_definition",
        lambda env_id, settings, known=environment_definition: replace(known(env_id, settings), repeats=False),
    )


@pytest.mark.usefixtures("not_repeating")
def test_of_a_task_that_does_not_repeat_states_may_differ_but_no_outcome() -> None:
    hashes = ("f" * 64,) * len(RECORDS[1].state_hashes)
    verification = check(with_record(2, state_hashes=hashes))
    assert verification.verdict is VerificationResult.WITHIN_TOLERANCE
    assert verification.reason == "the environment does not repeat to the last bit; all outcomes are equal"
    assert verification.score == score(RECORDS, TASK.definition.measures)
    assert verification.records[1].state_hashes == RECORDS[1].state_hashes
    assert check().verdict is VerificationResult.VERIFIED
    for outcome in (EpisodeOutcome.SUCCESS, EpisodeOutcome.TACTILE, EpisodeOutcome.ERROR):
        lie = with_record(2, state_hashes=hashes, outcome=outcome)
        assert check(lie).verdict is VerificationResult.DIVERGED


@pytest.mark.parametrize("made_on", ["x86_64-linux", "aarch64-linux", "zz-other"])
def test_whatever_class_a_log_names_every_bit_must_agree(made_on: str) -> None:
    header = made_elsewhere(platform_class=made_on)
    assert check(header=header).verdict is VerificationResult.VERIFIED
    hashes = ("f" * 64, *RECORDS[1].state_hashes[1:])
    assert check(with_record(2, state_hashes=hashes), header).verdict is VerificationResult.DIVERGED


@pytest.mark.usefixtures("not_repeating")
def test_where_states_may_differ_a_log_diverges_where_an_episode_ended_otherwise() -> None:
    last, other_states = RECORDS[1].env_steps, ("f" * 64,) * len(RECORDS[1].state_hashes)
    lie = with_record(2, outcome=EpisodeOutcome.SUCCESS, state_hashes=other_states)
    found = check(lie).divergence
    assert found is not None
    assert (found.episode, found.env_step) == (2, last)
    assert found.resimulated_info is not None


@pytest.mark.parametrize("changes", [{"task_hash": "0"}, {"mesh_hash": "other"}])
def test_log_of_another_list_or_version_is_impossible(changes: dict[str, Any]) -> None:
    verification = check(header=made_elsewhere(**changes))
    key, value = next(iter(changes.items()))
    assert verification.verdict is VerificationResult.IMPOSSIBLE
    assert verification.reason.startswith(f"Expected a log made with {key} ")
    assert verification.reason.endswith(f", got {value!r}; evaluate again.")


@pytest.mark.parametrize(
    ("records", "reason"),
    [
        (RECORDS[1:], "Expected 3 episodes, got 2; the first missing one is 1"),
        (
            with_record(2, shape="cuboid"),
            "Episode 2: expected the start trapezoid at (-4.0, -4.0, -8.0), got cuboid at",
        ),
    ],
)
def test_log_that_is_not_the_whole_list_is_impossible(records: list[EpisodeRecord], reason: str) -> None:
    verification = check(records)
    assert verification.verdict is VerificationResult.IMPOSSIBLE
    assert verification.reason.startswith(reason)


def test_part_of_a_list_can_be_verified_where_it_is_asked_for() -> None:
    assert check(RECORDS[:2], episodes=[1, 2]).verdict is VerificationResult.VERIFIED


@pytest.mark.parametrize(
    ("recorded", "ours", "shown"),
    [
        ({"is_success": True, "colour": "red"}, {"is_success": False}, {"is_success": True}),
        ({"is_success": 1}, {"is_success": False}, {"is_success": None}),
        ({"offset": [1.0, 2]}, {"offset": [0.5, 0.25]}, {"offset": [1.0, 2]}),
        ({"offset": [1.0] * 1000}, {"offset": [0.5, 0.25]}, {"offset": None}),
        ({"offset": [1.0]}, {"offset": [0.5, 0.25]}, {"offset": None}),
        ({"offset": [1.0, 2.0, 3.0]}, {"offset": [0.5, 0.25]}, {"offset": None}),
        ({"offset": 1.0}, {"offset": {"x": 0.5}}, {"offset": None}),
        ({"offset": {"x": 1.0}}, {"offset": 0.5}, {"offset": None}),
        ({"end_reason": 1.0}, {"end_reason": None}, {"end_reason": None}),
        ({"end_reason": "x" * 100}, {"end_reason": None}, {"end_reason": "x" * 100}),
        ({"end_reason": "x" * 101}, {"end_reason": None}, {"end_reason": None}),
        ({"end_reason": "x" * 1000}, {"end_reason": None}, {"end_reason": None}),
        ({"end_reason": "a\x00b"}, {"end_reason": "steps"}, {"end_reason": None}),
        ({"end_reason": "success"}, {"end_reason": None}, {"end_reason": "success"}),
        ({}, {"steps": 3}, {"steps": None}),
    ],
)
def test_of_a_recorded_info_only_what_has_our_form_is_shown(recorded: Any, ours: Any, shown: Any) -> None:
    assert comparable(recorded, ours) == shown


def test_a_log_with_the_pictures_of_its_states_is_verified() -> None:
    _, records = evaluated("rig")
    verification = check(records, camera="rig")
    assert verification.verdict is VerificationResult.VERIFIED
    assert result_hash(verification.manifest, verification.records) == result_hash(HEADER.manifest, records)


@pytest.mark.parametrize(
    ("recorded", "ours", "told"),
    [
        ("other rig", "rig", "expected the pictures .+… of env step . got the pictures .+… of env step"),
        (None, "rig", "expected the pictures .+… of env step .+, got no pictures"),
        ("rig", None, "expected no pictures, got the pictures .+… of env step"),
    ],
)
def test_other_pictures_of_equal_states_are_a_finding_of_their_own(
    recorded: str | None, ours: str | None, told: str
) -> None:
    _, records = evaluated(recorded)
    verification = check(records, camera=ours)
    assert (verification.verdict, verification.divergence) == (VerificationResult.OTHER_PICTURE, None)
    assert (verification.score, verification.records) == (None, ())
    assert re.match(f"episode 1: {told.replace('. got', '.+, got')}", verification.reason)
    assert "evaluate again with this version of vitac, unchanged, and upload the new log" in verification.reason


def test_the_picture_of_another_env_step_is_not_the_sampled_one() -> None:
    """A participant cannot name a step of their own choice, even with its true picture."""
    _, records = evaluated("rig")
    sampled = records[1].picture
    assert sampled is not None
    chosen = sampled.model_copy(update={"env_step": (sampled.env_step + 1) % 8})
    lie = [records[0], records[1].model_copy(update={"picture": chosen}), records[2]]
    verification = check(lie, camera="rig")
    assert verification.verdict is VerificationResult.OTHER_PICTURE
    assert verification.reason.startswith("episode 2:")


def test_other_states_are_named_before_other_pictures() -> None:
    _, records = evaluated("other rig")
    hashes = (*records[0].state_hashes[:-1], "f" * 64)
    lie = [records[0].model_copy(update={"state_hashes": hashes}), *records[1:]]
    assert check(lie, camera="rig").verdict is VerificationResult.DIVERGED


@pytest.mark.usefixtures("not_repeating")
def test_pictures_of_a_task_that_does_not_repeat_are_compared_where_the_states_are_equal() -> None:
    _, theirs = evaluated("other rig")
    _, ours = evaluated("rig")
    assert check(theirs, camera="rig").verdict is VerificationResult.OTHER_PICTURE
    assert check(ours, camera="rig").verdict is VerificationResult.VERIFIED
    moved = [record.model_copy(update={"state_hashes": ("f" * 64, *record.state_hashes[1:])}) for record in theirs]
    tolerated = check(moved, camera="rig")
    assert tolerated.verdict is VerificationResult.WITHIN_TOLERANCE
    assert [record.picture for record in tolerated.records] == [record.picture for record in ours]


def test_times_are_those_of_the_re_simulation(monkeypatch: pytest.MonkeyPatch) -> None:
    taken = Timings(physics_s=1.5, wall_s=2.5)
    monkeypatch.setattr(verification, "resimulate", lambda *arguments: replace(resimulate(*arguments), timings=taken))
    claimed = with_record(1, timings=Timings(wall_s=99.0))
    assert {record.timings for record in check(claimed).records} == {taken}


def test_a_recorded_info_without_any_key_is_shown_empty() -> None:
    """Beside it our own info is whole."""
    infos = ({}, *RECORDS[0].infos[1:])
    hashes = (RECORDS[0].state_hashes[0], "0" * 64, *RECORDS[0].state_hashes[2:])
    divergence = check(with_record(1, infos=infos, state_hashes=hashes)).divergence
    assert divergence is not None
    assert (divergence.env_step, divergence.recorded_info) == (1, {})
    assert divergence.resimulated_info
