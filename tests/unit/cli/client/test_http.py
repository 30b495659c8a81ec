import errno
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest
from vitac.cli.client import http
from vitac.cli.client.answers import HINTS, RequestRefused, ServiceUnreachable
from vitac.cli.client.http import DEFAULT_SERVER, Client, CredentialsUnusable, TokenUnusable, make_client
from vitac.errors import VitacError
from vitac.server.errors import ProblemCode

SECRET = "vitac_secret"  # noqa: S105 - made up
Answer = Callable[[httpx.Request], httpx.Response]


def client(answer: Answer, token: str | None = SECRET) -> Client:
    return Client(server="http://arena.test", token=token, transport=httpx.MockTransport(answer))


def refusing(status: int, **problem: object) -> Answer:
    return lambda _: httpx.Response(status, json=problem, headers={"x-request-id": "r-17"})


def test_sends_the_token_and_nothing_without_one() -> None:
    seen: list[str | None] = []

    def answer(request: httpx.Request) -> httpx.Response:
        seen.append(request.headers.get("authorization"))
        return httpx.Response(200, json={})

    client(answer).me()
    client(answer, token=None).leaderboard("track_1")
    assert seen == ["Bearer vitac_secret", None]


def test_a_refusal_tells_status_code_sentence_and_request_id() -> None:
    with pytest.raises(RequestRefused) as refused:
        client(refusing(400, code="some_code", detail="Because of that.")).me()
    for shown in ("400", "some_code", "Because of that.", "r-17"):
        assert shown in str(refused.value)


@pytest.mark.parametrize("code", ["log_rejected", "log_impossible"])
def test_hints_on_logs_fit_also_2025_text_logs(code: str) -> None:
    with pytest.raises(RequestRefused, match=r"hint: .*`vitac log import FILE`.* 2025 text log"):
        client(refusing(422, code=code, detail="It is none.")).me()


def test_every_hint_belongs_to_a_code_of_the_service() -> None:
    assert set(HINTS) <= set(ProblemCode)


def test_nobody_at_the_address_says_what_to_check() -> None:
    def answer(request: httpx.Request) -> httpx.Response:
        raise httpx.ConnectError("Connection refused", request=request)

    with pytest.raises(ServiceUnreachable, match=r"http://arena\.test.*VITAC_SERVER"):
        client(answer).me()


def test_lists_submissions_of_one_page() -> None:
    def answer(request: httpx.Request) -> httpx.Response:
        assert request.url.params["limit"] == "3"
        return httpx.Response(200, json={"items": [{"id": "a"}, {"id": "b"}], "next_before": None})

    assert [item["id"] for item in client(answer).submissions(limit=3)] == ["a", "b"]


def test_options_win_over_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VITAC_SERVER", "http://from.environment")
    monkeypatch.setenv("VITAC_TOKEN", "vitac_environment")
    file = tmp_path / "token"
    file.write_text("vitac_file\n")
    assert make_client(None, None) == Client(server="http://from.environment", token="vitac_environment")  # noqa: S106
    assert make_client("http://a.test/", file) == Client(server="http://a.test", token="vitac_file")  # noqa: S106


def test_the_service_of_the_last_login_gets_its_own_token_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.delenv("VITAC_SERVER", raising=False)
    monkeypatch.setenv("VITAC_TOKEN", "vitac_of_another_service")
    http.store_token("http://last.test", "vitac_kept")
    assert make_client(None, None) == Client(server="http://last.test", token="vitac_kept")  # noqa: S106
    named = make_client("http://last.test", None)
    assert named == Client(server="http://last.test", token="vitac_of_another_service")  # noqa: S106
    http.forget_token("http://last.test")
    here = make_client(None, None)
    assert here == Client(server=DEFAULT_SERVER, token="vitac_of_another_service")  # noqa: S106


def test_without_options_and_environment_it_is_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("VITAC_SERVER", raising=False)
    monkeypatch.delenv("VITAC_TOKEN", raising=False)
    assert make_client(None, None) == Client(server=DEFAULT_SERVER, token=None)


def test_an_address_without_scheme_or_a_missing_token_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(VitacError, match=r"Expected a service address like http://"):
        make_client("arena.test", None)
    with pytest.raises(VitacError, match=r"cannot be read.*--token-file"):
        make_client("http://arena.test", tmp_path / "none")
    (tmp_path / "program").write_bytes(b"\x7fELF\xff\xfe")
    with pytest.raises(TokenUnusable, match="Expected one API token"):
        make_client("http://arena.test", tmp_path / "program")


@pytest.mark.parametrize(
    "content", ["", "\n", "vitac_one vitac_two", "vitac_one\nvitac_two\n", "vitac_\u00e9", "vitac_\u200b"]
)
def test_what_cannot_be_sent_as_a_token_is_refused_before_a_service_is_asked(content: str, tmp_path: Path) -> None:
    file = tmp_path / "token"
    file.write_text(content)
    with pytest.raises(TokenUnusable, match="Expected one API token") as caught:
        make_client("http://arena.test", file)
    assert "No service answers" not in str(caught.value)
    assert content.strip() not in str(caught.value) or not content.strip(), "no secret is repeated"


FIRST, SECOND = "http://first.test", "http://second.test"


@pytest.fixture(autouse=True)
def configuration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    return tmp_path / "config"


def test_each_service_has_a_token_and_the_last_login_is_meant() -> None:
    assert (http.find_stored_token(FIRST), http.last_server()) == (None, None)
    http.store_token(FIRST, "vitac_1")
    http.store_token(SECOND, "vitac_2")
    assert (http.find_stored_token(FIRST), http.find_stored_token(SECOND)) == ("vitac_1", "vitac_2")
    assert http.last_server() == SECOND
    http.store_token(FIRST, "vitac_3")
    assert (http.find_stored_token(FIRST), http.last_server()) == ("vitac_3", FIRST)


def test_a_forgotten_token_is_gone_and_its_service_no_longer_meant() -> None:
    http.store_token(FIRST, "vitac_1")
    http.store_token(SECOND, "vitac_2")
    assert http.forget_token(FIRST)
    assert (http.find_stored_token(FIRST), http.last_server()) == (None, SECOND)
    assert http.forget_token(SECOND)
    assert http.last_server() is None
    assert not http.forget_token(SECOND)


def test_only_the_user_may_read_the_file_and_no_draft_is_left() -> None:
    http.store_token(FIRST, "vitac_1")
    file = http.credentials_file()
    assert (file.stat().st_mode & 0o777, file.parent.stat().st_mode & 0o777) == (0o600, 0o700)
    assert list(file.parent.iterdir()) == [file]


def test_without_a_configuration_folder_the_file_is_in_the_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", "")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert http.credentials_file() == tmp_path / ".config/vitac/credentials.json"


@pytest.mark.parametrize("content", ["", "[]", "null", "{}", '{"server": null}', '{"server": "a", "tokens": ["b"]}'])
@pytest.mark.parametrize(
    "use",
    [http.last_server, lambda: http.find_stored_token(FIRST), lambda: http.store_token(FIRST, "vitac_1")],
)
def test_a_damaged_file_is_named_and_left_as_it_is(content: str, use: Callable[[], object]) -> None:
    file = http.credentials_file()
    file.parent.mkdir(parents=True)
    file.write_text(content)
    with pytest.raises(CredentialsUnusable, match=f"{file} cannot be read .*; remove the file"):
        use()
    assert file.read_text() == content


def test_values_that_are_no_text_are_no_token() -> None:
    file = http.credentials_file()
    file.parent.mkdir(parents=True)
    file.write_text('{"server": 5, "tokens": {"http://first.test": 7}}')
    assert (http.find_stored_token(FIRST), http.last_server()) == (None, None)


def test_a_file_that_cannot_be_replaced_keeps_its_content_and_no_draft_is_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    http.store_token(FIRST, "vitac_1")

    def full(self: Path, target: Path) -> Path:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", full)
        with pytest.raises(CredentialsUnusable, match="No space left"):
            http.store_token(SECOND, "vitac_2")
    assert (http.find_stored_token(FIRST), http.find_stored_token(SECOND)) == ("vitac_1", None)
    assert list(http.credentials_file().parent.iterdir()) == [http.credentials_file()]


def test_a_folder_that_cannot_be_made_is_told(configuration: Path) -> None:
    configuration.write_text("a file")
    with pytest.raises(CredentialsUnusable):
        http.store_token(FIRST, "vitac_1")
