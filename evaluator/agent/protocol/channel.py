"""The trusted end of the socket between the evaluator and a policy: one question, one answer, nothing else."""

import array
import fcntl
import socket
import sys
import termios
from collections.abc import Sequence
from typing import Final

from .frames import AnswerKind, FrameReader, PolicyAnswer, PolicyQuestion, encode_question, violation

_CHUNK_BYTES: Final = 64 * 1024
"""Small enough that the C library has such a piece at hand and need not ask the kernel for it."""
_PEEK: Final = int(socket.MSG_PEEK | socket.MSG_DONTWAIT)
_DO_NOT_WAIT: Final = int(socket.MSG_DONTWAIT)
_CUT_OFF: Final = int(socket.MSG_CTRUNC)
"""Plain numbers: to combine Python's own names of them takes longer than the system call."""
_CREDENTIALS_BYTES: Final = 12
"""struct ucred: pid, uid, gid."""


class Channel:
    """The evaluator's end of one socketpair; never blocks, the session waits for it together with all else."""

    def __init__(self, sock: socket.socket, *, message_bytes: int) -> None:
        sock.setblocking(False)
        if sys.platform == "linux":
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
        self._sock = sock
        self._reader = FrameReader(message_bytes=message_bytes)
        self._unsent: list[memoryview] = []
        self._seq = 0

    def fileno(self) -> int:
        """Return the descriptor to poll."""
        return self._sock.fileno()

    @property
    def has_unsent(self) -> bool:
        """True while a part of the question still waits for room in the socket."""
        return bool(self._unsent)

    def ask(self, question: PolicyQuestion) -> None:
        """Start sending the next question.

        Raises:
            PolicyFailed: protocol_violation, the policy has already sent unrequested data.
        """
        self.check_silent()
        self._seq += 1
        self._unsent = encode_question(self._seq, question)
        self.send_more()

    def send_more(self) -> None:
        """Send what the socket takes now; a closed far end is left to `receive` to report."""
        try:
            sent = self._sock.sendmsg(self._unsent)
        except BlockingIOError:
            return
        except (BrokenPipeError, ConnectionResetError):
            self._unsent = []
            return
        self._unsent = _unsent_parts(self._unsent, sent)

    def receive(self, expected: Sequence[AnswerKind]) -> PolicyAnswer | None:
        """Return the answer to the last question, None while it is not complete, or raise.

        Raises:
            PolicyFailed: protocol_violation, and `ChannelClosed` where the far end is gone.
        """
        while (piece := self._read_piece()) is not None:
            answer = self._reader.feed(*piece)
            if answer is not None:
                return self._check(answer, expected)
        return None

    def check_silent(self) -> None:
        """Check that the socket holds no unrequested data.

        Raises:
            PolicyFailed: protocol_violation.
        """
        try:
            waiting = self._sock.recv(1, _PEEK)
        except (BlockingIOError, ConnectionResetError):
            waiting = b""
        if waiting or not self._reader.is_empty:
            raise violation("Received a second answer to one question, expected exactly one.")

    def has_unread_question(self) -> bool:
        """Return whether a part of a question was never read; the next reader would get it."""
        unread = bytearray(4)
        fcntl.ioctl(self._sock, termios.TIOCOUTQ, unread)
        return bool(self._unsent) or any(unread)

    def reset(self) -> None:
        """Drop an unfinished exchange and count questions from one; every process that could send has ended."""
        self._unsent = []
        self._seq = 0
        self._reader = FrameReader(message_bytes=self._reader.message_bytes)
        drain(self._sock)

    def close(self) -> None:
        """Close this end."""
        self._sock.close()

    def _check(self, answer: PolicyAnswer, expected: Sequence[AnswerKind]) -> PolicyAnswer:
        if self._unsent:
            raise violation("Received an answer before the policy had read the whole question.")
        if answer.header.seq != self._seq:
            raise violation(f"Expected the answer to question {self._seq}, got that to question {answer.header.seq}.")
        if answer.header.kind not in expected:
            raise violation(f"Expected an answer {' or '.join(expected)}, got {answer.header.kind!s}.")
        self.check_silent()
        return answer

    def _read_piece(self) -> tuple[bytes, int] | None:
        try:
            # Room for the sender's credentials and nothing else: descriptors that a policy passes along find no place.
            data, ancillary, flags, _ = self._sock.recvmsg(_CHUNK_BYTES, socket.CMSG_SPACE(_CREDENTIALS_BYTES))
        except BlockingIOError:
            return None
        except ConnectionResetError:
            data, ancillary, flags = b"", [], 0
        if flags & _CUT_OFF:
            raise violation("A message carried more than bytes (such as file descriptors).")
        if not data:
            raise ChannelClosed("The policy's end of the channel was closed before it answered.")
        return data, _sender_pid(ancillary)


class ChannelClosed(Exception):
    """The far end closed the channel; the session looks at how the process ended and names the verdict."""


def drain(sock: socket.socket) -> None:
    """Discard all unread data of a socket."""
    try:
        while sock.recv(_CHUNK_BYTES, _DO_NOT_WAIT):
            pass
    except (BlockingIOError, ConnectionResetError):
        return


def _unsent_parts(parts: list[memoryview], sent: int) -> list[memoryview]:
    rest = []
    for part in parts:
        skip = min(sent, part.nbytes)
        sent -= skip
        if skip < part.nbytes:
            rest.append(part[skip:])
    return rest


def _sender_pid(ancillary: list[tuple[int, int, bytes]]) -> int:
    """Return the process that has sent a piece, 0 where the system does not say."""
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == socket.SCM_CREDENTIALS:
            return array.array("i", data[:_CREDENTIALS_BYTES])[0]
    return 0
