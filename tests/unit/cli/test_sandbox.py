import json

import pytest
from page_fixtures import a_sandbox
from vitac.cli.main import main
from vitac.cli.sandbox import facts
from vitac.evaluator.agent import description

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


def test_a_cpu_without_vector_extensions_is_told() -> None:
    assert ("CPU", "x86_64 with no vector extensions") in facts(a_sandbox(simd=()))
