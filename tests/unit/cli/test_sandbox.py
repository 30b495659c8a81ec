import json
import re
from pathlib import Path

import pytest
from page_fixtures import a_sandbox
from vitac.cli.main import main
from vitac.cli.sandbox import facts, markdown_lines
from vitac.evaluator.agent import description

ROOT = Path(__file__).parents[3]
ROW = re.compile(r"^\| (\S+) \| (\S+) \|$", re.MULTILINE)
FOUND = a_sandbox()


def printed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *options: str) -> str:
    monkeypatch.setattr(description, "describe_sandbox", lambda: FOUND)
    with pytest.raises(SystemExit) as caught:
        main(["sandbox", *options])
    assert caught.value.code == 0
    return capsys.readouterr().out


def test_prints_what_a_policy_finds(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    shown = printed(monkeypatch, capsys)
    for row in ("3.11.9", "x86_64 with X86_V2, X86_V3", "scipy-openblas 0.3.31", "OMP_NUM_THREADS", "2.14.0"):
        assert row in shown
    assert json.loads(printed(monkeypatch, capsys, "--json")) == json.loads(FOUND.model_dump_json())
    assert "| pydantic | 2.14.0 |" in printed(monkeypatch, capsys, "--markdown")


def test_a_cpu_without_vector_extensions_is_told() -> None:
    assert ("CPU", "x86_64 with no vector extensions") in facts(a_sandbox(simd=()))


def test_the_manual_lists_what_the_locks_install() -> None:
    manual = (ROOT / "docs" / "sandbox.md").read_text()
    listed = {
        name.lower().replace("_", "-"): version for name, version in ROW.findall(manual.partition("| package")[2])
    }
    lock = (ROOT / "requirements" / "base.lock").read_text()
    locked = dict(re.findall(r"^([\w.-]+)==(\S+)", lock, re.MULTILINE))
    packages = {
        name: version for name, version in listed.items() if name not in {"package", "pip"} and "-" not in version
    }
    assert {"numpy", "numba", "pydantic", "pyyaml"} <= packages.keys()
    assert packages == {name: locked.get(name) for name in packages}


def test_the_manual_has_the_tables_that_the_command_prints() -> None:
    manual = (ROOT / "docs" / "sandbox.md").read_text()
    for line in markdown_lines(FOUND):
        if line.startswith("| ") and "---" not in line:
            name = line.split(" | ")[0]
            assert f"\n{name} | " in manual
