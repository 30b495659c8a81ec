"""What the example gives to LeRobot's policy is what the data set has, and its README leads to a policy that plays."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from runpy import run_path

import numpy as np
import pytest
from example_policies import flow
from vitac.training.demonstrations.lerobot.layout import fit_motions


def test_observations_are_those_of_the_data_set_and_a_blind_policy_feels_nothing(repository: Path) -> None:
    observe = run_path(str(repository / "examples" / "lerobot_act" / "play.py"))["observe"]
    gels = np.stack([flow(np.array([[2.9, 0], [0.4, -0.1], [0, 0.2]]), 0.5, seed) for seed in (1, 2)])
    observation = {"marker_flow": gels, "relative_motion": np.array([1.0, 0.0, -2.0], np.float32)}
    seen, blind = observe(observation, is_blind=False), observe(observation, is_blind=True)
    np.testing.assert_allclose(seen["observation.environment_state"], fit_motions(gels[None])[0], atol=1e-5)
    assert np.abs(seen["observation.environment_state"]).max() > 0.1
    assert not blind["observation.environment_state"].any()
    assert (seen["observation.state"] == blind["observation.state"]).all()


@pytest.mark.slow
def test_the_way_of_the_readme_leads_to_a_policy_that_plays_and_to_its_blind_twin(
    repository: Path, tmp_path: Path
) -> None:
    """With few demonstrations and two steps, so that it says nothing of how good they are."""
    python = os.environ.get("LEROBOT_PYTHON_V3_0")
    if python is None:
        pytest.skip("name a Python that has LeRobot 0.4 in LEROBOT_PYTHON_V3_0: its packages do not agree with ours")
    example = repository / "examples" / "lerobot_act"
    block = re.findall(r"```sh\n(.*?)```", (example / "README.md").read_text(), re.DOTALL)[0]
    collect, export, train = (shlex.split(line) for line in block.splitlines())
    variables = os.environ | {"HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path / "cache"), "OMP_NUM_THREADS": "1"}

    def run(*command: str | Path) -> str:
        ended = subprocess.run(command, cwd=tmp_path, env=variables, capture_output=True, text=True)
        assert ended.returncode == 0, ended.stderr
        return ended.stdout

    vitac = (sys.executable, "-c", "import sys; from vitac.cli.main import main; sys.exit(main())")
    (tmp_path / "examples").symlink_to(repository / "examples")
    run(*vitac, *(word.replace("290", "4") for word in collect[1:]))
    run(*vitac, *export[1:])
    run(python, example / "blind.py", "act_demonstrations", "blind_demonstrations")
    statistics = json.loads((tmp_path / "blind_demonstrations/meta/stats.json").read_text())
    assert not any(statistics["observation.environment_state"]["max"])
    for data_set, options in (("act_demonstrations", []), ("blind_demonstrations", ["--blind"])):
        words = [re.sub("^--steps=.*|^--batch_size=.*", "", word) for word in train[1:] if "_dir=" not in word]
        words = [word.replace("act_demonstrations", data_set) for word in words if word]
        trainer = Path(python).with_name("lerobot-train")
        run(trainer, *words, "--steps=2", "--batch_size=4", f"--output_dir=run_{data_set}")
        checkpoint = f"run_{data_set}/checkpoints/last/pretrained_model"
        played = run(python, example / "play.py", checkpoint, "--vitac", sys.executable, "--starts", "1", *options)
        assert re.search("[01] of 1 solved", played)
