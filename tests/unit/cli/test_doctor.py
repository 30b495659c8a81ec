import json
from collections.abc import Iterator

import pytest
from vitac.cli.main import main
from vitac.evaluator.agent import self_test
from vitac.evaluator.agent.isolation import machine
from vitac.evaluator.agent.isolation.bubblewrap import UserIsolation
from vitac.evaluator.agent.isolation.cgroup import MemoryIsolation
from vitac.evaluator.agent.isolation.machine import Requirement
from vitac.evaluator.agent.isolation.memory_files import FileIsolation
from vitac.evaluator.agent.self_test import Outcome, ProbeState
from vitac.evaluator.agent.session import EpisodeIsolation, Isolation

LEVEL = Isolation(
    user=UserIsolation.ROOT,
    memory=MemoryIsolation.CGROUP_V2,
    episodes=EpisodeIsolation.FROZEN_COPY,
    files=FileIsolation.DISK,
    process_ids_repeat=True,
)


def requirement(*, is_met: bool, is_needed: bool = True) -> Requirement:
    remedy = "" if is_met else "install it."
    return Requirement(name="bubblewrap", found="some", remedy=remedy, is_needed=is_needed)


def doctor(monkeypatch: pytest.MonkeyPatch, found: Requirement, states: list[ProbeState], *options: str) -> int:
    def run() -> Iterator[Outcome]:
        for number, state in enumerate(states):
            yield Outcome(name=f"probe {number}", state=state, detail="told", isolation=LEVEL)

    monkeypatch.setattr(machine, "requirements", lambda: [found])
    monkeypatch.setattr(self_test, "run", run)
    with pytest.raises(SystemExit) as caught:
        main(["doctor", *options])
    return int(caught.value.code or 0)


def test_says_that_all_was_held(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert doctor(monkeypatch, requirement(is_met=True), [ProbeState.HELD] * 2) == 0
    out = capsys.readouterr().out
    assert "All 2 attacks were blocked (user: root, memory: cgroup-v2, episodes: frozen-copy, files: disk)." in out


def test_an_escape_is_exit_code_1(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert doctor(monkeypatch, requirement(is_met=True), [ProbeState.HELD, ProbeState.ESCAPED]) == 1
    assert "NOT SAFE: probe 1." in capsys.readouterr().out


def test_nothing_is_tried_where_something_is_missing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert doctor(monkeypatch, requirement(is_met=False), [ProbeState.HELD]) == 1
    out = capsys.readouterr().out
    assert "bubblewrap: install it.\n" in out
    assert "No attack was run" in out
    assert "probe 0" not in out


def test_what_is_not_needed_is_no_obstacle(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert doctor(monkeypatch, requirement(is_met=False, is_needed=False), [ProbeState.HELD]) == 0
    assert "note" in capsys.readouterr().out


@pytest.mark.parametrize(("state", "code"), [(ProbeState.HELD, 0), (ProbeState.FAILED, 1)])
def test_json_says_the_same(
    state: ProbeState, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert doctor(monkeypatch, requirement(is_met=True), [state], "--json") == code
    content = json.loads(capsys.readouterr().out)
    assert content["safe"] is (code == 0)
    assert content["probes"][0]["state"] == state
    assert content["machine"][0]["name"] == "bubblewrap"
