from collections.abc import Iterable

import pytest
from page_fixtures import a_sandbox
from service_factories import ISOLATION
from vitac.evaluator.agent.self_test import PROBES, Outcome, Probe, ProbeState
from vitac.evaluator.package_sets import PackageSet, locked_versions
from vitac.worker.capabilities import SLOW_PROBES, probe_isolation


class FakeProbes:
    def __init__(self, states: dict[str, ProbeState]) -> None:
        self.states = states
        self.tried: list[str] = []

    def __call__(self, probes: tuple[Probe, ...]) -> Iterable[Outcome]:
        for probe in probes:
            self.tried.append(probe.name)
            state = self.states.get(probe.name, ProbeState.HELD)
            isolation = None if state is ProbeState.FAILED else ISOLATION
            yield Outcome(name=probe.name, state=state, detail="what came", isolation=isolation)


LOCKED = {name: versions[0] for name, versions in locked_versions([PackageSet.BASE]).items()}


@pytest.mark.slow
def test_machine_that_holds_every_probe_is_sound_and_its_level_is_named() -> None:
    probes = FakeProbes({})
    sandbox = a_sandbox(packages=LOCKED)
    report = probe_isolation(probes, lambda: sandbox)
    assert report.is_sound
    assert report.sandbox == sandbox
    assert report.level.startswith("user: root, memory: cgroup-v1")
    assert set(probes.tried) == {probe.name for probe in PROBES} - SLOW_PROBES


def test_slow_probes_are_probes() -> None:
    assert {probe.name for probe in PROBES} >= SLOW_PROBES


def test_one_escape_or_a_sandbox_that_does_not_start_makes_the_machine_unsound() -> None:
    for state in (ProbeState.ESCAPED, ProbeState.FAILED):
        report = probe_isolation(FakeProbes({"network out of reach": state}), pytest.fail)
        assert not report.is_sound
        assert report.sandbox is None
        assert report.problems == (f"network out of reach: {state} (what came)",)


def test_a_machine_with_other_packages_for_policies_is_refused_with_their_names() -> None:
    report = probe_isolation(FakeProbes({}), lambda: a_sandbox(packages=LOCKED | {"numpy": "2.5.0"}))
    assert report.problems == (
        "Policies would see other packages than the locked ones: numpy is 2.5.0, expected 2.4.6. Install the expected "
        "versions beside the worker.",
    )
    assert not report.is_sound


def test_this_machine_is_sound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VITAC_SANDBOX_FILES", "memory")
    report = probe_isolation()
    assert report.problems == ()
    assert report.sandbox is not None
    assert "numpy" in report.sandbox.packages
