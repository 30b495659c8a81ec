"""Plays on an emulated ARM64 machine and compares every bit with what this machine gives.

Run it as `python benchmarks/other_architecture.py FOLDER` on Debian with `qemu-user-static`. FOLDER keeps Debian's
ARM64 Python, the ARM64 wheels of `requirements/base.lock` and the compiled kernels; the first run takes a
quarter of an hour.
"""

import argparse
import hashlib
import importlib
import json
import os
import platform
import subprocess
import sys
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
HEURISTIC = ROOT / "examples" / "peg_insertion_heuristic"
DOME = ROOT / "examples" / "track_3_dome"
EPISODES = range(1, 21)
PLATFORMS = ("manylinux_2_28_aarch64", "manylinux_2_27_aarch64", "manylinux_2_17_aarch64", "manylinux2014_aarch64")


def main() -> None:
    """Compare, or play where `--play` says so."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--play", action="store_true", help="play here and print what was played")
    arguments = parser.parse_args()
    if arguments.play:
        print(json.dumps(play()))
        return
    if arguments.folder is None:
        parser.error("name a folder of at least 1 GB")
    folder = arguments.folder.resolve()
    prepare(folder)
    ours, ours_s = run([sys.executable], {})
    python = str(folder / "root/usr/bin/python3.11")
    emulated = ["qemu-aarch64-static", "-L", str(folder / "root"), python]
    theirs, theirs_s = run(emulated, {"PYTHONPATH": str(folder / "packages"), "VITAC_CACHE_DIR": str(folder / "cache")})
    print(f"{ours.pop('machine')}: {ours_s:.0f} s; {theirs.pop('machine')}, emulated: {theirs_s:.0f} s")
    for name in ours:
        print(f"{'equal' if ours[name] == theirs[name] else 'DIFFERENT':10} {name}")
    if ours != theirs:
        sys.exit(1)


def run(python: Sequence[str], variables: dict[str, str]) -> tuple[dict[str, Any], float]:
    """Return what this file plays under an interpreter, and the time that it took [s]."""
    command = [*python, "-P", __file__, "--play"]
    started = perf_counter()
    played = subprocess.run(command, env=os.environ | variables, check=True, stdout=subprocess.PIPE, text=True)  # noqa: S603
    return json.loads(played.stdout.splitlines()[-1]), perf_counter() - started


def prepare(folder: Path) -> None:
    """Fetch Python and its packages, once."""
    done = folder / "complete"
    if done.exists():
        return
    for name in ("apt/lists/partial", "apt/archives/partial", "debs", "wheels", "root", "packages/vitac"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    (folder / "apt/status").touch()
    (folder / "apt/sources.list").write_text(find_source())
    settings = {
        "APT::Architecture": "arm64", "APT::Architectures": "arm64", "Dir::State": folder / "apt",
        "Dir::State::status": folder / "apt/status", "Dir::Cache": folder / "apt",
        "Dir::Etc::sourcelist": folder / "apt/sources.list", "Dir::Etc::sourceparts": folder / "apt/none",
        "Debug::NoLocking": 1,
    }  # fmt: skip
    apt = ["apt-get", *(part for name, value in settings.items() for part in ("-o", f"{name}={value}"))]
    call([*apt, "update"])
    plan = call([*apt, "-s", "install", "--no-install-recommends", "python3", "libstdc++6", "libgomp1"])
    names = [line.split()[1] for line in plan.splitlines() if line.startswith("Inst ")]
    call([*apt, "download", *names], cwd=folder / "debs")
    for package in (folder / "debs").glob("*.deb"):
        call(["dpkg-deb", "--extract", str(package), str(folder / "root")])
    # Not the lock itself, whose markers pip would judge by this machine; its versions are the same.
    lock = (ROOT / "requirements/base.lock").read_text().splitlines()
    wanted = [line.split()[0] for line in lock if line[:1].isalnum()]
    pip = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary", ":all:"]
    pip += [part for name in (*PLATFORMS, "any") for part in ("--platform", name)]
    call([*pip, "--python-version", "3.11", "--implementation", "cp", "--dest", str(folder / "wheels"), *wanted])
    for wheel in (folder / "wheels").glob("*.whl"):
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(folder / "packages")
    for link in (ROOT / ".dev/vitac").iterdir():
        (folder / "packages/vitac" / link.name).symlink_to(link.resolve())
    done.touch()


def find_source() -> str:
    """Return the line that names this machine's own source of Debian packages."""
    wanted = ["Created-By: Packages", "Origin: Debian"]
    targets = call(["apt-get", "indextargets", "--format", "$(SITE) $(RELEASE) $(COMPONENT)", *wanted])
    return f"deb [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] {targets.splitlines()[0]}\n"


def call(command: Sequence[str], cwd: Path | None = None) -> str:
    """Return what a program prints."""
    return subprocess.run(command, cwd=cwd, check=True, stdout=subprocess.PIPE, text=True).stdout  # noqa: S603


def play() -> dict[str, Any]:
    """Return digests of all environments, pictures, pinned episodes, a sensor, and the hash of an evaluation."""
    sys.path.append(str(ROOT / "tests/support/envs"))
    trajectories, pinned = importlib.import_module("trajectories"), importlib.import_module("pinned_states")
    golden = {name: pinned.state_hashes(episode) for name, episode in pinned.EPISODES.items()}
    return {
        "machine": platform.machine(),
        **trajectories.digests(),
        **golden,
        "sensor of examples/track_3_dome": play_dome(),
        f"result hash of {len(EPISODES)} episodes of the heuristic": evaluate_heuristic(),
    }


def play_dome() -> str:
    """Return the digest of two env steps with the example's sensor."""
    import numpy as np
    from vitac.evaluator.episodes.episode import make_environment
    from vitac.evaluator.sensors.made import read_design
    from vitac.evaluator.submission.sources import staged
    from vitac.evaluator.tracks import find_task

    with staged(DOME) as folder:
        made: Any = make_environment(find_task("peg-insertion")[1], sensor=read_design(folder))
    env = made.unwrapped
    digest = hashlib.sha256()
    observation, _ = env.reset(seed=5)
    for action in np.random.default_rng(5).uniform(-1, 1, (2, 3)).astype(np.float32):
        observation, *_ = env.step(action)
        digest.update(env.state_hash().encode() + b"".join(observation[key].tobytes() for key in sorted(observation)))
    return digest.hexdigest()


class PolicyHere:
    """The example's policy in this process: a sandbox needs programs of its own architecture."""

    isolation = None
    cpu_s = channel_s = 0.0
    answers_s: tuple[float, ...] = ()
    output = ""

    def __init__(self, folder: Path) -> None:
        sys.path.insert(0, str(folder))
        self._make = importlib.import_module("policy").Policy

    def begin_shard(self) -> None:
        """Nothing is counted."""

    @contextmanager
    def episode(self, *, task: str, **_: object) -> Iterator["PolicyHere"]:
        """Give a new policy."""
        self._policy = self._make()
        self._policy.reset(task)
        yield self

    def act(self, observation: Any) -> Any:
        """Return the policy's action, as the channel carries it."""
        import numpy as np

        return np.asarray(self._policy.act(observation), dtype=np.float32)


def evaluate_heuristic() -> str:
    """Return the result hash of the first episodes."""
    from vitac.evaluator.episodes.episode import make_environment, run_episode
    from vitac.evaluator.episodes.records import make_manifest, make_reading, result_hash
    from vitac.evaluator.submission.manifest import load_manifest
    from vitac.evaluator.submission.sources import staged
    from vitac.evaluator.tracks import find_task

    track, task = find_task("peg-insertion")
    with staged(HEURISTIC) as folder:
        policy = PolicyHere(folder)
        reading = make_reading(task, load_manifest(folder).observation_keys)
        env = make_environment(task, None, reading.sent)
        records = [
            run_episode(env=env, task=task, episode=episode, open_session=lambda: policy, reading=reading)
            for episode in task.episodes
            if episode.number in EPISODES
        ]
    return result_hash(make_manifest(track, task, env), records)


if __name__ == "__main__":
    main()
