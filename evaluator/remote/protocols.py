"""The protocols of policy servers there are: what is said before, in and after an episode; called by `session`."""

import re
import time
from collections.abc import Mapping
from typing import Any, Final

from vitac.envs.extras import require_extra

from ..agent.protocol import violation
from .codec import decode, encode, read_field
from .description import RemoteProtocol, RemoteServer, by_level
from .line import AddressInvalid, Dialogue, Line, LineLost, Sent, check_websocket, reported

_BRIDGE_VERSION: Final = "robot-bridge-v1"
VLA_EVAL_VERSION: Final = 1
_GRPC: Final = re.compile(r"grpc://[^/@?#\s]+:[0-9]{1,5}")


class _OnLine:
    """One end of a dialogue that a websocket carries."""

    def __init__(self, line: Line) -> None:
        self._line = line

    def close(self) -> None:
        """Close the websocket."""
        self._line.close()


class OpenPi(_OnLine):
    """openpi: metadata first, then one answer to each observation; a text frame is a traceback."""

    def greet(self, deadline_s: float) -> None:
        """Take the server's metadata."""
        self._receive(deadline_s)

    def begin(self, prompt: str, deadline_s: float) -> None:
        """Do nothing: the protocol has no episodes."""

    def ask(self, sent: Sent, prompt: str, deadline_s: float) -> object:
        """Send an observation with its prompt; return the field `actions`."""
        self._line.check_silent()
        self._line.send(encode({**sent, "prompt": prompt}, binary_keys=True), deadline_s)
        return _field(self._receive(deadline_s), "actions")

    def end(self, deadline_s: float) -> None:
        """Do nothing: the protocol has no episodes."""

    def _receive(self, deadline_s: float) -> dict[Any, Any]:
        message = self._line.receive(deadline_s)
        if isinstance(message, str):
            raise reported(message)
        return decode(message)


class _Messages:
    """Messages in MessagePack on a line, each with its type."""

    def __init__(self, line: Line, *, binary_keys: bool, png: bool = False) -> None:
        self._line = line
        self._binary_keys = binary_keys
        self._png = png

    def send(self, message: Mapping[str, Any], deadline_s: float) -> None:
        self._line.send(encode(message, binary_keys=self._binary_keys, png=self._png), deadline_s)

    def receive(self, deadline_s: float) -> tuple[str, dict[Any, Any]]:
        data = self._line.receive(deadline_s)
        if isinstance(data, str):
            raise violation(f"Expected a binary message, got the text {data!r:.200}.")
        message = decode(data)
        kind = read_field(message, "type")
        return kind.decode("utf-8", "replace") if isinstance(kind, bytes) else str(kind), message


class VlaEval(_OnLine):
    """vla-eval's model servers: every message has a number, which its answer repeats."""

    def __init__(self, line: Line) -> None:
        super().__init__(line)
        self._messages = _Messages(line, binary_keys=False, png=True)
        self._seq = 0

    def greet(self, deadline_s: float) -> None:
        """Exchange greetings, and refuse another version of the protocol."""
        self._send("hello", {"harness_version": "vitac", "protocol_version": VLA_EVAL_VERSION}, deadline_s)
        payload = self._receive("hello", deadline_s)
        version = read_field(payload, "protocol_version")
        if version != VLA_EVAL_VERSION:
            raise violation(f"Expected a model server of protocol version {VLA_EVAL_VERSION}, got {version!r:.40}.")

    def begin(self, prompt: str, deadline_s: float) -> None:
        """Say that an episode begins; the server is silent."""
        self._send("episode_start", {"task": {"name": prompt}}, deadline_s)

    def ask(self, sent: Sent, prompt: str, deadline_s: float) -> object:
        """Send an observation; a slash in a name makes a level, as in `images/wrist`. Return the field `actions`."""
        self._send("observation", by_level(sent) | {"task_description": prompt}, deadline_s)
        return _field(self._receive("action", deadline_s), "actions")

    def end(self, deadline_s: float) -> None:
        """Say that the episode is over, not how it ended."""
        self._send("episode_end", {}, deadline_s)

    def _send(self, kind: str, payload: Mapping[str, Any], deadline_s: float) -> None:
        self._seq += 1
        message = {"type": kind, "payload": payload, "seq": self._seq, "timestamp": time.time()}
        self._messages.send(message, deadline_s)

    def _receive(self, expected: str, deadline_s: float) -> dict[Any, Any]:
        kind, message = self._messages.receive(deadline_s)
        payload = read_field(message, "payload")
        if not isinstance(payload, dict):
            raise violation(f"Expected a payload that is a map, got {type(payload).__name__}.")
        if kind == "error":
            raise reported(str(read_field(payload, "error")))
        _check_answer(expected, kind, self._seq, read_field(message, "seq"))
        return payload


class RobotBridge(_OnLine):
    """The 2026 edition's bridge, of which this is the robot's end: config, observations, actions, start and stop."""

    def __init__(self, line: Line) -> None:
        super().__init__(line)
        self._messages = _Messages(line, binary_keys=True)
        self._obs_seq = 0
        self._started = False

    def greet(self, deadline_s: float) -> None:
        """Greet the policy and take its configuration."""
        self._messages.send({"type": "hello", "protocol": _BRIDGE_VERSION}, deadline_s)
        kind, _ = self._messages.receive(deadline_s)
        if kind != "config":
            raise violation(f"Expected the message 'config', got {kind!r:.40}.")

    def begin(self, prompt: str, deadline_s: float) -> None:
        """Do nothing: the protocol has no episodes."""

    def ask(self, sent: Sent, prompt: str, deadline_s: float) -> object:
        """Send an observation with the task in words; return the field `action` of the answer to it.

        The policy gets its first observation before it says `start`, to warm up, and then again.
        """
        if not self._started:
            self._publish(sent, prompt, deadline_s)
            self._wait_for_start(deadline_s)
        self._publish(sent, prompt, deadline_s)
        while True:
            kind, message = self._messages.receive(deadline_s)
            if kind == "state":
                self._check_state(message)
                continue
            _check_answer("action", kind, self._obs_seq, read_field(message, "obs_seq"))
            return _field(message, "action")

    def end(self, deadline_s: float) -> None:
        """Do nothing: the protocol has no episodes."""

    def _publish(self, sent: Sent, prompt: str, deadline_s: float) -> None:
        self._obs_seq += 1
        message = {"type": "obs", "obs_seq": self._obs_seq, "obs": {**sent, "task": prompt}}
        self._messages.send(message, deadline_s)

    def _wait_for_start(self, deadline_s: float) -> None:
        """Wait until the policy has warmed up; an action that it made meanwhile is not played."""
        while not self._started:
            kind, message = self._messages.receive(deadline_s)
            if kind == "state":
                self._started = self._check_state(message)
            else:
                _check_answer("action", kind, self._obs_seq, read_field(message, "obs_seq"))

    @staticmethod
    def _check_state(message: Mapping[Any, Any]) -> bool:
        state = read_field(message, "state")
        if state not in {"start", b"start"}:
            raise LineLost(f"The policy said {state!r:.40}.")
        return True


def open_dialogue(address: str, server: RemoteServer, deadline_s: float) -> Dialogue:
    """Return the dialogue with a policy server, or with the policy that dials us, before the greeting.

    Args:
        address: as `check_address` takes it.
        server: what submission.yaml says of it.
        deadline_s: by the monotonic clock; whoever is there may be starting.

    Raises:
        ExtraMissing: the protocol needs packages that are not installed.
        LineLost, LineSilent: nobody is there.
    """
    match server.protocol:
        case RemoteProtocol.OPENPI:
            return OpenPi(Line.connect(address, deadline_s))
        case RemoteProtocol.VLA_EVAL:
            return VlaEval(Line.connect(address, deadline_s))
        case RemoteProtocol.ROBOT_BRIDGE:
            return RobotBridge(Line.accept(address, deadline_s))
        case RemoteProtocol.LEROBOT:
            require_extra("lerobot", "grpc", user="A policy server of LeRobot")
            from .lerobot import LeRobot

            return LeRobot(address, server, deadline_s)


def check_address(address: str, protocol: RemoteProtocol) -> None:
    """Make sure that an address names what speaks a protocol, and its port.

    Raises:
        AddressInvalid: it does not.
    """
    if protocol is not RemoteProtocol.LEROBOT:
        check_websocket(address)
    elif not _GRPC.fullmatch(address):
        raise AddressInvalid(f"Expected an address such as grpc://127.0.0.1:8080, got {address!r}.")


def _field(message: Mapping[Any, Any], name: str) -> object:
    value = read_field(message, name)
    if value is None:
        raise violation(f"Expected the field {name!r} in the answer, got {', '.join(map(str, message))!r:.200}.")
    return value


def _check_answer(expected: str, kind: str, seq: int, answered: object) -> None:
    if kind != expected:
        raise violation(f"Expected the message {expected!r}, got {kind!r:.40}.")
    if answered != seq:
        raise violation(f"Expected the answer to question {seq}, got that to question {answered!r:.40}.")
