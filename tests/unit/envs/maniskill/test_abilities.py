"""What ManiSkill can do on a machine: asked of a stand-in for its process, and of the real one where it is there."""

import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
from vitac.envs.maniskill import abilities as module
from vitac.envs.maniskill.abilities import Abilities, abilities
from vitac.envs.maniskill.env import missing_packages


@pytest.fixture(autouse=True)
def asked_anew() -> Iterator[None]:
    abilities.cache_clear()
    yield
    abilities.cache_clear()


def answers(monkeypatch: pytest.MonkeyPatch, answer: str | Exception) -> list[list[str]]:
    """Let the process answer so; return the commands that started it."""
    commands: list[list[str]] = []

    def run(command: list[str], **_: Any) -> Any:
        commands.append(command)
        if isinstance(answer, Exception):
            raise answer
        return subprocess.CompletedProcess(command, 0, stdout=answer)

    monkeypatch.setattr(module, "missing_packages", tuple)
    monkeypatch.setattr(subprocess, "run", run)
    return commands


def test_without_the_packages_nothing_is_started(monkeypatch: pytest.MonkeyPatch) -> None:
    commands = answers(monkeypatch, "")
    monkeypatch.setattr(module, "missing_packages", lambda: ("torch",))
    assert abilities() == Abilities()
    assert commands == []


def test_one_process_is_asked_once_and_its_last_line_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    said = 'a library greets\n\n{"physics": true, "pictures": false, "cuda": true}'
    commands = answers(monkeypatch, said)
    assert [abilities(), abilities()] == 2 * [Abilities(physics=True, cuda=True)]
    assert commands == [[sys.executable, "-P", "-m", "vitac.envs.maniskill.abilities"]]


@pytest.mark.parametrize(
    "error", [subprocess.CalledProcessError(-11, "python"), subprocess.TimeoutExpired("python", 120.0)]
)
def test_packages_that_end_the_process_or_hang_can_do_nothing(
    monkeypatch: pytest.MonkeyPatch, error: subprocess.SubprocessError
) -> None:
    answers(monkeypatch, error)
    assert abilities() == Abilities()


@pytest.mark.parametrize("said", ["", "a library says good-bye", "[1]", '{"physics": true, "sound": true}'])
def test_a_process_that_says_something_else_can_do_nothing(monkeypatch: pytest.MonkeyPatch, said: str) -> None:
    answers(monkeypatch, said)
    assert abilities() == Abilities()


@pytest.mark.skipif(bool(missing_packages()), reason="the extra maniskill is not installed")
def test_the_real_packages_can_be_loaded() -> None:
    assert abilities().physics
