"""The public list that is played beside the sealed one: it is shown, and ranks nothing."""

from functools import partial

import pytest
from service_factories import (
    TASK,
    TRACK,
    claim,
    finish,
    make_failed_record,
    make_principal,
    make_record,
    make_upload,
    play,
    play_all,
    shard_ids,
    store,
)
from submission_steps import SETTINGS, refused
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord
from vitac.evaluator.shards.order import ShardEnd
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import ListKind
from vitac.server.competitions.sealing import seal
from vitac.server.database.engine import Database
from vitac.server.database.models import Submission
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.evaluations.logs import LogClaim
from vitac.server.leaderboards.standings import leaderboard
from vitac.server.playbacks.asking import find_episode
from vitac.server.principals import CONSOLE, VISITOR, Principal
from vitac.server.submissions import creation, listing
from vitac.server.views.submissions import SubmissionView
from vitac.server.visibility import is_sealed

from competitions import (
    FIRST,
    make_competition,
    moved,
    open_now,
    put_in_place,
    sealed_competition,
    shown_stage,
    stored_stage,
)


@pytest.fixture
def principal(database: Database) -> Principal:
    with database.transaction() as session:
        content = open_now(sealed_competition())
        content["tracks"][TRACK]["stages"][0]["accepts"] = ["model", "log"]
        put_in_place(session, content)
        seal(session, CONSOLE, stored_stage(session, TRACK, FIRST))
        return make_principal(session)


def submit(database: Database, by: Principal, kind: SubmissionKind = SubmissionKind.MODEL) -> Submission:
    claimed = LogClaim(team=None, episodes=270, successes=1, success_rate=1 / 270, mean_steps=3.0)
    upload = make_upload(kind.value, kind=kind, **({} if kind.form.runs_policy else {"manifest": claimed.stored()}))
    with database.transaction() as session:
        return creation.create(session, by, upload)[0]


def play_lists(database: Database, submission: Submission, *, public: int, sealed: int) -> None:
    """Plays every episode; the first ones of each list are solved."""

    def record_of(number: int, *, task: str, solved: int) -> EpisodeRecord:
        return make_record(number, EpisodeOutcome.SUCCESS if number <= solved else EpisodeOutcome.STEPS, task)

    for shard_id in shard_numbers(database, submission):
        play(database, shard_id, partial(record_of, solved=public))
    for shard_id in shard_numbers(database, submission)[10:]:
        play(database, shard_id, partial(record_of, solved=sealed))


def shard_numbers(database: Database, submission: Submission) -> list[int]:
    with database.transaction() as session:
        return shard_ids(session, session.get_one(Submission, submission.id))


def view(database: Database, by: Principal, submission: Submission) -> SubmissionView:
    with database.transaction() as session:
        return listing.get(session, SETTINGS, by, submission.id)


def test_both_lists_are_played_the_sealed_one_alone_ranks_and_a_team_sees_the_episodes_of_the_other(
    database: Database, principal: Principal
) -> None:
    submission = submit(database, principal)
    assert view(database, principal, submission).evaluation.progress.episodes_total == 540
    play_lists(database, submission, public=200, sealed=100)
    shown = view(database, principal, submission).evaluation
    assert shown.progress.episodes_total == 270
    assert (shown.scores[0].success_rate, shown.list_kind) == (100 / 270, ListKind.SEALED)
    assert shown.practice_scores is not None
    (practice,) = shown.practice_scores
    assert (practice.successes, practice.p_value < 1e-6) == (200, True)
    said = (
        "Public list: 74.1 % (200 of 270), 37.0 points above the sealed one (95 % interval +28.9 to +44.4). Better on"
    )
    assert practice.sentence.startswith(said)
    with database.transaction() as session:
        board = leaderboard(session, shown_stage(session, TRACK, FIRST)).view
        assert (board.is_practice, [entry.success_rate for entry in board.entries]) == (False, [100 / 270 / 2])
        other = make_principal(session, "Team B")
        ends = listing.episodes(session, principal, submission.id, practice=True)
        assert sum(end.success for end in ends) == 200
        assert listing.episodes(session, principal, submission.id) == ()
        assert sum(end.success for end in listing.episodes(session, CONSOLE, submission.id)) == 100
        assert find_episode(session, principal, submission.id, TASK, 150, practice=True).commitment == ""
        with refused(ProblemCode.NOT_FOUND):
            find_episode(session, principal, submission.id, TASK, 150)
        for by in (other, VISITOR):
            with pytest.raises(ServiceError):
                listing.episodes(session, by, submission.id, practice=True)


def test_a_policy_that_breaks_on_the_public_list_has_no_score(database: Database, principal: Principal) -> None:
    submission = submit(database, principal)
    *of_both, last = shard_numbers(database, submission)
    for shard_id in of_both:
        play(database, shard_id)
    lease = claim(database, last)
    assert lease.commitment is None
    store(database, lease, [make_failed_record(number) for number in lease.episodes[:3]])
    finish(database, lease, ShardEnd.BROKEN)
    shown = view(database, principal, submission).evaluation
    assert (shown.state, shown.verdict and shown.verdict.code) == ("failed", "crashed")


def test_a_log_of_a_sealed_stage_plays_the_public_list_for_practice(database: Database, principal: Principal) -> None:
    submission = submit(database, principal, SubmissionKind.LOG)
    with database.transaction() as session:
        evaluation = newest_evaluation(session, session.get_one(Submission, submission.id))
        assert (evaluation.commitment, is_sealed(evaluation), len(evaluation.shards)) == (None, False, 10)
    play_all(database, submission)
    assert view(database, principal, submission).evaluation.practice_scores is None


def test_a_public_list_is_played_alone_and_its_board_is_for_practice(database: Database) -> None:
    content = open_now(make_competition())
    with database.transaction() as session:
        for stage in content["tracks"][TRACK]["stages"]:
            stage["qualified"] = None
        put_in_place(session, content)
        by = make_principal(session)
        assert leaderboard(session, shown_stage(session, TRACK, FIRST)).view.is_practice
    assert len(shard_numbers(database, submit(database, by))) == 10
    with database.transaction() as session:
        put_in_place(session, open_now(make_competition()))
        assert not leaderboard(session, shown_stage(session, TRACK, FIRST)).view.is_practice, "it decides who advances"


def test_episodes_of_others_are_closed_while_a_stage_ranks_on_a_public_list(database: Database) -> None:
    content = open_now(make_competition())
    content["tracks"][TRACK]["stages"][0]["public_pages"] = True
    with database.transaction() as session:
        put_in_place(session, content)
        by, other = make_principal(session), make_principal(session, "Team B")
    submission = submit(database, by)
    play_all(database, submission)

    def seen(reader: Principal) -> int:
        with database.transaction() as session:
            assert listing.get(session, SETTINGS, reader, submission.id).evaluation.success_rate is not None
            return len(listing.episodes(session, reader, submission.id))

    assert [seen(reader) for reader in (by, CONSOLE, other, VISITOR)] == [270, 270, 0, 0]
    with refused(ProblemCode.NOT_FOUND), database.transaction() as session:
        find_episode(session, other, submission.id, TASK, 1)
    with database.transaction() as session:
        put_in_place(session, moved(content, days=-60))
    assert [seen(reader) for reader in (other, VISITOR)] == [270, 270]
