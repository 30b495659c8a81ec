"""The line to a policy server: a websocket with deadlines, what is asked on it, and how two are joined into one."""

import asyncio
import contextlib
import socket
import ssl
import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any, Final, Protocol, Self
from urllib.parse import quote, urlsplit

from numpy.typing import NDArray
from vitac.errors import VitacError
from websockets.asyncio.connection import Connection
from websockets.client import ClientProtocol
from websockets.exceptions import ConnectionClosed, InvalidURI, PayloadTooBig
from websockets.frames import Frame, Opcode
from websockets.http11 import Request
from websockets.protocol import State
from websockets.server import ServerProtocol
from websockets.uri import parse_uri

from ..agent.isolation.output import printable
from ..agent.protocol import violation
from ..agent.verdicts import PolicyFailed, VerdictCode
from .codec import ANSWER_BYTES

_CHUNK_BYTES: Final = 256 * 1024
_RETRY_S: Final = 0.2
_DATA: Final = frozenset({Opcode.TEXT, Opcode.BINARY, Opcode.CONT})


class AddressInvalid(VitacError):
    """The address of a policy server is none: give one such as ws://127.0.0.1:8000."""


class LineLost(Exception):
    """The other end closed the line, or could not be reached."""


class LineSilent(Exception):
    """The deadline has passed."""


def check_websocket(address: str) -> None:
    """Make sure that an address names a websocket, and its port.

    Raises:
        AddressInvalid: it does not.
    """
    try:
        parse_uri(address)
    except (InvalidURI, ValueError) as error:
        raise AddressInvalid(
            f"Expected an address such as ws://127.0.0.1:8000 or wss://HOST/PATH, got {address!r}."
        ) from error


class Line:
    """An open websocket.

    Args:
        sock: what carries it.
        protocol: its end of the websocket, before the handshake.
    """

    def __init__(self, sock: socket.socket, protocol: ClientProtocol | ServerProtocol) -> None:
        self._sock = sock
        self._protocol = protocol
        self._frames: deque[Frame] = deque()

    @classmethod
    def connect(cls, address: str, deadline_s: float) -> Self:
        """Return a line to a server, which may be starting: it is tried until the deadline.

        Args:
            address: `ws://` or `wss://`.
            deadline_s: by the monotonic clock.

        Raises:
            LineLost: nobody answered, or it was no websocket.
        """
        while True:
            try:
                return cls._connect_once(address, deadline_s)
            except (OSError, LineLost, LineSilent) as error:
                if time.monotonic() + _RETRY_S >= deadline_s:
                    reason = "it did not answer in time" if isinstance(error, LineSilent) else str(error)
                    raise LineLost(f"No policy server answered at {address}: {reason}") from error
            time.sleep(_RETRY_S)

    @classmethod
    def _connect_once(cls, address: str, deadline_s: float) -> Self:
        uri = parse_uri(address)
        sock = socket.create_connection((uri.host, uri.port), timeout=_left_s(deadline_s))
        try:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if uri.secure:
                sock = ssl.create_default_context().wrap_socket(sock, server_hostname=uri.host)
            protocol = ClientProtocol(uri, max_size=ANSWER_BYTES)
            line = cls(sock, protocol)
            protocol.send_request(protocol.connect())
            line._shake_hands(deadline_s)
        except BaseException:
            sock.close()
            raise
        return line

    @classmethod
    def accept(cls, address: str, deadline_s: float) -> Self:
        """Return a line to the first policy that dials an address of this machine.

        Raises:
            LineLost: the address is not free, or what dialled spoke no websocket.
            LineSilent: nobody dialled before the deadline.
        """
        parts = urlsplit(address)
        with socket.socket() as listener:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)  # one for each process that plays
            try:
                listener.bind((parts.hostname or "", parts.port or 80))
                listener.listen(1)
                listener.settimeout(_left_s(deadline_s))
                sock, _ = listener.accept()
            except TimeoutError as error:
                raise LineSilent from error
            except OSError as error:
                raise LineLost(f"No policy can dial {address}: {error}.") from error
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        line = cls(sock, ServerProtocol(max_size=ANSWER_BYTES))
        try:
            line._shake_hands(deadline_s)
        except BaseException:
            sock.close()
            raise
        return line

    def send(self, data: bytes, deadline_s: float) -> None:
        """Send one message.

        Raises:
            LineLost: the other end is gone.
            LineSilent: it did not read before the deadline.
        """
        if self._protocol.state is not State.OPEN:
            raise LineLost("The policy's end of the line was closed.")
        self._protocol.send_binary(data)
        self._flush(deadline_s)

    def receive(self, deadline_s: float) -> bytes | str:
        """Return the next message: bytes, or a text.

        Raises:
            LineLost: the other end is gone.
            LineSilent: it was not there before the deadline.
            PolicyFailed: protocol_violation.
        """
        pieces: list[bytes] = []
        is_text = False
        while True:
            while self._frames:
                frame = self._frames.popleft()
                is_text = is_text or frame.opcode is Opcode.TEXT
                pieces.append(bytes(frame.data))
                if frame.fin:
                    message = b"".join(pieces)
                    return message.decode("utf-8", "replace") if is_text else message
            self._read(_left_s(deadline_s))

    def check_silent(self) -> None:
        """Check that nothing has arrived that nobody asked for.

        Raises:
            LineLost: the other end is gone.
            PolicyFailed: protocol_violation.
        """
        with contextlib.suppress(LineSilent):
            self._read(0.0)
        if self._frames:
            raise violation("Received a second answer to one question, expected exactly one.")

    def close(self) -> None:
        """Say so, without waiting, and close this end."""
        with contextlib.suppress(LineLost, LineSilent):
            if self._protocol.state is State.OPEN:
                self._protocol.send_close()
                self._flush(time.monotonic() + _RETRY_S)
        self._sock.close()

    def _shake_hands(self, deadline_s: float) -> None:
        self._flush(deadline_s)
        while self._protocol.state is State.CONNECTING:
            self._read(_left_s(deadline_s))
        if self._protocol.handshake_exc is not None:
            raise LineLost(f"{self._protocol.handshake_exc}.")

    def _read(self, wait_s: float) -> None:
        """Take what has arrived, or wait for something."""
        self._sock.settimeout(wait_s)
        try:
            data = self._sock.recv(_CHUNK_BYTES)
        except (TimeoutError, BlockingIOError, ssl.SSLWantReadError) as error:
            raise LineSilent from error
        except OSError as error:
            raise LineLost(f"The line to the policy broke: {error.strerror}.") from error
        if data:
            self._protocol.receive_data(data)
        else:
            self._protocol.receive_eof()
        for event in self._protocol.events_received():
            if isinstance(event, Request):
                assert isinstance(self._protocol, ServerProtocol)  # noqa: S101 - only a server gets requests
                self._protocol.send_response(self._protocol.accept(event))
            elif isinstance(event, Frame) and event.opcode in _DATA:
                self._frames.append(event)
        self._flush(time.monotonic() + max(wait_s, _RETRY_S))  # pongs, and what ends the line
        self._check_open(has_ended=not data)

    def _check_open(self, *, has_ended: bool) -> None:
        if isinstance(self._protocol.parser_exc, PayloadTooBig):
            raise violation(f"Expected a message of at most {ANSWER_BYTES} bytes, got a longer one.")
        if self._protocol.parser_exc is not None and not isinstance(self._protocol.parser_exc, EOFError):
            raise violation(f"Expected a websocket, got something else: {self._protocol.parser_exc}.")
        if not self._frames and (has_ended or self._protocol.state in {State.CLOSING, State.CLOSED}):
            reason = self._protocol.handshake_exc or self._protocol.close_rcvd or "without a word"
            raise LineLost(f"The policy's end closed the line: {reason}.")

    def _flush(self, deadline_s: float) -> None:
        for data in self._protocol.data_to_send():
            for piece in _pieces(data):
                sent = 0
                while sent < len(piece):
                    self._sock.settimeout(_left_s(deadline_s))
                    try:
                        sent += self._sock.send(piece[sent:])
                    except TimeoutError as error:
                        raise LineSilent from error
                    except OSError as error:
                        raise LineLost(f"The line to the policy broke: {error.strerror}.") from error


def _pieces(data: bytes) -> Iterator[memoryview]:
    view = memoryview(data)
    return (view[start : start + _CHUNK_BYTES] for start in range(0, len(view), _CHUNK_BYTES))


def _left_s(deadline_s: float) -> float:
    left_s = deadline_s - time.monotonic()
    if left_s <= 0:
        raise LineSilent
    return left_s


_ERROR_CHARACTERS: Final = 4096


Sent = Mapping[str, NDArray[Any]]


class Dialogue(Protocol):
    """What both ends say on one line; every call has a deadline by the monotonic clock.

    All raise `PolicyFailed`, `LineLost` and `LineSilent`.
    """

    def greet(self, deadline_s: float) -> None:
        """Do what comes before the first episode."""

    def begin(self, prompt: str, deadline_s: float) -> None:
        """Say that an episode begins."""

    def ask(self, sent: Sent, prompt: str, deadline_s: float) -> object:
        """Send an observation; return the field with the actions, undecoded."""

    def end(self, deadline_s: float) -> None:
        """Say that the episode is over."""

    def close(self) -> None:
        """Close this end."""


def reported(text: str) -> PolicyFailed:
    """Return the failure of a policy whose server said so, in a text of any length."""
    end = printable(text[-_ERROR_CHARACTERS:]).strip()
    return PolicyFailed(
        VerdictCode.CRASHED, f"The policy server reported an error: {end.rpartition(chr(10))[2]!r:.300}.", end
    )


WAITING = "waiting"
"""What the gate says to a line that it keeps."""
BEGIN = "begin"
"""What it says when somebody plays on it; all that follows is the policy server's protocol."""


PLAY = "/play/"
"""How paths at the gate's inner address begin, before the name of a team."""


def inner_address(gate: str, team: str) -> str:
    """Return where a team's policy is asked that has dialled the gate of an inner address."""
    return f"{gate.rstrip('/')}{PLAY}{quote(team, safe='')}"


async def join(one: Connection, other: Connection) -> None:
    """Send what comes from either end to the other, until one is closed; then both are."""
    copies = [asyncio.create_task(_copy(*ends)) for ends in ((one, other), (other, one))]
    try:
        await asyncio.wait(copies, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for copy in copies:
            copy.cancel()
        await asyncio.gather(*copies, one.close(), other.close(), return_exceptions=True)


async def _copy(source: Connection, target: Connection) -> None:
    with suppress(ConnectionClosed):
        async for message in source:
            await target.send(message)
