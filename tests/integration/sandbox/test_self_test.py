"""The self-test holds on this machine, and would tell if it did not."""

import ast
import os
import re
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

import pyseccomp  # type: ignore[import-untyped]
import pytest
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.agent.self_test import PROBES, Outcome, Probe, ProbeState, is_safe, make_policy, run
from vitac.evaluator.agent.verdicts import VerdictCode


@pytest.fixture(autouse=True)
def _as_workers_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VITAC_SANDBOX_FILES", "memory")


def outcome_of(probe: Probe) -> Outcome:
    (outcome,) = run((probe,))
    return outcome


def test_every_attempt_is_held() -> None:
    outcomes = list(run())
    assert [outcome.name for outcome in outcomes] == [probe.name for probe in PROBES]
    assert [outcome for outcome in outcomes if outcome.state is not ProbeState.HELD or outcome.isolation is None] == []


def test_attempts_call_by_the_numbers_of_the_architecture(monkeypatch: pytest.MonkeyPatch) -> None:
    """A number of x86-64 is another call on ARM64: an attempt would find every sandbox sound, or none."""
    monkeypatch.setattr(pyseccomp.Arch, "NATIVE", pyseccomp.Arch.AARCH64)
    code = make_policy(PROBES, Path("/canary"))
    numbers = ast.literal_eval(code.partition("CALLS = ")[2].partition("\n")[0])
    assert (numbers["ptrace"], numbers["socketpair"], numbers["setns"]) == (117, 199, 268)
    assert min(numbers.values()) >= 0, "libseccomp knows each"
    assert re.findall(r"allowed\(\s*\(\d", code) == []


@pytest.mark.parametrize(
    "probe",
    [
        Probe(name="reaches something", code="return 1"),
        Probe(name="is not ended", code="return 0", verdict=VerdictCode.OUT_OF_MEMORY),
        Probe(name="ends otherwise", code="raise ValueError", verdict=VerdictCode.CPU_TIME),
        Probe(name="ends though it should not", code="raise ValueError"),
    ],
    ids=lambda probe: probe.name,
)
def test_an_escape_is_told(probe: Probe) -> None:
    outcome = outcome_of(probe)
    assert outcome.state is ProbeState.ESCAPED
    assert not is_safe([outcome])


def test_probes_that_share_a_session_are_told_apart() -> None:
    probes = (
        Probe(name="ends though it should not", code="raise ValueError"),
        Probe(name="leaves a file", code='open("/tmp/left", "w").close()\nreturn 0'),
        Probe(name="finds the file of another", code='return int(os.path.exists("/tmp/left"))'),
        Probe(name="reaches something", code="return 1"),
        PROBES[0],
    )
    escaped, held = ProbeState.ESCAPED, ProbeState.HELD
    assert [(outcome.name, outcome.state) for outcome in run(probes)] == [
        (probe.name, state) for probe, state in zip(probes, (escaped, held, held, escaped, held), strict=True)
    ]


def test_a_sandbox_that_does_not_start_is_not_safe(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VITAC_BWRAP", "/none")
    outcome = outcome_of(PROBES[0])
    assert outcome.state is ProbeState.FAILED
    assert not is_safe([outcome])


def test_an_overloaded_machine_could_not_be_tested_and_is_not_safe() -> None:
    outcome = outcome_of(Probe(name="is late", code="time.sleep(60)", limits=Limits(action_wall_s=0.2)))
    assert outcome.state is ProbeState.FAILED
    assert not is_safe([outcome])


def test_probes_can_reach_what_is_open() -> None:
    """Without its isolation the memory probe would not end as expected: the probes look, they do not just agree."""
    memory = next(probe for probe in PROBES if probe.verdict is VerdictCode.OUT_OF_MEMORY)
    outcome = outcome_of(Probe(name=memory.name, code="return 0 * len([bytearray(1 << 20)])", limits=Limits()))
    assert outcome.state is ProbeState.HELD


def test_a_slow_machine_is_not_taken_for_an_escape() -> None:
    slowly = "end = time.process_time() + 0.7\nwhile time.process_time() < end:\n    pass\n"
    memory = next(probe for probe in PROBES if probe.verdict is VerdictCode.OUT_OF_MEMORY)
    outcome = outcome_of(replace(memory, code=slowly + memory.code))
    assert outcome.state is ProbeState.HELD, outcome.detail


def test_folders_of_killed_self_tests_are_removed_and_those_of_others_at_work_are_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with subprocess.Popen(["true"]) as ended:
        ended.wait()
    killed, living = (tmp_path / f"vitac-doctor-{pid}-x" for pid in (ended.pid, os.getppid()))
    (killed / "probe-0").mkdir(parents=True)
    living.mkdir()
    assert list(run(())) == []
    assert list(tmp_path.iterdir()) == [living]
