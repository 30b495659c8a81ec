"""Examples of one policy: what their manifests say."""

from pathlib import Path

import pytest
from vitac.evaluator.submission.manifest import load_manifest


@pytest.mark.parametrize(
    ("example", "track", "task"),
    [
        ("assembly_scripted", "assembly", "assembly"),
        ("cable_end_scripted", "cable_end", "cable-end"),
        ("explore_scripted", "explore", "explore"),
        ("in_hand_turn_scripted", "in_hand_turn", "in-hand-turn"),
        ("lock_opening_heuristic", "track_1", "lock-opening"),
        ("peg_insertion_heuristic", "track_1", "peg-insertion"),
        ("slip_scripted", "slip", "slip"),
        ("soft_plug_scripted", "soft_plug", "soft-plug"),
    ],
)
def test_is_a_valid_submission(repository: Path, example: str, track: str, task: str) -> None:
    [file] = (repository / "examples" / example).glob("*/submission.yaml")
    manifest = load_manifest(file.parent)
    assert (manifest.track, manifest.tasks, manifest.entry_point) == (track, (task,), "policy:Policy")
