from contextlib import suppress
from datetime import UTC, datetime
from typing import Any
from uuid import UUID

import numpy as np
import pytest
from quick_worker import record_of
from service_factories import (
    TASK,
    TRACK,
    RecordOf,
    make_failed_record,
    make_principal,
    make_record,
    make_score,
    make_upload,
    outdate,
    play,
    play_all,
    submit_scored,
)
from sqlalchemy import select, text, update
from submission_steps import refused
from vitac.evaluator.agent.verdicts import VerdictCode
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome, EpisodeRecord, FailureStage
from vitac.evaluator.tracks import UnknownTask
from vitac.evaluator.version import evaluator_version
from vitac.server.audit import newest_entries
from vitac.server.database.engine import Database
from vitac.server.database.models import BoardResult, CompetitionRow, Evaluation, Submission, Team
from vitac.server.database.states import EvaluationState, Role
from vitac.server.decisions import rejudging
from vitac.server.decisions.rejudging import comparison
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.evaluations import lifecycle
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.leaderboards.standings import leaderboard
from vitac.server.principals import CONSOLE, Principal
from vitac.server.receipts.issuing import receipts_of_submission
from vitac.server.submissions import creation, runs
from vitac.server.transparency.log import count_entries
from vitac.server.views.decisions import RejudgedSubmissionView

from competitions import make_competition, open_now, put_in_place, shown_stage


def standings(database: Database) -> list[tuple[str, int | None, float]]:
    """Teams of the board with rank and success rate, those of other versions last."""
    with database.transaction() as session:
        entries = leaderboard(session, shown_stage(session, TRACK), task=TASK).view.entries
        return [(entry.team, entry.rank, entry.success_rate) for entry in entries]


def of_task(episode: int, *, task: str) -> EpisodeRecord:
    """Every second episode succeeds."""
    return make_record(episode, EpisodeOutcome.SUCCESS if episode % 2 else EpisodeOutcome.TACTILE, task)


def broken(episode: int, *, task: str) -> EpisodeRecord:
    return make_failed_record(episode, stage=FailureStage.LOAD, code=VerdictCode.CRASHED, task=task)


@pytest.fixture
def upgraded(database: Database) -> dict[str, Submission]:
    """Results of three teams that an older evaluator has made: 90, 80 and 70 of 100."""
    with database.transaction() as session:
        made = {
            name: submit_scored(session, make_principal(session, name), name, {TASK: make_score(successes)})
            for name, successes in (("Ants", 90), ("Bees", 80), ("Cats", 70))
        }
        outdate(session)
    return made


def start(database: Database, *submissions: Submission) -> UUID:
    with database.transaction() as session:
        ids = [submission.id for submission in submissions]
        return rejudging.start(
            session, CONSOLE, shown_stage(session, TRACK), submissions=ids, reason="the new evaluator"
        ).id


def play_proposed(database: Database, rejudgement: UUID, **plays: RecordOf) -> None:
    """Plays what a rejudgement has queued: by `plays` of a team, else every second episode succeeds."""
    with database.transaction() as session:
        found = session.scalars(select(Evaluation).where(Evaluation.rejudgement_id == rejudgement)).all()
        shards = {each.submission.team.name: sorted(shard.id for shard in each.shards) for each in found}
    for team, ids in shards.items():
        with suppress(AssertionError):  # nothing to claim: an earlier shard has ended the evaluation
            for shard_id in ids:
                play(database, shard_id, acting_apart(team, plays.get(team, of_task)))


def acting_apart(team: str, record_of: RecordOf) -> RecordOf:
    """The same records with actions of the team's own: else all but the first would be copies."""

    def own(episode: int, *, task: str) -> EpisodeRecord:
        record = record_of(episode, task=task)
        random = np.random.default_rng((*team.encode(), episode))
        actions = random.uniform(-0.9, 0.9, record.actions.shape).astype(np.float32)
        return record.model_copy(update={"actions": ActionSequence.from_array(actions)})

    return own


def compared(database: Database, rejudgement: UUID) -> dict[str, RejudgedSubmissionView]:
    with database.transaction() as session:
        rows = comparison(session, rejudging.find(session, CONSOLE, rejudgement))
    return {row.team: row for row in rows}


def test_new_results_stand_beside_the_present_ones_until_they_are_applied(
    database: Database, upgraded: dict[str, Submission]
) -> None:
    before = standings(database)
    assert before == [("Ants", None, 0.9), ("Bees", None, 0.8), ("Cats", None, 0.7)], "another evaluator made them"
    rejudgement = start(database)
    assert not any(row.changes for row in compared(database, rejudgement).values()), "nothing has ended"
    play_proposed(database, rejudgement, Cats=make_record, Ants=record_of)
    assert standings(database) == before
    with database.transaction() as session:
        assert count_entries(session) == 3, "those of the submissions"
        for submission in upgraded.values():
            assert newest_evaluation(session, submission).evaluator_version == "0+old"
    rows = compared(database, rejudgement)
    ranks = {team: (row.before.rank, row.after.rank) for team, row in rows.items()}
    assert ranks == {"Ants": (1, 2), "Bees": (2, 3), "Cats": (3, 1)}
    assert (rows["Cats"].before.success_rate, rows["Cats"].after.success_rate) == (0.35, 0.5)
    assert all(row.changes for row in rows.values())
    shown = compared(database, rejudgement)

    with database.transaction() as session:
        told = rejudging.apply(session, CONSOLE, rejudgement)
    assert [row.team for row in told] == ["Cats", "Ants", "Bees"]
    assert standings(database) == [("Cats", 1, 1.0), ("Ants", 2, pytest.approx(2 / 3)), ("Bees", 3, 0.5)]
    with database.transaction() as session:
        assert count_entries(session) == 7, "with the rejudgement"
        receipt = receipts_of_submission(session, upgraded["Cats"].id)[-1]
        assert receipt.result.evaluation == newest_evaluation(session, upgraded["Cats"]).id
        entry = newest_entries(session, 1)[0]
        assert (entry.action, entry.before is not None) == ("rejudgement.apply", True)
        assert entry.after[str(upgraded["Cats"].id)]["rank"] == 1
    assert compared(database, rejudgement) == shown, "it still says what it has changed"
    with refused(ProblemCode.NOT_REQUEUABLE), database.transaction() as session:
        rejudging.discard(session, CONSOLE, rejudgement)


def test_a_discarded_rejudgement_changes_nothing(database: Database, upgraded: dict[str, Submission]) -> None:
    before = standings(database)
    rejudgement = start(database, upgraded["Ants"], upgraded["Bees"])
    assert set(compared(database, rejudgement)) == {"Ants", "Bees"}
    with refused(ProblemCode.STAGE_NOT_OVER), database.transaction() as session:
        rejudging.apply(session, CONSOLE, rejudgement)
    with database.transaction() as session:
        rejudging.discard(session, CONSOLE, rejudgement)
    with database.transaction() as session:
        states = session.scalars(select(Evaluation.state).where(Evaluation.rejudgement_id == rejudgement)).all()
        assert set(states) == {EvaluationState.CANCELLED}
    assert standings(database) == before
    with refused(ProblemCode.NOT_REQUEUABLE), database.transaction() as session:
        rejudging.apply(session, CONSOLE, rejudgement)


def test_the_team_can_still_be_evaluated_after_its_new_result_was_discarded(
    database: Database, upgraded: dict[str, Submission]
) -> None:
    rejudgement = start(database, upgraded["Ants"])
    play_proposed(database, rejudgement)
    with database.transaction() as session:
        rejudging.discard(session, CONSOLE, rejudgement)
    with database.transaction() as session:
        team = Principal(role=Role.TEAM, team_id=upgraded["Ants"].team_id, team_name="Ants")
        again, is_new = creation.create(session, team, make_upload("Ants", name="Ants"))
        assert (again.id, is_new) == (upgraded["Ants"].id, True)
        assert newest_evaluation(session, again).run == 2


def test_a_policy_that_fails_now_leaves_the_board_and_lost_machines_change_nothing(
    database: Database, upgraded: dict[str, Submission]
) -> None:
    with database.transaction() as session:
        session.execute(update(Evaluation).values(evaluator_version=evaluator_version()))
        session.execute(update(BoardResult).values(evaluator_version=evaluator_version()))
    rejudgement = start(database)
    play_proposed(database, rejudgement, Ants=broken)
    with database.transaction() as session:
        lost = session.scalars(
            select(Evaluation)
            .where(Evaluation.rejudgement_id == rejudgement)
            .join(Submission)
            .where(Submission.name == "Bees")
        ).one()
        session.execute(text("SET LOCAL session_replication_role = replica"))
        session.execute(
            text(
                "UPDATE evaluations SET state = 'failed', verdict_code = 'machine_failed', scores = NULL, "
                "result_hash = NULL, finished_at = now() WHERE id = :id"
            ),
            {"id": lost.id},
        )
        # The organizers asked for it, so it is not counted against the team.
        assert lifecycle.count_machine_failures(session, Submission.id == upgraded["Bees"].id) == 0
    rows = compared(database, rejudgement)
    assert rows["Ants"].after.verdict == VerdictCode.CRASHED
    assert (rows["Ants"].changes, rows["Bees"].keeps_result, rows["Bees"].changes) == (True, True, False)
    with database.transaction() as session:
        rejudging.apply(session, CONSOLE, rejudgement)
    assert standings(database) == [("Bees", 1, 0.8), ("Cats", 2, 0.5)]


def test_what_cannot_be_rejudged_is_refused(database: Database, upgraded: dict[str, Submission]) -> None:
    def refuse(code: ProblemCode, by: Principal = CONSOLE, **options: Any) -> None:
        with refused(code), database.transaction() as session:
            place = shown_stage(session, options.pop("track", TRACK), options.pop("stage", None))
            rejudging.start(session, by, place, **({"reason": "x"} | options))

    for reason in ("", " ", "two\x00parts", "x" * 501, "turned \u202e around"):
        refuse(ProblemCode.INVALID_REQUEST, reason=reason)
    refuse(ProblemCode.UNKNOWN_TRACK, track="nothing")
    refuse(ProblemCode.UNKNOWN_STAGE, stage="stage1")
    refuse(ProblemCode.NOT_FOUND, submissions=[UUID(int=1)])
    refuse(ProblemCode.NOT_FOUND, track="track_2")
    refuse(ProblemCode.FORBIDDEN, by=Principal(role=Role.JUDGE, team_id=None, team_name=None))
    start(database, upgraded["Ants"])
    refuse(ProblemCode.NOT_REQUEUABLE, submissions=[upgraded["Ants"].id])
    with refused(ProblemCode.NOT_FOUND), database.transaction() as session:
        rejudging.apply(session, CONSOLE, UUID(int=1))


def test_an_older_rejudgement_takes_no_newer_result_away(database: Database, upgraded: dict[str, Submission]) -> None:
    older = start(database)
    play_proposed(database, older)
    newer = start(database, upgraded["Ants"])
    play_proposed(database, newer, Ants=make_record)
    seen = compared(database, newer)
    assert seen["Ants"].changes
    with database.transaction() as session:
        runs.run_again(session, CONSOLE, upgraded["Bees"].id)
        rejudging.apply(session, CONSOLE, newer)
    rows = compared(database, older)
    assert {team for team, row in rows.items() if row.keeps_result} == {"Ants", "Bees"}, "one waits, one is complete"
    assert not rows["Ants"].changes
    with database.transaction() as session:
        rejudging.apply(session, CONSOLE, older)
    assert compared(database, newer) == seen
    assert standings(database) == [("Ants", 1, 1.0), ("Cats", 2, 0.5), ("Bees", None, 0.8)]
    play_all(database, upgraded["Bees"])
    assert [rate for team, _, rate in standings(database) if team == "Bees"] == [1.0]
    assert compared(database, older) == rows, "whatever came after it"
    assert compared(database, newer) == seen
    with database.transaction() as session:
        for team, run in (("Ants", newer), ("Bees", None), ("Cats", older)):
            assert newest_evaluation(session, upgraded[team]).rejudgement_id == run


def test_boards_that_stand_still_are_not_changed(database: Database) -> None:
    with database.transaction() as session:
        put_in_place(session, open_now(make_competition()))
        staged = submit_scored(session, make_principal(session, "Ants"), "Ants", {TASK: make_score(90)})
    rejudgement = start(database, staged)
    play_proposed(database, rejudgement)
    with database.transaction() as session:
        session.get_one(CompetitionRow, "cup").frozen_at = datetime.now(UTC)
    assert compared(database, rejudgement)["Ants"].changes, "organizers see what it would change"
    with pytest.raises(ServiceError, match="unfreeze"), database.transaction() as session:
        rejudging.apply(session, CONSOLE, rejudgement)
    with database.transaction() as session:
        assert session.scalars(
            select(BoardResult.ranked_by["success_rate"].as_float()).where(BoardResult.board == TASK)
        ).all() == [0.9]
        session.get_one(CompetitionRow, "cup").frozen_at = None
    with database.transaction() as session:
        rejudging.apply(session, CONSOLE, rejudgement)
        assert session.scalars(
            select(BoardResult.ranked_by["success_rate"].as_float()).where(BoardResult.board == TASK)
        ).all() == [0.5]


def test_a_proposed_evaluation_can_be_cancelled_and_uploads_that_are_gone_are_left_alone(
    database: Database, upgraded: dict[str, Submission]
) -> None:
    with database.transaction() as session:
        session.get_one(Team, upgraded["Cats"].team_id).erased_at = datetime.now(UTC)
    rejudgement = start(database)
    assert set(compared(database, rejudgement)) == {"Ants", "Bees"}, "the upload of Cats was removed"
    with refused(ProblemCode.NOT_FOUND):
        start(database, upgraded["Cats"])
    with pytest.raises(ServiceError, match=f"for rejudgement {rejudgement}"), database.transaction() as session:
        runs.run_again(session, CONSOLE, upgraded["Ants"].id)
    team = Principal(role=Role.TEAM, team_id=upgraded["Ants"].team_id, team_name="Ants")
    with database.transaction() as session:
        query = select(Evaluation).where(Evaluation.rejudgement_id == rejudgement).join(Submission)
        proposed = session.scalars(query.where(Submission.name == "Ants")).one()
        with refused(ProblemCode.FORBIDDEN):
            runs.cancel_evaluation(session, team, proposed)
        runs.cancel_evaluation(session, CONSOLE, proposed)
        with refused(ProblemCode.NOT_CANCELLABLE):
            runs.cancel_evaluation(session, CONSOLE, proposed)
        assert proposed.state is EvaluationState.CANCELLED
        assert newest_evaluation(session, upgraded["Ants"]).state is EvaluationState.COMPLETED
        runs.run_again(session, CONSOLE, upgraded["Ants"].id)


def test_what_played_a_removed_task_is_left_out_unless_it_is_named(
    database: Database, upgraded: dict[str, Submission]
) -> None:
    with database.transaction() as session:
        gone = session.get_one(Submission, upgraded["Bees"].id)
        gone.tasks = [TASK, "gone"]
    with pytest.raises(UnknownTask, match="'gone'"):
        start(database, gone)
    rejudgement = start(database)
    assert compared(database, rejudgement).keys() == {"Ants", "Cats"}
    with database.transaction() as session:
        rejudging.discard(session, CONSOLE, rejudgement)
        session.get_one(Submission, gone.id).tasks = ["gone"]
        on_board = session.get_one(Evaluation, newest_evaluation(session, gone).id)
        on_board.scores = [{**row, "task": "gone"} for row in on_board.scores or []]
    with database.transaction() as session:
        board = leaderboard(session, shown_stage(session, TRACK)).view
    assert [(entry.team, entry.rank) for entry in board.entries] == [("Ants", None), ("Cats", None)]
    assert board.teams == 2
