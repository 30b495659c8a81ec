import smtplib
import ssl
from datetime import UTC, datetime
from email import policy
from email.parser import BytesParser
from typing import Any
from uuid import UUID

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from service_factories import make_settings
from vitac.server.accounts import sending
from vitac.server.accounts.webhooks import Undelivered
from vitac.server.api.members import EMAIL
from vitac.server.database.models import Notice
from vitac.server.database.states import NoticeChannel, NoticeKind

HOSTILE = "x\r\nBcc: victim@example.org\r\n\r\nbody"


def a_notice(**changes: Any) -> Notice:
    values: dict[str, Any] = {
        "id": UUID(int=1),
        "kind": NoticeKind.FAILED,
        "channel": NoticeChannel.MAIL,
        "target": "ann@example.org",
        "subject": "evaluation:1",
        "facts": {"name": "zero", "track": "track_1", "verdict": "crashed", "page": "/submissions/1"},
        "created_at": datetime(2031, 1, 1, tzinfo=UTC),
    }
    return Notice(**(values | changes))


class FakeServer:
    """Takes what is sent; the last one made is kept."""

    last: "FakeServer"

    def __init__(self, host: str, port: int, timeout: float, context: ssl.SSLContext | None = None) -> None:
        self.where, self.done, self.context = (host, port), list[str](), context
        FakeServer.last = self

    def __enter__(self) -> "FakeServer":
        return self

    def __exit__(self, *exception: object) -> None:
        self.done.append("quit")

    def starttls(self, context: object) -> None:
        self.done.append("encrypted")

    def login(self, user: str, password: str) -> None:
        self.done.append(f"{user} {password}")

    def send_message(self, message: object) -> None:
        self.done.append("sent")


def test_the_subject_of_an_announcement_is_its_title() -> None:
    facts = {"title": "We moved", "text": "To another machine.\nTomorrow.", "page": "/announcements"}
    made = sending.make_message(a_notice(kind=NoticeKind.ANNOUNCEMENT, facts=facts), make_settings())
    assert made["Subject"] == "ViTac Arena: We moved"
    assert made.get_content().startswith("We moved\n\nTo another machine.\nTomorrow.")


def test_what_a_team_wrote_makes_no_further_header() -> None:
    facts = {"name": HOSTILE, "track": "track_1", "verdict": "crashed", "page": "/submissions/1"}
    made = sending.make_message(a_notice(facts=facts), make_settings(mail_from="arena@example.org"))
    assert made["Bcc"] is None
    assert made["Message-ID"] == "<00000000-0000-0000-0000-000000000001@example.org>"
    headers = bytes(made).partition(b"\n\n")[0]
    assert b"\nBcc" not in headers
    assert "Bcc: victim" in made.get_content()


@settings(max_examples=30)
@given(st.from_regex(EMAIL, fullmatch=True).filter(lambda address: len(address) <= 254))
def test_every_address_that_the_api_takes_gets_a_mail_of_one_recipient(address: str) -> None:
    made = sending.make_message(a_notice(target=address), make_settings(mail_from="arena@example.org"))
    read = BytesParser(policy=policy.default).parsebytes(bytes(made))
    assert [one.addr_spec for one in read["To"].addresses] == [address]


@pytest.mark.parametrize("target", [HOSTILE, "ann@example.org\nBcc: victim@example.org"])
def test_an_address_with_a_line_end_is_not_sent_to(target: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(smtplib, "SMTP", FakeServer)
    with pytest.raises(Undelivered):
        sending.send_mail(a_notice(target=target), make_settings(mail_url="smtp://mail.example.org:25"))


def test_leaves_over_the_server_of_the_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("SMTP", "SMTP_SSL"):
        monkeypatch.setattr(smtplib, name, FakeServer)
    sending.send_mail(a_notice(), make_settings(mail_url="smtp+starttls://us%40er:w%3Ard@mail.example.org:587"))
    assert FakeServer.last.where == ("mail.example.org", 587)
    assert FakeServer.last.done == ["encrypted", "us@er w:rd", "sent", "quit"]
    sending.send_mail(a_notice(), make_settings(mail_url="smtps://mail.example.org"))
    assert FakeServer.last.done == ["sent", "quit"]
    used = FakeServer.last.context
    assert used is not None
    assert (used.verify_mode, used.check_hostname) == (ssl.CERT_REQUIRED, True), "the password goes to nobody else"


def test_facts_that_are_not_there_are_a_named_failure() -> None:
    with pytest.raises(Undelivered, match="KeyError"):
        sending.send_mail(a_notice(facts={}), make_settings(mail_url="file:///nowhere"))


def test_a_server_that_does_not_answer_is_named() -> None:
    with pytest.raises(Undelivered, match="Error"):
        sending.send_mail(a_notice(), make_settings(mail_url="smtp://127.0.0.1:1"))


def test_another_scheme_is_no_setting() -> None:
    with pytest.raises(ValueError, match="expected a scheme of smtp, smtps"):
        make_settings(mail_url="https://mail.example.org")
