"""Models and logs that act nearly as an earlier submission of another team are noted, for organizers."""

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
from submission_steps import refused
from vitac.evaluator.episodes.records import ActionSequence, EpisodeRecord
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.db.engine import Database
from vitac.server.db.models import Submission
from vitac.server.desk.troubles import troubles
from vitac.server.errors import ProblemCode
from vitac.server.evaluations.near_copies import list_near_copies
from vitac.server.leaderboards.log_boards import log_boards
from vitac.server.logs.claims import LogClaim
from vitac.server.principals import CONSOLE, Principal
from vitac.server.submissions import creation

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
            "the states, or nearly the actions, of another team's earlier submission"
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
