"""Where a webhook may lead: to hosts of the internet, not to those that only this machine can reach."""

import socket
import threading
from contextlib import suppress
from ipaddress import IPv4Address, ip_address, ip_network
from typing import Any, Final
from urllib.parse import SplitResult, urlsplit

from ..errors import ProblemCode, ServiceError

MAX_LENGTH = 500
LOOKED_UP_WITHIN_S = 2.0
"""A host that is not found within this time may be named; where it leads is looked at with each notice."""
_LOOK_UPS = threading.BoundedSemaphore(4)
"""Hosts that are looked up at the same time; name servers of others may take long to answer."""
_INTERNET_6 = ip_network("2000::/3")
"""What of version 6 is given out to networks; loopback, mapped (`::ffff:`), NAT64 and local addresses are outside."""
_NOT_PUBLIC: Final = tuple(
    map(
        ip_network,
        (
            *("0.0.0.0/8", "10.0.0.0/8", "100.64.0.0/10", "127.0.0.0/8", "169.254.0.0/16", "172.16.0.0/12"),
            *("192.0.0.0/24", "192.0.2.0/24", "192.88.99.0/24", "192.168.0.0/16", "198.18.0.0/15", "198.51.100.0/24"),
            *("203.0.113.0/24", "224.0.0.0/4", "240.0.0.0/4"),
            "168.63.129.16/32",  # where a cloud's virtual machines reach what manages them
            "2001::/23",  # Teredo, ORCHID, benchmarks
            *("2001:db8::/32", "3fff::/20"),  # documentation
            "2002::/16",  # 6to4: stands for an address of version 4
        ),
    )
)
"""Special-purpose networks of IANA's registries, and what leads to another address. Not `ipaddress.is_global`, which
changes with Python's version: that of 3.11 takes `fec0::` and `3fff::` for public."""
SocketAddress = tuple[int, tuple[Any, ...]]
"""Address family, and what a socket connects to."""


def checked(address: str, *, inside_allowed: bool, what: str = "The webhook's address") -> SplitResult:
    """Return the parts of an address that somebody gives.

    Args:
        address: as it was given.
        inside_allowed: whether hosts inside, and unencrypted connections, may be named.
        what: is given, for the message.

    Raises:
        ServiceError: it cannot be used; where the name of a host leads is looked at by `require_public`, and with each
            notice.
    """
    try:
        parts = urlsplit(address)
        port = parts.port
    except ValueError as error:
        raise _invalid(what, address, str(error)) from error
    if len(address) > MAX_LENGTH or not address.isascii() or not address.isprintable() or " " in address:
        raise _invalid(what, address, f"expected at most {MAX_LENGTH} printable ASCII characters")
    schemes = ("https", "http") if inside_allowed else ("https",)
    if parts.scheme not in schemes or not parts.hostname or port == 0:
        raise _invalid(what, address, f"expected {' or '.join(schemes)}://HOST/...")
    if parts.username is not None or parts.password is not None or parts.fragment:
        raise _invalid(what, address, "expected an address without user, password and fragment")
    if not inside_allowed and not _may_be_public(parts.hostname):
        raise _invalid(what, address, f"{parts.hostname} is not an address of the public internet")
    return parts


def require_public(address: str) -> None:
    """Refuse an address whose host leads inside; a host that is not found, or not soon, may be named.

    No transaction is open meanwhile.

    Raises:
        ServiceError: as `checked`, or the host leads inside.
    """
    parts, problems = checked(address, inside_allowed=False), list[str]()

    def look_up() -> None:
        try:
            resolved(parts.hostname or "", parts.port or 443, inside_allowed=False)
        except PermissionError as error:
            problems.append(str(error))
        except (OSError, UnicodeError):
            pass
        finally:
            _LOOK_UPS.release()

    if _LOOK_UPS.acquire(blocking=False):
        thread = threading.Thread(target=look_up, name="webhook-host", daemon=True)
        thread.start()
        thread.join(LOOKED_UP_WITHIN_S)
    if problems:
        raise _invalid("The webhook's address", address, problems[0])


def resolved(host: str, port: int, *, inside_allowed: bool) -> SocketAddress:
    """Return where to connect to for a host; connecting to just that keeps a second answer of its DNS from counting.

    Raises:
        OSError: the host is not known, or one of its addresses is inside.
    """
    found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    for *_, where in found:
        if not inside_allowed and not is_public(str(where[0])):
            raise PermissionError(f"{host} leads to {where[0]}, which is not an address of the public internet")
    family, _, _, _, where = found[0]
    return family, tuple(where)


def is_public(address: str) -> bool:
    """Return whether an address is one of the internet, and stands for no other one."""
    found = ip_address(address.partition("%")[0])
    is_given_out = isinstance(found, IPv4Address) or found in _INTERNET_6
    return is_given_out and not any(found in network for network in _NOT_PUBLIC if network.version == found.version)


def _may_be_public(host: str) -> bool:
    """Return whether a host is a name, or an address of the internet."""
    with suppress(ValueError):
        return is_public(host)
    return True


def _invalid(what: str, address: str, problem: str) -> ServiceError:
    return ServiceError(ProblemCode.INVALID_REQUEST, f"{what} {address!r:.100} cannot be used: {problem}.")
