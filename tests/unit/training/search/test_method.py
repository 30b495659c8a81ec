"""The search: what it finds, what is kept when it is stopped, and that it ends with the same bits."""

import json
from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np
import pytest
from toy_lock import ToyLock
from vitac.evaluator.scoring.score import rate
from vitac.evaluator.submission.manifest import load_manifest
from vitac.training.files import NotSaved, load
from vitac.training.folder_lock import FolderInUse
from vitac.training.log import FOLDER, Charts
from vitac.training.run import Folder, OtherRun, read_results
from vitac.training.search import method, policy
from vitac.training.search.method import (
    FIRST_LIFT,
    FIRST_PULL,
    FIRST_SPREAD,
    LONGEST_ENV_STEPS,
    Ending,
    Generation,
    NothingSolved,
    SearchRecipe,
    WeightSearch,
    best,
    play,
)
from vitac.training.search.policy import ACTIONS, FEATURES
from vitac.training.streams import Use, stream

RECIPE = SearchRecipe(task="lock-opening", seed=4, generations=4, candidates=40, kept=6, episodes=6, chosen_by=8)
SMALL = RECIPE.model_copy(update={"generations": 3, "candidates": 24, "kept": 3, "episodes": 3, "chosen_by": 3})
LIFT = np.zeros((ACTIONS, FEATURES))
LIFT[1, 0] = -1.0
MIDDLE = np.zeros((ACTIONS, FEATURES))
MIDDLE[:, 0] = -FIRST_PULL, -FIRST_LIFT
PULL_THEN_LIFT = LIFT.copy()
PULL_THEN_LIFT[0, 3] = -0.5


def search(path: Path, recipe: SearchRecipe = RECIPE, **more: Any) -> WeightSearch:
    return WeightSearch(recipe=recipe, folder=Folder(path=path), make=ToyLock, **more)


def files(folder: Path) -> dict[str, bytes]:
    """All but the charts, which hold times, by name."""
    found = [path for path in folder.rglob("*") if path.is_file() and path.parent.name != FOLDER]
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


class Stopped(BaseException):
    """Like Ctrl-C or a kill: nobody in the search catches it."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    search(folder).go()
    return folder


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("small")
    search(folder, SMALL).go()
    return folder


@pytest.mark.slow
def test_learns_more_than_what_it_begins_with(whole: Path) -> None:
    rows = [json.loads(line) for line in (whole / "log.jsonl").read_text().splitlines()]
    assert [row["generation"] for row in rows] == [1, 2, 3, 4]
    assert rows[-1]["solved"]["successes"] >= 7
    starts = [(stream(RECIPE.seed, Use.REPORT), number) for number in range(40)]
    begun = [play(ToyLock(), MIDDLE, start) for start in starts]
    learned = [play(ToyLock(), load(whole / "round-004.npz")["mean"], start) for start in starts]
    assert sum(ending.solved for ending in begun) < 32
    assert sum(ending.solved for ending in learned) >= 36


def test_tells_how_long_is_left(small: Path, tmp_path: Path) -> None:
    lines: list[str] = []
    search(tmp_path, SMALL, tell=lines.append).go()
    assert [line.partition(":")[0] for line in lines] == [f"generation {number} of 3" for number in (1, 2, 3)]
    assert [line.endswith(", less than 1 min left") for line in lines] == [True, True, False]
    assert files(tmp_path) == files(small)


def test_first_candidates_pull_and_lift_more_or_less(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[np.ndarray] = []

    def worth(_: WeightSearch, candidates: np.ndarray, number: int) -> np.ndarray:
        drawn.append(candidates)
        return np.arange(len(candidates), 0.0, -1.0)

    monkeypatch.setattr(WeightSearch, "_worth", worth)
    search(tmp_path, RECIPE.model_copy(update={"generations": 2, "candidates": 400, "kept": 3})).go()
    np.testing.assert_allclose(drawn[0].mean(axis=0), MIDDLE, atol=0.1)
    np.testing.assert_allclose(drawn[0].std(axis=0), FIRST_SPREAD, atol=0.1)
    np.testing.assert_allclose(drawn[1].mean(axis=0), drawn[0][:3].mean(axis=0), atol=0.1)


def test_best_generation_becomes_a_submission(whole: Path) -> None:
    track = whole / "submission" / "Track_1"
    manifest = load_manifest(track)
    assert (manifest.tasks, manifest.observation_keys) == (("lock-opening",), ("marker_flow",))
    assert (track / "policy.py").read_bytes() == Path(str(policy.__file__)).read_bytes()
    made, env = run_path(str(track / "policy.py"))["Policy"](), ToyLock()
    endings = [play(env, made.weights, (stream(RECIPE.seed, Use.REPORT), number)) for number in range(20)]
    assert sum(ending.solved for ending in endings) >= 18


def test_several_processes_find_the_same(small: Path, tmp_path: Path) -> None:
    search(tmp_path, SMALL, processes=2).go()
    assert files(tmp_path) == files(small)


def test_second_search_in_the_same_folder_is_refused_until_the_submission_is_whole(
    small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    exported = method.export

    def try_too(*_: object) -> None:
        with pytest.raises(FolderInUse, match="wait for it, end it, or give another folder"):
            search(tmp_path, SMALL).go()

    def export(*arguments: Any) -> None:
        try_too()
        exported(*arguments)

    monkeypatch.setattr(method, "export", export)
    search(tmp_path, SMALL, tell=try_too).go()
    monkeypatch.undo()
    assert files(tmp_path) == files(small)
    assert len(search(tmp_path, SMALL).go()) == 3, "free again"


@pytest.mark.parametrize("stop_at", ["generation 1", "generation 2"])
def test_stopped_search_ends_with_the_same_bits(small: Path, tmp_path: Path, stop_at: str) -> None:
    def stop(line: str) -> None:
        if line.startswith(stop_at):
            raise Stopped

    with pytest.raises(Stopped):
        search(tmp_path, SMALL, tell=stop).go()
    assert not (tmp_path / "submission").exists()
    search(tmp_path, SMALL).go()
    assert files(tmp_path) == files(small)


def test_search_that_goes_on_judges_nothing_again_and_keeps_its_log(small: Path, tmp_path: Path) -> None:
    def stop(line: str) -> None:
        if line.startswith("generation 2"):
            raise Stopped

    env, heard = ToyLock(), []
    with pytest.raises(Stopped):
        WeightSearch(recipe=SMALL, folder=Folder(path=tmp_path), make=lambda: env, tell=stop).go()
    log = tmp_path / "log.jsonl"
    kept = log.read_bytes()
    assert len(kept.splitlines()) == 2

    def hear(_: str) -> None:
        heard.append(log.read_bytes())

    for _ in range(2):
        WeightSearch(recipe=SMALL, folder=Folder(path=tmp_path), make=lambda: env, tell=hear).go()
    whole = (small / "log.jsonl").read_bytes()
    assert heard == [kept, kept, *[whole] * 4]
    judged = [number for seed, number in env.resets if seed == stream(SMALL.seed, Use.CHOOSE)]
    assert judged == [*range(SMALL.chosen_by)] * SMALL.generations
    assert files(tmp_path) == files(small)


def test_generation_that_a_kill_left_out_of_the_log_is_charted_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    charted: list[int] = []

    def add_row(_: Charts, number: int, __: object) -> None:
        charted.append(number)
        if len(charted) == 2:
            raise Stopped

    monkeypatch.setattr(Charts, "add_row", add_row)
    with pytest.raises(Stopped):
        search(tmp_path, SMALL).go()
    search(tmp_path, SMALL).go()
    assert charted == [1, 2, 2, 3]


def test_log_of_a_search_is_no_runs(small: Path) -> None:
    with pytest.raises(OtherRun, match="that of a search, which writes its submission itself"):
        read_results(Folder(path=small))


def test_starts_that_choose_teach_nothing_and_none_is_reported(tmp_path: Path) -> None:
    env = ToyLock()
    WeightSearch(recipe=SMALL, folder=Folder(path=tmp_path), make=lambda: env).go()
    used = {use: [number for seed, number in env.resets if seed == stream(4, use)] for use in Use}
    assert len(set(used[Use.COLLECT])) == SMALL.generations * SMALL.episodes
    assert set(used[Use.CHOOSE]) == set(range(SMALL.chosen_by))
    assert used[Use.REPORT] == []
    assert sum(map(len, used.values())) == len(env.resets)


def test_folder_of_another_recipe_is_refused(small: Path) -> None:
    before = files(small)
    with pytest.raises(OtherRun, match="holds a run of another recipe; give another folder"):
        search(small, SMALL.model_copy(update={"seed": 5})).go()
    assert files(small) == before


def test_search_that_cannot_tell_candidates_apart_stops(tmp_path: Path) -> None:
    class Stuck(ToyLock):
        def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
            observation, _, _, _, _ = super().step(action)
            return observation, 0.0, False, True, {"is_success": False}

    with pytest.raises(NothingSolved, match="generation 1 solved any of 3 episodes; give more candidates"):
        WeightSearch(recipe=SMALL, folder=Folder(path=tmp_path), make=Stuck).go()
    assert not list(tmp_path.glob("round-*"))


def test_full_disk_keeps_the_generations_before(small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise NotSaved("the disk is full")

    def fill(line: str) -> None:
        if line.startswith("generation 2"):
            monkeypatch.setattr("vitac.training.search.method.save", full)

    with pytest.raises(NotSaved):
        search(tmp_path, SMALL, tell=fill).go()
    monkeypatch.undo()
    search(tmp_path, SMALL).go()
    assert files(tmp_path) == files(small)


def test_episode_without_an_end_is_cut_off() -> None:
    nothing = np.zeros((ACTIONS, FEATURES))
    slow = ToyLock()
    starts = [(1, number) for number in range(30)]
    free = [start for start in starts if not reset_pressed(start)]
    assert play(slow, nothing, free[0]) == Ending(solved=False, env_steps=LONGEST_ENV_STEPS)
    assert play(slow, LIFT, free[0]) == Ending(solved=True, env_steps=4)


def reset_pressed(start: tuple[int, int]) -> bool:
    env = ToyLock()
    env.reset(options={"rng_seed": start})
    return env.left_mm >= 2.0


def test_pulling_first_opens_what_lifting_alone_does_not() -> None:
    env = ToyLock()
    start = next((1, number) for number in range(30) if reset_pressed((1, number)))
    assert not play(env, LIFT, start).solved
    assert play(env, PULL_THEN_LIFT, start).solved


def test_success_is_worth_more_than_any_saving_of_env_steps() -> None:
    quick, slow = Ending(solved=True, env_steps=4), Ending(solved=True, env_steps=LONGEST_ENV_STEPS)
    assert quick.worth > slow.worth > quick.worth / 2
    assert Ending(solved=False, env_steps=1).worth == 0


def test_best_solves_most_then_takes_fewest_env_steps_and_is_the_latest() -> None:
    found = [
        Generation(number=number, solved=rate(solved, 10), mean_env_steps=env_steps)
        for number, solved, env_steps in ((1, 9, 4.0), (2, 10, 5.0), (3, 10, 4.5), (4, 10, 4.5), (5, 10, 4.75))
    ]
    assert best(found).number == 4
