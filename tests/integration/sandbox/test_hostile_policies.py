"""Every policy in `policies/` meets the verdict that its header expects, on this machine's own isolation.

Headers: `# expect:` a verdict, or `harmless` where every action must be zero in every episode; `# where:` load or
episode; `# limits:` smaller limits, so that the test is quick. Where there is no sandbox, these tests fail; they never
skip.
"""

import os
import re
from dataclasses import dataclass
from glob import glob
from pathlib import Path

import numpy as np
import pytest
from submissions import submission_folder
from vitac.evaluator.agent.isolation import tracing
from vitac.evaluator.agent.isolation.cgroup import MemoryIsolation
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.agent.session import PolicySession
from vitac.evaluator.agent.verdicts import PolicyFailed, VerdictCode

POLICIES = sorted((Path(__file__).parent / "policies").glob("*.py"))
TOOLS = Path(__file__).parent / "policies" / "tools" / "channel_tools.py"
OBSERVATION = {
    "marker_flow": np.zeros((2, 2, 128, 2), dtype=np.float32),
    "relative_motion": np.zeros(4, dtype=np.float32),
}
EPISODES = 3
ACTIONS = 3


@dataclass(frozen=True, kw_only=True)
class Header:
    expect: str
    where: str
    limits: Limits


def header_of(path: Path) -> Header:
    fields = dict(re.findall(r"^# (\w+): (.+)$", path.read_text(), re.MULTILINE))
    limits = dict(pair.split("=") for pair in fields.get("limits", "").split())
    numbers = {name: float(value) if "." in value else int(value) for name, value in limits.items()}
    return Header(expect=fields["expect"], where=fields["where"], limits=Limits(**numbers))  # type: ignore[arg-type]


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """A submission's folder in a place that every user can reach."""
    return submission_folder(tmp_path / "Track_1")


def play(session: PolicySession) -> list[list[float]]:
    with session.episode(task="peg-insertion", action_shape=(3,)) as policy:
        return [policy.act(OBSERVATION).tolist() for _ in range(ACTIONS)]


def verdict_of(session: PolicySession) -> PolicyFailed:
    with pytest.raises(PolicyFailed) as caught:
        play(session)
    return caught.value


def left_behind() -> list[str]:
    # Path.glob would fail where the control group of another test process vanishes meanwhile.
    found = glob(f"/sys/fs/cgroup/**/vitac-{os.getpid()}-*", recursive=True)  # noqa: PTH207
    return [path for path in found if Path(path).is_dir()]


@pytest.mark.slow
@pytest.mark.parametrize("path", POLICIES, ids=lambda path: path.stem)
def test_policy_meets_its_verdict(path: Path, outside: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracing, "_FREEZE_DEADLINE_S", 5.0)  # one of them never gets ready to be copied
    header = header_of(path)
    (outside / "policy.py").write_text(path.read_text())
    (outside / TOOLS.name).write_text(TOOLS.read_text())
    if header.where == "load":
        with pytest.raises(PolicyFailed) as caught, PolicySession(outside, limits=header.limits):
            pass
        check_failure(caught.value, header.expect)
    else:
        with PolicySession(outside, limits=header.limits) as session:
            if "process_ids" in path.stem and not session.isolation.process_ids_repeat:
                pytest.skip("this machine cannot repeat process ids (/proc/sys is read-only); the result says so")
            if "of_sockets" in path.stem and session.isolation.memory is MemoryIsolation.WATCHDOG:
                pytest.skip("only a control group counts the memory of sockets; the result and its page say so")
            check_episodes(session, header.expect)
    assert left_behind() == []


def check_episodes(session: PolicySession, expect: str) -> None:
    if expect == "harmless":
        zeros = [[0.0, 0.0, 0.0]] * ACTIONS
        assert [play(session) for _ in range(EPISODES)] == [zeros] * EPISODES
        return
    check_failure(verdict_of(session), expect)
    check_failure(verdict_of(session), expect)  # an episode's verdict does not depend on the one before it


def check_failure(failure: PolicyFailed, expect: str) -> None:
    assert failure.verdict == VerdictCode(expect), f"{failure}\n{failure.output_tail}"
    assert failure.message
    assert len(failure.message) < 5000
    assert len(failure.output_tail.encode()) <= 3 * Limits().output_kept_bytes
    assert all(char.isprintable() or char in "\n\t" for char in failure.message + failure.output_tail)
