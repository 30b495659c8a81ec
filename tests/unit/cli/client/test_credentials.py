import errno
from collections.abc import Callable
from pathlib import Path

import pytest
from vitac.cli.client import credentials
from vitac.cli.client.credentials import CredentialsUnusable

FIRST, SECOND = "http://first.test", "http://second.test"


@pytest.fixture(autouse=True)
def configuration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    return tmp_path / "config"


def test_each_service_has_a_token_and_the_last_login_is_meant() -> None:
    assert (credentials.find_stored_token(FIRST), credentials.last_server()) == (None, None)
    credentials.keep(FIRST, "vitac_1")
    credentials.keep(SECOND, "vitac_2")
    assert (credentials.find_stored_token(FIRST), credentials.find_stored_token(SECOND)) == ("vitac_1", "vitac_2")
    assert credentials.last_server() == SECOND
    credentials.keep(FIRST, "vitac_3")
    assert (credentials.find_stored_token(FIRST), credentials.last_server()) == ("vitac_3", FIRST)


def test_a_forgotten_token_is_gone_and_its_service_no_longer_meant() -> None:
    credentials.keep(FIRST, "vitac_1")
    credentials.keep(SECOND, "vitac_2")
    assert credentials.forget(FIRST)
    assert (credentials.find_stored_token(FIRST), credentials.last_server()) == (None, SECOND)
    assert credentials.forget(SECOND)
    assert credentials.last_server() is None
    assert not credentials.forget(SECOND)


def test_only_the_user_may_read_the_file_and_no_draft_is_left() -> None:
    credentials.keep(FIRST, "vitac_1")
    file = credentials.path()
    assert (file.stat().st_mode & 0o777, file.parent.stat().st_mode & 0o777) == (0o600, 0o700)
    assert list(file.parent.iterdir()) == [file]


def test_without_a_configuration_folder_the_file_is_in_the_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", "")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert credentials.path() == tmp_path / ".config/vitac/credentials.json"


@pytest.mark.parametrize("content", ["", "[]", "null", "{}", '{"server": null}', '{"server": "a", "tokens": ["b"]}'])
@pytest.mark.parametrize(
    "use",
    [credentials.last_server, lambda: credentials.find_stored_token(FIRST), lambda: credentials.keep(FIRST, "vitac_1")],
)
def test_a_damaged_file_is_named_and_left_as_it_is(content: str, use: Callable[[], object]) -> None:
    file = credentials.path()
    file.parent.mkdir(parents=True)
    file.write_text(content)
    with pytest.raises(CredentialsUnusable, match=f"{file} cannot be read .*; remove the file"):
        use()
    assert file.read_text() == content


def test_values_that_are_no_text_are_no_token() -> None:
    file = credentials.path()
    file.parent.mkdir(parents=True)
    file.write_text('{"server": 5, "tokens": {"http://first.test": 7}}')
    assert (credentials.find_stored_token(FIRST), credentials.last_server()) == (None, None)


def test_a_file_that_cannot_be_replaced_keeps_its_content_and_no_draft_is_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    credentials.keep(FIRST, "vitac_1")

    def full(self: Path, target: Path) -> Path:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", full)
        with pytest.raises(CredentialsUnusable, match="No space left"):
            credentials.keep(SECOND, "vitac_2")
    assert (credentials.find_stored_token(FIRST), credentials.find_stored_token(SECOND)) == ("vitac_1", None)
    assert list(credentials.path().parent.iterdir()) == [credentials.path()]


def test_a_folder_that_cannot_be_made_is_told(configuration: Path) -> None:
    configuration.write_text("a file")
    with pytest.raises(CredentialsUnusable):
        credentials.keep(FIRST, "vitac_1")
