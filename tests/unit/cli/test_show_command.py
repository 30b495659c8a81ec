import json
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from evaluation_records import make_manifest, make_record
from fake_scene import FakeScene
from PIL import Image
from vitac.cli import main as cli
from vitac.evaluator.logs.log import LogHeader, write_log

Run = Callable[..., tuple[int, str, str]]

LINE_OF_2025 = {
    "episode": 3,
    "task": "peg_insertion",
    "shape": "cuboid",
    "initial_offset": [1, 0, 0],
    "steps": [{"n": 1, "action": [0.5, 0, 0]}, {"n": 2, "action": [-0.5, 0, 0]}],
    "result": "FAIL",
}


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs `vitac show` in a folder of its own, on a fake of the physics; exit code, output, errors."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("VITAC_ASSETS_DIR", raising=False)
    monkeypatch.setattr(FakeScene, "bulge_m", -6e-4)
    monkeypatch.setattr(FakeScene, "statuses", ())
    monkeypatch.setattr("vitac.envs.scene.grasped_scene.Scene", FakeScene)

    def run_show(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as exit_:
            cli.main(["show", *map(str, arguments)])
        out, err = capsys.readouterr()
        assert isinstance(exit_.value.code, int)
        return exit_.value.code, out, err

    return run_show


def test_plays_a_variant_with_what_is_drawn_for_the_episode(run: Run) -> None:
    assert run("peg-insertion-robust", "--episode", 5, "--width", 640)[0] == 0
    scene = FakeScene.built[-1]
    assert (scene.gels[0].youngs_modulus_pa != 3e5, scene.contact.model) == (True, "arena-2")


def test_draws_the_end_of_an_episode(run: Run, tmp_path: Path) -> None:
    code, out, _ = run("peg-insertion", "--episode", 5, "--width", 640)
    assert code == 0
    assert out.splitlines() == [
        "Peg insertion, episode 5: trapezoid: success after 3 env steps",
        "The task was solved.",
        "actions: straight to the target, which no policy sees",
        "peg-insertion-5.png",
    ]
    with Image.open(tmp_path / "peg-insertion-5.png") as image:
        assert image.size == (640, 365)


@pytest.mark.slow
def test_pictures_have_the_same_size_by_default(run: Run, tmp_path: Path) -> None:
    assert run("peg-insertion", "--episode", 5, "--step", 0, "--out", "a.png", "--colour", "displacement")[0] == 0
    with Image.open(tmp_path / "a.png") as image:
        assert image.size == (1600, 912)


@pytest.mark.slow
def test_folder_gets_a_picture_for_the_reset_and_every_env_step(run: Run, tmp_path: Path) -> None:
    code, out, _ = run("peg-insertion", "--episode", 5, "--out", "frames", "--width", 600)
    assert code == 0
    names = ["step-00.png", "step-01.png", "step-02.png", "step-03.png"]
    assert out.splitlines()[3:] == [f"frames/{name}" for name in names]
    assert sorted(path.name for path in (tmp_path / "frames").iterdir()) == names


@pytest.mark.slow
def test_animation_has_a_picture_for_every_ipc_step(run: Run, tmp_path: Path) -> None:
    # 1 mm to the hole is two IPC steps, each of the three env steps ends with one down, after the first the peg waits.
    (tmp_path / "a.jsonl").write_text(json.dumps({**LINE_OF_2025, "steps": LINE_OF_2025["steps"][:1]}))  # type: ignore[index]
    arguments = ("peg-insertion", "--episode", 3, "--actions", "a.jsonl", "--width", 600)
    assert run(*arguments, "--out", "a.webp")[0] == 0
    assert run(*arguments, "--out", "b.webp", "--every", "env-step")[0] == 0
    with Image.open(tmp_path / "a.webp") as fine, Image.open(tmp_path / "b.webp") as coarse:
        assert fine.n_frames == 1 + 2 + 1  # type: ignore[attr-defined]
        assert coarse.n_frames == 2  # type: ignore[attr-defined]


@pytest.mark.slow
def test_frames_of_ipc_steps_are_named_in_order(run: Run, tmp_path: Path) -> None:
    (tmp_path / "a.jsonl").write_text(json.dumps({**LINE_OF_2025, "steps": LINE_OF_2025["steps"][:1]}))  # type: ignore[index]
    code, out, _ = run(
        "peg-insertion",
        "--episode",
        3,
        "--actions",
        "a.jsonl",
        "--width",
        600,
        "--out",
        "f",
        "--every",
        "ipc-step",
        "--json",
    )
    assert code == 0
    found = json.loads(out)
    assert [Path(name).stem for name in found["files"]] == ["step-00", "step-01-ipc-01", "step-01-ipc-02", "step-01"]
    assert (found["outcome"], found["env_steps"], found["actions"]) == ("not ended", 1, "a.jsonl")


def test_plays_the_actions_of_one_of_our_logs_from_its_own_start(run: Run, tmp_path: Path) -> None:
    record = make_record(episode=4, env_steps=2)
    with (tmp_path / "log.jsonl").open("wb") as stream:
        write_log(stream, LogHeader(team=None, submission_digest=None, manifest=make_manifest()), [record])
    code, out, _ = run("peg-insertion", "--episode", 4, "--actions", "log.jsonl", "--width", 600, "--json")
    assert code == 0
    assert json.loads(out)["title"] == "Peg insertion, episode 4: cuboid"


def test_an_environment_plays_the_random_start_of_a_seed(run: Run, tmp_path: Path) -> None:
    arguments = ("ViTac/LockOpening-v1", "--episode", 5, "--width", 600)
    first, second = (run(*arguments, "--out", f"{name}.png", "--json") for name in ("a", "b"))
    assert first[0] == second[0] == 0
    assert json.loads(first[1])["title"].startswith("ViTac/LockOpening-v1, random start 5: key")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_real_physics_is_drawn(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from vitac.envs.fem.scene.scene import Scene

    monkeypatch.setattr("vitac.envs.scene.grasped_scene.Scene", Scene)
    code, out, _ = run("peg-insertion", "--episode", 5, "--step", 0, "--width", 600, "--json")
    assert code == 0
    assert json.loads(out)["outcome"] in {"success", "tactile", "steps"}
    with Image.open(tmp_path / "peg-insertion-5.png") as image:
        assert len(np.unique(np.asarray(image).reshape(-1, 3), axis=0)) > 500


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("peg-insertoin", "--episode", 1),
            "There is no task 'peg-insertoin'; did you mean peg-insertion? The tasks are",
        ),
        (("peg-insertion", "--episode", 0), "Expected episodes of peg-insertion from 1 to 270, got 0."),
        (("peg-insertion", "--episode", 271), "Expected episodes of peg-insertion from 1 to 270, got 271."),
        (("peg-insertion", "--episode", 5, "--out", "a.jpg"), "expected .png, .gif, .webp, or no suffix for a folder"),
        (("peg-insertion", "--episode", 5, "--out", "no/a.png"), "Cannot write pictures to no/a.png: No such file"),
        (
            ("peg-insertion", "--episode", 5, "--step", 7),
            "The episode ended after env step 3: expected --step 0 to 3, got 7",
        ),
        (
            ("peg-insertion", "--episode", 5, "--actions", "empty.jsonl"),
            "empty.jsonl contains no actions for episode 5",
        ),
        (("peg-insertion", "--episode", 5, "--policy", "missing"), "missing"),
        (("ViTac/LockOpening-v1", "--episode", -1), "expected non-negative integers"),
        (
            ("ViTac/LockOpening-v1", "--episode", 1, "--policy", "."),
            "Expected a task such as peg-insertion for --policy or --actions, got ViTac/LockOpening-v1",
        ),
        (("peg-insertion", "--episode", 5, "--assets", "missing"), "Expected the challenge's meshes in missing"),
    ],
)
def test_refuses_in_one_sentence(run: Run, tmp_path: Path, arguments: tuple[object, ...], message: str) -> None:
    (tmp_path / "empty.jsonl").write_text("")
    code, out, err = run(*arguments)
    assert code == 1
    assert out == ""
    assert err.startswith("vitac: ")
    assert message in err
    assert list(tmp_path.iterdir()) == [tmp_path / "empty.jsonl"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("peg-insertion",), "--episode"),
        (
            ("peg-insertion", "--episode", 5, "--out", "a.gif", "--step", 1),
            "expected a single PNG as output for one env step",
        ),
        (("peg-insertion", "--episode", 5, "--actions", "a.jsonl", "--policy", "."), "expected one of them, got both"),
        (("peg-insertion", "--episode", 5, "--actions", "missing.jsonl"), "does not exist"),
        (("peg-insertion", "--episode", 5, "--colour", "temperature"), "temperature"),
        (("peg-insertion", "--episode", 5, "--width", 20), "greater than or equal to 600"),
    ],
)
def test_wrong_usage_ends_with_two(run: Run, tmp_path: Path, arguments: tuple[object, ...], message: str) -> None:
    (tmp_path / "a.jsonl").write_text("")
    code, _, err = run(*arguments)
    assert code == 2
    assert message in err


@pytest.mark.parametrize("missing", ["matplotlib", "PIL"])
def test_missing_extra_is_refused_with_the_command_that_installs_it(
    run: Run, repository: Path, monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    extra = tomllib.loads((repository / "pyproject.toml").read_text())["project"]["optional-dependencies"]["show"]
    listed = ["numpy>=2", *(f'{requirement}; extra == "show"' for requirement in extra), 'torch; extra == "torch"']
    monkeypatch.setattr("vitac.envs.extras.requires", lambda _: listed)
    monkeypatch.setattr("vitac.envs.extras.find_spec", lambda name: None if name == missing else object())
    code, _, err = run("peg-insertion", "--episode", 5)
    assert code == 1
    assert err.rstrip().endswith("-m pip install " + " ".join(f"'{requirement}'" for requirement in extra))
    assert "numpy" not in err


def test_every_task_of_ours_that_is_scored_can_be_drawn() -> None:
    from vitac.envs.drawing.drawable import find_perspective, straight_to_target
    from vitac.evaluator.tracks import list_tracks, load_track

    drawn = [task.env_id for name in list_tracks() if name != "maniskill" for task in load_track(name).tasks.values()]
    assert drawn
    for env_id in drawn:
        assert find_perspective(env_id).held_name
        assert callable(straight_to_target(env_id))


@pytest.mark.slow
def test_cameras_of_an_env_step_are_drawn(run: Run, tmp_path: Path) -> None:
    arguments = ("fusion-insertion", "--episode", 2, "--step", 1, "--view", "cameras", "--width", 600)
    code, out, _ = run(*arguments, "--out", "cameras.png")
    assert code == 0
    assert out.splitlines()[-1] == "cameras.png"
    with Image.open(tmp_path / "cameras.png") as image:
        assert image.size == (600, 384)


@pytest.mark.slow
def test_depth_is_that_of_the_tracks_task(run: Run, tmp_path: Path) -> None:
    for task in ("fusion-insertion", "fusion-insertion-gt"):
        arguments = (task, "--episode", 2, "--step", 0, "--view", "cameras", "--width", 600)
        assert run(*arguments, "--out", f"{task}.png")[0] == 0
    measured, exact = ((tmp_path / f"{task}.png").read_bytes() for task in ("fusion-insertion", "fusion-insertion-gt"))
    assert measured != exact


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["rast", "rt"])
def test_a_rendering_of_an_env_step_is_drawn_where_sapien_is_and_else_refused(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: str
) -> None:
    arguments = ("fusion-insertion", "--episode", 2, "--step", 1, "--view", mode, "--width", 600, "--out", "still.png")
    rendered: list[str] = []

    def renderer(asked: str) -> SimpleNamespace:
        rendered.append(asked)
        return SimpleNamespace(picture=lambda sight: sight.colours)

    monkeypatch.setitem(sys.modules, "sapien", None)
    code, _, err = run(*arguments)
    assert (code, "need SAPIEN" in err, (tmp_path / "still.png").exists()) == (1, True, False)
    monkeypatch.setattr("vitac.envs.vision.renderer.make_renderer", renderer)
    assert run(*arguments)[0] == 0
    assert rendered == [mode]
    with Image.open(tmp_path / "still.png") as image:
        assert image.size == (600, 204)


@pytest.mark.parametrize("view", ["cameras", "rast", "rt"])
def test_a_task_without_cameras_is_refused(run: Run, view: str) -> None:
    code, _, err = run("peg-insertion", "--episode", 5, "--view", view, "--width", 600)
    assert code == 1
    assert "has no cameras beside the gripper: expected --view episode" in err
