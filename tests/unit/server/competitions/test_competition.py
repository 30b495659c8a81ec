"""The competition as one object of a transaction: read once, locked by who changes it, and left alone after the end."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from service_factories import TRACK, make_principal
from sqlalchemy import update
from submission_steps import refused
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.version import evaluator_version
from vitac.server.accounts import teams
from vitac.server.accounts.quotas import stage_uses
from vitac.server.competitions.competition import Competition
from vitac.server.competitions.sealing import reveal, seal
from vitac.server.competitions.stages import PRACTICE, CountedResults
from vitac.server.competitions.view import competition_view
from vitac.server.database.engine import Database
from vitac.server.database.locks import unless_held
from vitac.server.database.models import CompetitionRow
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.principals import CONSOLE

from competitions import (
    CLOSES,
    FIRST,
    OPENS,
    SECOND,
    competition_of,
    make_competition,
    open_now,
    put_in_place,
    sealed_competition,
)

ENDED = datetime(2026, 9, 1, 12, 30, tzinfo=UTC)
FROZEN = datetime(2026, 8, 1, tzinfo=UTC)


def is_free(database: Database, *, shared: bool) -> bool:
    with database.transaction() as session:
        return unless_held(session, lambda: Competition.lock(session, "cup", shared=shared)) is not None


def test_a_service_without_competition_has_nothing_to_change_and_nothing_final(database: Database) -> None:
    with database.transaction() as session:
        competition = Competition.lock(session, "cup")
        assert (competition.is_held, competition.stages, competition.hides_names) == (False, (), False)
        competition.require_not_final()
        with refused(ProblemCode.NOT_FOUND):
            Competition.lock_to_change(session, CONSOLE)


def test_many_may_hold_it_as_it_is_and_one_alone_may_change_it(database: Database) -> None:
    with database.transaction() as session:
        put_in_place(session, make_competition())
    with database.transaction() as session:
        assert Competition.lock(session, "cup", shared=True).row is Competition.read(session).row
        assert is_free(database, shared=True)
        assert not is_free(database, shared=False)
    with database.transaction() as session:
        Competition.lock(session, "cup")
        assert not is_free(database, shared=True)
    assert is_free(database, shared=False)


def test_a_transaction_reads_it_once_until_it_is_changed_or_locked(database: Database) -> None:
    with database.transaction() as session:
        put_in_place(session, make_competition())
    with database.transaction() as session:
        competition = Competition.read(session)
        assert Competition.read(session) is competition
        put_in_place(session, make_competition(title="Another"))
        assert Competition.read(session).definition.title == "Another"
    with database.transaction() as session:
        read = Competition.read(session)
        with database.transaction() as other:
            put_in_place(other, make_competition(title="A third"))
            other.execute(update(CompetitionRow).values(frozen_at=ENDED))
        assert (read.definition.title, read.row.frozen_at) == ("Another", None)
        assert (Competition.lock(session, "cup").definition.title, read.row.frozen_at) == ("A third", ENDED)


def test_a_final_competition_is_refused_by_its_title_and_end() -> None:
    competition = competition_of(make_competition(title="Cup of Gels", anonymous=True))
    competition.require_not_final()
    assert competition.hides_names
    competition.row.finalized_at = ENDED
    assert not competition.hides_names
    with pytest.raises(ServiceError, match=r"^Cup of Gels has been final since 2026-09-01 12:30:00 UTC\.") as refusal:
        competition.require_not_final()
    assert refusal.value.code is ProblemCode.COMPETITION_FINAL


def test_a_stage_is_open_from_its_first_instant_to_before_its_last() -> None:
    stage, moment = competition_of(make_competition()).stage(TRACK, FIRST), timedelta(microseconds=1)
    instants = (OPENS - moment, OPENS, CLOSES - moment, CLOSES)
    assert [stage.is_in_time(at) for at in instants] == [False, True, True, False]
    assert [stage.is_over(at) for at in instants] == [False, False, False, True]
    elsewhere = competition_of(make_competition(taken_here=False)).stage(TRACK, FIRST)
    assert not elsewhere.is_in_time(OPENS)


def test_a_stage_whose_secret_is_published_is_open_to_nobody_and_nowhere(database: Database) -> None:
    with database.transaction() as session:
        definition = put_in_place(session, open_now(sealed_competition()))
        competition, now = Competition.read(session), datetime.now(UTC)
        stage, team = competition.stage(TRACK, FIRST), teams.own(session, make_principal(session))
        seal(session, CONSOLE, stage)
        assert stage.is_open(now)
        assert {use.stage for use in stage_uses(session, team)} == {FIRST}
        reveal(session, CONSOLE, stage)
        assert not stage.is_open(now)
        assert stage_uses(session, team) == []
        assert not competition_view(session).tracks[0].stages[0].is_open
        with refused(ProblemCode.STAGE_CLOSED):
            competition.open_stage(TRACK, CONSOLE, definition.tracks[TRACK].stages[0].opens)


def test_stages_know_their_track_the_one_before_them_and_the_last_one() -> None:
    competition = competition_of(make_competition(ranking=["success_rate", "submitted_at"]))
    first, second = competition.stages
    assert (first.before, second.before) == (None, first)
    assert competition.last_stages == (second,)
    assert (str(second), second.subject) == (f"stage {SECOND} of {TRACK}", f"stage:cup/{TRACK}/{SECOND}")
    assert [key.name for key in second.find_ranking().keys] == ["success_rate", "submitted_at"]
    assert (first.plays_sealed_list, second.plays_sealed_list) == (False, True)
    assert competition.stage_titles == {(TRACK, FIRST): "Simulation", (TRACK, SECOND): "Final"}
    assert competition_of(make_competition(taken_here=False)).stages_held_here == ()
    with refused(ProblemCode.UNKNOWN_STAGE):
        competition.stage(TRACK, "stage9")


def test_a_stage_takes_its_teams_by_the_final_list_of_a_stage_of_another_track() -> None:
    content = sealed_competition()
    final = content["tracks"][TRACK]["stages"].pop() | {"qualified": {"top": 1, "after": f"{TRACK}/{FIRST}"}}
    assert not competition_of(content).stage(TRACK, FIRST).has_final, "nothing hangs on it"
    content["tracks"] = {"track_2": {"title": "Platform", "stages": [final]}} | content["tracks"]
    competition = competition_of(content)
    assert competition.stage(TRACK, FIRST).has_final
    assert competition.stage("track_2", SECOND).before == competition.stage(TRACK, f"{FIRST}.final")
    content["tracks"][TRACK]["stages"][0] |= {"list": "public"}
    assert competition_of(content).definition.public_rankings == {
        f"tracks.track_2.stages.{SECOND}.qualified": "Final of Platform is for teams by Simulation"
    }


def test_outside_of_a_competition_a_stage_takes_everything_from_everybody_at_any_time(database: Database) -> None:
    with database.transaction() as session:
        team = teams.own(session, make_principal(session))
        (stage,) = Competition.read(session).list_stages(TRACK)
        assert (stage.name, str(stage), stage.is_practice, stage.is_sealed) == (PRACTICE, TRACK, True, False)
        assert stage.is_open(OPENS)
        assert stage.may_submit(team)
        for kind in SubmissionKind:
            stage.require_accepts(team, kind)
        with refused(ProblemCode.UNKNOWN_STAGE):
            Competition.read(session).shown_stage(TRACK, PRACTICE)


def test_frozen_and_final_hold_for_the_stages_of_the_competition_and_not_for_practice(database: Database) -> None:
    with database.transaction() as session:
        competition = replace(competition_of(make_competition()), session=session)
        _holds_for_stages(competition)


def _holds_for_stages(competition: Competition) -> None:
    competition.row.frozen_at, competition.row.finalized_at = FROZEN, ENDED
    competition.row.boards = [{"track": TRACK, "evaluator_version": "old"}]
    stage, practice = competition.stage(TRACK, FIRST), competition.stored_stage(TRACK, PRACTICE)
    assert stage.counted_results() == CountedResults(evaluator_version="old", frozen_at=FROZEN, final_since=ENDED)
    assert stage.counted_results(live=True).frozen_at is None
    today = CountedResults(evaluator_version=evaluator_version(), frozen_at=None, final_since=None)
    assert practice.counted_results() == today


def test_a_session_that_only_reads_asks_for_the_competitions_once(database: Database) -> None:
    with database.reading() as session:
        assert Competition.read_all(session) is Competition.read_all(session)
    with database.transaction() as session:
        assert not Competition.read_all(session)[0].is_held
        put_in_place(session, make_competition())
        assert Competition.read_all(session)[0].is_held
