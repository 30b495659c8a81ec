"""Where a webhook may lead: to hosts of the internet, not to those that only this machine can reach."""

import socket
from collections.abc import Iterator
from ipaddress import IPv4Address, IPv6Address, IPv6Network, ip_address
from typing import Any
from urllib.parse import SplitResult, urlsplit

from ..errors import ProblemCode, ServiceError

MAX_LENGTH = 500
_NAT64 = IPv6Network("64:ff9b::/96")
SocketAddress = tuple[int, tuple[Any, ...]]
"""Address family, and what a socket connects to."""


def checked(address: str, *, inside_allowed: bool) -> SplitResult:
    """Return the parts of a webhook's address.

    Args:
        address: as it was given.
        inside_allowed: whether hosts inside, and unencrypted connections, may be named.

    Raises:
        ServiceError: it cannot be used; where the host leads is looked at with each notice.
    """
    try:
        parts = urlsplit(address)
        port = parts.port
    except ValueError as error:
        raise _invalid(address, str(error)) from error
    if len(address) > MAX_LENGTH or not address.isascii() or not address.isprintable() or " " in address:
        raise _invalid(address, f"expected at most {MAX_LENGTH} printable ASCII characters")
    schemes = ("https", "http") if inside_allowed else ("https",)
    if parts.scheme not in schemes or not parts.hostname or port == 0:
        raise _invalid(address, f"expected {' or '.join(schemes)}://HOST/...")
    if parts.username is not None or parts.password is not None or parts.fragment:
        raise _invalid(address, "expected no user, password or fragment")
    return parts


def resolved(host: str, port: int, *, inside_allowed: bool) -> SocketAddress:
    """Return where to connect to for a host; connecting to just that keeps a second answer of its DNS from counting.

    Raises:
        OSError: the host is not known, or one of its addresses is inside.
    """
    found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    for *_, where in found:
        if not inside_allowed and any(not one.is_global or one.is_multicast for one in _leads_to(str(where[0]))):
            raise PermissionError(f"{host} leads to {where[0]}, which is no address of the internet")
    family, _, _, _, where = found[0]
    return family, tuple(where)


def _leads_to(address: str) -> Iterator[IPv4Address | IPv6Address]:
    """Yield an address and those of version 4 that it stands for."""
    found = ip_address(address.partition("%")[0])
    yield found
    if isinstance(found, IPv6Address):
        if found in _NAT64:
            yield IPv4Address(int(found) & 0xFFFFFFFF)
        yield from (embedded for embedded in (found.ipv4_mapped, found.sixtofour) if embedded is not None)
        yield from found.teredo or ()


def _invalid(address: str, problem: str) -> ServiceError:
    return ServiceError(
        ProblemCode.INVALID_REQUEST, f"The webhook's address {address!r:.100} cannot be used: {problem}."
    )
