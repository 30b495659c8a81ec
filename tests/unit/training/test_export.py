"""A run becomes a submission."""

from pathlib import Path
from runpy import run_path

import numpy as np
import pytest
from toy_peg import ToyPeg
from vitac.evaluator.scoring.score import rate
from vitac.evaluator.submission.manifest import load_manifest
from vitac.training.export import NotExportable, export
from vitac.training.files import save
from vitac.training.learning.student import Student, StudentPlan
from vitac.training.run import Folder, RoundResult
from vitac.training.submission.policy import HISTORY_SIZE

CHOSEN = RoundResult(number=3, student=rate(7, 10), critic=rate(9, 10), env_steps=100)

HIDDEN = 16
BELIEF = np.zeros((HISTORY_SIZE + 2 * HIDDEN + 1, 3), dtype=np.float32)
BELIEF[-1] = 1.5, -0.5, 8.0


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    made = Folder(path=tmp_path / "run")
    student = Student(StudentPlan(networks=2, hidden=HIDDEN), np.random.default_rng(0))
    stored = {f"student.{name}": value for name, value in student.state().items()}
    save(made.networks(3), {**stored, "belief": BELIEF, "critic.0.p.bias0": np.zeros(4, np.float32)})
    return made


def test_submission_is_one_that_the_evaluator_takes(folder: Folder, tmp_path: Path) -> None:
    destination = export(folder, CHOSEN, tmp_path / "submission")
    manifest = load_manifest(destination / "Track_1")
    assert manifest.tasks == ("peg-insertion",)
    assert manifest.observation_keys == ("marker_flow", "relative_motion")
    assert sorted(path.name for path in (destination / "Track_1").iterdir()) == [
        "policy.py",
        "submission.yaml",
        "weights.npz",
    ]


def test_exported_policy_plays(folder: Folder, tmp_path: Path) -> None:
    destination = export(folder, CHOSEN, tmp_path / "submission")
    policy = run_path(str(destination / "Track_1" / "policy.py"))["Policy"]()
    policy.reset("peg-insertion")
    observation, _ = ToyPeg().reset(options={"rng_seed": (1, 2)})
    action = policy.act(observation)
    assert action.shape == (3,)
    assert np.abs(action).max() <= 1.0
    assert not [name for name in policy.weights if "critic" in name]
    assert policy.belief().tolist() == [1.5, -0.5, 8.0]


def test_folder_that_is_there_is_kept(folder: Folder, tmp_path: Path) -> None:
    with pytest.raises(NotExportable, match="is there already; expected a new folder"):
        export(folder, CHOSEN, tmp_path)


def test_large_weights_are_refused(folder: Folder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vitac.training.export.LARGEST_BYTES", 100)
    with pytest.raises(NotExportable, match="expected at most 100; train a smaller student"):
        export(folder, CHOSEN, tmp_path / "submission")
    assert not (tmp_path / "submission").exists()
