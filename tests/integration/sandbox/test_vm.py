"""Policies under isolation `vm`: each episode has a kernel of its own, and ends with the same verdicts as elsewhere."""

import textwrap
from pathlib import Path

import numpy as np
import pytest
from submissions import submission_folder
from vitac.evaluator.agent.isolation import cgroup, gvisor
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.agent.self_test import PROBES, is_safe, run
from vitac.evaluator.agent.session import ISOLATION_VARIABLE, PolicySession
from vitac.evaluator.agent.verdicts import PolicyFailed, SandboxFailed, VerdictCode
from vitac.evaluator.isolation_kinds import IsolationKind

pytestmark = pytest.mark.slow  # each episode starts a kernel and loads its policy
OBSERVATION = {"x": np.zeros(1, dtype=np.float32)}
TRIED = ("network out of reach", "files hidden", "room for files tells nothing", "episodes share nothing")


@pytest.fixture
def vm(monkeypatch: pytest.MonkeyPatch) -> None:
    """The setting of a worker; a machine without gVisor or control groups says so."""
    monkeypatch.setenv(ISOLATION_VARIABLE, "vm")
    try:
        gvisor.find_program()
    except SandboxFailed as error:
        pytest.skip(str(error))
    group = cgroup.create(Limits())
    if group is None:
        pytest.skip("isolation vm needs control groups, which this user may not make")
    group.remove()


def policy(tmp_path: Path, act: str) -> Path:
    """A submission out of the body of `act`."""
    body = textwrap.indent(act, " " * 8)
    code = f"import os\n\nclass Policy:\n    def reset(self, task):\n        pass\n    def act(self, seen):\n{body}"
    return submission_folder(tmp_path / "Track_1", {"policy.py": code})


@pytest.mark.usefixtures("vm")
def test_what_a_kernel_of_ones_own_must_hold_holds() -> None:
    outcomes = list(run(tuple(probe for probe in PROBES if probe.name in TRIED)))
    assert [outcome.name for outcome in outcomes] == list(TRIED)
    assert is_safe(outcomes), outcomes
    assert {outcome.isolation.kind for outcome in outcomes if outcome.isolation} == {IsolationKind.VM}


@pytest.mark.usefixtures("vm")
def test_an_own_kernel_counts_from_the_beginning_in_each_episode_and_knows_nothing_of_the_machine(
    tmp_path: Path,
) -> None:
    act = """
import os, time
number = os.pipe()
numbers = [os.getpid(), os.fstat(number[0]).st_ino, float(open("/proc/loadavg").read().split()[0])]
return [*numbers, time.clock_gettime(time.CLOCK_BOOTTIME) < 30]"""
    with PolicySession(policy(tmp_path, act)) as session:
        answers = []
        for _ in range(2):
            with session.episode(task="task", action_shape=(4,)) as episode:
                answers.append(episode.act(OBSERVATION).tolist())
    assert answers[0] == answers[1]
    assert answers[0][3] == 1


@pytest.mark.usefixtures("vm")
@pytest.mark.parametrize(
    ("act", "verdict", "part"),
    [
        ("os._exit(3)", VerdictCode.CRASHED, "exit code 3"),
        ("raise ValueError", VerdictCode.CRASHED, "ValueError"),
        ("os.kill(os.getpid(), 9)", VerdictCode.CRASHED, "signal 9"),
        ("os.kill(1, 9)\nimport time\ntime.sleep(9)", VerdictCode.CRASHED, "process ended"),
        ("kept = [b'x' * (1 << 20) for _ in iter(int, 1)]", VerdictCode.OUT_OF_MEMORY, "memory"),
    ],
)
def test_verdicts_are_those_of_namespaces(tmp_path: Path, act: str, verdict: VerdictCode, part: str) -> None:
    limits = Limits(memory_bytes=256 << 20, action_cpu_s=20.0, action_wall_s=30.0)
    with PolicySession(policy(tmp_path, act), limits=limits) as session:
        with pytest.raises(PolicyFailed, match=part) as caught, session.episode(task="t", action_shape=(3,)) as episode:
            episode.act(OBSERVATION)
        assert caught.value.verdict is verdict


def test_a_machine_without_gvisor_is_told_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(gvisor.PROGRAM_VARIABLE, "no-such-program")
    folder = policy(tmp_path, "return [0]")
    with pytest.raises(SandboxFailed, match="needs the program no-such-program"):
        PolicySession(folder, kind=IsolationKind.VM).__enter__()
    monkeypatch.setenv(ISOLATION_VARIABLE, "glass")
    with pytest.raises(SandboxFailed, match="Expected VITAC_ISOLATION to be namespaces or vm or none, got 'glass'"):
        PolicySession(folder)
