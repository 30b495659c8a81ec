from datetime import timedelta
from functools import partial

from service_factories import (
    TASK,
    TRACK,
    make_failed_record,
    make_principal,
    make_score,
    make_secret,
    make_settings,
    play_all,
    submit,
    submit_scored,
)
from sqlalchemy import select, update
from submission_steps import refused
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.server.accounts import members, messages, teams, tokens, webhooks
from vitac.server.accounts.members import JoiningMember
from vitac.server.audit import newest_entries, record
from vitac.server.competitions.sealing import seal
from vitac.server.database.engine import Database
from vitac.server.database.models import EpisodeResult, Evaluation, Question, Submission
from vitac.server.database.states import Role
from vitac.server.errors import ProblemCode
from vitac.server.evaluations.history import histories
from vitac.server.operations import team_data
from vitac.server.principals import CONSOLE, Principal
from vitac.server.submissions import runs
from vitac.server.submissions.files import stored_digests
from vitac.server.submissions.listing import submission_views
from vitac.server.submissions.withdrawal import REMOVED

from competitions import make_competition, put_in_place, stored_stage, teams_on_board

SETTINGS = make_settings()


def test_a_team_takes_all_of_its_data_and_nobody_elses(database: Database) -> None:
    with database.transaction() as session:
        ants, bees = make_principal(session, "Ants"), make_principal(session, "Bees")
        make_secret(session, ants)
        submit(session, ants)
        submit(session, bees, "theirs")
        messages.ask_question(session, ants, "Why?", public=False)
        messages.publish_announcement(session, CONSOLE, title="News", text="Text", notify=True)
        own = teams.own(session, ants)
        found = team_data.export(session, SETTINGS, ants, own)
        assert (found.team.name, len(found.tokens), len(found.submissions)) == ("Ants", 1, 1)
        assert [one.text for one in found.questions] == ["Why?"]
        assert "team.register" in {line.action for line in found.audit_log}
        empty = team_data.export(session, SETTINGS, CONSOLE, teams.register(session, CONSOLE, name="Cats"))
        assert (empty.submissions, empty.questions, empty.appeals) == ([], [], [])
        with refused(ProblemCode.NOT_FOUND):
            team_data.export(session, SETTINGS, bees, own)


def test_a_teams_data_says_nothing_that_was_said_in_confidence_or_is_sealed(database: Database) -> None:
    with database.transaction() as session:
        content = make_competition()
        put_in_place(session, content | {"tracks": {"mail": content["tracks"][TRACK] | {"taken_here": False}}})
        ants = make_principal(session, "Ants")
        own = teams.own(session, ants)
        for action in ("judging.conflict", "team.merge", "team.quota"):
            before = {"marks": [9], "contact": "bee@example.org", "teams": ["Bees"]}
            record(session, CONSOLE, action, f"team:{own.id}", {}, before=before)
        webhooks.add(session, ants, own, "https://hook.example.org/", inside_allowed=False)
        submission = submit(session, ants)
        _, code = members.invite(session, ants, own)
        _, issued = members.join(session, JoiningMember(code=code, name="Bob"), timedelta(days=1))
    play_all(database, submission, partial(make_failed_record, output="secret start"))
    with database.transaction() as session:
        own = teams.own(session, ants)
        sealed = seal(session, CONSOLE, stored_stage(session, TRACK, "stage1"))
        session.execute(update(Evaluation).values(commitment=sealed.commitment))
        session.expire_all()
        bob = tokens.authenticate(session, issued.secret)
        for by, leads in ((ants, True), (CONSOLE, True), (bob, False)):
            found = team_data.export(session, SETTINGS, by, own)
            text = found.model_dump_json()
            assert "judging" not in text
            assert "bee@example.org" not in text
            assert ("https://hook.example.org/" in text) is leads
            assert [hook.address for hook in found.webhooks] == ["https://hook.example.org/"] * leads
            assert {"team.merge", "team.quota"} <= {line.action for line in found.audit_log}
            assert leads or [token.id for token in found.tokens] == [issued.token.id]
            seen = submission_views(session, SETTINGS, histories(session, session.query(Submission).all()), ants)
            assert found.submissions == seen, "an organizer's copy holds no more than the team's"
        with refused(ProblemCode.NOT_FOUND):
            team_data.export(session, SETTINGS, Principal(role=Role.JUDGE), own)


def test_a_removed_team_leaves_nothing_of_how_its_policies_failed_and_no_name_is_in_its_way(
    database: Database,
) -> None:
    with database.transaction() as session:
        ants = make_principal(session, "Ants")
        submission = submit(session, ants)
        team_id = teams.own(session, ants).id
        for name in (f"Deleted team {team_id.hex[:8]}", f"Deleted team {team_id.hex}"):
            teams.register(session, CONSOLE, name=name)
    play_all(database, submission, partial(make_failed_record, output="I am Ann"))
    with database.transaction() as session:
        failed = session.scalars(select(EpisodeResult)).all()
        assert failed
        assert "I am Ann" in str(failed[0].record)
        n_failed = len(failed)
        team_data.erase(session, CONSOLE, teams.own(session, ants))
    with database.transaction() as session:
        evaluation = session.scalars(select(Evaluation)).one()
        assert (evaluation.verdict_message, evaluation.log_tail) == (REMOVED, "")
        kept = session.scalars(select(EpisodeResult)).all()
        assert len(kept) == n_failed
        for row in kept:
            assert "I am Ann" not in str(row.record)
            assert EpisodeRecord.model_validate(row.record).record_digest() == row.record_digest


def test_a_removed_team_leaves_its_scores_and_nothing_else(database: Database) -> None:
    with database.transaction() as session:
        ants, bees = make_principal(session, "Ants"), make_principal(session, "Bees")
        secret = make_secret(session, ants)
        submit_scored(session, ants, "best", {TASK: make_score(90)})
        shared = [submit(session, by, "the same") for by in (ants, bees)]
        mine = submit(session, ants, "mine")
        submission_id, public = mine.id, messages.ask_question(session, ants, "Public?", public=True).id
        messages.ask_question(session, ants, "Private?", public=False)
        members.set_email(session, CONSOLE, members.find_captain(session, teams.own(session, ants)), "a@example.org")
        with refused(ProblemCode.INVALID_REQUEST):
            team_data.erase(session, CONSOLE, teams.own(session, ants))
    for submission in (*shared, mine):
        play_all(database, submission)
    with database.transaction() as session:
        session.execute(update(EpisodeResult).values(output="I am Ann"))
        team = teams.own(session, ants)
        with refused(ProblemCode.FORBIDDEN):
            team_data.erase(session, ants, team)
        kept = set(stored_digests(session))
        for _ in range(2):
            team_data.erase(session, CONSOLE, team)
    with database.transaction() as session:
        team = teams.own(session, ants)
        assert team.name.startswith("Deleted team ")
        assert members.list_team_members(session, team.id) == []
        with refused(ProblemCode.INVALID_CREDENTIALS):
            tokens.authenticate(session, secret)
        names = teams_on_board(session, task=TASK)
        assert team.name in names
        printed = session.execute(select(EpisodeResult.submission_digest, EpisodeResult.output).distinct()).all()
        assert sorted(output for _, output in printed) == ["", "I am Ann"], "what Bees have, too, stays theirs"
        assert [one.id for one in session.query(Question)] == [public]
        assert len(set(stored_digests(session))) < len(kept)
        with refused(ProblemCode.NOT_REQUEUABLE):
            runs.run_again(session, CONSOLE, submission_id)
        found = newest_entries(session, 5, action="team.delete")
        assert [(line.before, line.after) for line in found] == [({"erased": False}, {"erased": True})]
