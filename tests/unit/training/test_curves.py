"""Learning curves: what is read of each kind of training, and what the page says of several seeds."""

import json
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from vitac.training.curves import Curve, NoCurve, Point, draw_curves, make_page, read_curves, write_curves


def curve(seed: int, *successes: int, method: str = "train clone", wanted: int | None = None) -> Curve:
    points = (
        Point(env_steps=1000 * number, successes=solved, episodes=50) for number, solved in enumerate(successes, 1)
    )
    return Curve(
        task="lock-opening",
        method=method,
        seed=seed,
        points=tuple(points),
        wanted=wanted,
        cpu_s=wanted and 600.0,
        options=f" --seed {seed}",
    )


def write_run(folder: Path, name: str, text: str, **recipe: object) -> Path:
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / "run.json").write_text(json.dumps({"recipe": {"task": "lock-opening", "seed": 4, **recipe}}))
    (folder / name).write_text(text)
    return folder


def test_curve_of_the_challenges_method_is_that_of_its_evaluations(tmp_path: Path) -> None:
    log = "time/total_timesteps,time/cpu_s,eval/success_rate\n10,1.0,\n2000,20.0,0.1\n2100,21.0,\n4000,40.0,0.58\n"
    run = write_run(tmp_path / "run", "progress.csv", log, env_steps=80_000, evaluation_episodes=50)
    (found,) = read_curves([run])
    assert (found.method, found.seed, found.wanted, found.cpu_s) == ("train reference", 4, 80_000, 40.0)
    assert [(point.env_steps, point.successes) for point in found.points] == [(2000, 5), (4000, 29)]


def test_a_fidelity_is_a_method_of_its_own_and_the_command_that_continues_names_how_it_began(tmp_path: Path) -> None:
    log = "time/total_timesteps,time/cpu_s,eval/success_rate\n2000,20.0,0.1\n"
    chosen: dict[str, object] = {"env_steps": 80_000, "evaluation_episodes": 50, "sensor": "ab12"}
    run = write_run(tmp_path / "run", "progress.csv", log, fidelity="training", device="cuda", **chosen)
    (found,) = read_curves([run])
    assert found.method == "train reference, fidelity training"
    assert "--out RUN --seed 4 --sensor FOLDER --fidelity training --device cuda`" in make_page(
        [found], {"lock-opening": "lock.svg"}
    )


def test_curves_of_rounds_are_those_of_their_students_and_the_blind(tmp_path: Path) -> None:
    solved = {"successes": 3, "episodes": 10}
    line = json.dumps({"round": 1, "env_steps": 70, "student": solved})
    (found,) = read_curves([write_run(tmp_path / "run", "log.jsonl", line)])
    assert (found.method, found.points) == ("train", (Point(env_steps=70, successes=3, episodes=10),))
    line = json.dumps({"round": 1, "env_steps": 60, "solved": solved})
    clone = write_run(tmp_path / "clone", "log.jsonl", line)
    (clone / "blind").mkdir()
    (clone / "blind" / "log.jsonl").write_text(line.replace("3", "0"))
    assert [each.method for each in read_curves([clone])] == ["train clone", "train clone, blind"]


def test_a_contact_model_and_draws_are_methods_of_their_own(tmp_path: Path) -> None:
    line = json.dumps({"round": 1, "env_steps": 70, "student": {"successes": 3, "episodes": 10}})
    recipes: dict[str, dict[str, object]] = {
        "train": {"contact_model": "challenge-2025", "draws": {}},
        "train, arena-2": {"contact_model": "arena-2"},
        "train, arena-2, drawn, fidelity training": {
            "contact_model": "arena-2",
            "draws": {"clearance_mm": [1, 2]},
            "fidelity": "training",
        },
    }
    runs = [write_run(tmp_path / name, "log.jsonl", line, **recipe) for name, recipe in recipes.items()]
    assert [each.method for each in read_curves(runs)] == list(recipes)


def test_stored_curves_are_read_again_and_a_newer_one_of_the_same_training_replaces_them(tmp_path: Path) -> None:
    path = tmp_path / "curves.json"
    path.write_text(write_curves([curve(0, 10, 20), curve(1, 15)]))
    assert read_curves([path]) == [curve(0, 10, 20), curve(1, 15)]
    newer = tmp_path / "newer.json"
    newer.write_text(write_curves([curve(1, 15, 30)]))
    assert read_curves([path, newer]) == [curve(0, 10, 20), curve(1, 15, 30)]


def test_folder_without_a_curve_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NoCurve, match=r"holds no curve .*; expected the folder of `vitac train`"):
        read_curves([tmp_path])
    log = "time/total_timesteps,time/cpu_s,eval/success_rate\n10,1.0,\n"
    run = write_run(tmp_path / "run", "progress.csv", log, env_steps=80_000, evaluation_episodes=50)
    with pytest.raises(NoCurve, match="has no evaluation yet"):
        read_curves([run])


def test_page_has_the_mean_of_seeds_and_says_what_is_not_finished() -> None:
    curves = [curve(0, 20, 30), curve(1, 30), curve(2, 5, method="train reference", wanted=10_000)]
    page = make_page(curves, {"lock-opening": "lock.svg"})
    assert "| `train clone` | 2 | 1,000 | 50.0 [0.0, 100.0] | 40, 60 |" in page
    assert "2,000" not in page
    assert "| the organizers' log | | | 90.6 [85.1, 94.2] | |" in page
    assert "seed 2, was not trained to the end: 1,000 of 10,000 env steps in 10 minutes of CPU time" in page
    assert "the rest takes about 1.5 hours of one core" in page
    assert "train reference lock-opening --out RUN --seed 2` continues it" in page


def test_picture_has_a_line_for_each_method_at_its_height() -> None:
    picture = ET.fromstring(draw_curves([curve(0, 0, 50), curve(1, 0, 50), curve(0, 25, method="train")]))  # noqa: S314
    name = "{http://www.w3.org/2000/svg}"
    lines = [each.attrib["points"].split() for each in picture.iter(f"{name}polyline")]
    heights = [[float(place.partition(",")[2]) for place in line] for line in lines]
    assert heights == [[260.0, 16.0], [138.0]]
    texts = [each.text for each in picture.iter(f"{name}text")]
    assert {"train clone (2)", "train (1)", "organizers' log", "1,000", "100%"} <= set(texts)
