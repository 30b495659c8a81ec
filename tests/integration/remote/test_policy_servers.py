"""The packages that serve policies, unmodified, each in an environment of its own from the registry."""

import contextlib
import os
import socket
import subprocess
import sysconfig
import time
import venv
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.episodes.records import result_hash
from vitac.evaluator.evaluation import serving
from vitac.evaluator.evaluation.local import LocalEvaluation, evaluate
from vitac.evaluator.logs.log import LogReader
from vitac.evaluator.remote.description import RemoteServer
from vitac.evaluator.remote.session import RemoteSession
from vitac.evaluator.shards.policy import load_in_sandbox, load_remote
from vitac.evaluator.submission.sources import staged
from vitac.evaluator.tracks import load_track

pytestmark = pytest.mark.slow
EPISODES = range(1, 1 + int(os.environ.get("VITAC_REMOTE_EPISODES", "12")))
PEG_HEURISTIC = Path(__file__).parents[3] / "examples" / "peg_insertion_heuristic" / "Track_1"
OPENPI = """
import sys
import numpy as np
sys.path.insert(0, sys.argv[2])
from policy import Policy
from openpi_server import WebsocketPolicyServer

class Served:
    def infer(self, observation):
        if not np.any(observation["state"]):
            self.policy = Policy()
            self.policy.reset(observation["prompt"])
        names = {"marker_flow": observation["observation/touch"], "relative_motion": observation["state"]}
        return {"actions": np.asarray(self.policy.act(names))[None].repeat(5, axis=0)}

WebsocketPolicyServer(Served(), host="127.0.0.1", port=int(sys.argv[1])).serve_forever()
"""
VLA_EVAL = """
import sys
import numpy as np
sys.path.insert(0, sys.argv[2])
from policy import Policy
from vla_eval.model_servers.predict import PredictModelServer
from vla_eval.model_servers.serve import serve

class Served(PredictModelServer):
    async def on_episode_start(self, config, ctx):
        await super().on_episode_start(config, ctx)
        self.policy = Policy()
        self.policy.reset(config["task"]["name"])

    def predict(self, observation, ctx):
        if "images" in observation:
            assert observation["task_description"] == "Look."
            return {"actions": observation["images"]["wrist"].astype(float).mean(axis=(0, 1)) / 255}
        return {"actions": self.policy.act(observation)}

serve(Served(), host="127.0.0.1", port=int(sys.argv[1]))
"""
LEROBOT = """
import sys
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies import ACTConfig, make_pre_post_processors
from lerobot.policies.act.modeling_act import ACTPolicy

torch.manual_seed(0)
state, picture, action = (PolicyFeature(FeatureType[kind], shape) for kind, shape in
    (("STATE", (4,)), ("VISUAL", (3, 64, 64)), ("ACTION", (4,))))
seen = {"observation.state": state, "observation.images.wrist": picture}
small = {"dim_model": 32, "n_heads": 2, "dim_feedforward": 64, "n_encoder_layers": 1, "use_vae": False}
config = ACTConfig(input_features=seen, output_features={"action": action}, chunk_size=8, n_action_steps=8,
    pretrained_backbone_weights=None, device="cpu", **small)
ACTPolicy(config).save_pretrained(sys.argv[1])
statistics = {name: {"mean": torch.zeros(4), "std": torch.ones(4)} for name in ("observation.state", "action")}
for processors in make_pre_post_processors(config, dataset_stats=statistics):
    processors.save_pretrained(sys.argv[1])
"""


@pytest.fixture(scope="module")
def make_python(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Makes an environment with packages of the registry; skips where it cannot be made."""

    def make(*packages: str) -> Path:
        folder = tmp_path_factory.mktemp("environment")
        venv.create(folder, with_pip=True)
        python = folder / "bin" / "python"
        command = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *packages]
        installed = subprocess.run(command, capture_output=True, text=True)
        if installed.returncode:
            pytest.skip(f"{' and '.join(packages)} cannot be installed here: {installed.stderr[-300:]}")
        return python

    return make


def free_port() -> int:
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        port: int = sock.getsockname()[1]
    return port


@contextlib.contextmanager
def served(python: Path, program: str, folder: Path) -> Iterator[str]:
    """Serves the policy of the heuristic with a program on a free port."""
    port = free_port()
    script = folder / "serve.py"
    script.write_text(program)
    with (folder / "output").open("wb") as output:
        server = subprocess.Popen([python, script, str(port), PEG_HEURISTIC], stdout=output, stderr=output)
    try:
        yield f"ws://127.0.0.1:{port}"
    finally:
        server.kill()
        server.wait()


@pytest.fixture(scope="module")
def openpi_python(make_python: Callable[..., Path]) -> Path:
    return make_python("openpi-client==0.1.2", "openpi-server==0.1.0")


@pytest.fixture(scope="module")
def vla_eval_python(make_python: Callable[..., Path]) -> Path:
    return make_python("vla-eval==0.8.0")


def test_run_of_vla_eval_plays_our_episodes_with_our_hash(
    vla_eval_python: Path, in_sandbox: LocalEvaluation, tmp_path: Path
) -> None:
    """Its harness and our benchmark are in one environment, which also has the packages of ours."""
    site_packages = sysconfig.get_paths(vars={"base": str(vla_eval_python.parents[1])})["purelib"]
    (Path(site_packages) / "ours.pth").write_text(f"import site; site.addsitedir({sysconfig.get_path('purelib')!r})\n")
    benchmark = {
        "benchmark": "vitac.integrations.vla_eval:ViTac",
        "episodes_per_task": 1,
        "params": {"episodes": list(EPISODES), "log": str(tmp_path / "log.jsonl")},
    }
    with served(vla_eval_python, VLA_EVAL, tmp_path) as address:
        config = {"server": {"url": address}, "output_dir": str(tmp_path / "results"), "benchmarks": [benchmark]}
        (tmp_path / "config.yaml").write_text(yaml.safe_dump(config))
        command = [
            str(vla_eval_python.with_name("vla-eval")),
            "run",
            "--no-docker",
            "-c",
            str(tmp_path / "config.yaml"),
        ]
        finished = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert finished.returncode == 0, finished.stderr[-2000:]
    assert f"result hash of {len(EPISODES)} episodes {in_sandbox.result_hash}" in finished.stderr
    with (tmp_path / "log.jsonl").open("rb") as stream:
        records = list(LogReader(stream).records())
    assert result_hash(in_sandbox.manifest, records) == in_sandbox.result_hash


def play(folder: Path, remote: str | None) -> LocalEvaluation:
    """Plays some episodes of the peg task, with the submission of a folder or a server that it describes."""
    track = load_track("track_1")
    task = track.tasks["peg-insertion"]
    return evaluate(submission_dir=folder, track=track, task=task, episodes=EPISODES, remote=remote)


def described(folder: Path, remote: str) -> Path:
    """A submission that has a server play."""
    text = f"track: track_1\ntasks: [peg-insertion]\nname: from elsewhere\nremote: {remote}\n"
    (folder / "submission.yaml").write_text(text)
    return folder


@pytest.fixture(scope="module")
def in_sandbox() -> LocalEvaluation:
    return play(PEG_HEURISTIC, None)


def test_own_policy_that_is_served_here_plays_with_the_hash_of_the_sandbox(
    in_sandbox: LocalEvaluation, tmp_path: Path
) -> None:
    track = load_track("track_1")
    with (
        staged(PEG_HEURISTIC) as submission,
        serving.served(track, partial(load_in_sandbox, submission, Limits(), track.packages)) as address,
    ):
        assert play(described(tmp_path, "{protocol: vla-eval}"), address).result_hash == in_sandbox.result_hash


def test_openpi_server_plays_with_the_hash_of_the_sandbox(
    openpi_python: Path, in_sandbox: LocalEvaluation, tmp_path: Path
) -> None:
    names = "{observation/touch: marker_flow, state: relative_motion}"
    submission = described(tmp_path, f"{{protocol: openpi, observations: {names}, prompt: peg-insertion}}")
    with served(openpi_python, OPENPI, tmp_path) as address:
        evaluation = play(submission, address)
    assert evaluation.result_hash == in_sandbox.result_hash is not None
    assert evaluation.isolation is None


def test_openpi_server_answers_within_two_milliseconds(openpi_python: Path, tmp_path: Path) -> None:
    observation = {"state": np.ones(4, np.float32), "observation/touch": np.ones((2, 2, 128, 2), np.float32)}
    server = RemoteServer.model_validate({"protocol": "openpi"})
    with (
        served(openpi_python, OPENPI.replace("self.policy.act(names)", "np.zeros(3)"), tmp_path) as address,
        RemoteSession(address, server) as session,
        session.episode(task="peg-insertion", action_shape=(3,)) as policy,
    ):
        times_s = []
        for _ in range(100):
            started_s = time.perf_counter()
            policy.act(observation)
            times_s.append(time.perf_counter() - started_s)
    assert np.median(times_s) < 2e-3


def test_vla_eval_server_plays_with_the_hash_of_the_sandbox(
    vla_eval_python: Path, in_sandbox: LocalEvaluation, tmp_path: Path
) -> None:
    submission = described(tmp_path, "{protocol: vla-eval}")
    with served(vla_eval_python, VLA_EVAL, tmp_path) as address:
        assert play(submission, address).result_hash == in_sandbox.result_hash is not None


def test_vla_eval_server_sees_the_pixels_of_a_picture(vla_eval_python: Path, tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
    server = RemoteServer.model_validate(
        {"protocol": "vla-eval", "observations": {"images/wrist": "rgb"}, "prompt": "Look."}
    )
    with (
        served(vla_eval_python, VLA_EVAL, tmp_path) as address,
        RemoteSession(address, server) as session,
        session.episode(task="peg-insertion", action_shape=(3,)) as policy,
    ):
        action = policy.act({"rgb": picture})
    np.testing.assert_allclose(action, picture.mean(axis=(0, 1)) / 255, rtol=1e-6)


@pytest.fixture(scope="module")
def lerobot_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    """LeRobot's own server, and a folder with an ACT of drawn weights, which it may load."""
    python = os.environ.get("LEROBOT_PYTHON_V0_6")
    if python is None:
        pytest.skip(
            "name a Python with `lerobot[async]` 0.6 in LEROBOT_PYTHON_V0_6: it needs 3.12 and torch of its own"
        )
    folder = tmp_path_factory.mktemp("lerobot")
    subprocess.run([python, "-c", LEROBOT, str(folder / "act")], check=True, capture_output=True, cwd=folder)
    command = [
        python,
        "-m",
        "lerobot.async_inference.policy_server",
        "--host=127.0.0.1",
        f"--port={(port := free_port())}",
    ]
    with (folder / "output").open("wb") as output:
        server = subprocess.Popen(command, stdout=output, stderr=output, cwd=folder)
    yield f"grpc://127.0.0.1:{port}", folder / "act"
    server.kill()
    server.wait()


def test_lerobots_server_plays_twice_alike_and_through_a_line_of_ours(
    lerobot_server: tuple[str, Path], tmp_path: Path
) -> None:
    address, model = lerobot_server
    names = "{observation.state: relative_motion, wrist: {key: rgb_picture, size: [64, 64]}}"
    policy = f"{{type: act, path: '{model}'}}"
    remote = f"{{protocol: lerobot, policy: {policy}, execute: 4, observations: {names}}}"
    text = f"track: track_2\ntasks: [fusion-insertion]\nname: ACT\nremote: {remote}\n"
    (tmp_path / "submission.yaml").write_text(text)
    through = tmp_path / "through"
    through.mkdir()
    (through / "submission.yaml").write_text(text.replace(remote, "{protocol: vla-eval}"))
    track = load_track("track_2")
    task = track.tasks["fusion-insertion"]

    def play_fusion(folder: Path, address: str) -> LocalEvaluation:
        return evaluate(submission_dir=folder, track=track, task=task, episodes=EPISODES, remote=address)

    direct = play_fusion(tmp_path, address)
    assert direct.failure is None
    assert play_fusion(tmp_path, address).result_hash == direct.result_hash is not None
    with serving.served(track, partial(load_remote, tmp_path, Limits(), address)) as line:
        assert play_fusion(through, line).result_hash == direct.result_hash
