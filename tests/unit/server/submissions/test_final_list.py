"""The final list of a stage: chosen submissions play it together, once and after the close, and it alone decides."""

from datetime import UTC, datetime
from typing import Any

import pytest
from service_factories import (
    TASK,
    TRACK,
    complete_scored,
    make_principal,
    make_score,
    shard_ids,
    submit,
    submit_scored,
    successes_below,
)
from service_factories import play as play_shard
from sqlalchemy import select
from submission_steps import SETTINGS, refused
from vitac.envs.tasks.definition import Better
from vitac.evaluator.ranking import SUBMITTED_AT, SUCCESS_RATE, Ranking
from vitac.server.competitions.applying import apply
from vitac.server.competitions.competition import Competition
from vitac.server.competitions.definition import AT_ONCE_RUNS, CompetitionDefinition
from vitac.server.competitions.sealing import find_secret, reveal, sealed_lists
from vitac.server.database.engine import Database
from vitac.server.database.models import FreshList, ReceiptRow, Shard, Submission
from vitac.server.decisions.finishing import finalize
from vitac.server.errors import ProblemCode
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.leaderboards.shake_up import list_shake_up
from vitac.server.leaderboards.standings import leaderboard
from vitac.server.operations.desk import read_desk
from vitac.server.principals import CONSOLE, Principal
from vitac.server.submissions import listing
from vitac.server.submissions.final_list import choose, play, play_due

from competitions import FIRST, make_competition, moved, open_now, put_in_place, shown_stage, stored_stage

FINAL = f"{FIRST}.final"
LIVE = {"Ants": 150, "Bees": 120, "Cats": 90}
LATER = {"Ants": 20, "Bees": 60, "Cats": 100}


def cup(**of_stage: Any) -> dict[str, Any]:
    content = open_now(make_competition(prizes=[{"place": "first", "amount": 5}]))
    (stage, _) = content["tracks"][TRACK]["stages"]
    content["tracks"][TRACK]["stages"] = [stage | {"list": "sealed", "accepts": ["model"]} | of_stage]
    return content


@pytest.fixture
def teams(database: Database) -> dict[str, Principal]:
    """A stage whose winner gets a prize, and its teams, each with a first submission and a better one."""
    with database.transaction() as session:
        apply(session, CONSOLE, CompetitionDefinition.model_validate(cup()))
        by_name = {name: make_principal(session, name) for name in LIVE}
        for name, successes in LIVE.items():
            submit_scored(session, by_name[name], f"first of {name}", {TASK: make_score(successes - 60, 200)})
            submit_scored(session, by_name[name], f"best of {name}", {TASK: make_score(successes, 200)})
    return by_name


def close(database: Database) -> None:
    with database.transaction() as session:
        put_in_place(session, moved(cup(), days=-300))


def named(database: Database, name: str, stage: str = FIRST) -> Submission:
    with database.transaction() as session:
        return session.scalars(select(Submission).where(Submission.name == name, Submission.stage == stage)).one()


def entered(database: Database) -> dict[str, Submission]:
    with database.transaction() as session:
        return {found.name: found for found in session.scalars(select(Submission).where(Submission.stage == FINAL))}


def play_final(database: Database) -> None:
    close(database)
    with database.transaction() as session:
        assert play_due(session) == 1
        for submission in session.scalars(select(Submission).where(Submission.stage == FINAL)):
            complete_scored(session, submission, {TASK: make_score(LATER[submission.team.name], 200)})


def test_a_stage_that_decides_has_two_lists_and_both_are_committed_to_before(database: Database, teams: object) -> None:
    with database.transaction() as session:
        lists = sealed_lists(session, Competition.read(session))
        assert [found.stage for found in lists] == [FIRST, FINAL]
        assert len({found.commitment for found in lists}) == 2
        entries = session.scalars(select(ReceiptRow).order_by(ReceiptRow.number)).all()
        assert [entry.stands_for for entry in entries[:4]] == [
            "competition",
            "sealed_list",
            "sealed_list",
            "submission",
        ]
        live, final = Competition.read(session).stages
        assert (live.decides, final.decides, final.before) == (False, True, None)
        said = leaderboard(session, shown_stage(session, TRACK)).view.list_sentence or ""
    assert said.startswith("This board shows the live list, played at each submission. The final list, which alone")
    assert f"is played after {live.rules.closes:%F %H:%M} UTC, once, for the chosen submission of each team" in said


def test_the_chosen_submission_plays_and_without_a_choice_the_best(
    database: Database, teams: dict[str, Principal]
) -> None:
    with database.transaction() as session:
        for name in ("best of Ants", "first of Ants"):  # the newer choice counts
            found = session.scalars(select(Submission).where(Submission.name == name)).one()
            choose(session, teams["Ants"], found.id, chosen=True)
        with refused(ProblemCode.NOT_FOUND):
            choose(session, teams["Bees"], found.id, chosen=True)
    play_final(database)
    assert set(entered(database)) == {"first of Ants", "best of Bees", "best of Cats"}
    with database.transaction() as session:
        for submission in session.scalars(select(Submission).where(Submission.stage == FINAL)):
            chosen = session.get_one(Submission, submission.final_of)
            assert (submission.digest, submission.submitted_at) == (chosen.digest, chosen.submitted_at)
            evaluation = newest_evaluation(session, submission)
            assert evaluation.commitment == stored_stage(session, TRACK, FINAL).commitment
            shards = session.scalars(select(Shard).where(Shard.id.in_(shard_ids(session, submission))))
            assert {shard.commitment for shard in shards} == {evaluation.commitment}, "no public list beside it"


def test_the_final_list_is_played_once_and_after_the_close(database: Database, teams: dict[str, Principal]) -> None:
    with database.transaction() as session:
        assert play_due(session) == 0
        with refused(ProblemCode.STAGE_NOT_OVER):
            play(session, CONSOLE, stored_stage(session, TRACK, FIRST))
    close(database)
    chosen = named(database, "best of Ants").id
    with database.transaction() as session:
        with refused(ProblemCode.STAGE_CLOSED):
            choose(session, teams["Ants"], chosen, chosen=True)
        with refused(ProblemCode.LIST_SEALED):
            reveal(session, CONSOLE, stored_stage(session, TRACK, FINAL))
        with refused(ProblemCode.STAGE_NOT_OVER):
            finalize(session, CONSOLE, confirmed=None)
        choose(session, CONSOLE, chosen, chosen=True)
    play_final(database)
    with database.transaction() as session:
        assert play_due(session) == 0
        with refused(ProblemCode.STAGE_IN_USE):
            play(session, CONSOLE, stored_stage(session, TRACK, FIRST))
        with refused(ProblemCode.STAGE_CLOSED):
            choose(session, CONSOLE, chosen, chosen=False)
        entry = session.scalars(select(ReceiptRow).where(ReceiptRow.stands_for == "final_list")).one()
        assert str(chosen) in entry.entry
        with refused(ProblemCode.STAGE_IN_USE):
            apply(session, CONSOLE, CompetitionDefinition.model_validate(cup()), confirmed=None)


def test_an_evaluation_of_the_live_list_that_waits_holds_the_final_one_up(
    database: Database, teams: dict[str, Principal]
) -> None:
    with database.transaction() as session:
        submit(session, teams["Ants"], "late")
    close(database)
    with database.transaction() as session:
        assert play_due(session) == 0
    assert entered(database) == {}


def test_the_final_list_alone_decides_and_its_board_is_shown_first(
    database: Database, teams: dict[str, Principal]
) -> None:
    play_final(database)
    with database.transaction() as session:
        board, live = (leaderboard(session, shown_stage(session, TRACK, name)).view for name in (None, FIRST))
        assert ([entry.team for entry in board.entries], board.stage) == (["Cats", "Bees", "Ants"], FINAL)
        assert [entry.team for entry in live.entries] == ["Ants", "Bees", "Cats"]
        assert (board.list_sentence or "").startswith("This board shows the final list, which alone decides")
        of_task = leaderboard(session, shown_stage(session, TRACK), task=TASK).view
        shaken = {one.team: one for one in list_shake_up(session, of_task, 50)}
        assert (shaken["Ants"].live_rank, shaken["Ants"].final_rank) == (1, 3)
        low, high = shaken["Ants"].interval
        assert low < 0.1 - 0.75 < high < 0
        fewest = Ranking(keys=(SUCCESS_RATE.model_copy(update={"better": Better.LOW}), SUBMITTED_AT))
        other = list_shake_up(session, of_task.model_copy(update={"ranking": fewest}), 50)
        assert {one.team: one.live_rank for one in other} == {"Cats": 1, "Bees": 2, "Ants": 3}
        (winner,) = finalize(session, CONSOLE, confirmed=None)
        assert winner.team == "Cats"


def test_a_team_sees_its_choice_and_which_one_plays(database: Database, teams: dict[str, Principal]) -> None:
    chosen = named(database, "best of Ants")
    with database.transaction() as session:
        choose(session, teams["Ants"], chosen.id, chosen=True)
        shown = {by: listing.get(session, SETTINGS, by, chosen.id).chosen for by in (teams["Ants"], CONSOLE)}
        assert set(shown.values()) == {True}
    play_final(database)
    final = entered(database)["best of Ants"]
    with database.transaction() as session:
        assert listing.get(session, SETTINGS, teams["Ants"], final.id).final_of == chosen.id


def test_at_once_has_one_list_that_decides_and_few_runs(database: Database) -> None:
    with database.transaction() as session:
        apply(session, CONSOLE, CompetitionDefinition.model_validate(cup(sealed="at_once")))
        (stage,) = Competition.read(session).stages
        assert (stage.decides, stage.has_final, stage.quotas.scored_runs) == (True, False, AT_ONCE_RUNS)
        by = make_principal(session)
        for number in range(AT_ONCE_RUNS):
            submit_scored(session, by, str(number), {TASK: make_score(number)}, at=datetime.now(UTC))
        with refused(ProblemCode.QUOTA_EXCEEDED):
            submit_scored(session, by, "one more", {TASK: make_score(9)})


@pytest.mark.slow
def test_a_list_that_decides_at_once_is_compared_with_fresh_ones_that_are_thrown_away(database: Database) -> None:
    with database.transaction() as session:
        apply(session, CONSOLE, CompetitionDefinition.model_validate(cup(sealed="at_once")))
        by = make_principal(session, "Ants")
    for run, learnt in enumerate((0, 200)):
        with database.transaction() as session:
            submission = submit(session, by, f"run {run}")
            evaluation = newest_evaluation(session, submission)
            sealed, fresh = evaluation.commitment, evaluation.fresh_commitment
            assert len({sealed, fresh, None}) == 3
            assert find_secret(session, fresh or "") != find_secret(session, sealed or "")
        order = play_lists(database, submission, {sealed: 40 + learnt, fresh: 50, "": 50})
        assert order == ["", fresh, sealed], "nothing of the sealed list is known while the others are played"
    with database.transaction() as session:
        assert session.scalars(select(FreshList)).all() == []
        (drift,) = read_desk(session, CONSOLE).drifts
        assert (drift.team, drift.is_alarm) == ("Ants", True)
        assert drift.sealed[1] - drift.sealed[0] == pytest.approx(100 / 270)
        assert drift.fresh[1] == drift.fresh[0]
        shown = listing.get(session, SETTINGS, by, submission.id).evaluation
        assert [score.successes for score in shown.practice_scores or ()] == [50]
        assert sum(end.success for end in listing.episodes(session, by, submission.id, practice=True)) == 50


def play_lists(database: Database, submission: Submission, solved: dict[str | None, int]) -> list[str]:
    """Plays all lists, of each the first episodes with success; returns their commitments in order."""
    played: list[int] = []
    order: list[str] = []
    while True:
        with database.transaction() as session:
            waiting = [shard for shard in shard_ids(session, submission) if shard not in played]
            commitments: set[str | None] = {session.get_one(Shard, shard).commitment for shard in waiting}
        (commitment,) = commitments or {None}
        if commitment is None:
            return order
        order.append(commitment)
        for shard in waiting:
            play_shard(database, shard, successes_below(solved[commitment] + 1))
        played += waiting
