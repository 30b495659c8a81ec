from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest
from service_factories import TASK, make_principal, make_score, make_settings, submit_scored
from sqlalchemy.orm import Session
from vitac.server.audit import newest_entries
from vitac.server.database.engine import Database
from vitac.server.database.models import Submission, Team
from vitac.server.database.states import Role
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.leaderboards.descriptions import describe, descriptions_among, find_description, remove, restore
from vitac.server.leaderboards.public_pages import set_public
from vitac.server.operations.team_data import erase, export
from vitac.server.principals import CONSOLE, VISITOR, Principal
from vitac.server.views.submissions import DescriptionView

from competitions import make_competition, open_now, put_in_place

SETTINGS = make_settings(database_url="postgresql:///elsewhere")
CODE = "https://github.com/bears/policy"
JUDGE = Principal(role=Role.JUDGE)


@dataclass(frozen=True, kw_only=True)
class Described:
    """A public result of one team, and another team."""

    session: Session
    owner: Principal
    other: Principal
    submission: Submission

    def write(self, by: Principal | None = None, **given: Any) -> DescriptionView:
        describe(self.session, by or self.owner, self.submission.id, **{"text": "", **given})
        return self.seen_by(self.owner)

    def refusal(self, by: Principal | None = None, **given: Any) -> ServiceError:
        with pytest.raises(ServiceError) as refused:
            self.write(by, **given)
        return refused.value

    def seen_by(self, by: Principal) -> DescriptionView:
        return find_description(self.session, by, self.submission.id)

    def on_boards_for(self, by: Principal) -> list[str]:
        return [found.code for found in descriptions_among(self.session, by, [self.submission.id]).values()]


@pytest.fixture
def one(database: Database) -> Iterator[Described]:
    with database.transaction() as session:
        owner, other = make_principal(session), make_principal(session, "Team B")
        submission = submit_scored(session, owner, "good", {TASK: make_score(80)})
        set_public(session, owner, submission.id, public=True)
        yield Described(session=session, owner=owner, other=other, submission=submission)


def test_a_team_writes_about_its_public_result_and_everybody_reads_it(one: Described) -> None:
    written = one.write(
        text="  A network.\r\nTwo layers.\n", code=f" {CODE} ", paper="https://arxiv.org/abs/1706.03762"
    )
    assert (written.text, written.code, written.discussion) == ("A network.\nTwo layers.", CODE, "")
    for by in (one.other, VISITOR, JUDGE, CONSOLE):
        assert one.seen_by(by) == written
        assert one.on_boards_for(by) == [CODE]
    assert one.write() == DescriptionView()
    assert one.on_boards_for(VISITOR) == []
    actions = [entry.action for entry in newest_entries(one.session, subject=f"submission:{one.submission.id}")]
    assert actions.count("submission.describe") == 2


def test_only_its_team_writes_and_only_about_a_public_result(one: Described) -> None:
    assert one.refusal(one.other, text="mine").code is ProblemCode.FORBIDDEN
    assert one.refusal(JUDGE, text="mine").code is ProblemCode.FORBIDDEN
    set_public(one.session, one.owner, one.submission.id, public=False)
    assert "Make it public first" in str(one.refusal(text="mine"))
    assert one.refusal(one.other, text="mine").code is ProblemCode.NOT_FOUND


@pytest.mark.parametrize(
    "address",
    [
        "javascript:alert(1)",
        "data:text/html,<script>alert(1)</script>",
        "http://github.com/bears",
        "//github.com/bears",
        "https://githu\u0431.com/bears",
        "https://xn--gthub-n4a.com/bears",
        "https://github.com\\@evil.com/",
        "https://github.com@evil.com/",
        "https://github.com:8443/",
        "https://github.com:443x/",
        "https://127.0.0.1/",
        "https://[::1]/",
        "https://2130706433/",
        "https://0x7f.1/",
        "https://localhost/",
        "https://printer.local/",
        "https://github.com./",
        "https://github..com/",
        "https://git hub.com/",
        "https://github.com/\u202egnp",
        'https://github.com/"><script>',
        "https://" + "a" * 500 + ".com",
        "https://",
    ],
)
def test_links_lead_by_https_to_hosts_that_read_as_they_are(one: Described, address: str) -> None:
    refused = one.refusal(code=address)
    assert refused.code is ProblemCode.INVALID_REQUEST
    assert "The link to code" in str(refused)
    assert len(str(refused)) < 500
    assert one.seen_by(one.owner) == DescriptionView()


def test_a_text_is_plain_and_bounded(one: Described) -> None:
    for text in ("a" * 4001, "a" * 10_000_000, "turned \u202e around", "null \0"):
        refused = one.refusal(text=text)
        assert refused.code is ProblemCode.INVALID_REQUEST
        assert len(str(refused)) < 300
    assert one.write(text="<script>alert(1)</script>").text == "<script>alert(1)</script>", "pages escape it"


def test_a_change_made_against_an_older_state_is_refused(one: Described) -> None:
    first = one.write(text="first", base="")
    assert one.write(text="second", base=first.revision).text == "second"
    for base in (first.revision, ""):
        assert one.refusal(text="third", base=base).code is ProblemCode.CHANGED_MEANWHILE
    assert one.seen_by(VISITOR).text == "second"


def test_an_organizer_hides_it_from_others_and_its_team_cannot_write_again(one: Described) -> None:
    written = one.write(text="Buy here.", code=CODE)
    with pytest.raises(ServiceError):
        remove(one.session, one.owner, one.submission.id, "no")
    remove(one.session, CONSOLE, one.submission.id, "An advertisement.")
    for by in (one.other, VISITOR):
        assert one.seen_by(by) == DescriptionView()
        assert one.on_boards_for(by) == []
    assert one.seen_by(one.owner).removed_for == "An advertisement."
    assert "An advertisement." in str(one.refusal(text="Buy there."))
    restore(one.session, CONSOLE, one.submission.id)
    assert one.seen_by(VISITOR) == written
    found = newest_entries(one.session, subject=f"submission:{one.submission.id}")
    changes = [(entry.action, entry.after) for entry in found if entry.action.endswith("-description")]
    assert changes == [
        ("submission.restore-description", {"reason": None}),
        ("submission.remove-description", {"reason": "An advertisement."}),
    ]


def test_nothing_is_shown_to_others_while_teams_are_anonymous(one: Described) -> None:
    written = one.write(text="By the Bears.", code=CODE)
    put_in_place(one.session, open_now(make_competition()) | {"anonymous": True})
    for by in (one.other, VISITOR):
        assert one.seen_by(by) == DescriptionView()
        assert one.on_boards_for(by) == []
    assert one.seen_by(one.owner) == one.seen_by(CONSOLE) == written


def test_it_is_among_the_data_of_its_team_and_goes_with_them(one: Described) -> None:
    written = one.write(text="By the Bears.", code=CODE)
    team = one.session.get_one(Team, one.submission.team_id)
    assert [found.description for found in export(one.session, SETTINGS, CONSOLE, team).submissions] == [written]
    erase(one.session, CONSOLE, team)
    one.session.refresh(one.submission)
    assert one.submission.description is None
