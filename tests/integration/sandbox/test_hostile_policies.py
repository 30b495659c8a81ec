"""Every policy in `policies/` meets the verdict that it expects, on this machine's own isolation.

`acts.py` and `counting.py` hold many, each with `@expects`. Other files have headers: `# expect:` a verdict, or
`harmless` where every action must be zero in every episode; `# where:` load or episode; `# limits:` smaller limits, so
that the test is quick. Where there is no sandbox, these tests fail; they never skip.
"""

import os
import re
import runpy
from dataclasses import dataclass
from glob import glob
from pathlib import Path

import numpy as np
import pytest
from submissions import submission_folder
from vitac.evaluator.agent.isolation import tracing
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.agent.session import PolicySession
from vitac.evaluator.agent.verdicts import PolicyFailed, VerdictCode

FOLDER = Path(__file__).parent / "policies"
COLLECTIONS = ("acts", "counting")
TOOLS = FOLDER / "tools" / "channel_tools.py"
OBSERVATION = {
    "marker_flow": np.zeros((2, 2, 128, 2), dtype=np.float32),
    "relative_motion": np.zeros(4, dtype=np.float32),
}
EPISODES = 3
ACTIONS = 3


@dataclass(frozen=True, kw_only=True)
class Hostile:
    name: str
    source: str
    expect: str
    where: str
    limits: Limits


def in_a_file(path: Path) -> Hostile:
    text = path.read_text()
    fields = dict(re.findall(r"^# (\w+): (.+)$", text, re.MULTILINE))
    limits = dict(pair.split("=") for pair in fields.get("limits", "").split())
    numbers = {name: float(value) if "." in value else int(value) for name, value in limits.items()}
    smaller = Limits(**numbers)  # type: ignore[arg-type]
    return Hostile(name=path.stem, source=text, expect=fields["expect"], where=fields["where"], limits=smaller)


def in_a_collection(path: Path) -> list[Hostile]:
    text = path.read_text()
    found = [made for made in runpy.run_path(str(path)).values() if hasattr(made, "expected")]
    return [
        Hostile(
            name=policy.__name__,
            source=f"{text}\n\nPolicy = {policy.__name__}\n",
            expect=policy.expected["verdict"],
            where=policy.expected["where"],
            limits=Limits(**policy.expected["limits"]),
        )
        for policy in found
    ]


def all_policies() -> list[Hostile]:
    paths = sorted(FOLDER.glob("*.py"))
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(TOOLS.parent)
        return [
            policy
            for path in paths
            for policy in (in_a_collection(path) if path.stem in COLLECTIONS else [in_a_file(path)])
        ]


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


@pytest.mark.slow(minutes=3)
@pytest.mark.parametrize("hostile", all_policies(), ids=lambda hostile: hostile.name)
def test_policy_meets_its_verdict(hostile: Hostile, outside: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracing, "_FREEZE_DEADLINE_S", 5.0)  # one of them never gets ready to be copied
    (outside / "policy.py").write_text(hostile.source)
    (outside / TOOLS.name).write_text(TOOLS.read_text())
    if hostile.where == "load":
        with pytest.raises(PolicyFailed) as caught, PolicySession(outside, limits=hostile.limits):
            pass
        check_failure(caught.value, hostile.expect)
    else:
        with PolicySession(outside, limits=hostile.limits) as session:
            if "process_ids" in hostile.name and not session.isolation.process_ids_repeat:
                pytest.skip("this machine cannot repeat process ids (/proc/sys is read-only); the result says so")
            check_episodes(session, hostile.expect)
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
