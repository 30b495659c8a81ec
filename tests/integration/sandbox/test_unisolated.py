"""One's own policy without a sandbox, where a machine has none: the same verdicts and the same result."""

import textwrap
from pathlib import Path

import numpy as np
import pytest
from submissions import submission_folder
from vitac.cli.terminal.own_policy import fall_back_where_nothing_isolates
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.agent.self_test import run
from vitac.evaluator.agent.session import ISOLATION_VARIABLE, PolicySession
from vitac.evaluator.agent.verdicts import PolicyFailed, SandboxFailed, VerdictCode
from vitac.evaluator.isolation_kinds import IsolationKind

OBSERVATION = {"x": np.zeros(1, dtype=np.float32)}


@pytest.fixture(autouse=True)
def _none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(ISOLATION_VARIABLE, "none")


def policy(tmp_path: Path, act: str) -> Path:
    """A submission out of the body of `act`."""
    body = textwrap.indent(act, " " * 8)
    code = "import os\n\nclass Policy:\n    count = 0\n    def reset(self, task): pass\n    def act(self, seen):\n"
    return submission_folder(tmp_path / "Track_1", {"policy.py": code + body})


def test_each_episode_has_a_process_of_its_own(tmp_path: Path) -> None:
    folder = policy(tmp_path, "Policy.count += 1\nreturn [Policy.count, 0, 0]")
    with PolicySession(folder) as session:
        for _ in range(2):
            with session.episode(task="task", action_shape=(3,)) as episode:
                assert episode.act(OBSERVATION).tolist() == [1, 0, 0]
        assert session.isolation.kind is IsolationKind.NONE


@pytest.mark.parametrize(
    ("act", "verdict", "part"),
    [
        ("os._exit(3)", VerdictCode.CRASHED, "exit code 3"),
        ("raise ValueError", VerdictCode.CRASHED, "ValueError"),
        ("os.kill(os.getpid(), 9)", VerdictCode.CRASHED, "signal 9"),
        ("while True: pass", VerdictCode.CPU_TIME, "More than 0.5 s of CPU time"),
        ("while True: print('x' * 4096)", VerdictCode.OUTPUT_FLOOD, "printed"),
    ],
)
def test_verdicts_are_those_of_the_sandbox(tmp_path: Path, act: str, verdict: VerdictCode, part: str) -> None:
    with PolicySession(policy(tmp_path, act), limits=Limits(action_cpu_s=0.5)) as session:
        with pytest.raises(PolicyFailed, match=part) as caught, session.episode(task="t", action_shape=(3,)) as episode:
            episode.act(OBSERVATION)
        assert caught.value.verdict is verdict


def test_a_command_says_why_it_goes_on_without_a_sandbox(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv(ISOLATION_VARIABLE)
    fall_back_where_nothing_isolates()
    assert capsys.readouterr().err == ""
    monkeypatch.setenv("VITAC_BWRAP", "/bin/false")
    fall_back_where_nothing_isolates()
    said = capsys.readouterr().err
    assert said.startswith("Your policy runs without the sandbox, with the same result")
    assert "bubblewrap says: exit code 1" in said


def test_what_others_send_never_runs_so() -> None:
    with pytest.raises(SandboxFailed, match="VITAC_ISOLATION is none, with which nothing keeps a policy"):
        next(run())
