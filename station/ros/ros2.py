"""ROS 2 on the wire: its topics and services are DDS topics, written and read by Cyclone DDS without any of ROS.

Names and request headers are those of rmw_cyclonedds: topic `rt/NAME` of type `package::msg::dds_::Name_`, and for a
service `rq/NAMERequest` and `rr/NAMEReply`, whose messages begin with the caller's id and a number.
"""

import dataclasses
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from importlib import import_module
from secrets import randbits
from threading import Event, Thread
from typing import Any, Final

from vitac.envs.extras import explain_missing

from ..eyes import Finger
from .messages import PACKAGE, QUEUE, RESET_SERVICES, RosMissing, RosVersion, TopicMessage

_WAIT_S: Final = 0.1
_ANSWER_S: Final = 5.0


class Ros2Node:
    """Topics and services of this process in a DDS domain; make one with `ros2_node`."""

    def __init__(self, participant: Any) -> None:
        """Take the participant of a domain."""
        self._participant = participant
        self._types = {topic: _class(name) for topic, name in RosVersion.ROS_2.topics().items()}
        self._writers: dict[str, Any] = {}
        self._ended = Event()
        self._threads: list[Thread] = []

    def advertise(self) -> None:
        """Announce all topics."""
        for topic, type_ in self._types.items():
            self._writers[topic] = self._writer(f"rt/{topic}", type_)

    def publish(self, message: TopicMessage, time_ns: int) -> None:
        """Publish a message of a topic that `advertise` announced."""
        header, time = _class("std_msgs/msg/Header"), _class("builtin_interfaces/msg/Time")
        stamp = time(sec=time_ns // 10**9, nanosec=time_ns % 10**9)
        made = self._types[message.topic](header=header(stamp=stamp, frame_id=message.frame), **message.plain_fields())
        self._writers[message.topic].write(made)

    def serve_resets(self, reset: Callable[[Finger], None]) -> None:
        """Offer the service that starts a tracker again, for each side."""
        for side, name in RESET_SERVICES.items():
            writer = self._writer(f"rr/{name}Reply", _reset_answer())
            self._read(f"rq/{name}Request", _reset_request(), partial(_answer_reset, reset, side, writer))

    def call_reset(self, side: Finger) -> bool:
        """Start the tracker of a side again, wherever it runs; return what it answers.

        Raises:
            TimeoutError: nobody offers the service, or it does not answer.
        """
        caller, answers, answered = randbits(63), list[bool](), Event()

        def receive(answer: Any) -> None:
            if answer.caller == caller:
                answers.append(answer.success)
                answered.set()

        self._read(f"rr/{RESET_SERVICES[side]}Reply", _reset_answer(), receive)
        requests = self._writer(f"rq/{RESET_SERVICES[side]}Request", _reset_request())
        for _ in range(int(_ANSWER_S / _WAIT_S)):  # until the service and this process have found each other
            requests.write(_reset_request()(caller=caller, number=1, flag=True))
            if answered.wait(_WAIT_S):
                return answers[0]
        raise TimeoutError(
            f"Expected an answer of the service {RESET_SERVICES[side]} within {_ANSWER_S:g} s, got none."
        )

    def listen(self, receive: Callable[[str, dict[str, Any]], None]) -> None:
        """Call a function in threads of this node with topic and fields of each message that arrives."""
        for topic, type_ in self._types.items():
            self._read(f"rt/{topic}", type_, partial(_deliver, receive, topic))

    def close(self) -> None:
        """End the threads that listen."""
        self._ended.set()
        for thread in self._threads:
            thread.join()

    def _writer(self, name: str, type_: Any) -> Any:
        from cyclonedds.pub import DataWriter

        return DataWriter(self._participant, self._topic(name, type_), qos=_quality())

    def _read(self, name: str, type_: Any, receive: Callable[[Any], None]) -> None:
        from cyclonedds.sub import DataReader

        reader = DataReader(self._participant, self._topic(name, type_), qos=_quality())

        def read() -> None:
            while not self._ended.is_set():
                for sample in reader.take_iter(timeout=int(_WAIT_S * 1e9)):
                    receive(sample)
                    if self._ended.is_set():  # the iterator does not end as long as samples come in
                        return

        self._threads.append(Thread(target=read, daemon=True))
        self._threads[-1].start()

    def _topic(self, name: str, type_: Any) -> Any:
        from cyclonedds.topic import Topic

        return Topic(self._participant, name, type_)


@contextmanager
def ros2_node() -> Iterator[Ros2Node]:
    """Join the DDS domain ROS_DOMAIN_ID, by default 0.

    Raises:
        RosMissing: Cyclone DDS is not installed.
    """
    try:
        from cyclonedds.domain import DomainParticipant
    except ImportError as error:
        raise RosMissing(explain_missing("cyclonedds", "station", "ROS 2")) from error
    node = Ros2Node(DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0"))))
    try:
        yield node
    finally:
        node.close()


@cache
def _class(name: str) -> Any:
    """Return Cyclone's class of a type, such as std_msgs/msg/Header."""
    from cyclonedds.idl import make_idl_struct

    _, fields = RosVersion.ROS_2.types().fielddefs[name]
    package, kind, short = name.split("/")
    own = f"{package}::{kind}::dds_::{short}_"
    return make_idl_struct(f"{short}_", own, {name: _field_type(type_) for name, type_ in fields})


def _field_type(description: Any) -> Any:
    """Return Cyclone's type of a field, from the description that `rosbags` makes of it."""
    from rosbags.interfaces import Nodetype

    types: Any = import_module("cyclonedds.idl.types")
    kind, of = description
    if kind is Nodetype.NAME:
        return _class(of)
    if kind is Nodetype.SEQUENCE:
        return types.sequence[_field_type(of[0])]
    return {"bool": bool, "string": str}.get(of[0]) or getattr(types, of[0])


@cache
def _reset_request() -> Any:
    return _reset_class("Request", "flag")


@cache
def _reset_answer() -> Any:
    return _reset_class("Response", "success")


def _reset_class(kind: str, field: str) -> Any:
    from cyclonedds.idl import make_idl_struct, types

    name = f"ResetMarkerTracker_{kind}_"
    return make_idl_struct(
        name, f"{PACKAGE}::srv::dds_::{name}", {"caller": types.uint64, "number": types.int64, field: bool}
    )


def _answer_reset(reset: Callable[[Finger], None], side: Finger, writer: Any, request: Any) -> None:
    reset(side)
    writer.write(_reset_answer()(caller=request.caller, number=request.number, success=True))


def _deliver(receive: Callable[[str, dict[str, Any]], None], topic: str, message: Any) -> None:
    names = (field.name for field in dataclasses.fields(message) if field.name != "header")
    receive(topic, {name: getattr(message, name) for name in names})


def _quality() -> Any:
    """Return what ROS 2 asks of a topic by default, in the representation that it writes."""
    from cyclonedds.qos import Policy, Qos

    return Qos(
        Policy.Reliability.Reliable(max_blocking_time=int(_WAIT_S * 1e9)),
        Policy.Durability.Volatile,
        Policy.History.KeepLast(QUEUE),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )
