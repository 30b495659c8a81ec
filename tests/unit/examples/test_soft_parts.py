"""The scene of soft parts that docs/environments.md shows: its IPC steps are solved and the block is pressed."""

import runpy
from pathlib import Path

import pytest


def test_block_is_held_and_pressed_on_the_pad(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = runpy.run_path(str(repository / "examples" / "soft_parts" / "press.py"))["scene"]
    assert scene.solved
    assert scene.grip_force_n() > 1.0
    assert scene.force_on_held_n(4)[2] > 0.1, "the pad pushes upwards"
    assert capsys.readouterr().out.startswith("True ")
