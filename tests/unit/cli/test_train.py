"""`vitac train`."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from toy_lock import ToyLock
from toy_peg import ToyPeg
from typer.testing import CliRunner
from vitac.cli.main import build_app
from vitac.evaluator.strict_model import DocumentRejected
from vitac.evaluator.submission.manifest import load_manifest
from vitac.training.cloning import method
from vitac.training.demonstrations import expert

RECIPE = """task: peg-insertion
seed: 1
random_episodes: 20
guided_episodes: 20
rounds: 1
chosen_by: 10
critic: {networks: 1, hidden: 8, sweeps: 1, epochs: 1}
student: {networks: 1, hidden: 8, epochs: 1}
"""


@pytest.fixture(autouse=True)
def toy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vitac.training.collection.make_environment", lambda **_: ToyPeg())
    monkeypatch.setattr("vitac.training.collection._ENVIRONMENTS", {})
    monkeypatch.setattr("vitac.training.search.method.lock_environment", ToyLock)
    # The command sets them for the whole process, which here is that of all tests.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.setenv(name, "1")


@pytest.fixture
def recipe(tmp_path: Path) -> str:
    path = tmp_path / "recipe.yaml"
    path.write_text(RECIPE)
    return str(path)


def vitac(*words: str) -> Any:
    return CliRunner().invoke(build_app(words), list(words))


def test_trains_and_exports(recipe: str, tmp_path: Path) -> None:
    trained = vitac("train", recipe, "--out", str(tmp_path / "run"), "--json")
    assert trained.exit_code == 0, trained.output
    assert json.loads(trained.stdout)["best"] == 1
    exported = vitac("train", "export", str(tmp_path / "run"), "--to", str(tmp_path / "submission"))
    assert exported.exit_code == 0, exported.output
    assert load_manifest(tmp_path / "submission" / "Track_1").tasks == ("peg-insertion",)


def test_verb_may_be_written_out(recipe: str, tmp_path: Path) -> None:
    told = vitac("train", "run", recipe, "--out", str(tmp_path / "run")).stdout
    assert f"vitac train export {tmp_path / 'run'} --to FOLDER" in told


def test_collects_only(recipe: str, tmp_path: Path) -> None:
    collected = vitac("train", "collect", recipe, "--out", str(tmp_path / "run"))
    assert collected.exit_code == 0, collected.output
    assert collected.stdout.split() == ["episodes", "40"]
    assert not (tmp_path / "run" / "log.jsonl").exists()
    assert len(list((tmp_path / "run" / "episodes").glob("*.npz"))) == 2


@pytest.mark.parametrize(
    ("verb", "work"),
    [("run", "run.Run.go"), ("collect", "run.Run.collect_first"), ("search", "search.method.WeightSearch.go")],
)
def test_stopping_says_how_to_go_on(
    recipe: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verb: str, work: str
) -> None:
    def stopped(_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(f"vitac.training.{work}", stopped)
    if verb == "search":
        Path(recipe).write_text("task: lock-opening\nseed: 1\n")
    found = vitac("train", verb, recipe, "--out", str(tmp_path / "run"))
    assert found.exit_code == 130
    assert f"stopped; run the same command to continue from {tmp_path / 'run'}" in found.stderr
    assert found.stdout == ""


def test_searches_and_writes_a_submission(tmp_path: Path) -> None:
    recipe, out = tmp_path / "search.yaml", tmp_path / "run"
    recipe.write_text(
        "task: lock-opening\nseed: 4\ngenerations: 2\ncandidates: 24\nkept: 3\nepisodes: 3\nchosen_by: 3\n"
    )
    words = ("train", "search", str(recipe), "--out", str(out))
    searched = vitac(*words)
    assert searched.exit_code == 0, searched.output
    assert str(out / "submission") in searched.stdout
    assert load_manifest(out / "submission" / "Track_1").tasks == ("lock-opening",)
    again = json.loads(vitac(*words, "--json").stdout)
    assert set(again["generations"]) == {"generation 1", "generation 2"}
    assert f"generation {again['best']}" in searched.stdout


def test_clones_and_shows_the_curves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(expert, "make_environment", lambda _, observation_keys, settings: ToyPeg(observation_keys))
    monkeypatch.setattr(expert, "held_pose_mm_deg", lambda grasped: grasped)
    quick = partial(method.ClonePlan, hidden=8, gradient_steps=20, chosen_by=5, reported=20)
    monkeypatch.setattr(method, "ClonePlan", quick)
    out = tmp_path / "run"
    words = ("train", "clone", "peg-insertion", "--out", str(out), "--rounds", "1", "--episodes", "25")
    cloned = vitac(*words)
    assert cloned.exit_code == 0, cloned.output
    assert "gain by sensing" in cloned.stdout
    gain = json.loads(vitac(*words, "--json").stdout)
    assert gain == json.loads((out / "gain.json").read_text())
    shown = vitac("train", "curves", str(out))
    assert "| `train clone, blind` | 1 |" in shown.stdout
    stored = vitac("train", "curves", str(out), "--to", str(tmp_path / "curves"))
    assert stored.stdout.strip() == str(tmp_path / "curves" / "README.md")
    assert (tmp_path / "curves" / "README.md").read_text().strip() == shown.stdout.strip()
    assert (tmp_path / "curves" / "peg-insertion.svg").exists()
    again = vitac("train", "curves", str(tmp_path / "curves" / "curves.json"))
    assert again.stdout == shown.stdout


@pytest.mark.parametrize(
    ("verb", "task", "right"),
    [
        ("search", "peg-insertion", "vitac train"),
        ("run", "lock-opening", "vitac train search"),
        ("collect", "lock-opening", "vitac train search"),
    ],
)
def test_recipe_of_the_other_method_is_refused_and_the_right_verb_named(
    recipe: str, tmp_path: Path, verb: str, task: str, right: str
) -> None:
    Path(recipe).write_text(f"task: {task}\nseed: 1\n")
    found = vitac("train", verb, recipe, "--out", str(tmp_path / "run"))
    assert isinstance(found.exception, DocumentRejected)
    assert str(found.exception).endswith(f"run `{right}` with this recipe.")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("words", [["nowhere.yaml", "--out", "run"], ["export", "nowhere", "--to", "there"]])
def test_what_is_not_there_is_a_usage_error(words: list[str]) -> None:
    found = vitac("train", *words)
    assert found.exit_code == 2
    assert "does not exist" in found.stderr
