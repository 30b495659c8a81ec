from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from service_client import bearer, running_service
from service_factories import TASK, TRACK, complete_scored, make_principal, make_score, submit
from sqlalchemy.orm import Session
from submission_steps import refused
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.accounts import messages, teams, tokens
from vitac.server.accounts.messages import find_receiver
from vitac.server.accounts.quotas import stage_uses
from vitac.server.competitions.applying import apply, freeze_boards
from vitac.server.competitions.competition import Competition, choose_competition, find_stage, list_competition_choices
from vitac.server.competitions.definition import CompetitionDefinition
from vitac.server.competitions.sealing import reveal
from vitac.server.competitions.view import competition_view
from vitac.server.database.engine import Database
from vitac.server.database.states import Role
from vitac.server.decisions import rejudging
from vitac.server.decisions.advancement import confirm, propose
from vitac.server.decisions.finishing import finalize, winners
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.leaderboards.standings import leaderboard
from vitac.server.principals import CONSOLE, Principal
from vitac.server.receipts.issuing import receipts_of_board
from vitac.server.settings import Settings
from vitac.server.submissions import appeals, creation, listing
from vitac.server.submissions.runs import run_again
from vitac.server.submissions.withdrawal import disqualify, reinstate
from vitac.server.visibility import decide_sight, visible

from competitions import FIRST, PUBLIC_RANKING, SECOND, make_competition, moved, open_now, put_in_place

MAIN, CLASS = "cup", "class"


@pytest.fixture
def both(database: Database) -> Database:
    """Two competitions with stages of the same names on the same track, both open; the class opened a day later."""
    with database.transaction() as session:
        for name, days in ((MAIN, 0.0), (CLASS, 0.5)):
            content = moved(open_now(make_competition(name=name, title=f"The {name}", appeal_days=7)), days=days)
            stage = content["tracks"][TRACK]["stages"][0]
            stage |= {"list": "sealed", "sealed": "at_once", "accepts": ["model"], "quotas": {"scored_runs": 1}}
            apply(session, CONSOLE, CompetitionDefinition.model_validate(content), confirmed=None)
    return database


def teams_of_board(session: Session, competition: str) -> list[str]:
    stage = Competition.find(session, competition).stage(TRACK, FIRST)
    return [entry.team for entry in leaderboard(session, stage).view.entries]


def test_each_competition_has_its_own_boards_quotas_and_sealed_lists(both: Database) -> None:
    with both.transaction() as session:
        ants, bees = make_principal(session, "Ants"), make_principal(session, "Bees")
        # The same content is a submission of its own in each competition, and uses the quota of each once.
        made = {name: submit(session, ants, competition=name) for name in (MAIN, CLASS)}
        assert made[MAIN].id != made[CLASS].id
        with refused(ProblemCode.QUOTA_EXCEEDED), session.begin_nested():
            submit(session, ants, "more", competition=MAIN)
        other = submit(session, bees, "bees", competition=CLASS)
        assert [
            (use.competition, use.limit, use.used) for use in stage_uses(session, teams.own(session, bees)) if use.limit
        ] == [(CLASS, 1, 1), (MAIN, 1, 0)]
        commitments = {name: newest_evaluation(session, made[name]).commitment for name in made}
        assert len(set(commitments.values())) == 2
        for name, commitment in commitments.items():
            (track,) = competition_view(session, name).tracks
            assert track.stages[0].commitment == commitment
        for submission, successes in ((made[MAIN], 50), (made[CLASS], 50), (other, 90)):
            complete_scored(session, submission, {TASK: make_score(successes)})
        assert teams_of_board(session, MAIN) == ["Ants"]
        assert teams_of_board(session, CLASS) == ["Bees", "Ants"]
        signed = {
            name: receipts_of_board(session, Competition.find(session, name).stage(TRACK, FIRST), SubmissionKind.MODEL)
            for name in made
        }
        for receipt in signed[CLASS]:
            receipt.require_valid()  # by itself, as it is in an export
        assert [receipt.content.submission for receipt in signed[MAIN]] == [made[MAIN].id]
        assert [receipt.content.submission for receipt in signed[CLASS]] == [made[CLASS].id, other.id]
        assert signed[MAIN][0].entry.board != signed[CLASS][0].entry.board


def test_a_track_shows_the_competition_that_opened_last(both: Database) -> None:
    with both.transaction() as session:
        assert Competition.find_by_track(session, TRACK).shown_stage(TRACK).competition == CLASS
        assert competition_view(session).name == CLASS


def test_a_submission_names_its_competition_only_while_several_take_it(both: Database) -> None:
    with both.transaction() as session:
        ants, now = make_principal(session, "Ants"), datetime.now(UTC)
        with pytest.raises(
            ServiceError, match="Several competitions take submissions to track_1 now: class, cup"
        ) as no:
            submit(session, ants)
        assert (no.value.code, no.value.extras["competitions"]) == (ProblemCode.COMPETITION_REQUIRED, [CLASS, MAIN])
        with pytest.raises(ServiceError, match="cup takes no submissions to 'track_3', expected one of track_1"):
            choose_competition(session, "track_3", now, MAIN)
        assert [one.name for one in list_competition_choices(session, now)] == [CLASS, MAIN]
        # The class ends first: from then on the track takes submissions for the competition that is still open.
        row = Competition.find(session, CLASS).row
        content = moved(CompetitionDefinition.model_validate(row.definition).model_dump(mode="json"), days=-31)
        put_in_place(session, content)
        assert list_competition_choices(session, now) == []
        assert submit(session, ants).competition == MAIN
        assert submit(session, ants, competition=CLASS, at=now - timedelta(days=30)).competition == CLASS
        with refused(ProblemCode.STAGE_CLOSED):
            submit(session, ants, competition=CLASS)


def test_one_competition_is_frozen_and_ended_while_the_other_continues(both: Database) -> None:
    with both.transaction() as session:
        ants = make_principal(session, "Ants")
        freeze_boards(session, CONSOLE, CLASS)
        submission = submit(session, ants, competition=CLASS)
        assert find_stage(session, submission).frozen_at is not None
        assert Competition.find(session, MAIN).frozen_at is None
        complete_scored(session, submission, {TASK: make_score(80)})
        finalize(session, CONSOLE, CLASS, at=datetime.now(UTC) + timedelta(days=70), confirmed=None)
        assert Competition.find(session, MAIN).row.finalized_at is None
        assert winners(session, MAIN) == []
        assert submit(session, ants, competition=MAIN).competition == MAIN


def test_whoever_changes_one_of_several_names_it(both: Database) -> None:
    with both.transaction() as session:
        for change in (freeze_boards, finalize):
            with pytest.raises(Exception, match="several competitions; name one of class, cup"):
                change(session, CONSOLE)
        with refused(ProblemCode.NOT_FOUND):
            freeze_boards(session, CONSOLE, "elsewhere")
        assert Competition.find(session, track="track_3").list_stages("track_3")[0].is_practice


def test_a_file_with_another_name_makes_a_further_competition_only_where_that_is_confirmed(database: Database) -> None:
    first, other = (
        CompetitionDefinition.model_validate(make_competition(name=name, title=name)) for name in (MAIN, "cpu")
    )
    with database.transaction() as session:
        apply(session, CONSOLE, first, confirmed=[PUBLIC_RANKING])
    with refused(ProblemCode.CONFIRMATION_NEEDED), database.transaction() as session:
        apply(session, CONSOLE, other, confirmed=[PUBLIC_RANKING])
    with database.transaction() as session:
        apply(session, CONSOLE, other, confirmed=["name", PUBLIC_RANKING])
        assert {one.name for one in Competition.read_all(session)} == {MAIN, "cpu"}
        assert Competition.find(session, MAIN).stage(TRACK, SECOND).is_sealed


def class_organizer(session: Session) -> Principal:
    issued = tokens.issue(session, CONSOLE, role=Role.ORGANIZER, label="school", competition=CLASS, lifetime=None)
    assert tokens.token_view(issued.token).competition == CLASS
    return tokens.authenticate(session, issued.secret)


def test_an_organizer_of_one_competition_sees_only_what_belongs_to_it(both: Database) -> None:
    with both.transaction() as session:
        by, ants = class_organizer(session), make_principal(session, "Ants")
        made = {name: submit(session, ants, competition=name) for name in (MAIN, CLASS)}
        for submission in made.values():
            complete_scored(session, submission, {TASK: make_score(50)})
            appeals.open_appeal(session, ants, submission.id, "Look again.")
        listed = listing.list_submissions(session, Settings(), by, team="Ants").items
        assert [one.id for one in listed] == [made[CLASS].id]
        assert [one.submission_id for one in appeals.visible(session, by)] == [made[CLASS].id]
        seen = {name: decide_sight(by, newest_evaluation(session, made[name])).episodes for name in made}
        assert seen == {MAIN: False, CLASS: True}
        for stage in (Competition.find(session, name).stage(TRACK, FIRST) for name in made):
            rejudging.start(session, CONSOLE, stage, reason="Look again.")
        assert [one.competition for one in rejudging.rejudgements(session, by)] == [CLASS]
        (other,) = (one for one in rejudging.rejudgements(session, CONSOLE) if one.competition == MAIN)
        with refused(ProblemCode.NOT_FOUND):
            rejudging.find(session, by, other.id)
        with refused(ProblemCode.NOT_FOUND):
            visible(session, by, made[MAIN].id)


def test_an_organizer_of_one_competition_changes_only_what_belongs_to_it(both: Database) -> None:
    with both.transaction() as session:
        by, ants, bees = class_organizer(session), make_principal(session, "Ants"), make_principal(session, "Bees")
        made = {name: submit(session, ants, competition=name) for name in (MAIN, CLASS)}
        submit(session, bees, "bees", competition=MAIN)
        for submission in made.values():
            complete_scored(session, submission, {TASK: make_score(50)})
        appeal = {
            name: appeals.open_appeal(session, ants, submission.id, "Look again.").id
            for name, submission in made.items()
        }
        stages = {name: Competition.find(session, name).stage(TRACK, FIRST) for name in made}

        appeals.rule(session, by, appeal[CLASS], "No.", upheld=False)
        disqualify(session, by, made[CLASS].id, "copied")
        reinstate(session, by, made[CLASS].id)
        rejudging.discard(session, by, rejudging.start(session, by, stages[CLASS], reason="Look again.").id)
        reveal(session, by, stages[CLASS])
        freeze_boards(session, by)
        assert Competition.find(session, CLASS).frozen_at is not None
        assert find_receiver(session, by, teams.own(session, ants).id).name == "Ants"

        for not_found in (
            lambda: find_receiver(session, by, teams.own(session, bees).id),
            lambda: appeals.rule(session, by, appeal[MAIN], "No.", upheld=False),
            lambda: disqualify(session, by, made[MAIN].id, "copied"),
            lambda: run_again(session, by, made[MAIN].id),
        ):
            with refused(ProblemCode.NOT_FOUND):
                not_found()
        for of_the_cup in (
            lambda: rejudging.start(session, by, stages[MAIN], reason="Look again."),
            lambda: reveal(session, by, stages[MAIN]),
            lambda: freeze_boards(session, by, MAIN),
            lambda: finalize(session, by, MAIN),
            lambda: propose(session, by, Competition.find(session, MAIN).stage(TRACK, SECOND)),
            lambda: confirm(session, by, Competition.find(session, MAIN).stage(TRACK, SECOND)),
        ):
            with pytest.raises(ServiceError, match="organizes the competition class, and this concerns cup; ask an"):
                of_the_cup()
        for of_the_service in (
            lambda: teams.disqualify(session, by, teams.own(session, ants), "late"),
            lambda: creation.owner(session, by, "Ants"),
            lambda: messages.answer_question(session, by, 1, "Yes.", public=True),
        ):
            with pytest.raises(ServiceError, match="and this concerns the whole service"):
                of_the_service()
        with refused(ProblemCode.FORBIDDEN):
            tokens.issue(session, by, role=Role.ORGANIZER, label="more", lifetime=None)


def test_an_organizers_token_is_for_a_competition_that_exists(both: Database) -> None:
    with both.transaction() as session, pytest.raises(ServiceError, match="expected one of class, cup"):
        tokens.issue(session, CONSOLE, role=Role.ORGANIZER, label="school", competition="clash", lifetime=None)


def test_every_competition_has_its_own_addresses(both: Database, tmp_path: Path) -> None:
    with both.transaction() as session:
        ants = make_principal(session, "Ants")
        secret = tokens.issue(session, CONSOLE, role=Role.ORGANIZER, label="x", competition=CLASS, lifetime=None).secret
        for name in (MAIN, CLASS):
            freeze_boards(session, CONSOLE, name)
            made = submit(session, ants, competition=name)
            complete_scored(session, made, {TASK: make_score(50)})
            appeals.open_appeal(session, ants, made.id, name)
        finalize(session, CONSOLE, CLASS, at=datetime.now(UTC) + timedelta(days=70), confirmed=None)
    with running_service(both, tmp_path) as service:

        def get(path: str, token: str | None = None) -> Any:
            return service.client.get(f"/api/v1{path}", headers=bearer(token) if token else {}).json()

        listed = get("/competitions")["items"]
        assert [(one["name"], one["title"], one["state"]) for one in listed] == [
            (CLASS, "The class", "final"),
            (MAIN, "The cup", "open"),
        ]
        assert get("/competition") == get(f"/competitions/{CLASS}")
        assert get(f"/competitions/{MAIN}")["title"] == "The cup"
        assert get("/competitions/cap")["detail"].startswith("There is no competition 'cap', expected one of class")
        assert get(f"/competitions/{CLASS}/archive")["competition"]["name"] == CLASS
        assert get(f"/competitions/{MAIN}/archive")["code"] == "not_found"
        # Frozen boards show nothing new to visitors, and nothing of the other competition to its organizers.
        of_main, of_class = (f"/competitions/{name}/leaderboards/{TRACK}" for name in (MAIN, CLASS))
        assert [len(get(of_main, token)["entries"]) for token in (None, secret, service.organizer_token)] == [0, 0, 1]
        assert get(of_class) == get(f"/leaderboards/{TRACK}")
        assert get(f"/competitions/{MAIN}/leaderboards/track_3")["code"] == "invalid_request"
        assert get(f"/competitions/{MAIN}/leaderboards/{TRACK}/logs")["track"] == TRACK
        for name in (MAIN, CLASS):
            of_competition = get(f"/competitions/{name}/appeals", service.organizer_token)["items"]
            assert [one["text"] for one in of_competition] == [name]
            found = get(f"/submissions?competition={name}", service.organizer_token)["items"]
            assert [one["competition"] for one in found] == [name]
        assert get(f"/competitions/{MAIN}/appeals", secret)["items"] == []
