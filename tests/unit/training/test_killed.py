"""A run whose process is killed, which cannot tidy up."""

import os
import signal
import time
from multiprocessing import get_context
from pathlib import Path

import pytest
from toy_peg import ToyPeg
from vitac.training.recipe import AssessorRecipe, CriticRecipe, Recipe, StudentRecipe
from vitac.training.run import Folder, Run

LIMIT_S = 60
RECIPE = Recipe(
    task="peg-insertion",
    seed=4,
    random_episodes=60,
    guided_episodes=60,
    rounds=1,
    chosen_by=5,
    critic=CriticRecipe(networks=1, hidden=8, sweeps=1, epochs=1),
    assessor=AssessorRecipe(networks=1, hidden=8, sweeps=1, epochs=1),
    student=StudentRecipe(networks=1, hidden=8, epochs=1),
)


def go(folder: Path) -> None:
    Run(recipe=RECIPE, folder=Folder(path=folder)).go()


def go_and_hang(folder: Path, files: int) -> None:
    """Run, and stop for ever in the middle of an episode once so many files are there."""
    reset = ToyPeg.reset

    def hanging(env: ToyPeg, **options: object) -> object:
        if len(list(folder.rglob("*.npz"))) == files:
            (folder / "hangs").touch()
            time.sleep(10 * LIMIT_S)
        return reset(env, **options)  # type: ignore[arg-type]

    ToyPeg.reset = hanging  # type: ignore[method-assign, assignment]
    go(folder)


def kept(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("files", [0, 3])
def test_killed_run_goes_on_to_the_same_bits(tmp_path: Path, files: int) -> None:
    killed, whole = tmp_path / "killed", tmp_path / "whole"
    process = get_context("fork").Process(target=go_and_hang, args=(killed, files))
    process.start()
    deadline = time.monotonic() + LIMIT_S
    while not (killed / "hangs").exists():
        assert process.is_alive(), "the run ended before it was killed"
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert process.pid is not None
    os.kill(process.pid, signal.SIGKILL)
    process.join(LIMIT_S)
    (killed / "hangs").unlink()
    assert len([path for path in killed.rglob("*.npz") if path.parent.name == "episodes"]) == files
    go(killed)
    go(whole)
    assert kept(killed) == kept(whole)
