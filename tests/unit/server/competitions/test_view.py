from datetime import timedelta

import pytest
from service_factories import TRACK
from submission_steps import refused
from vitac.evaluator.tracks import ListKind
from vitac.server.competitions import sealing
from vitac.server.competitions.competition import Competition
from vitac.server.competitions.view import competition_view, track_stages
from vitac.server.database.engine import Database
from vitac.server.database.models import CompetitionRow
from vitac.server.errors import ProblemCode
from vitac.server.principals import CONSOLE

from competitions import FIRST, OPENS, SECOND, make_competition, put_in_place, stored_stage

WINNER = {
    "track": TRACK, "place": "first", "rank": 1, "team": "Ants", "amount": 5, "currency": "USD", "note": None,
    "success_rate": 0.5, "mean_steps": None, "submission": "s", "result_hash": "h",
}  # fmt: skip


@pytest.fixture
def prepared(database: Database) -> Database:
    with database.transaction() as session:
        content = make_competition(prizes=[{"place": "first", "amount": 5}], appeal_days=3)
        content["tracks"][TRACK]["judging"] = {"criteria": [{"name": "idea", "title": "The idea"}]}
        put_in_place(session, content)
        for name in (SECOND, f"{SECOND}.final"):
            sealing.seal(session, CONSOLE, stored_stage(session, TRACK, name))
    return database


def test_everybody_sees_schedule_prizes_and_commitments_but_no_secret(prepared: Database) -> None:
    with prepared.transaction() as session:
        found = competition_view(session, at=OPENS + timedelta(days=1))
        secret = sealing.sealed_lists(session, Competition.read(session))[0].secret
    first, second, final = found.tracks[0].stages
    assert [(stage.name, stage.is_open) for stage in (first, second)] == [(FIRST, True), (SECOND, False)]
    assert (first.list_kind, first.commitment) == (ListKind.PUBLIC, None)
    assert (second.scored_runs, second.qualified) == (2, "the best team of the stage before")
    assert None not in {second.commitment, final.commitment}
    assert second.commitment != final.commitment
    assert (final.final_of, final.opens, final.is_open, final.accepts) == (SECOND, second.closes, False, [])
    assert second.secret is None
    assert secret not in found.model_dump_json()
    assert found.tracks[0].prizes[0].amount == 5
    assert found.winners == []
    assert found.appeal_days == 3
    assert "for: The idea." in (found.tracks[0].judging or "")


def test_the_stages_of_a_track_are_those_of_the_competition(prepared: Database) -> None:
    with prepared.transaction() as session:
        at = OPENS + timedelta(days=1)
        assert track_stages(session, TRACK, at=at) == competition_view(session, at=at).tracks[0].stages
        assert track_stages(session, "track_3") == []


def test_after_the_reveal_the_secret_is_published(prepared: Database) -> None:
    with prepared.transaction() as session:
        made = sealing.reveal(session, CONSOLE, stored_stage(session, TRACK, SECOND))
        assert competition_view(session).tracks[0].stages[1].secret == made.secret


def test_winners_are_shown_once_they_are_final(prepared: Database) -> None:
    with prepared.transaction() as session:
        row = session.get_one(CompetitionRow, "cup")
        row.finalized_at, row.winners = OPENS, [WINNER]
        session.flush()
        found = competition_view(session)
    assert [(winner.team, winner.amount) for winner in found.winners] == [("Ants", 5)]
    assert found.finalized_at == OPENS


def test_a_track_elsewhere_is_never_open_and_has_no_list(database: Database) -> None:
    with database.transaction() as session:
        put_in_place(session, make_competition(taken_here=False))
        (track,) = competition_view(session, at=OPENS).tracks
    assert [(stage.is_open, stage.list_kind) for stage in track.stages] == [(False, None)] * 2


def test_without_a_competition_there_is_nothing_to_see(database: Database) -> None:
    with refused(ProblemCode.NOT_FOUND), database.transaction() as session:
        competition_view(session)
