"""`vitac_policy.py` by itself, where there is no NumPy; tests/integration/sandbox/test_images.py plays with it."""

import ast
import os
import runpy
import socket
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from images import POLICY_FILE
from vitac.evaluator.agent.protocol import AnswerKind, Channel, PolicyAnswer, PolicyQuestion, QuestionKind

Policy = type("Policy", (), {"act": lambda self, seen: [seen["pair"].tolist()[1][0], float(seen["flag"][0]), 0]})


def ask(policy: object, *questions: PolicyQuestion) -> list[PolicyAnswer]:
    """The answers of a policy that `serve` speaks for."""
    ours, theirs = socket.socketpair()
    serve = runpy.run_path(str(POLICY_FILE))["serve"]

    def play() -> None:
        with suppress(SystemExit):
            serve(policy, theirs.fileno())

    thread = threading.Thread(target=play)
    thread.start()
    channel = Channel(ours, message_bytes=1 << 20)
    answers = []
    for question in questions:
        channel.ask(question)
        while (answer := channel.receive(tuple(AnswerKind))) is None:
            pass
        answers.append(answer)
    ours.close()
    thread.join()
    theirs.close()
    return answers


@pytest.fixture(autouse=True)
def process(monkeypatch: pytest.MonkeyPatch) -> None:
    """What `serve` does to the process that it has for itself ends with the test."""
    monkeypatch.setattr(os, "pipe", os.pipe)
    monkeypatch.setattr(os, "_exit", sys.exit)


def test_without_numpy_arrays_are_memory_views_of_their_shape(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numpy", None)
    arrays: dict[str, Any] = {
        "pair": np.array([[1, 2], [0.5, 4]], np.float32),
        "flag": np.array([True]),
        "none": np.zeros((0, 3)),
    }
    loaded, ready, acted, believed = ask(
        Policy(),
        PolicyQuestion(kind=QuestionKind.LOAD),
        PolicyQuestion(kind=QuestionKind.RESET, text="task"),
        PolicyQuestion(kind=QuestionKind.OBSERVE, arrays=arrays),
        PolicyQuestion(kind=QuestionKind.BELIEVE),
    )
    assert [each.header.kind for each in (loaded, ready, acted, believed)] == ["loaded", "ready", "action", "belief"]
    assert acted.arrays["action"].tolist() == [0.5, 1.0, 0.0]
    assert believed.arrays == {}


def test_what_a_policy_raises_is_its_answer(capfd: pytest.CaptureFixture[str]) -> None:
    (failed,) = ask(Policy(), PolicyQuestion(kind=QuestionKind.OBSERVE))
    assert (failed.header.kind, failed.header.message) == ("failed", "KeyError: 'pair'")
    assert "Traceback" in capfd.readouterr().err


def test_is_written_for_python_3_6() -> None:
    ast.parse(Path(POLICY_FILE).read_text(), feature_version=(3, 6))
