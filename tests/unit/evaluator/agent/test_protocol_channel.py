import json
import os
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from vitac.evaluator.agent.protocol import (
    AnswerKind,
    Channel,
    ChannelClosed,
    PolicyAnswer,
    PolicyQuestion,
    QuestionKind,
)
from vitac.evaluator.agent.verdicts import PolicyFailed, VerdictCode


@pytest.fixture
def ends() -> Iterator[tuple[Channel, socket.socket]]:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        yield Channel(ours, message_bytes=1 << 20), theirs


def frame(seq: int, kind: str = "ready", **more: object) -> bytes:
    header = json.dumps({"seq": seq, "kind": kind, **more}).encode()
    return struct.pack("<4sIQ", b"VTC1", len(header), 0) + header


def open_descriptors() -> set[str]:
    return {entry.name for entry in Path("/proc/self/fd").iterdir()}


def receive(channel: Channel) -> PolicyAnswer:
    answer = channel.receive([AnswerKind.READY, AnswerKind.FAILED])
    assert answer is not None
    return answer


def test_question_and_answer(ends: tuple[Channel, socket.socket]) -> None:
    channel, theirs = ends
    channel.ask(PolicyQuestion(kind=QuestionKind.RESET, text="peg-insertion"))
    assert b"peg-insertion" in theirs.recv(1000)
    assert channel.receive([AnswerKind.READY]) is None
    theirs.sendall(frame(1))
    assert receive(channel).sender_pid == os.getpid()


def test_answer_to_an_earlier_question_is_a_violation(ends: tuple[Channel, socket.socket]) -> None:
    channel, theirs = ends
    for seq in (1, 2):
        channel.ask(PolicyQuestion(kind=QuestionKind.RESET))
        theirs.sendall(frame(1))
        if seq == 1:
            receive(channel)
    with pytest.raises(PolicyFailed, match="answer to question 2, got that to question 1"):
        receive(channel)


def test_unexpected_kind_is_a_violation(ends: tuple[Channel, socket.socket]) -> None:
    channel, theirs = ends
    channel.ask(PolicyQuestion(kind=QuestionKind.RESET))
    theirs.sendall(frame(1, "loaded"))
    with pytest.raises(PolicyFailed, match="Expected an answer ready or failed, got loaded"):
        receive(channel)


def test_second_answer_right_away_is_a_violation(ends: tuple[Channel, socket.socket]) -> None:
    channel, theirs = ends
    channel.ask(PolicyQuestion(kind=QuestionKind.RESET))
    theirs.sendall(frame(1) * 2)
    with pytest.raises(PolicyFailed) as caught:
        receive(channel)
    assert caught.value.verdict is VerdictCode.PROTOCOL_VIOLATION


def test_second_answer_later_is_a_violation(ends: tuple[Channel, socket.socket]) -> None:
    channel, theirs = ends
    channel.ask(PolicyQuestion(kind=QuestionKind.RESET))
    theirs.sendall(frame(1))
    receive(channel)
    theirs.sendall(frame(1))
    with pytest.raises(PolicyFailed, match="second answer"):
        channel.ask(PolicyQuestion(kind=QuestionKind.RESET))


def test_answer_before_the_question_is_read_is_a_violation(ends: tuple[Channel, socket.socket]) -> None:
    channel, theirs = ends
    channel.ask(PolicyQuestion(kind=QuestionKind.OBSERVE, arrays={"x": np.zeros(10_000_000, dtype=np.uint8)}))
    assert channel.has_unsent
    theirs.sendall(frame(1))
    with pytest.raises(PolicyFailed, match="before the policy had read"):
        receive(channel)


def test_large_question_is_sent_as_room_comes(ends: tuple[Channel, socket.socket]) -> None:
    channel, theirs = ends
    value = np.frombuffer(os.urandom(3_000_000), dtype=np.uint8)
    channel.ask(PolicyQuestion(kind=QuestionKind.OBSERVE, arrays={"x": value}))
    came = bytearray()
    while channel.has_unsent:
        came += theirs.recv(1 << 20)
        channel.send_more()
    theirs.setblocking(False)
    came += theirs.recv(1 << 22)
    assert came.endswith(value.tobytes())


def test_closed_far_end_is_told_apart(ends: tuple[Channel, socket.socket]) -> None:
    channel, theirs = ends
    theirs.close()
    channel.ask(PolicyQuestion(kind=QuestionKind.RESET))
    with pytest.raises(ChannelClosed):
        channel.receive([AnswerKind.READY])


def test_passed_descriptors_are_a_violation_and_not_kept(ends: tuple[Channel, socket.socket]) -> None:
    channel, theirs = ends
    channel.ask(PolicyQuestion(kind=QuestionKind.RESET))
    before = open_descriptors()
    with open("/dev/null") as file:  # noqa: PTH123
        socket.send_fds(theirs, [frame(1)], [file.fileno()] * 50)
    with pytest.raises(PolicyFailed, match="more than bytes"):
        channel.receive([AnswerKind.READY])
    assert open_descriptors() <= before


def test_starting_afresh_forgets_what_came(ends: tuple[Channel, socket.socket]) -> None:
    channel, theirs = ends
    channel.ask(PolicyQuestion(kind=QuestionKind.RESET))
    theirs.recv(1000)
    theirs.sendall(frame(1)[:9])
    assert channel.receive([AnswerKind.READY]) is None
    theirs.sendall(b"rest")
    channel.reset()
    channel.ask(PolicyQuestion(kind=QuestionKind.RESET))
    theirs.sendall(frame(1))
    assert receive(channel).header.seq == 1  # counted anew, so that numbers do not tell how many episodes there were


def test_knows_whether_a_question_was_read(ends: tuple[Channel, socket.socket]) -> None:
    channel, theirs = ends
    channel.ask(PolicyQuestion(kind=QuestionKind.RESET))
    assert channel.has_unread_question()
    theirs.recv(1000)
    assert not channel.has_unread_question()
