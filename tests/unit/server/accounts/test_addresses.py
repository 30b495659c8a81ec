import socket
import threading

import pytest
from vitac.server.accounts import webhooks
from vitac.server.errors import ServiceError

INSIDE = [
    "127.0.0.1",
    "10.1.2.3",
    "192.168.0.1",
    "172.16.0.1",
    "169.254.169.254",
    "100.64.0.1",
    "0.0.0.0",  # noqa: S104 - is refused
    "224.0.0.1",
    "::1",
    "fe80::1%eth0",
    "fd00::1",
    "::ffff:127.0.0.1",
    "64:ff9b::7f00:1",
    "2002:7f00:1::",
    "::ffff:93.184.215.14",  # a mapped, translated or tunnelled address is none of the internet
    "64:ff9b::5db8:d70e",
    "64:ff9b:1::1",
    "2002:5db8:d70e::1",
    "2001::1",
    "fec0::1",
    "3fff::1",
    "5f00::1",
    "100::1",
    "ff0e::1",
    "168.63.129.16",
]


def answer_with(monkeypatch: pytest.MonkeyPatch, *found: str) -> None:
    """Lets every host have these addresses."""

    def looked_up(host: str, port: int, **_: object) -> list[tuple[object, ...]]:
        return [(socket.AF_INET6 if ":" in one else socket.AF_INET, 1, 6, "", (one, port)) for one in found]

    monkeypatch.setattr(webhooks.socket, "getaddrinfo", looked_up)  # type: ignore[attr-defined]


@pytest.mark.parametrize("inside", INSIDE)
def test_a_host_that_leads_inside_is_refused_also_as_one_of_several(
    monkeypatch: pytest.MonkeyPatch, inside: str
) -> None:
    for found in ((inside,), ("93.184.215.14", inside)):
        answer_with(monkeypatch, *found)
        with pytest.raises(PermissionError, match="not an address of the public internet"):
            webhooks.resolve_address("hook.example.org", 443, inside_allowed=False)
    assert webhooks.resolve_address("hook.example.org", 443, inside_allowed=True)[1][0] == "93.184.215.14"


@pytest.mark.parametrize("inside", [*INSIDE, "localhost", "127.1", "2130706433"])
def test_a_webhook_to_a_host_inside_is_refused_when_it_is_added(inside: str) -> None:
    host = f"[{inside}]" if ":" in inside else inside
    with pytest.raises(ServiceError, match="not an address of the public internet"):
        webhooks.require_public(f"https://{host}/hook")


def test_a_webhook_may_be_added_while_its_host_is_not_found(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, answered = threading.Event(), threading.Event()

    def look_up(*_: object, **__: object) -> list[object]:
        asked.set()
        answered.wait(60)
        raise socket.gaierror

    monkeypatch.setattr(webhooks, "LOOKED_UP_WITHIN_S", 0.01)
    monkeypatch.setattr(webhooks.socket, "getaddrinfo", look_up)  # type: ignore[attr-defined]
    webhooks.require_public("https://hook.example.org/")
    assert asked.wait(60)
    answered.set()


def test_a_host_of_the_internet_is_connected_to_by_its_address(monkeypatch: pytest.MonkeyPatch) -> None:
    answer_with(monkeypatch, "93.184.215.14", "2606:2800:21f::1")
    assert webhooks.resolve_address("hook.example.org", 443, inside_allowed=False) == (
        socket.AF_INET,
        ("93.184.215.14", 443),
    )


@pytest.mark.parametrize(
    "address",
    [
        "",
        "hook.example.org",
        "http://hook.example.org/",
        "ftp://hook.example.org/",
        "file:///etc/passwd",
        "https:///path",
        "https://user@hook.example.org/",
        "https://:word@hook.example.org/",
        "https://hook.example.org/#part",
        "https://hook.example.org:0/",
        "https://hook.example.org:99999/",
        "https://hook.example.org/a b",
        "https://hook.example.org/\r\nHost: inside",
        "https://hök.example.org/",
        "https://[::1/",
        "https://hook.example.org/" + "a" * 500,
    ],
)
def test_an_address_that_is_no_plain_https_is_refused(address: str) -> None:
    with pytest.raises(ServiceError, match="cannot be used"):
        webhooks.check_address(address, inside_allowed=False)


def test_a_setting_allows_http_for_hosts_inside() -> None:
    assert webhooks.check_address("http://127.0.0.1:9/x?y=1", inside_allowed=True).port == 9
    assert webhooks.check_address("https://hook.example.org/x", inside_allowed=False).hostname == "hook.example.org"


@pytest.mark.parametrize("port", [22, 25, 80, 3306, 6379, 8080])
def test_a_port_of_another_service_is_refused(port: int) -> None:
    with pytest.raises(ServiceError, match=f"expected port 443 or 8443, got {port}"):
        webhooks.check_address(f"https://hook.example.org:{port}/", inside_allowed=False)
    assert webhooks.check_address(f"http://127.0.0.1:{port}/", inside_allowed=True).port == port


def test_the_ports_of_https_are_taken() -> None:
    for address in ("https://hook.example.org/", "https://hook.example.org:443/", "https://hook.example.org:8443/"):
        webhooks.check_address(address, inside_allowed=False)
