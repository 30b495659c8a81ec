import email
import socket
import ssl
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from email import policy
from functools import partial
from http.server import BaseHTTPRequestHandler, HTTPServer
from ipaddress import ip_address
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from service_factories import TRACK, make_principal, make_settings, play_all, submit
from sqlalchemy import update
from sqlalchemy.orm import Session
from submission_steps import refused
from vitac.server.accounts import members, outbox, sending, teams, webhooks
from vitac.server.database.engine import Database
from vitac.server.database.models import Notice, Webhook
from vitac.server.database.states import NoticeChannel, NoticeKind, Role
from vitac.server.errors import ProblemCode
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.principals import CONSOLE, Principal
from vitac.server.settings import Settings
from worker_fakes import eventually

from competitions import make_competition, open_now, put_in_place

FACTS = {"name": "zero", "track": TRACK, "page": "/submissions/1"}


@dataclass
class Receiver:
    """What a team's program got, and with which status it answers."""

    address: str = ""
    status: int = 204
    got: list[tuple[dict[str, str], bytes]] = field(default_factory=list)


@contextmanager
def receiving() -> Iterator[Receiver]:
    receiver = Receiver()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            receiver.got.append((dict(self.headers), body))
            self.send_response(receiver.status)
            self.send_header("Location", "http://127.0.0.1:1/elsewhere")
            self.end_headers()

        def log_message(self, *_: object) -> None: ...

    server = HTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    receiver.address = f"http://127.0.0.1:{server.server_port}/hook?team=a"
    try:
        yield receiver
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@contextmanager
def answering(chunks: Sequence[bytes], pause_s: float = 0.0, context: ssl.SSLContext | None = None) -> Iterator[int]:
    """The port of a receiver of one request that answers in pieces with pauses, and ends when nobody listens."""
    stopping = threading.Event()

    def answer(listening: socket.socket) -> None:
        try:
            connection, _ = listening.accept()
            with context.wrap_socket(connection, server_side=True) if context else connection as opened:
                asked = b""
                while not asked.endswith(b"}"):
                    asked += opened.recv(65536)
                for chunk in chunks:
                    opened.sendall(chunk)
                    if stopping.wait(pause_s):
                        return
        except OSError:
            return  # cut off

    with socket.create_server(("127.0.0.1", 0)) as listening:
        thread = threading.Thread(target=answer, args=[listening])
        thread.start()
        try:
            yield listening.getsockname()[1]
        finally:
            stopping.set()
            thread.join()


def self_signed(folder: Path) -> tuple[ssl.SSLContext, Path]:
    """How 127.0.0.1 serves https with a certificate of its own, and the certificate that its callers trust."""
    key, now = ec.generate_private_key(ec.SECP256R1()), datetime.now(UTC)
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "127.0.0.1")])
    made = (
        x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([x509.IPAddress(ip_address("127.0.0.1"))]), critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )
    trusted, secret = folder / "certificate.pem", folder / "key.pem"
    trusted.write_bytes(made.public_bytes(serialization.Encoding.PEM))
    secret.write_bytes(
        key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(trusted, secret)
    return context, trusted


def a_webhook_notice(database: Database, address: str) -> None:
    with database.transaction() as session:
        own = teams.own(session, make_principal(session))
        webhooks.add(session, CONSOLE, own, address, inside_allowed=True)
        outbox.announce(session, NoticeKind.FINISHED, own.id, "evaluation:1", FACTS)


def settings_with(tmp_path: Path) -> Settings:
    return make_settings(
        mail_url=f"file://{tmp_path / 'mails'}",
        mail_from="arena@example.org",
        webhooks_may_lead_inside=True,
        public_url="https://arena.example.org/",
    )


def with_address(session: Session, by: Principal, address: str = "ann@example.org") -> None:
    members.set_email(session, CONSOLE, members.find_captain(session, teams.own(session, by)), address)


def announce(
    session: Session, *subjects: str, kind: NoticeKind = NoticeKind.FINISHED, team: str = "Team A", **address: str
) -> Principal:
    """Make a team with an e-mail address, and announce to it."""
    by = make_principal(session, team)
    with_address(session, by, **address)
    for subject in subjects:
        outbox.announce(session, kind, teams.own(session, by).id, subject, FACTS)
    return by


def send_one(database: Database, settings: Settings) -> bool:
    """Sends what has been due for longest; whether there was something."""
    claimed = sending.claim(database)
    if claimed is not None:
        sending.send(database, settings, claimed)
    return claimed is not None


def due_again(database: Database) -> None:
    """Lets the pause before the next try pass."""
    with database.transaction() as session:
        session.execute(update(Notice).values(due_at=datetime.now(UTC)))


def test_a_submission_is_told_from_acceptance_to_its_end_and_each_only_once(database: Database, tmp_path: Path) -> None:
    settings = settings_with(tmp_path)
    with database.transaction() as session:
        team = make_principal(session)
        with_address(session, team)
        submission = submit(session, team)
        outbox.announce(session, NoticeKind.ACCEPTED, submission.team_id, "other:1", FACTS)
    play_all(database, submission)
    while send_one(database, settings):
        pass
    mails = [
        email.message_from_bytes(path.read_bytes(), policy=policy.default)
        for path in (tmp_path / "mails").glob("*.eml")
    ]
    subjects = sorted(str(sent["Subject"]) for sent in mails)
    assert subjects == [
        "ViTac Arena: Submission zero to Tactile manipulation has a score.",
        "ViTac Arena: Submission zero to Tactile manipulation was accepted and waits for its evaluation.",
        f"ViTac Arena: Submission zero to {TRACK} was accepted and waits for its evaluation.",
    ]
    assert {str(sent["To"]) for sent in mails} == {"ann@example.org"}
    assert len({sent["Message-ID"] for sent in mails}) == 3
    text = next(sent.get_body().get_content() for sent in mails if "a score" in str(sent["Subject"]))  # type: ignore[union-attr]
    assert f"https://arena.example.org/submissions/{submission.id}" in text
    with database.transaction() as session:
        outbox.announce(session, NoticeKind.ACCEPTED, submission.team_id, "other:1", FACTS)
        assert all(notice.sent_at and notice.attempts == 1 for notice in outbox.newest(session))
    assert not send_one(database, settings)


def test_a_submission_is_told_with_the_title_that_the_competition_gives_its_track(database: Database) -> None:
    with database.transaction() as session:
        put_in_place(session, open_now(make_competition()))
        team = make_principal(session)
        with_address(session, team)
        submission = submit(session, team)
        (told,) = outbox.newest(session)
        assert (told.facts["track"], told.facts["track_title"]) == (TRACK, "Touch")
        assert "zero to Touch was accepted" in sending.make_message(told, make_settings())["Subject"]
        submission.track, submission.stage = "gone", ""
        outbox.announce_evaluation(session, NoticeKind.FINISHED, newest_evaluation(session, submission))
        finished = next(found for found in outbox.newest(session) if found.kind is NoticeKind.FINISHED)
        assert finished.facts["track_title"] == "gone", "its track file is gone"


def test_what_is_rolled_back_muted_or_of_who_has_left_is_not_told(database: Database) -> None:
    with database.transaction() as session:
        team = make_principal(session)
        with_address(session, team)
        own = teams.own(session, team)
        captain = members.find_captain(session, own)
        members.mute(session, CONSOLE, captain, [NoticeKind.FINISHED])
        outbox.announce(session, NoticeKind.FINISHED, own.id, "evaluation:1", FACTS)
        assert outbox.newest(session) == []
    with database.transaction() as session:
        outbox.announce(session, NoticeKind.FAILED, own.id, "evaluation:1", FACTS)
        assert len(outbox.newest(session)) == 1
        session.rollback()
    with database.transaction() as session:
        assert outbox.newest(session) == []
        members.set_email(session, CONSOLE, members.find_captain(session, teams.own(session, team)), None)
        outbox.announce(session, NoticeKind.FAILED, own.id, "evaluation:1", FACTS)
        assert outbox.newest(session) == []


def test_mails_to_a_team_are_bounded_and_webhooks_are_not(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outbox, "MAX_MAILS_A_DAY", 2)
    with database.transaction() as session:
        team = make_principal(session)
        with_address(session, team)
        own = teams.own(session, team)
        webhooks.add(session, team, own, "https://hook.example.org/", inside_allowed=False)
        for number in range(4):
            outbox.announce(session, NoticeKind.FINISHED, own.id, f"evaluation:{number}", FACTS)
        channels = [notice.channel for notice in outbox.newest(session)]
    assert (channels.count(NoticeChannel.MAIL), channels.count(NoticeChannel.WEBHOOK)) == (2, 4)


def test_a_webhook_is_signed_retried_with_the_same_id_and_follows_no_redirect(
    database: Database, tmp_path: Path
) -> None:
    settings = settings_with(tmp_path)
    with receiving() as receiver:
        with database.transaction() as session:
            team = make_principal(session)
            own = teams.own(session, team)
            hook = webhooks.add(session, team, own, receiver.address, inside_allowed=True)
            outbox.announce(session, NoticeKind.FINISHED, own.id, "evaluation:1", FACTS)
        receiver.status = 302
        assert send_one(database, settings)
        assert not send_one(database, settings), "the next try waits"
        with database.transaction() as session:
            notice = outbox.newest(session, unsent_only=True)[0]
            assert notice.problem == "It answered with status 302, expected 2xx."
            assert timedelta(seconds=20) < notice.due_at - datetime.now(UTC) <= sending.FIRST_PAUSE
        receiver.status = 200
        due_again(database)
        assert send_one(database, settings)
    (first, body), (second, repeated) = receiver.got
    assert (first["Vitac-Notice-Id"], body) == (second["Vitac-Notice-Id"], repeated)
    for headers, sent in receiver.got:
        assert headers["Vitac-Signature"] == webhooks.signature(hook.secret, int(headers["Vitac-Time"]), sent)
    assert webhooks.signature("0" * 64, int(first["Vitac-Time"]), body) != first["Vitac-Signature"]
    with database.transaction() as session:
        assert outbox.newest(session, unsent_only=True) == []


def test_a_notice_that_cannot_be_sent_is_given_up_and_sent_again_by_an_organizer(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sending, "MAX_ATTEMPTS", 2)
    settings = make_settings()  # neither e-mails nor hosts inside
    with database.transaction() as session:
        team = make_principal(session)
        with_address(session, team)
        own = teams.own(session, team)
        session.add(Webhook(team_id=own.id, address="https://127.0.0.1:1/", secret="0" * 64))
        session.flush()
        outbox.announce(session, NoticeKind.FINISHED, own.id, "evaluation:1", FACTS)
    for _ in range(2):
        due_again(database)
        assert [send_one(database, settings) for _ in range(3)] == [True, True, False]
    due_again(database)
    assert not send_one(database, settings)
    with database.transaction() as session:
        found = {notice.channel: notice for notice in outbox.newest(session)}
        assert "VITAC_MAIL_URL is not set" in str(found[NoticeChannel.MAIL].problem)
        assert "not an address of the public internet" in str(found[NoticeChannel.WEBHOOK].problem)
        assert all(notice.given_up_at for notice in found.values())
        with refused(ProblemCode.FORBIDDEN):
            outbox.retry(session, team, found[NoticeChannel.MAIL].id)
        outbox.retry(session, CONSOLE, found[NoticeChannel.MAIL].id)
        with refused(ProblemCode.INVALID_REQUEST):
            outbox.retry(session, CONSOLE, found[NoticeChannel.MAIL].id)
    assert [send_one(database, settings) for _ in range(2)] == [True, False]


def test_who_was_killed_while_sending_loses_nothing_and_who_was_late_says_nothing(
    database: Database, tmp_path: Path
) -> None:
    with database.transaction() as session:
        announce(session, "evaluation:1")
    claimed = sending.claim(database)
    assert claimed is not None
    assert sending.claim(database) is None
    due_again(database)  # the claim has ended
    assert send_one(database, settings_with(tmp_path))
    sending._note(database, claimed.notice, "too late")
    with database.transaction() as session:
        (notice,) = outbox.newest(session)
        assert (notice.problem, notice.attempts, notice.sent_at is None) == (None, 2, False)


def test_the_sender_works_until_it_is_stopped(database: Database, tmp_path: Path) -> None:
    with database.transaction() as session:
        announce(session, "evaluation:1")
    sender = sending.NoticeSender(database, settings_with(tmp_path).model_copy(update={"sweep_interval_s": 0.02}))
    sender.start()
    eventually(lambda: list((tmp_path / "mails").glob("*.eml")) != [])
    sender.stop()
    assert len(list((tmp_path / "mails").glob("*.eml"))) == 1


@pytest.mark.parametrize("address", ["x@[a", "a@b\x0bc", "(" * 200 + "@example.org", "<@>,:;@@"])
def test_an_address_that_is_none_is_its_notices_problem_and_no_other_ones(
    address: str, database: Database, tmp_path: Path
) -> None:
    with database.transaction() as session:
        for name, target in (("Ants", address), ("Bees", "bee@example.org")):
            announce(session, f"evaluation:{name}", team=name, address=target)
    settings = settings_with(tmp_path)
    assert [send_one(database, settings) for _ in range(3)] == [True, True, False]
    with database.transaction() as session:
        sent = {notice.target: notice.sent_at is not None for notice in outbox.newest(session)}
        assert sent["bee@example.org"]


@pytest.mark.parametrize("secure", [False, True])
def test_a_receiver_that_answers_byte_by_byte_is_cut_off(
    secure: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    context, trusted = self_signed(tmp_path)
    monkeypatch.setenv("SSL_CERT_FILE", str(trusted))
    whole = [b"HTTP/1.1 200 OK\r\n\r\n"]
    listening = partial(answering, context=context if secure else None)
    made = Notice(kind=NoticeKind.FINISHED, subject="evaluation:1", facts=FACTS, created_at=datetime.now(UTC))
    send = partial(webhooks.send, made, secret="0" * 64, inside_allowed=True)
    scheme = "https" if secure else "http"
    with listening(whole) as port:
        send(address=f"{scheme}://127.0.0.1:{port}/")
    monkeypatch.setattr(webhooks, "WHOLE_TIMEOUT_S", 0.2)
    dripping = [bytes([byte]) for byte in whole[0]]  # 1 s, then a good answer
    with listening(dripping, 0.05) as port, pytest.raises(webhooks.Undelivered):
        send(address=f"{scheme}://127.0.0.1:{port}/")


def test_what_a_receiver_says_is_kept_in_one_line_without_controls(database: Database, tmp_path: Path) -> None:
    with answering([b"\0\x1b[31mnonsense\0" + b"x" * 900 + b"\r\n\r\n"]) as port:
        a_webhook_notice(database, f"http://127.0.0.1:{port}/")
        assert send_one(database, settings_with(tmp_path))
    with database.transaction() as session:
        (notice,) = outbox.newest(session)
        assert notice.problem is not None
        assert "nonsense" in notice.problem
        assert notice.problem.isprintable()
        assert len(notice.problem) == sending.PROBLEM_LENGTH


def test_a_notice_whose_last_try_was_not_noted_is_given_up_and_the_next_is_sent(
    database: Database, tmp_path: Path
) -> None:
    with database.transaction() as session:
        announce(session, "evaluation:0", "evaluation:1")
        killed = outbox.newest(session)[0]
        killed.attempts, killed.due_at = sending.MAX_ATTEMPTS, datetime.now(UTC) - timedelta(hours=1)
        killed_id = killed.id
    settings = settings_with(tmp_path)
    assert [send_one(database, settings) for _ in range(2)] == [True, False]
    with database.transaction() as session:
        given_up = session.get_one(Notice, killed_id)
        assert (given_up.given_up_at is not None, given_up.sent_at) == (True, None)
        assert given_up.problem == "The server stopped while it was sending this."
        outbox.retry(session, CONSOLE, killed_id)
    assert send_one(database, settings)


def test_only_its_own_team_waits_for_a_webhook_that_hangs_and_the_sender_stops_nevertheless(
    database: Database, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failed, let_go, sent = threading.Event(), threading.Event(), threading.Event()
    begun: list[str] = []

    def send(_: Notice, address: str, *__: object, **___: object) -> None:
        begun.append(address)
        if "hangs" in address:
            let_go.wait(120.0)
        else:
            sent.set()

    def fail(*_: object) -> None:
        failed.set()
        raise ValueError("no competition")

    monkeypatch.setattr(webhooks, "send", send)
    monkeypatch.setattr(outbox, "announce_deadlines", fail)
    monkeypatch.setattr(sending, "STOPPED_WITHIN_S", 0.05)
    with database.transaction() as session:
        for name, hooks in (("Ants", sending.WEBHOOKS_AT_ONCE), ("Bees", 1)):
            own = teams.own(session, make_principal(session, name))
            for number in range(hooks):
                address = f"http://127.0.0.1:1/{'hangs' if name == 'Ants' else 'answers'}/{number}"
                session.add(Webhook(team_id=own.id, address=address, secret="0" * 64))
            session.flush()
            with_address(session, Principal(role=Role.TEAM, team_id=own.id, team_name=name), f"{name}@example.org")
            outbox.announce(session, NoticeKind.FINISHED, own.id, f"evaluation:{name}", FACTS)
        session.execute(update(Notice).where(Notice.team_id == own.id).values(due_at=datetime.now(UTC)))
    sender = sending.NoticeSender(database, settings_with(tmp_path).model_copy(update={"sweep_interval_s": 0.02}))
    sender.start()
    try:
        assert sent.wait(120.0)
        assert failed.wait(120.0)
        for _ in range(1000):
            if len(written := list((tmp_path / "mails").glob("*.eml"))) == 2:
                break
            let_go.wait(0.02)
        sender.stop()
        assert len(written) == 2, "the mails of both teams"
        assert sorted("hangs" in address for address in begun) == [False, True], "one at a time of a team"
        for _ in range(1000):  # the others end soon, on a busy machine after `stop` has stopped waiting
            if (alive := sum(thread.is_alive() for thread in sender._threads)) == 1:
                break
            let_go.wait(0.02)
        assert alive == 1, "the webhook is still at work"
    finally:
        let_go.set()
        for thread in sender._threads:
            thread.join()
    with database.transaction() as session:
        unsent = outbox.newest(session, unsent_only=True)
        assert len(unsent) == sending.WEBHOOKS_AT_ONCE - 1, "no other was begun after the sender was told to stop"


def test_webhooks_are_the_captains_and_few(database: Database) -> None:
    with database.transaction() as session:
        team, other = make_principal(session), make_principal(session, "Team B")
        own = teams.own(session, team)
        made = [
            webhooks.add(session, team, own, "https://hook.example.org/", inside_allowed=False)
            for _ in range(webhooks.MAX_WEBHOOKS)
        ]
        with refused(ProblemCode.INVALID_REQUEST):
            webhooks.add(session, team, own, "https://hook.example.org/", inside_allowed=False)
        for not_leading in (other, Principal(role=team.role, team_id=team.team_id)):
            with pytest.raises(Exception, match=r"captain|There is no team"):
                webhooks.list_webhooks(session, not_leading, own)
        with refused(ProblemCode.NOT_FOUND):
            webhooks.remove(session, other, teams.own(session, other), made[0].id)
        webhooks.remove(session, team, own, made[0].id)
        assert {hook.id for hook in webhooks.list_webhooks(session, team, own)} == {hook.id for hook in made[1:]}


def test_over_https_a_notice_goes_only_to_who_has_the_certificate_of_its_host(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    context, trusted = self_signed(tmp_path)
    made = Notice(kind=NoticeKind.FINISHED, subject="evaluation:1", facts=FACTS, created_at=datetime.now(UTC))
    good = [b"HTTP/1.1 200 OK\r\n\r\n"]
    with (
        answering(good, context=context) as port,
        pytest.raises(webhooks.Undelivered, match="CERTIFICATE_VERIFY_FAILED"),
    ):
        webhooks.send(made, f"https://127.0.0.1:{port}/", "0" * 64, inside_allowed=True)
    monkeypatch.setenv("SSL_CERT_FILE", str(trusted))
    with (
        answering(good, context=context) as port,
        pytest.raises(webhooks.Undelivered, match="not valid for 'localhost'"),
    ):
        webhooks.send(made, f"https://localhost:{port}/", "0" * 64, inside_allowed=True)


def test_a_webhook_that_is_removed_takes_its_waiting_notices_along(database: Database, tmp_path: Path) -> None:
    a_webhook_notice(database, "http://127.0.0.1:1/")
    with database.transaction() as session:
        team = teams.find(session, "Team A")
        members.set_email(session, CONSOLE, members.find_captain(session, team), "ann@example.org")
        outbox.announce(session, NoticeKind.FAILED, team.id, "evaluation:2", FACTS)
        (hook,) = webhooks.list_webhooks(session, CONSOLE, team)
        webhooks.remove(session, CONSOLE, team, hook.id)
        assert [notice.channel for notice in outbox.newest(session)] == [NoticeChannel.MAIL]
    settings = settings_with(tmp_path)
    assert [send_one(database, settings) for _ in range(2)] == [True, False]


def test_of_several_senders_at_once_each_sends_other_notices(database: Database, tmp_path: Path) -> None:
    settings = settings_with(tmp_path)
    with database.transaction() as session:
        announce(session, *(f"evaluation:{number}" for number in range(12)))
    with ThreadPoolExecutor(4) as pool:
        sent = list(pool.map(lambda _: send_one(database, settings), range(16)))
    assert sent.count(True) == 12
    with database.transaction() as session:
        assert {notice.attempts for notice in outbox.newest(session)} == {1}
