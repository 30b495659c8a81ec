from datetime import UTC, datetime, timedelta

from service_factories import make_settings
from vitac.server.accounts import members, merging, outbox, teams
from vitac.server.audit import newest_entries
from vitac.server.database.engine import Database
from vitac.server.database.models import CompetitionRow
from vitac.server.database.states import NoticeKind
from vitac.server.principals import CONSOLE

from competitions import make_competition, put_in_place


def test_addresses_are_forgotten_so_long_after_the_end(database: Database) -> None:
    settings = make_settings(contacts_kept_days=30)
    with database.transaction() as session:
        team = teams.register(session, CONSOLE, name="Ants", contact="a@example.org")
        captain = members.find_captain(session, team)
        members.set_email(session, CONSOLE, captain, "a@example.org")
        outbox.announce(session, NoticeKind.FINISHED, team.id, "evaluation:1", {})
        assert merging.forget_contacts(session, settings) == 0
        put_in_place(session, make_competition())
        row = session.get_one(CompetitionRow, "cup")
        row.finalized_at, row.winners = datetime(2031, 1, 1, tzinfo=UTC), []
        session.flush()
        later = row.finalized_at + timedelta(days=30)
        assert merging.forget_contacts(session, make_settings(), later) == 0
        assert merging.forget_contacts(session, settings, later - timedelta(seconds=1)) == 0
        assert merging.forget_contacts(session, settings, later) == 2
        session.expire_all()
        assert (team.contact, captain.email) == (None, None)
        assert outbox.newest(session) == [], "a mail's notice names the address, too"
        assert merging.forget_contacts(session, settings, later) == 0
        assert newest_entries(session, 1)[0].before == {"contacts": 2}
