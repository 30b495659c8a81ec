"""What organizers read of notices and appeals: times as people write them, and in JSON as in the API."""

import json
from datetime import UTC, datetime

from cli_service import CliService, evaluated_submission
from vitac.cli.client.answers import RequestRefused
from vitac.server.accounts import teams
from vitac.server.database.models import Notice
from vitac.server.database.states import NoticeChannel, NoticeKind
from vitac.server.submissions import appeals

WHEN = datetime(2031, 2, 1, 12, 30, 15, 250_000, tzinfo=UTC)


def test_a_notice_that_was_given_up_is_listed_and_tried_again(service: CliService) -> None:
    assert "No notice." in service.run("admin", "notice", "list").stdout
    with service.database.transaction() as session:
        made = Notice(
            kind=NoticeKind.FAILED, team_id=teams.find(session, "Team A").id, subject="evaluation:1",
            channel=NoticeChannel.MAIL, target="ann@example.org", facts={}, created_at=WHEN, given_up_at=WHEN,
            problem="refused",
        )  # fmt: skip
        session.add(made)
        session.flush()
        number = str(made.id)
    assert "2031-02-01 12:30:15Z  failed  mail     ann@example.org" in service.run("admin", "notice", "list").stdout
    (told,) = json.loads(service.run("admin", "notice", "list", "--unsent", "--json").stdout)
    assert (told["created_at"], told["kind"], told["id"]) == ("2031-02-01T12:30:15.250000Z", "failed", number)
    for _ in range(2):
        tried = json.loads(service.run("admin", "notice", "retry", number, "--dry-run", "--json").stdout)
        assert (tried["given_up_at"], tried["attempts"]) == (None, 0)
    assert service.run("admin", "notice", "retry", number).exit_code == 0
    again = service.run("admin", "notice", "retry", number)
    assert isinstance(again.exception, RequestRefused)
    assert "not given up yet" in str(again.exception)


def test_an_appeal_is_shown_and_ruled_on(service: CliService) -> None:
    by, submission = evaluated_submission(service)
    with service.database.transaction() as session:
        number = str(appeals.open_appeal(session, by, submission, "Look again.").id)
        opened_at = appeals.find(session, by, int(number)).opened_at
    shown = service.run("admin", "appeal", "show", number).stdout
    assert f"opened_at        {opened_at:%F %T}Z" in shown
    told = json.loads(service.run("admin", "appeal", "list", "--open", "--json").stdout)
    assert [each["opened_at"] for each in told] == [opened_at.isoformat().replace("+00:00", "Z")]
    assert told[0]["submission_id"] == str(submission)
    ruled = json.loads(service.run("admin", "appeal", "rule", number, "It was not.", "--reject", "--json").stdout)
    assert (ruled["state"], ruled["ruling"]) == ("rejected", "It was not.")
    assert "rejected already" in str(service.run("admin", "appeal", "rule", number, "No.", "--uphold").exception)
    assert "No appeal." in service.run("admin", "appeal", "list", "--open").stdout
