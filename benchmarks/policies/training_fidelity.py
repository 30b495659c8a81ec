"""What `fidelity="training"` gives up and gains: speed, motion of the gels, forces, and successes on the same starts.

python benchmarks/policies/training_fidelity.py [--starts 60] [--replays 30] [--json FILE]

- Speed: env steps per CPU second of one process with random actions, resets included, at both fidelities in turn.
- Motion and forces: actions of random size from the same starts at both; differences of the sensing nodes, projected
  into the sensor's picture, and of the force on the held part.
- Successes: example policies, and a planner that knows the truth, from the same starts with the same noise at both.

Exits with 1 if the peg plays less than 100 env steps per CPU second, or a policy's success differs significantly.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from time import process_time
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "variants"))

import numpy as np
from players import EXAMPLES, Example, Planner, Player
from vitac.envs.tactile.camera import CHALLENGE_CAMERA, project
from vitac.envs.tasks.settings import Fidelity
from vitac.evaluator.scoring.score import rate
from vitac.evaluator.scoring.starts import permutation_p_value
from vitac.evaluator.tracks import find_task
from vitac.training.demonstrations.frames import make_observed_environment
from vitac.training.run import format_rate

POLICIES = {
    "peg-insertion": ("peg_insertion_heuristic", "peg_insertion_trained"),
    "lock-opening": ("lock_opening_heuristic", "lock_opening_trained", "lock_opening_cloned"),
}
SEED = 3_000_000
AIM_PER_S, LEAST_P = 100.0, 0.05
MOST_STEPS = 8


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--starts", type=int, default=60, help="from which each policy plays")
    parser.add_argument("--replays", type=int, default=30, help="episodes of random actions")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    chosen = parser.parse_args()
    found: dict[str, Any] = {}
    for task in POLICIES:
        found[task] = {"replays": compare_replays(task, chosen.replays)}
        print(f"{task}: {json.dumps(found[task]['replays'])}", flush=True)
        for name in (*POLICIES[task], "planner"):
            found[task][name] = compare_successes(task, name, chosen.starts)
            print(f"{task}, {name}: {json.dumps(found[task][name])}", flush=True)
    if chosen.json:
        chosen.json.write_text(json.dumps(found, indent=1) + "\n")
    too_slow = found["peg-insertion"]["replays"]["env_steps_per_cpu_s"][Fidelity.TRAINING] < AIM_PER_S
    differing = [
        name for task, names in POLICIES.items() for name in (*names, "planner") if found[task][name]["p"] < LEAST_P
    ]
    print(f"too slow: {too_slow}; successes that differ: {', '.join(differing) or 'none'}")
    sys.exit(int(too_slow or bool(differing)))


def compare_replays(task: str, count: int) -> dict[str, Any]:
    """Return speed, and how far motion and forces of the same actions differ."""
    envs = {fidelity: observed_environment(task, fidelity) for fidelity in Fidelity}
    cpu_s, played = dict.fromkeys(Fidelity, 0.0), dict.fromkeys(Fidelity, 0)
    motions_px, motion_errors_px, forces_n, force_errors_n, diff_errors_m = [], [], [], [], []
    for number in range(-1, count):
        paths = {}
        for fidelity, env in envs.items():
            before_s = process_time()
            paths[fidelity] = list(replay(env, number))
            if number >= 0:  # the first loads the kernels
                cpu_s[fidelity] += process_time() - before_s
                played[fidelity] += len(paths[fidelity])
        for exact, fast in zip(*paths.values(), strict=False):
            motions_px.append(exact[0])
            motion_errors_px.append(fast[0] - exact[0])
            forces_n.append(exact[1])
            force_errors_n.append(fast[1] - exact[1])
            diff_errors_m.append(fast[2] - exact[2])
    rates = {str(fidelity): round(played[fidelity] / cpu_s[fidelity], 1) for fidelity in Fidelity}
    errors_px = np.abs(motion_errors_px)
    return {
        "env_steps_per_cpu_s": rates,
        "ratio": round(rates[Fidelity.TRAINING] / rates[Fidelity.FULL], 2),
        "moments": len(motions_px),
        "motion_rms_px": rms(motions_px),
        "motion_error_px": {"rms": rms(motion_errors_px), **quantiles(errors_px)},
        "force_rms_n": rms(forces_n),
        "force_error_n": {"rms": rms(force_errors_n), **quantiles(np.abs(force_errors_n))},
        "surface_diff_error_um": {"rms": 1e6 * rms(diff_errors_m), "mean": float(1e6 * np.mean(diff_errors_m))},
    }


def observed_environment(task: str, fidelity: Fidelity) -> Any:
    """Return an environment that observes the sensing faces and the forces."""
    _, found = find_task(task)
    wanted = [entry for entry in found.definition.observables if entry.name in ("surface_pts", "contact_forces")]
    return make_observed_environment(found, wanted, fidelity=fidelity.value)


def replay(env: Any, number: int) -> Iterator[tuple[Any, Any, Any]]:
    """Play random actions of one size; yield motion of nodes [px], force on the part [N] and `surface_diff` [m]."""
    random = np.random.default_rng((SEED, number + 1))
    size = random.uniform(0.2, 1.0)
    env.reset(options={"rng_seed": (SEED, number + 1)})
    for _ in range(MOST_STEPS):
        action = size * random.uniform(-1, 1, env.action_space.shape)
        observation, _, terminated, truncated, info = env.step(action.astype(np.float32))
        faces = observation["surface_pts"].astype(np.float64)
        seen_px = [[project(np.ascontiguousarray(moment), CHALLENGE_CAMERA) for moment in side] for side in faces]
        yield (
            np.array([now - before for before, now in seen_px]),
            observation["contact_forces"][0],
            (np.array(info["surface_diff_m"])),
        )
        if terminated or truncated:
            return


def compare_successes(task: str, name: str, count: int) -> dict[str, Any]:
    """Return successes at both fidelities from the same starts, and the exact p of as many differing pairs."""
    solved: dict[Fidelity, list[bool]] = {fidelity: [] for fidelity in Fidelity}
    for fidelity in Fidelity:
        player = make_player(task, name, fidelity)
        for number in range(count):
            info = player.play({"rng_seed": (SEED + 1, number)})
            solved[fidelity].append(info["end_reason"] == "success")
    pairs = list(zip(*solved.values(), strict=True))
    lost, won = pairs.count((True, False)), pairs.count((False, True))
    rates = {str(fidelity): format_rate(rate(sum(each), count)) for fidelity, each in solved.items()}
    return {**rates, "only_full": lost, "only_training": won, "p": permutation_p_value([1] * lost + [-1] * won)}


def make_player(task: str, name: str, fidelity: Fidelity) -> Player:
    """Return an example or the planner at a fidelity."""
    track, found = find_task(task)
    if name == "planner":
        return Planner(found, fidelity=fidelity.value)
    return Example(found, EXAMPLES / name / track.folder, named=task, fidelity=fidelity.value)


def rms(values: Any) -> float:
    """Return the root mean square of all numbers."""
    return float(np.sqrt(np.mean(np.square(np.concatenate([np.ravel(value) for value in values])))))


def quantiles(values: Any) -> dict[str, float]:
    """Return median and 95th percentile of all numbers."""
    return {"median": float(np.median(values)), "p95": float(np.quantile(values, 0.95))}


if __name__ == "__main__":
    main()
