"""What happened in an episode, from its record alone."""

import threading
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest
from asked_playbacks import SETTINGS, Played, played
from recorded_forces import some_forces
from service_factories import TASK, make_principal, make_score, play, shard_ids, submit_scored, submit_to, take
from sqlalchemy import select, update
from sqlalchemy.orm import Session
from submission_steps import make_worker
from vitac.envs.tasks.definition import Family
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome, EpisodeRecord
from vitac.evaluator.tracks import ListKind, load_track
from vitac.evaluator.version import evaluator_version
from vitac.server.database.engine import Database
from vitac.server.database.models import Evaluation, Playback, Submission, Work, Worker
from vitac.server.database.states import Role, WorkerState, WorkState
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.leaderboards.public_pages import set_public
from vitac.server.playbacks import asking, work
from vitac.server.playbacks.asking import (
    Mark,
    PlaybackFile,
    ask,
    find_digest,
    find_episode,
    find_playback,
    playback_key,
    playback_view,
    requester,
    tell_story,
)
from vitac.server.principals import CONSOLE, VISITOR, Principal
from vitac.server.queue.work import hand_back, name_requirement
from vitac.server.tracks import find_playback_family

JUDGE = Principal(role=Role.JUDGE)
ONE_AT_ONCE = SETTINGS.model_copy(update={"playbacks_at_once": 1})


def needed_by_playbacks(session: Session) -> list[str]:
    """What the playbacks that wait require of a worker."""
    return list(session.scalars(select(Playback.requires).where(Playback.state == WorkState.QUEUED)))


def refusal(asked: Played, number: int, **settings: Any) -> ServiceError:
    with pytest.raises(ServiceError) as refused:
        asked.ask(number, **settings)
    return refused.value


def change(database: Database, playback: Playback, **values: object) -> None:
    with database.transaction() as session:
        found = session.get_one(Playback, playback.id)
        for name, value in values.items():
            setattr(found, name, value)


def test_asking_again_finds_the_same_one(team_a: Played) -> None:
    assert team_a.found(3) is None
    first = team_a.ask(3)
    assert first.state is WorkState.QUEUED
    assert team_a.ask(3).id == first.id
    assert team_a.ask(4).id != first.id
    with team_a.database.transaction() as session:
        assert len(needed_by_playbacks(session)) == 2


def test_those_who_ask_at_the_same_time_get_one(team_a: Played) -> None:
    found: list[int] = []
    barrier = threading.Barrier(6)

    def run() -> None:
        barrier.wait()
        found.append(team_a.ask(2).id)

    threads = [threading.Thread(target=run) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 6
    assert len(set(found)) == 1


def test_equal_episodes_of_two_teams_share_a_playback(team_a: Played) -> None:
    other = played(team_a.database, "Team B", "other content")
    assert other.episode(2).id != team_a.episode(2).id
    assert other.ask(2).id == team_a.ask(2).id


def test_another_evaluator_or_format_makes_another_playback(team_a: Played, monkeypatch: pytest.MonkeyPatch) -> None:
    episode = team_a.episode()
    keys = {playback_key(episode)}
    monkeypatch.setattr(asking, "FORMAT", 1000)
    keys.add(playback_key(episode))
    monkeypatch.setattr(asking, "find_version", lambda _: "2+other")
    keys.add(playback_key(episode))
    assert len(keys) == 3


def test_a_team_has_only_so_many_in_the_queue(team_a: Played) -> None:
    for number in (1, 2):
        team_a.ask(number, playbacks_at_once=2)
    refused = refusal(team_a, 3, playbacks_at_once=2)
    assert refused.code is ProblemCode.TOO_MANY_REQUESTS
    assert "At most 2 playbacks that wait or are being made" in refused.detail
    assert team_a.ask(1, playbacks_at_once=2).state is WorkState.QUEUED
    other = played(team_a.database, "Team B", "other content")
    assert other.ask(4, playbacks_at_once=2).state is WorkState.QUEUED


def test_a_team_asks_for_only_so_many_in_an_hour(team_a: Played) -> None:
    first = team_a.ask(1, playbacks_per_hour=1)
    change(team_a.database, first, state=WorkState.FAILED, problem="no", finished_at=datetime.now(UTC))
    refused = refusal(team_a, 2, playbacks_per_hour=1)
    assert "At most 1 new playbacks in an hour" in refused.detail
    change(team_a.database, first, asked_at=datetime.now(UTC) - timedelta(minutes=61))
    assert team_a.ask(2, playbacks_per_hour=1).state is WorkState.QUEUED


def test_requests_at_the_same_time_do_not_exceed_the_limit(team_a: Played) -> None:
    refused: list[ServiceError] = []
    barrier = threading.Barrier(5)

    def run(number: int) -> None:
        barrier.wait()
        try:
            team_a.ask(number, playbacks_at_once=2)
        except ServiceError as error:
            refused.append(error)

    threads = [threading.Thread(target=run, args=(number,)) for number in range(1, 6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(refused) == 3


def test_organizers_have_no_limit(team_a: Played) -> None:
    for number in (1, 2, 3):
        team_a.ask(number, by=CONSOLE, playbacks_at_once=1, playbacks_per_hour=1)
    assert requester(CONSOLE) == "organizer"
    assert requester(team_a.by) == f"team:{team_a.by.team_id}"
    assert requester(JUDGE) == "judge"


def test_visitors_ask_for_playbacks_of_public_submissions_and_have_one_limit_together(team_a: Played) -> None:
    with team_a.database.transaction() as session:
        public = submit_scored(session, team_a.by, "public", {TASK: make_score(80)})
        set_public(session, team_a.by, public.id, public=True)
    with pytest.raises(ServiceError) as refused:
        team_a.ask(1, by=VISITOR)
    assert refused.value.code is ProblemCode.MISSING_CREDENTIALS
    for by, number in ((VISITOR, 1), (VISITOR, 2), (team_a.by, 3)):
        with team_a.database.transaction() as session:
            episode = find_episode(session, team_a.by, team_a.submission.id, TASK, number)
            settings = SETTINGS.model_copy(update={"playbacks_at_once": 2})
            assert ask(session, settings, by, episode).owner == requester(by)
    with team_a.database.transaction() as session, pytest.raises(ServiceError) as too_many:
        ask(session, settings, VISITOR, find_episode(session, team_a.by, team_a.submission.id, TASK, 4))
    assert too_many.value.code is ProblemCode.TOO_MANY_REQUESTS
    with team_a.database.transaction() as session, pytest.raises(ServiceError) as missing:
        find_episode(session, VISITOR, public.id, TASK, 1)
    assert missing.value.code is ProblemCode.NOT_FOUND, "it is public, but has no such episode"


def test_a_failed_one_is_tried_again_after_an_hour(team_a: Played) -> None:
    first = team_a.ask(1)
    failed_at = datetime.now(UTC)
    change(team_a.database, first, state=WorkState.FAILED, problem="states differ", finished_at=failed_at)
    assert team_a.ask(1).problem == "states differ"
    change(team_a.database, first, finished_at=failed_at - timedelta(minutes=61))
    again = team_a.ask(1)
    assert again.state is WorkState.QUEUED
    assert again.id != first.id


@pytest.mark.parametrize(("task", "number"), [(TASK, 999), (TASK, 0), ("lock-opening", 1), ("no-task", 1)])
def test_an_episode_that_is_not_there_is_not_found(team_a: Played, task: str, number: int) -> None:
    with team_a.database.transaction() as session, pytest.raises(ServiceError) as refused:
        find_episode(session, team_a.by, team_a.submission.id, task, number)
    assert refused.value.code is ProblemCode.NOT_FOUND


@pytest.fixture
def pick_cube(database: Database) -> Submission:
    """A submission of ManiSkill whose first shard has been played."""
    with database.transaction() as session:
        submission = submit_to(session, make_principal(session), track="maniskill", task="pick-cube")
        first = shard_ids(session, submission)[0]
    play(database, first)
    return submission


def test_a_film_waits_for_workers_that_can_draw_until_it_is_made(database: Database, pick_cube: Submission) -> None:
    able = name_requirement(evaluator_version(), Family.MANISKILL_PICTURES)
    make_worker(database, families=["tactile", "maniskill", "maniskill-pictures"])
    with database.transaction() as session:
        asked = ask(session, SETTINGS, CONSOLE, find_episode(session, CONSOLE, pick_cube.id, "pick-cube", 1))
        assert needed_by_playbacks(session) == [able]
        view = playback_view(session, SETTINGS, asked)
        assert (view.family, view.workers) == (Family.MANISKILL_PICTURES, 1)
        hand_back(session, take(session, asked.id))
        session.execute(update(Playback).values(asked_at=datetime.now(UTC) - timedelta(hours=1)))
        work.give_up_unmade(session)
        assert needed_by_playbacks(session) == [able]
        lease = work.begin(session, take(session, asked.id))
        work.end_made(session, lease, {"film_sha256": "1" * 64, "still_sha256": "2" * 64})
        session.expire_all()
        assert asked.state is WorkState.DONE
        assert {"1" * 64, "2" * 64} <= work.stored_digests(session)
        assert find_digest(session, asked.episode, PlaybackFile.FILM) == "1" * 64


def test_a_film_that_no_running_worker_can_draw_is_refused_to_all_but_the_made_one_is_shown(
    database: Database, pick_cube: Submission
) -> None:
    able = ["tactile", "maniskill", "maniskill-pictures"]
    make_worker(database)
    make_worker(database, families=["tactile", "maniskill"])
    make_worker(database, families=able, evaluator_version="0+other")
    make_worker(database, families=able, state=WorkerState.STOPPED)
    with database.transaction() as session:
        episode = find_episode(session, CONSOLE, pick_cube.id, "pick-cube", 1)
        for by in (CONSOLE, VISITOR):
            with pytest.raises(ServiceError, match=r"no running worker can draw ManiSkill’s .* Vulkan") as refused:
                ask(session, SETTINGS, by, episode)
            assert refused.value.code is ProblemCode.INVALID_REQUEST
        assert (find_playback(session, episode), needed_by_playbacks(session)) == (None, [])
        make_worker(database, families=able)
        asked = ask(session, SETTINGS, VISITOR, episode)
        session.execute(update(Worker).values(state=WorkerState.STOPPED))
        assert ask(session, SETTINGS, VISITOR, episode).id == asked.id, "what is there needs no worker"
        assert playback_view(session, SETTINGS, asked).workers == 0


def test_films_that_lost_their_workers_are_given_up_and_lock_visitors_out_for_no_longer(
    database: Database, pick_cube: Submission
) -> None:
    tactile = played(database, "Team B")
    make_worker(database, families=["tactile", "maniskill-pictures"])
    with database.transaction() as session:
        for number in (1, 2):
            ask(session, ONE_AT_ONCE, CONSOLE, find_episode(session, CONSOLE, pick_cube.id, "pick-cube", number))
        session.execute(update(Work).values(owner=requester(VISITOR)))
    with pytest.raises(ServiceError) as locked, database.transaction() as session:
        ask(session, ONE_AT_ONCE, VISITOR, tactile.episode())
    assert locked.value.code is ProblemCode.TOO_MANY_REQUESTS
    with database.transaction() as session:
        session.execute(update(Worker).values(families=["tactile"]))
        session.execute(update(Playback).values(asked_at=datetime.now(UTC) - timedelta(minutes=61)))
        work.give_up_unmade(session)
        assert {playback.problem for playback in session.query(Playback)} == {"No worker that can make it was running."}
        assert ask(session, ONE_AT_ONCE, VISITOR, tactile.episode()).state is WorkState.QUEUED


def test_a_playback_is_of_a_family_whatever_has_become_of_its_tracks_file(monkeypatch: pytest.MonkeyPatch) -> None:
    assert find_playback_family("track_1", TASK) is Family.TACTILE
    for family in Family:
        monkeypatch.setattr("vitac.server.tracks.find_family", lambda *_, now=family: now)
        drawn = family is not Family.TACTILE
        assert find_playback_family("own", "cubes") is (Family.MANISKILL_PICTURES if drawn else Family.TACTILE), family


def test_what_does_not_repeat_is_refused_and_nothing_is_queued(
    database: Database, pick_cube: Submission, monkeypatch: pytest.MonkeyPatch
) -> None:
    track = load_track("maniskill")
    task = track.tasks["pick-cube"]
    on_gpu = task.model_copy(update={"settings": dict(task.settings) | {"sim_backend": "physx_cuda"}})
    changed = track.model_copy(update={"tasks": {"pick-cube": on_gpu}})
    monkeypatch.setattr(asking, "load_track", lambda _: changed)
    with database.transaction() as session:
        episode = find_episode(session, CONSOLE, pick_cube.id, "pick-cube", 1)
        with pytest.raises(ServiceError, match=r"no playbacks of ManiSkill/PickCube-v1 .* do not repeat") as refused:
            ask(session, SETTINGS, CONSOLE, episode)
        assert refused.value.code is ProblemCode.INVALID_REQUEST
        assert (find_playback(session, episode), needed_by_playbacks(session)) == (None, [])


def test_another_teams_episode_is_not_found(team_a: Played) -> None:
    with team_a.database.transaction() as session:
        other = make_principal(session, "Team B")
        with pytest.raises(ServiceError) as refused:
            find_episode(session, other, team_a.submission.id, TASK, 1)
    assert refused.value.code is ProblemCode.NOT_FOUND


def test_episodes_of_a_sealed_list_are_shown_to_organizers_only(
    team_a: Played, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("vitac.server.visibility.known_task", lambda *_: None)
    with team_a.database.transaction() as session:
        session.execute(update(Evaluation).values(list_kind=ListKind.SEALED))
    with team_a.database.transaction() as session:
        assert find_episode(session, CONSOLE, team_a.submission.id, TASK, 1).episode == 1
        with pytest.raises(ServiceError) as refused:
            find_episode(session, team_a.by, team_a.submission.id, TASK, 1)
    assert refused.value.code is ProblemCode.NOT_FOUND


def test_a_view_says_what_is_before_it_and_whether_anybody_works(team_a: Played) -> None:
    team_a.ask(1)
    second = team_a.ask(2)
    with team_a.database.transaction() as session:
        playback = session.get_one(Playback, second.id)
        view = playback_view(session, SETTINGS, playback)
    assert view.waits_for == 1
    assert view.workers == 0
    assert (view.env_steps, view.env_steps_played) == (3, 0)
    assert not view.has_still


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
