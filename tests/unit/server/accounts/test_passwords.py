import threading

import pytest
from argon2 import extract_parameters
from vitac.server.accounts import passwords
from vitac.server.errors import ServiceError


def test_what_is_kept_is_argon2id_and_says_which_password_is_right() -> None:
    kept = passwords.hashed("twelve chars")
    assert kept.startswith("$argon2id$")
    assert passwords.is_right("twelve chars", kept)
    assert not passwords.is_right("twelve charz", kept)
    assert kept != passwords.hashed("twelve chars")


@pytest.mark.parametrize("kept", [None, "", "not a hash"])
def test_without_a_hash_no_password_is_right(kept: str | None) -> None:
    assert not passwords.is_right("nobody", kept)  # the password of the hash that is checked in its place


@pytest.mark.parametrize("password", ["", "x" * 11, "x" * 257])
def test_the_length_is_bounded(password: str) -> None:
    with pytest.raises(ServiceError, match=f"got {len(password)}"):
        passwords.hashed(password)
    assert not passwords.is_right("x" * 257, None)


def test_few_wait_for_the_thread_and_further_ones_are_refused() -> None:
    thread, ended = passwords.PasswordThread("passwords"), threading.Event()
    works = [thread.submit(ended.wait) for _ in range(passwords.WAITING)]
    with pytest.raises(ServiceError, match=r"no more can wait") as refused:
        thread.submit(ended.wait)
    assert refused.value.status == 429
    ended.set()
    assert all(work.result() for work in works)
    assert thread.run(lambda: "again") == "again"


def test_an_account_without_a_password_is_checked_as_long_as_another() -> None:
    assert extract_parameters(passwords._NOBODYS_HASH) == extract_parameters(passwords.hashed("correct horse battery"))
