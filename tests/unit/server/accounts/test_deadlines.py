from datetime import timedelta

from service_factories import TRACK, make_principal, make_settings
from vitac.server.accounts import members, outbox, teams
from vitac.server.accounts.outbox import announce_deadlines
from vitac.server.accounts.sending import make_message
from vitac.server.database.engine import Database
from vitac.server.database.models import Qualification
from vitac.server.principals import CONSOLE

from competitions import CLOSES, LATER_CLOSES, SECOND, make_competition, put_in_place


def test_each_team_that_may_submit_is_told_once_a_day_before(database: Database) -> None:
    with database.transaction() as session:
        announce_deadlines(session, CLOSES)
        put_in_place(session, make_competition())
        ants, bees = make_principal(session, "Ants"), make_principal(session, "Bees")
        for by in (ants, bees):
            captain = members.find_captain(session, teams.own(session, by))
            members.set_email(session, CONSOLE, captain, f"{by.team_name}@example.org")
        waiting = teams.register(session, CONSOLE, name="Waiting", waits=True)
        members.set_email(session, CONSOLE, members.find_captain(session, waiting), "w@example.org")
        session.add(Qualification(competition="cup", track=TRACK, stage=SECOND, team_id=bees.team_id))
        session.flush()
        for too_early_or_late in (CLOSES - timedelta(hours=24, seconds=1), CLOSES, LATER_CLOSES):
            announce_deadlines(session, too_early_or_late)
        assert outbox.newest(session) == []
        for _ in range(2):
            announce_deadlines(session, CLOSES - timedelta(hours=24))
        assert sorted(notice.target for notice in outbox.newest(session)) == ["Ants@example.org", "Bees@example.org"]
        announce_deadlines(session, LATER_CLOSES - timedelta(seconds=1))
        told = [notice.target for notice in outbox.newest(session) if SECOND in notice.subject]
        assert told == ["Bees@example.org"]
        bees_notice = next(notice for notice in outbox.newest(session) if SECOND in notice.subject)
        assert (bees_notice.facts["track"], bees_notice.facts["stage"]) == (TRACK, SECOND), "names, for programs"
        made = make_message(bees_notice, make_settings())
        assert made["Subject"] == f"ViTac Arena: Stage Final of Touch closes at {LATER_CLOSES:%F %H:%M} UTC."
        bees_notice.facts = {name: fact for name, fact in bees_notice.facts.items() if not name.endswith("_title")}
        made = make_message(bees_notice, make_settings())
        assert f"Stage {SECOND} of {TRACK} closes at" in made["Subject"], "written by an older server"
