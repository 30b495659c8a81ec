"""A training run: rounds, what is kept when it is stopped, and that it ends with the same bits."""

import json
import os
import signal
import time
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_peg import ToyPeg
from vitac.evaluator.scoring.score import rate
from vitac.evaluator.version import evaluator_parts
from vitac.training.files import FileDamaged
from vitac.training.folder_lock import FolderInUse
from vitac.training.learning.critic import CriticPlan
from vitac.training.learning.network import Learner, TrainingDiverged
from vitac.training.learning.student import AssessorPlan, StudentPlan
from vitac.training.log import FOLDER, Charts
from vitac.training.recipe import Recipe
from vitac.training.run import Folder, OtherRun, RoundResult, Run, best, format_rate, read_results
from vitac.training.streams import StreamRefused, Use, stream

RECIPE = Recipe(
    task="peg-insertion",
    seed=2,
    random_episodes=30,
    guided_episodes=30,
    rounds=2,
    student_episodes=20,
    critic_episodes=10,
    chosen_by=10,
    critic=CriticPlan(networks=1, hidden=16, sweeps=2, epochs=1),
    assessor=AssessorPlan(networks=1, hidden=16, sweeps=2, epochs=1),
    assessed_from=2,
    assessments=2,
    student=StudentPlan(networks=1, hidden=16, epochs=2),
)

LIMIT_S = 60


def run(path: Path, recipe: Recipe = RECIPE, lines: list[str] | None = None) -> Run:
    heard: list[str] = [] if lines is None else lines
    return Run(recipe=recipe, folder=Folder(path=path), tell=heard.append)


def files(folder: Path) -> dict[str, bytes]:
    """All but the charts, which hold times, by name."""
    found = [path for path in folder.rglob("*") if path.is_file() and path.parent.name != FOLDER]
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


class Stopped(BaseException):
    """Like Ctrl-C or a kill: nobody in the run catches it."""


def test_each_round_is_assessord_and_logged(tmp_path: Path) -> None:
    lines: list[str] = []
    results = run(tmp_path, lines=lines).go()
    assert [result.number for result in results] == [1, 2]
    assert read_results(Folder(path=tmp_path)) == results
    assert results[1].env_steps > results[0].env_steps
    assert [result.student.episodes for result in results] == [10, 10]
    assert any(line.startswith("round 2 of 2: student ") for line in lines)
    assert any("random episodes: 1 of 1 files" in line for line in lines)


def test_tells_how_long_is_left(tmp_path: Path) -> None:
    lines: list[str] = []
    run(tmp_path, RECIPE.model_copy(update={"random_episodes": 60}), lines=lines).go()
    rounds = [line for line in lines if line.startswith("round") and " of 2: student" in line]
    assert [line.endswith(" env steps, less than 1 min left") for line in rounds] == [True, False]
    files = [line for line in lines if line.startswith("random episodes")]
    assert files == [
        "random episodes: 0 of 2 files",
        "random episodes: 1 of 2 files, less than 1 min left",
        "random episodes: 2 of 2 files",
    ]


def test_finished_run_is_not_made_again(tmp_path: Path, toy: list[ToyPeg]) -> None:
    first = run(tmp_path).go()
    before, episodes = files(tmp_path), len(toy[0].resets)
    assert run(tmp_path).go() == first
    assert files(tmp_path) == before
    assert len(toy[0].resets) == episodes


@pytest.mark.slow
@pytest.mark.parametrize(
    "stop_at",
    [
        "student episodes: 1",
        "round 1, critic: turn 2",
        "round 2, assessor: turn 2",
        "round 2, student: turn 1",
        "round 2 of 2: ",
    ],
)
def test_stopped_run_ends_with_the_same_bits(tmp_path: Path, stop_at: str) -> None:
    run(tmp_path / "whole").go()

    def stop(line: str) -> None:
        if line.startswith(stop_at):
            raise Stopped

    stopped = Run(recipe=RECIPE, folder=Folder(path=tmp_path / "stopped"), tell=stop)
    with pytest.raises(Stopped):
        stopped.go()
    run(tmp_path / "stopped").go()
    assert files(tmp_path / "stopped") == files(tmp_path / "whole")


def test_log_never_gets_shorter_and_what_is_in_it_is_not_judged_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(line: str) -> None:
        if line.startswith("round 2, critic: "):
            raise Stopped

    with pytest.raises(Stopped):
        Run(recipe=RECIPE, folder=Folder(path=tmp_path), tell=stop).go()
    assert [result.number for result in read_results(Folder(path=tmp_path))] == [1]
    finished = run(tmp_path).go()
    log = (tmp_path / "log.jsonl").read_bytes()
    heard: list[bytes] = []

    def hear(_: str) -> None:
        heard.append((tmp_path / "log.jsonl").read_bytes())

    monkeypatch.setattr(Run, "_judged", None)
    assert Run(recipe=RECIPE, folder=Folder(path=tmp_path), tell=hear).go() == finished
    assert set(heard) == {log}


def test_damaged_log_is_told_and_made_again_from_what_is_kept(tmp_path: Path, toy: list[ToyPeg]) -> None:
    run(tmp_path).go()
    before, episodes = files(tmp_path), len(toy[0].resets)
    log = tmp_path / "log.jsonl"
    log.write_text('{"round": 1}\n')
    for use in (run(tmp_path).go, lambda: read_results(Folder(path=tmp_path))):
        with pytest.raises(FileDamaged, match=r"log.jsonl does not hold what was written; delete it and run it again"):
            use()
    log.unlink()
    run(tmp_path).go()
    assert files(tmp_path) == before
    assert len(toy[0].resets) == episodes


def test_what_a_kill_left_half_written_is_removed_at_the_next_start(tmp_path: Path) -> None:
    run(tmp_path).collect_first()
    before = files(tmp_path)
    for name in (
        ".log.jsonl.4194999.new",
        "episodes/.one.npz.4194999.new",
        "submission/Track_1/.weights.npz.4194999.new",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"half")
    with pytest.raises(OtherRun):
        run(tmp_path, RECIPE.model_copy(update={"seed": 3})).collect_first()
    assert len(files(tmp_path)) == len(before) + 3
    run(tmp_path).collect_first()
    assert files(tmp_path) == before


def test_collecting_first_is_what_the_run_does_first(tmp_path: Path, toy: list[ToyPeg]) -> None:
    assert run(tmp_path).collect_first() == 60
    episodes = len(toy[0].resets)
    collected = files(tmp_path)
    run(tmp_path).go()
    assert collected.items() <= files(tmp_path).items()
    assert len(toy[0].resets) == episodes + 20 + 10 + 4 * 10


def test_second_run_in_the_same_folder_is_refused_and_changes_nothing(tmp_path: Path) -> None:
    short, tried = RECIPE.model_copy(update={"rounds": 1, "chosen_by": 2}), []

    def try_too(line: str) -> None:
        if line.startswith(("random episodes: 1", "round 1 of 1")):
            before = files(tmp_path)
            for use in (run(tmp_path, short).go, run(tmp_path, short).collect_first):
                with pytest.raises(
                    FolderInUse, match=rf"\(process {os.getpid()} on .*\); wait for it, end it, or give"
                ):
                    use()
            assert files(tmp_path) == before
            tried.append(line.partition(":")[0])

    first = Run(recipe=short, folder=Folder(path=tmp_path), tell=try_too)
    assert first.collect_first() == run(tmp_path, short).collect_first() == 60, "free again"
    assert first.go() == run(tmp_path, short).go()
    assert tried == ["random episodes", "random episodes", "round 1 of 1"], "in both verbs, and at the end"


def test_folder_of_another_recipe_is_refused(tmp_path: Path) -> None:
    run(tmp_path).collect_first()
    other = RECIPE.model_copy(update={"seed": 3})
    with pytest.raises(OtherRun, match="holds a run of another recipe; give another folder"):
        run(tmp_path, other).go()


def test_folder_of_another_version_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(tmp_path).collect_first()
    changed = {**evaluator_parts(), "numpy": "9.9.9"}
    monkeypatch.setattr("vitac.training.run.evaluator_parts", lambda: changed)
    with pytest.raises(OtherRun, match="holds a run of another numpy; give another folder"):
        run(tmp_path).go()


def test_folder_that_does_not_say_what_it_is_for_is_refused(tmp_path: Path) -> None:
    run(tmp_path).go()
    described = tmp_path / "run.json"
    for damage in (b"", b"{", b"\xff", described.read_bytes()[:-20]):
        described.write_bytes(damage)
        with pytest.raises(OtherRun, match=r"another version, or its run.json is damaged"):
            run(tmp_path).go()
    described.unlink()
    before = files(tmp_path)
    with pytest.raises(
        OtherRun, match=r"holds a training but no run.json that says of which recipe; give another folder"
    ):
        run(tmp_path, RECIPE.model_copy(update={"seed": 3})).go()
    assert files(tmp_path) == before


def test_seed_of_an_official_list_is_refused_before_anything_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for use in Use:
        monkeypatch.setattr("vitac.training.streams.FIRST_STREAM", -10 * RECIPE.seed - use)  # its stream is list 0
        with pytest.raises(StreamRefused, match="Seed 0 is that of the official list of "):
            run(tmp_path / "run").collect_first()
    assert not (tmp_path / "run").exists()


def test_folder_of_other_training_code_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(tmp_path).collect_first()
    before = files(tmp_path)
    monkeypatch.setattr(
        "vitac.training.run.sources_hash", lambda package: {"vitac.training": "a learner that was changed"}[package]
    )
    with pytest.raises(OtherRun, match=r"holds a run of another vitac\.training; give another folder"):
        run(tmp_path).go()
    assert files(tmp_path) == before


def test_results_of_an_unfinished_run_are_refused(tmp_path: Path) -> None:
    run(tmp_path).collect_first()
    with pytest.raises(OtherRun, match="holds no finished round; train first"):
        read_results(Folder(path=tmp_path))


def test_diverging_round_keeps_those_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    learn = Learner.learn

    def diverging(learner: Learner, *seen: Any, rate: float) -> float:
        if (tmp_path / "round-001.npz").exists():
            seen[0][:] = np.nan
        return learn(learner, *seen, rate=rate)

    monkeypatch.setattr(Learner, "learn", diverging)
    with pytest.raises(TrainingDiverged):
        run(tmp_path).go()
    assert [result.number for result in read_results(Folder(path=tmp_path))] == [1]
    assert not (tmp_path / "round-002.npz").exists()


def test_starts_that_choose_are_not_learned_from_and_none_is_reported(tmp_path: Path, toy: list[ToyPeg]) -> None:
    run(tmp_path).go()
    used = {Use(use): [number for seed, number in toy[0].resets if seed == stream(2, use)] for use in Use}
    assert len(used[Use.COLLECT]) == len(set(used[Use.COLLECT])) == 60 + 30
    assert set(used[Use.CHOOSE]) == set(range(10))
    assert used[Use.REPORT] == []


def test_best_round_solves_the_most_and_is_the_latest_of_equals() -> None:
    results = [
        RoundResult(number=number, student=rate(solved, 10), critic=rate(9, 10), env_steps=5)
        for number, solved in ((1, 4), (2, 7), (3, 7), (4, 2))
    ]
    assert best(results).number == 3


def test_rates_are_told_with_their_interval() -> None:
    assert format_rate(rate(7, 10)) == "7 of 10 (70.0 % [39.7, 89.2])"


def test_log_has_a_line_for_each_round(tmp_path: Path) -> None:
    run(tmp_path).go()
    rows = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [row["round"] for row in rows] == [1, 2]
    assert {"student", "critic", "env_steps"} <= set(rows[0])


def test_a_run_charts_its_rounds_and_losses_and_a_finished_one_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    charted: list[tuple[int, str]] = []
    monkeypatch.setattr(Charts, "add_row", lambda _, number, row: charted.append((number, ",".join(row))))
    monkeypatch.setattr(Charts, "add_loss", lambda _, number, who, loss: charted.append((number, who)))
    run(tmp_path).go()
    row = "round,env_steps,student,critic"
    first = ["critic"] * 2 + ["student"] * 2 + [row]
    second = ["critic"] * 2 + (["assessor"] * 2 + ["student"] * 2) * 2 + [row]
    assert charted == [*((1, name) for name in first), *((2, name) for name in second)]
    charted.clear()
    run(tmp_path).go()
    assert not charted


def test_what_a_kill_left_out_of_the_log_is_charted_when_the_run_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    charted: list[int] = []

    def chart_until(last: int) -> None:
        def add_row(_: Charts, number: int, __: object) -> None:
            if number > last:
                raise Stopped
            charted.append(number)

        monkeypatch.setattr(Charts, "add_row", add_row)

    chart_until(1)
    with pytest.raises(Stopped):
        run(tmp_path).go()
    assert [result.number for result in read_results(Folder(path=tmp_path))] == [1]
    chart_until(2)
    run(tmp_path).go()
    assert charted == [1, 2]


def test_charts_that_cannot_be_written_do_not_stop_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("vitac.training.log.find_spec", lambda _: object())
    monkeypatch.setattr(Charts, "_write", fail)
    lines: list[str] = []
    assert [result.number for result in run(tmp_path, lines=lines).go()] == [1, 2]
    assert [line.partition(" gets ")[0] for line in lines if "no more charts" in line] == [str(tmp_path / FOLDER)]
    assert (tmp_path / "round-002.npz").exists()


def go(folder: Path) -> None:
    run(folder, RECIPE.model_copy(update={"random_episodes": 60, "guided_episodes": 60, "rounds": 1})).go()


def go_and_hang(folder: Path, count: int) -> None:
    """Run, and stop for ever in the middle of an episode once so many files are there."""
    reset = ToyPeg.reset

    def hanging(env: ToyPeg, **options: object) -> object:
        if len(list(folder.rglob("*.npz"))) == count:
            (folder / "hangs").touch()
            time.sleep(10 * LIMIT_S)
        return reset(env, **options)  # type: ignore[arg-type]

    ToyPeg.reset = hanging  # type: ignore[method-assign, assignment]
    go(folder)


@pytest.mark.parametrize("count", [0, 3])
def test_killed_run_goes_on_to_the_same_bits(tmp_path: Path, count: int) -> None:
    killed, whole = tmp_path / "killed", tmp_path / "whole"
    process = get_context("fork").Process(target=go_and_hang, args=(killed, count))
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
    assert len([path for path in killed.rglob("*.npz") if path.parent.name == "episodes"]) == count
    go(killed)
    go(whole)
    assert files(killed) == files(whole)


def test_a_recipe_is_learned_from_at_its_fidelity_and_judged_at_full_under_its_contact_model_and_draws(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: dict[str, ToyPeg] = {}
    worlds = []

    def make(fidelity: str, **world: object) -> ToyPeg:
        made[fidelity] = ToyPeg()
        worlds.append(world)
        return made[fidelity]

    monkeypatch.setattr("vitac.training.collection.make_environment", make)
    go_at_training = run(tmp_path)
    go_at_training.recipe = Recipe.model_validate(
        {
            **go_at_training.recipe.model_dump(),
            "fidelity": "training",
            "contact_model": "arena-2",
            "draws": {"clearance_mm": [1.0, 2.0]},
        }
    )
    go_at_training.go()
    streams = {fidelity: {seed for seed, _ in toy.resets} for fidelity, toy in made.items()}
    assert streams == {"training": {stream(2, Use.COLLECT)}, "full": {stream(2, Use.CHOOSE)}}
    assert worlds == 2 * [{"contact_model": "arena-2", "draws": {"clearance_mm": (1.0, 2.0)}}]
