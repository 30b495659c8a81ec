"""`vitac show` of ManiSkill's tasks, on a stand-in for ManiSkill, and on the real one where it can be drawn."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from evaluation_records import make_record
from fake_pick_cube import FakePickCube, in_place_of_maniskill
from numpy.typing import NDArray
from PIL import Image
from submissions import submission_folder
from vitac.cli import main as cli
from vitac.envs.maniskill import env, film
from vitac.envs.maniskill.abilities import abilities
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome
from vitac.evaluator.tracks import find_task

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> FakePickCube:
    made = in_place_of_maniskill(monkeypatch)
    made.single_action_space.shape = (4,)
    return made


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs `vitac show pick-cube` in a folder of its own; exit code, output, errors."""
    monkeypatch.chdir(tmp_path)

    def run_show(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as exit_:
            cli.main(["show", "pick-cube", *map(str, arguments)])
        out, err = capsys.readouterr()
        assert isinstance(exit_.value.code, int)
        return exit_.value.code, out, err

    return run_show


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Recorded actions of episode 3: three env steps."""
    episode = find_task("pick-cube")[1].episodes[2]
    actions = ActionSequence.from_array(np.full((3, 4), 0.5, np.float32))
    record = make_record(
        3, EpisodeOutcome.ACTIONS_ENDED, 3, task="pick-cube", shape=episode.shape, initial_offset=episode.offset,
        actions=actions,
    )  # fmt: skip
    path = tmp_path / "actions.jsonl"
    path.write_text(record.model_dump_json() + "\n")
    return path


def bright(picture: Path, frame: int = 0) -> float:
    """How much of the stand-in's picture is bright: it grows with the env steps."""
    with Image.open(picture) as image:
        image.seek(frame)
        pixels = np.asarray(image.convert("L"), dtype=float)
        middle: float = pixels[pixels.shape[0] // 2].mean()
    return middle


def test_without_actions_the_start_is_drawn_and_the_report_says_so(
    run: Run, fake: FakePickCube, tmp_path: Path
) -> None:
    code, out, _ = run("--episode", 5)
    assert code == 0
    assert out.splitlines() == [
        "Pick a cube, episode 5: not ended after 0 env steps",
        "actions: none (the start)",
        "pick-cube-5.png",
    ]
    with Image.open(tmp_path / "pick-cube-5.png") as image:
        assert image.width == 640
    assert (fake.draws, fake.commands) == (True, [])


def test_recorded_actions_are_played_from_the_episodes_own_start(
    run: Run, fake: FakePickCube, log: Path, tmp_path: Path
) -> None:
    assert run("--episode", 3, "--out", "start.png")[0] == 0
    code, out, _ = run("--episode", 3, "--actions", log, "--json")
    assert (code, json.loads(out)) == (
        0,
        {
            "title": "Pick a cube, episode 3",
            "actions": "actions.jsonl",
            "outcome": "not ended",
            "env_steps": 3,
            "beliefs": [],
            "files": ["pick-cube-3.png"],
        },
    )
    (alone, _), (played, _) = fake.resets
    assert alone == played
    assert bright(tmp_path / "start.png") < bright(tmp_path / "pick-cube-3.png")
    code, _, err = run("--episode", 4, "--actions", log)
    assert (code, "contains no actions for episode 4" in err) == (1, True)


@pytest.mark.usefixtures("fake")
def test_an_env_step_an_animation_and_a_folder_show_what_they_are_asked_for(
    run: Run, log: Path, tmp_path: Path
) -> None:
    arguments = ("--episode", 3, "--actions", log, "--width", 600)
    for step in (0, 2, 3):
        assert run(*arguments, "--step", step, "--out", f"{step}.png")[0] == 0
    found = [bright(tmp_path / f"{step}.png") for step in (0, 2, 3)]
    assert found[0] < found[1] < found[2]
    assert run(*arguments, "--out", "a.webp", "--every", "env-step")[0] == 0
    with Image.open(tmp_path / "a.webp") as moving:
        assert (moving.n_frames, moving.width) == (4, 600)  # type: ignore[attr-defined]
    assert bright(tmp_path / "a.webp", 0) < bright(tmp_path / "a.webp", 3)
    assert run(*arguments, "--out", "frames")[0] == 0
    assert sorted(path.name for path in (tmp_path / "frames").iterdir()) == [f"step-0{step}.png" for step in range(4)]
    code, _, err = run(*arguments, "--step", 4)
    assert (code, "ended after env step 3: expected --step 0 to 3, got 4" in err) == (1, True)


@pytest.mark.usefixtures("fake")
def test_a_still_draws_no_more_than_its_env_step_and_the_last(
    run: Run, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A picture may take a second where no GPU draws it."""
    drawn = []
    picture = env.ManiSkillEnv.picture

    def counted(self: env.ManiSkillEnv) -> NDArray[np.uint8]:
        drawn.append(1)
        return picture(self)

    monkeypatch.setattr(env.ManiSkillEnv, "picture", counted)
    for arguments, count in (((), 1), (("--step", 1), 2), (("--step", 3), 1)):
        drawn.clear()
        assert run("--episode", 3, "--actions", log, *arguments)[0] == 0
        assert len(drawn) == count


@pytest.mark.usefixtures("fake")
def test_pictures_of_a_folder_are_written_as_they_are_drawn(
    run: Run, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An episode may have 500 env steps: all its pictures at once took gigabytes."""
    written_before = []
    frames = tmp_path / "frames"

    def noted(shot: film.Shot, title: str, width_px: int) -> film.Picture:
        assert (title, width_px) == ("Pick a cube, episode 3; actions: actions.jsonl", 640)
        written_before.append(len(list(frames.iterdir())))
        return shot.picture

    monkeypatch.setattr(film, "captioned", noted)
    code, out, _ = run("--episode", 3, "--actions", log, "--out", frames, "--json")
    assert (code, written_before) == (0, [0, 1, 2, 3])
    assert json.loads(out)["files"] == sorted(map(str, frames.iterdir()))
    assert bright(frames / "step-00.png") < bright(frames / "step-03.png")


@pytest.mark.usefixtures("fake")
def test_a_submissions_policy_acts_in_its_sandbox(run: Run, tmp_path: Path) -> None:
    policy = "class Policy:\n    def reset(self, task): pass\n    def act(self, seen): return 4 * [1.0]\n"
    manifest = "track: maniskill\nname: ones\ntasks: [pick-cube]\ncontrol_modes: {pick-cube: pd_ee_delta_pos}\n"
    for folder in (tmp_path.parent, tmp_path):
        folder.chmod(0o755)
    folder = submission_folder(tmp_path / "ManiSkill", {"submission.yaml": manifest, "policy.py": policy})
    code, out, err = run("--episode", 1, "--policy", folder)
    assert (code, err) == (0, "")
    assert out.splitlines()[:3] == [
        "Pick a cube, episode 1: steps after 50 env steps",
        EpisodeOutcome.STEPS.sentence,
        "actions: ones",
    ]


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--colour", "stress"), "--colour"),
        (("--view", "cameras"), "--view"),
        (("--every", "ipc-step", "--out", "a.webp"), "--every"),
        (("--assets", "."), "--assets"),
    ],
)
def test_what_gels_and_our_cameras_have_is_refused(run: Run, arguments: tuple[str, ...], named: str) -> None:
    code, _, err = run("--episode", 1, *arguments)
    assert code == 2
    words = " ".join(err.replace("│", " ").split())
    assert named in words
    assert "no gels and no cameras of ours in ManiSkill/PickCube-v1" in words


def test_without_the_packages_the_refusal_says_what_to_install(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(env, "missing_packages", lambda: ("mani-skill", "sapien"))
    code, _, err = run("--episode", 1)
    assert code == 1
    assert "Tasks of ManiSkill need mani-skill, sapien (extra maniskill, 3 GB)" in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not abilities().physics, reason="the extra maniskill is not installed")
def test_the_real_scene_is_drawn_where_there_is_a_driver_and_refused_where_none_is(tmp_path: Path) -> None:
    """In a process of its own, as SAPIEN looks for drivers once."""

    def shown(**variables: str) -> subprocess.CompletedProcess[str]:
        code = "from vitac.cli.main import main; main(['show', 'pick-cube', '--episode', '1'])"
        command = [sys.executable, "-P", "-c", code]
        return subprocess.run(
            command, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL, cwd=tmp_path,
            env=os.environ | variables,
        )  # fmt: skip

    refused = shown(VK_DRIVER_FILES="/nonexistent", VK_ICD_FILENAMES="/nonexistent")
    assert (refused.returncode, refused.stdout) == (1, "")
    assert "A picture of ManiSkill/PickCube-v1 is drawn by SAPIEN, which finds no Vulkan driver" in refused.stderr
    if not abilities().pictures:
        pytest.skip("no Vulkan driver: only the refusal was tried")
    assert shown().returncode == 0
    with Image.open(tmp_path / "pick-cube-1.png") as image:
        assert len(np.unique(np.asarray(image).reshape(-1, 3), axis=0)) > 500
