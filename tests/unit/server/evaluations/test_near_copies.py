"""Models and logs that are near copies of another team's earlier submission are not ranked until they are cleared."""

from functools import partial

import numpy as np
import pytest
from service_factories import (
    TASK,
    TRACK,
    RecordOf,
    make_principal,
    make_record,
    make_upload,
    play_all,
    sha256,
)
from submission_steps import SETTINGS, refused
from vitac.evaluator.episodes.records import ActionSequence, EpisodeRecord
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.audit import newest_entries
from vitac.server.database.engine import Database
from vitac.server.database.models import Submission
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.evaluations.logs import LogClaim
from vitac.server.evaluations.near_copies import list_near_copies
from vitac.server.leaderboards.log_boards import log_boards
from vitac.server.leaderboards.standings import leaderboard
from vitac.server.operations.desk import troubles
from vitac.server.principals import CONSOLE, VISITOR, Principal
from vitac.server.submissions import creation, listing, runs, withdrawal

from competitions import shown_stage

STEPS = 3


@pytest.fixture
def teams(database: Database) -> tuple[Principal, Principal]:
    with database.transaction() as session:
        return make_principal(session, "Source"), make_principal(session, "Table")


def acting(seed: int, *, change: float = 0.0) -> RecordOf:
    """Records of a policy that acts by its seed, changed a little; their states say nothing."""

    def record_of(episode: int, *, task: str) -> EpisodeRecord:
        actions = np.random.default_rng((seed, episode)).uniform(-0.9, 0.9, (STEPS, 3))
        noise = change * np.random.default_rng((99, episode)).uniform(-1, 1, actions.shape)
        return make_record(
            episode,
            task=task,
            actions=ActionSequence.from_array((actions + noise).astype(np.float32)),
            state_hashes=tuple(sha256(f"{seed} {episode} {change} {step}") for step in range(STEPS + 1)),
        )

    return record_of


def submit(database: Database, by: Principal, name: str, kind: SubmissionKind = SubmissionKind.MODEL) -> Submission:
    claim = LogClaim(team=None, episodes=270, successes=270, success_rate=1.0, mean_steps=3.0)
    upload = make_upload(name, name=name, kind=kind, **({} if kind.form.runs_policy else {"manifest": claim.stored()}))
    with database.transaction() as session:
        return creation.create(session, by, upload)[0]


def found(database: Database) -> list[tuple[str, str, int]]:
    with database.transaction() as session:
        return sorted(
            (one.submission_name, one.earlier_submission_name, one.near) for one in list_near_copies(session, CONSOLE)
        )


@pytest.mark.parametrize("later_is_evaluated_first", [False, True])
def test_the_later_of_two_that_act_alike_is_noted(
    database: Database, teams: tuple[Principal, Principal], later_is_evaluated_first: bool
) -> None:
    source, table = submit(database, teams[0], "source"), submit(database, teams[1], "table")
    plays = [partial(play_all, database, source, acting(1)), partial(play_all, database, table, acting(1, change=1e-5))]
    for play in reversed(plays) if later_is_evaluated_first else plays:
        play()
    assert found(database) == [("table", "source", 270)]
    with database.transaction() as session:
        (one,) = list_near_copies(session, CONSOLE)
        assert (one.task, one.sealed, one.team, one.earlier_team) == (TASK, False, "Table", "Source")
        assert one.difference <= 1e-5
        assert [trouble.problem for trouble in troubles(session, CONSOLE)] == [
            "the states, nearly the actions, or the archive of another team's earlier submission"
        ]
    with refused(ProblemCode.FORBIDDEN), database.transaction() as session:
        list_near_copies(session, teams[0])


def test_what_a_team_did_itself_before_is_no_copy(database: Database, teams: tuple[Principal, Principal]) -> None:
    for by, name, change in ((teams[0], "first", 0.0), (teams[1], "table", 1e-5), (teams[0], "again", 1e-4)):
        play_all(database, submit(database, by, name), acting(1, change=change))
    assert found(database) == [("table", "first", 270)]


def test_what_another_team_chose_by_itself_is_no_copy(database: Database, teams: tuple[Principal, Principal]) -> None:
    for by, seed in zip(teams, (1, 2), strict=True):
        play_all(database, submit(database, by, f"policy {seed}"), acting(seed))
    assert found(database) == []


def test_a_log_of_nearly_the_actions_of_a_model_is_not_ranked(
    database: Database, teams: tuple[Principal, Principal]
) -> None:
    play_all(database, submit(database, teams[0], "source"), acting(1))
    play_all(database, submit(database, teams[1], "log", SubmissionKind.LOG), acting(1, change=1e-5))
    with database.transaction() as session:
        (entry,) = log_boards(session, shown_stage(session, TRACK)).view.boards[0].entries
        assert (entry.rank, entry.copy_of and entry.copy_of.episodes) == (None, 270)


def on_board(database: Database) -> list[tuple[int | None, str]]:
    with database.transaction() as session:
        view = leaderboard(session, shown_stage(session, TRACK), task=TASK).view
        return [(entry.rank, entry.submission_name) for entry in view.entries]


def test_a_model_that_acts_nearly_as_an_earlier_one_is_not_ranked_until_an_organizer_clears_it(
    database: Database, teams: tuple[Principal, Principal]
) -> None:
    source, table = submit(database, teams[0], "source"), submit(database, teams[1], "table")
    play_all(database, source, acting(1))
    play_all(database, table, acting(1, change=1e-5))
    assert on_board(database) == [(1, "source"), (None, "table")]
    with database.transaction() as session:
        copy = leaderboard(session, shown_stage(session, TRACK), task=TASK).view.entries[1].copy_of
        shown = listing.get(session, SETTINGS, teams[1], table.id)
        assert copy is not None
        assert shown.copy_of == copy
        assert shown.evaluation.success_rate is not None
        assert copy.sentence.startswith(
            f"270 of 270 episodes of {TASK} on the public list are near those of an earlier submission of Source"
        )
        assert "is not ranked until an organizer has cleared it" in copy.sentence
        for by in (teams[1], VISITOR):
            with pytest.raises(ServiceError):
                withdrawal.clear_copy(session, by, table.id, "made apart")
    with database.transaction() as session:
        withdrawal.clear_copy(session, CONSOLE, table.id, "made apart")
        with refused(ProblemCode.INVALID_REQUEST):
            withdrawal.clear_copy(session, CONSOLE, table.id, "again")
        assert newest_entries(session)[0].action == "submission.clear"
        assert not troubles(session, CONSOLE)
    assert sorted(on_board(database)) == [(1, "source"), (2, "table")]
    with database.transaction() as session:
        cleared = listing.get(session, SETTINGS, teams[1], table.id).copy_of
        assert cleared is not None
        assert (cleared.ranked, cleared.sentence.endswith("An organizer has cleared it: made apart")) == (True, True)
        runs.run_again(session, CONSOLE, table.id)
    play_all(database, table, acting(1, change=1e-5))
    assert sorted(on_board(database)) == [(1, "source"), (2, "table")]
    with database.transaction() as session:
        for _ in range(2):
            withdrawal.withdraw_clearance(session, CONSOLE, table.id)
        assert [entry.action for entry in newest_entries(session, 2)].count("submission.withdraw-clearance") == 1
    assert on_board(database) == [(1, "source"), (None, "table")]


def test_a_cleared_copy_stays_ranked_beside_one_that_is_not_cleared(
    database: Database, teams: tuple[Principal, Principal]
) -> None:
    with database.transaction() as session:
        third = make_principal(session, "Third")
    copies = [submit(database, by, by.team_name or "") for by in (*teams, third)]
    for number, submission in enumerate(copies):
        play_all(database, submission, acting(1, change=1e-5 * number))
    with database.transaction() as session:
        withdrawal.clear_copy(session, CONSOLE, copies[1].id, "made apart")
    with database.transaction() as session:
        found = [listing.get(session, SETTINGS, CONSOLE, one.id).copy_of for one in copies[1:]]
        assert [copy and copy.ranked for copy in found] == [True, False]


def test_a_team_keeps_its_place_by_what_is_no_copy(database: Database, teams: tuple[Principal, Principal]) -> None:
    play_all(database, submit(database, teams[0], "source"), acting(1))
    for name, records in (("own", acting(2)), ("table", acting(1, change=1e-5))):
        play_all(database, submit(database, teams[1], name), records)
    assert sorted(on_board(database)) == [(1, "source"), (2, "own")]


def test_what_was_marked_is_ranked_again_once_it_is_known_to_be_the_earlier_one(
    database: Database, teams: tuple[Principal, Principal]
) -> None:
    """Its team had acted so before, in a submission that was evaluated last."""
    first, source = submit(database, teams[1], "first"), submit(database, teams[0], "source")
    later = submit(database, teams[1], "later")
    play_all(database, source, acting(1))
    play_all(database, later, acting(1, change=1e-5))
    assert on_board(database) == [(1, "source"), (None, "later")]
    play_all(database, first, acting(1, change=1e-4))
    assert {name: rank is not None for rank, name in on_board(database)} == {"source": False, "first": True}
