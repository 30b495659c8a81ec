from datetime import UTC, datetime, timedelta
from pathlib import Path
from uuid import UUID

import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.web.session import signer
from vitac.web.session.signer import SessionSigner, load_key

NOW = datetime(2026, 11, 21, 3, 0, tzinfo=UTC)
SIGNER = SessionSigner(key=b"k" * 32)
TOKEN = UUID("6f1f6c1e-2a54-4f0e-8a43-94a4a8a0a001")
OTHER = UUID("6f1f6c1e-2a54-4f0e-8a43-94a4a8a0a002")


def test_reads_back_what_it_signed() -> None:
    begun = signer.begin(TOKEN, now=NOW)
    assert SIGNER.read(SIGNER.sign(begun), now=NOW) == begun


def test_session_is_over_at_its_expiry() -> None:
    begun = signer.begin(TOKEN, now=NOW)
    cookie = SIGNER.sign(begun)
    last_moment = NOW + signer.LIFETIME - timedelta(seconds=1)
    assert SIGNER.read(cookie, now=last_moment) == begun
    assert SIGNER.read(cookie, now=NOW + signer.LIFETIME) is None


@pytest.mark.parametrize(
    "cookie", [None, "", "x", "...", "token-1.99999999999.", "token-1.99999999999.00ff", "ümlaut.1.é"]
)
def test_refuses_a_cookie_that_it_did_not_sign(cookie: str | None) -> None:
    assert SIGNER.read(cookie, now=NOW) is None


def test_refuses_another_servers_cookie() -> None:
    foreign = SessionSigner(key=b"x" * 32).sign(signer.begin(TOKEN, now=NOW))
    assert SIGNER.read(foreign, now=NOW) is None


def test_refuses_a_longer_expiry_under_an_old_signature() -> None:
    token_id, expiry, mac = SIGNER.sign(signer.begin(TOKEN, now=NOW)).split(".")
    assert SIGNER.read(f"{token_id}.{int(expiry) + 1}.{mac}", now=NOW) is None


@given(st.text(max_size=80))
def test_never_reads_a_made_up_cookie(cookie: str) -> None:
    assert SIGNER.read(cookie, now=NOW) is None


def test_form_token_belongs_to_one_session() -> None:
    mine, other = (SIGNER.sign(signer.begin(token, now=NOW)) for token in (TOKEN, OTHER))
    assert SIGNER.accepts_form_token(mine, SIGNER.form_token(mine))
    assert not SIGNER.accepts_form_token(other, SIGNER.form_token(mine))
    assert not SIGNER.accepts_form_token(None, SIGNER.form_token(mine))
    assert not SIGNER.accepts_form_token(mine, "")


def test_form_token_is_not_a_session_signature() -> None:
    cookie = SIGNER.sign(signer.begin(TOKEN, now=NOW))
    assert SIGNER.form_token(cookie) not in cookie


def test_a_device_is_known_for_its_member_until_it_expires() -> None:
    cookie = SIGNER.sign_device("owls\neve", now=NOW)
    assert SIGNER.read_device(cookie, "owls\neve", now=NOW) == cookie.partition(".")[0]
    late = NOW + signer.DEVICE_LIFETIME
    for other, member, now in (
        (cookie, "owls\nann", NOW),
        (cookie, "owls\neve", late),
        (f"{cookie}0", "owls\neve", NOW),
    ):
        assert SIGNER.read_device(other, member, now=now) is None
    assert SIGNER.read_device(None, "owls\neve", now=NOW) is None


def test_makes_the_key_once_and_keeps_it_private(tmp_path: Path) -> None:
    path = tmp_path / "state" / "session.key"
    first = load_key(path)
    assert len(first) == signer.KEY_BYTES
    assert load_key(path) == first
    assert path.stat().st_mode & 0o777 == 0o600
    assert list(path.parent.iterdir()) == [path]


def test_two_servers_that_start_at_once_agree_on_the_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "session.key"
    first = load_key(path)
    # The second one looked before the first had written.
    monkeypatch.setattr(Path, "exists", lambda _: False)
    assert load_key(path) == first
