"""`vitac compile` plays every tactile task, and needs a folder that can be written to."""

from pathlib import Path
from typing import Any

import gymnasium
import pytest
from vitac.cli.main import main
from vitac.envs.tasks.registry import task_definitions


def exit_code() -> Any:
    with pytest.raises(SystemExit) as caught:
        main(["compile"])
    return caught.value.code


def test_every_tactile_task_is_played_and_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("VITAC_CACHE_DIR", str(tmp_path))
    calls: list[Any] = []

    class Played(gymnasium.Env[Any, Any]):
        action_space = gymnasium.spaces.Box(-1, 1, (2,))

        def reset(self, **options: Any) -> Any:
            calls.append("reset")

        def step(self, action: Any) -> Any:
            calls.append("step")

        def render(self) -> Any:
            calls.append("render")

    def make(env_id: str, **arguments: Any) -> Played:
        calls.append((env_id, arguments))
        return Played()

    monkeypatch.setattr(gymnasium, "make", make)
    assert exit_code() == 0
    arguments = {"privileged": True, "render_mode": "rgb_array"}
    assert calls == [call for name in task_definitions() for call in ((name, arguments), "reset", "step", "render")]
    assert f"in {tmp_path / 'kernels'}." in capsys.readouterr().out


def test_folder_that_cannot_be_written_is_refused_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("VITAC_CACHE_DIR", str(tmp_path / "file"))
    assert exit_code() == 1
    assert f"can be written to, got {tmp_path / 'file'}" in capsys.readouterr().err
