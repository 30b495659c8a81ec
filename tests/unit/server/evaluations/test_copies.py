from collections.abc import Mapping

import numpy as np
import pytest
from database_work import database_work
from service_factories import (
    TASK,
    RecordOf,
    make_principal,
    make_record,
    make_upload,
    play_all,
    sha256,
)
from sqlalchemy import text
from vitac.evaluator.episodes.records import ActionSequence, EpisodeRecord
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import Task
from vitac.evaluator.tracks.definition import ShardEpisodes
from vitac.server.accounts.shown_names import ShownNames
from vitac.server.database.engine import Database
from vitac.server.database.models import Submission
from vitac.server.evaluations import lifecycle, view
from vitac.server.evaluations.copies import find_copies, flag_copies
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.evaluations.logs import LogClaim
from vitac.server.leaderboards.log_boards import log_boards
from vitac.server.principals import CONSOLE, Principal
from vitac.server.submissions import creation
from vitac.server.views.evaluations import CopyView

from competitions import shown_stage

CLAIM = LogClaim(team=None, episodes=270, successes=270, success_rate=1.0, mean_steps=3.0)


@pytest.fixture(autouse=True)
def _whole_lists_are_one_shard(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dozens of evaluations are made up here, of which ten shards each took most of the time."""

    def uncut(task: Task) -> tuple[ShardEpisodes, ...]:
        return (ShardEpisodes(index=0, episodes=task.episodes),)

    monkeypatch.setattr(lifecycle, "cut", uncut)


@pytest.fixture
def other(database: Database) -> Principal:
    with database.transaction() as session:
        return make_principal(session, "Team B")


def add(database: Database, by: Principal, content: str, kind: SubmissionKind = SubmissionKind.LOG) -> Submission:
    manifest = {"track": "track_1"} if kind is SubmissionKind.MODEL else CLAIM.stored()
    with database.transaction() as session:
        return creation.create(session, by, make_upload(content, kind=kind, manifest=manifest, name=content))[0]


def elsewhere_from(first: int) -> RecordOf:
    """Records with other actions and states from an episode on."""

    def record(episode: int, *, task: str = TASK) -> EpisodeRecord:
        if episode < first:
            return make_record(episode, task=task)
        actions = ActionSequence.from_array(np.full((3, 3), 0.3 + episode / 1000, np.float32))
        hashes = tuple(sha256(f"B {episode} {n}") for n in range(4))
        return make_record(episode, task=task, actions=actions, state_hashes=hashes)

    return record


def with_negative_zeros(episode: int, *, task: str = TASK) -> EpisodeRecord:
    return make_record(episode, task=task, actions=ActionSequence.from_array(np.full((3, 3), -0.0, np.float32)))


def ending_otherwise(after: int) -> RecordOf:
    """Records with other actions and states after so many env steps."""

    def record(episode: int, *, task: str = TASK) -> EpisodeRecord:
        honest = make_record(episode, task=task)
        actions = honest.actions.to_array()
        actions[after:] += 0.125
        hashes = (*honest.state_hashes[: after + 1], *(sha256(f"other {episode} {n}") for n in range(after, 3)))
        return make_record(episode, task=task, actions=ActionSequence.from_array(actions), state_hashes=hashes)

    return record


def found(database: Database, *submissions: Submission) -> list[CopyView | None]:
    with database.transaction() as session:
        ids = [newest_evaluation(session, submission).id for submission in submissions]
        copies = find_copies(session, ids, ShownNames.read(session, CONSOLE), logs=ids)
    return [copies.get(evaluation_id) for evaluation_id in ids]


def ranks(database: Database) -> Mapping[str, int | None]:
    with database.transaction() as session:
        return {
            entry.team: entry.rank
            for entry in log_boards(session, shown_stage(session, "track_1")).view.boards[0].entries
        }


@pytest.mark.parametrize("theirs", [SubmissionKind.LOG, SubmissionKind.MODEL, SubmissionKind.TEXT_LOG])
def test_a_log_with_the_states_of_another_teams_submission_is_not_ranked(
    database: Database, principal: Principal, other: Principal, theirs: SubmissionKind
) -> None:
    """Whatever its header and its digest say, and with actions of other bytes."""
    first = add(database, principal, "first", theirs)
    stolen = add(database, other, "stolen")
    play_all(database, first)
    play_all(database, stolen, with_negative_zeros)
    assert found(database, first, stolen) == [None, CopyView(team="Team A", episodes=270, ranked=False)]
    assert ranks(database) == ({"Team A": 1} if theirs is SubmissionKind.LOG else {}) | {"Team B": None}
    with database.transaction() as session:
        copied = {row.team: row.copied_episodes for row in view.list_evaluations(session, limit=10)}
    assert copied == {"Team A": 0, "Team B": 270}


def test_the_earlier_submission_stands_even_if_it_is_evaluated_later(
    database: Database, principal: Principal, other: Principal
) -> None:
    first, stolen = add(database, principal, "first"), add(database, other, "stolen")
    play_all(database, stolen)
    assert ranks(database) == {"Team B": 1}
    play_all(database, first)
    assert found(database, first, stolen) == [None, CopyView(team="Team A", episodes=270, ranked=False)]
    assert ranks(database) == {"Team A": 1, "Team B": None}


def test_the_same_file_from_two_teams_is_found_although_its_episodes_are_stored_once(
    database: Database, principal: Principal, other: Principal
) -> None:
    first, same = add(database, principal, "one"), add(database, other, "one")
    play_all(database, first)
    play_all(database, same)
    assert found(database, first, same) == [None, CopyView(team="Team A", episodes=270, ranked=False)]


def test_repeats_under_each_others_numbers_are_found(
    database: Database, principal: Principal, other: Principal
) -> None:
    """Repeats of a start have equal states and differ in their noise only."""

    def shifted(episode: int, *, task: str = TASK) -> EpisodeRecord:
        hashes = make_record((episode + 89) % 270 + 1, task=task).state_hashes
        return make_record(episode, task=task, state_hashes=hashes)

    first, later = add(database, principal, "first"), add(database, other, "later")
    play_all(database, first)
    play_all(database, later, shifted)
    assert found(database, later) == [CopyView(team="Team A", episodes=270, ranked=False)]


@pytest.mark.parametrize(("equal", "ranked"), [(1, True), (134, True), (135, False)])
def test_fewer_than_half_of_the_episodes_are_told_but_ranked(
    database: Database, principal: Principal, other: Principal, equal: int, ranked: bool
) -> None:
    first, later = add(database, principal, "first"), add(database, other, "later")
    play_all(database, first)
    play_all(database, later, elsewhere_from(equal + 1))
    assert found(database, later) == [CopyView(team="Team A", episodes=equal, ranked=ranked)]
    assert ranks(database)["Team B"] == (2 if ranked else None)


@pytest.mark.parametrize("theirs_first", [True, False])
def test_a_log_that_only_ends_its_episodes_otherwise_is_a_copy_whichever_is_evaluated_first(
    database: Database, principal: Principal, other: Principal, theirs_first: bool
) -> None:
    """The last of three actions is another one in each episode, so that no episode has the same states to its end."""
    first, changed = add(database, principal, "first"), add(database, other, "changed")
    played = [(first, make_record), (changed, ending_otherwise(after=2))]
    for submission, record_of in played if theirs_first else reversed(played):
        play_all(database, submission, record_of)
    assert found(database, first, changed) == [None, CopyView(team="Team A", episodes=270, ranked=False)]
    assert ranks(database) == {"Team A": 1, "Team B": None}


def test_a_log_that_goes_its_own_way_before_half_of_its_env_steps_is_none(
    database: Database, principal: Principal, other: Principal
) -> None:
    first, own = add(database, principal, "first"), add(database, other, "own")
    play_all(database, first)
    play_all(database, own, ending_otherwise(after=1))
    assert found(database, own) == [None]


def test_of_a_stolen_log_episodes_count_whole_or_begun(
    database: Database, principal: Principal, other: Principal
) -> None:
    """A third is repeated to the end, a third to the last action, a third not at all."""

    def mixed(episode: int, *, task: str = TASK) -> EpisodeRecord:
        return (make_record, ending_otherwise(after=2), elsewhere_from(1))[episode % 3](episode, task=task)

    model, log = add(database, principal, "model", SubmissionKind.MODEL), add(database, other, "log")
    play_all(database, model)
    play_all(database, log, mixed)
    assert found(database, log) == [CopyView(team="Team A", episodes=180, ranked=False)]


def test_logs_that_begin_all_episodes_with_the_same_moves_are_no_copies(
    database: Database, principal: Principal, other: Principal
) -> None:
    """Two teams feel for the part by equal moves, which lead to equal states, and then act on what they felt."""

    def probing(ends: str) -> RecordOf:
        def record(episode: int, *, task: str = TASK) -> EpisodeRecord:
            actions = np.full((3, 3), 0.5, np.float32)
            actions[0, 0] = -0.0 if ends == "B" and episode % 2 else 0.0
            actions[2] = episode / 1000 + (0.25 if ends == "B" else 0.0)
            hashes = (*(sha256(f"{episode} {n}") for n in range(3)), sha256(f"{ends} {episode}"))
            return make_record(episode, task=task, actions=ActionSequence.from_array(actions), state_hashes=hashes)

        return record

    first, later = add(database, principal, "first"), add(database, other, "later")
    play_all(database, first, probing("A"))
    play_all(database, later, probing("B"))
    assert found(database, first, later) == [None, CopyView(team="Team A", episodes=1, ranked=True)]
    assert ranks(database) == {"Team A": 1, "Team B": 2}


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0)])
def test_a_team_whose_text_log_came_first_may_upload_its_actions_as_a_log_although_another_team_did_so_before(
    database: Database, principal: Principal, other: Principal, order: tuple[int, ...]
) -> None:
    text_log = add(database, principal, "text", SubmissionKind.TEXT_LOG)
    stolen, own = add(database, other, "stolen"), add(database, principal, "own")
    for number in order:
        play_all(database, (text_log, stolen, own)[number])
    copy = CopyView(team="Team A", episodes=270, ranked=False)
    assert found(database, text_log, stolen, own) == [None, copy, None]
    assert ranks(database) == {"Team A": 1, "Team B": None}


def test_own_logs_and_episodes_without_an_env_step_are_no_copies_but_a_model_that_goes_as_a_log_is(
    database: Database, principal: Principal, other: Principal
) -> None:
    def unmoved(episode: int, *, task: str = TASK) -> EpisodeRecord:
        none = ActionSequence.from_array(np.zeros((0, 3), np.float32))
        return make_record(
            episode, task=task, env_steps=0, actions=none, infos=(), state_hashes=(sha256(f"reset {episode}"),)
        )

    own = [add(database, principal, "first"), add(database, principal, "again")]
    model = add(database, other, "model", SubmissionKind.MODEL)
    for submission in (*own, model):
        play_all(database, submission)
    still = [add(database, principal, "still"), add(database, other, "still, too")]
    for submission in still:
        play_all(database, submission, unmoved)
    assert found(database, *own, *still) == [None] * 4
    (copy,) = found(database, model)
    assert copy is not None
    assert (copy.team, copy.episodes, copy.of, copy.task, copy.ranked) == ("Team A", 270, 270, TASK, False)


def test_a_copy_is_found_by_indexes_and_comparing_again_changes_nothing(
    database: Database, principal: Principal, other: Principal
) -> None:
    for number in range(3):
        play_all(database, add(database, principal, f"other {number}"), elsewhere_from(number))
    first, stolen = add(database, principal, "first"), add(database, other, "stolen")
    play_all(database, first)
    play_all(database, stolen)
    before = found(database, stolen)
    with database.transaction() as session:
        session.execute(text("ANALYZE"))
    with database.transaction() as session:
        evaluation = newest_evaluation(session, session.get_one(Submission, stolen.id))
        with database_work(session) as work:
            flag_copies(session, evaluation)
    assert work.statements <= 7
    assert found(database, stolen) == before
