"""Random episodes at the bounds of what a policy may do, every IPC step checked.

Usage: python tests/support/physics/physics_fuzz.py
           [--task peg|tilted|lock|moving|explore|turn|slip|plug|assembly|cable] [--first SEED]
           [--episodes N] [--past-end] [--eigenvalues] [--json FILE]

Prints every IPC step that was divided, did not converge or would not last, with the numbers that play it again.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from balance_check import SAME_FORCE_N, BalanceCheck
from intersection_check import GraspedSceneCheck
from vitac.envs.fem.scene.report import StepReport, StepStatus
from vitac.envs.geometry.keys_and_locks import KeyShape
from vitac.envs.geometry.pegs import PegShape
from vitac.envs.scene.grasped_scene import GraspedScene, PhysicsSettings
from vitac.envs.tasks.assembly.env import LARGEST_MM_DEG, AssemblyEnv, HeadShape
from vitac.envs.tasks.explore.definition import EndShape
from vitac.envs.tasks.explore.env import ExploreEnv
from vitac.envs.tasks.in_hand_turn.env import DRAWN, InHandTurnEnv, RodShape
from vitac.envs.tasks.lock_opening.env import LockOpeningEnv, lock_physics
from vitac.envs.tasks.moving_hole.env import MovingHoleEnv
from vitac.envs.tasks.peg_insertion.env import PegInsertionEnv
from vitac.envs.tasks.slip.env import SlipEnv, SlipShape
from vitac.envs.tasks.soft_plug.env import CableEndEnv, PlugShape, SoftPlugEnv
from vitac.envs.tasks.task_env import TactileTaskEnv

PEG, LOCK, MOVING, EXPLORE, TURN, SLIP, PLUG = "peg", "lock", "moving", "explore", "turn", "slip", "plug"
ASSEMBLY, TILTED, CABLE = "assembly", "tilted", "cable"
TASKS = (PEG, LOCK, MOVING, EXPLORE, TURN, SLIP, PLUG, ASSEMBLY, TILTED, CABLE)
ENV_STEPS = 8


@dataclass(frozen=True, kw_only=True)
class FuzzedStep:
    """One IPC step of a fuzzed episode."""

    task: str
    seed: int
    env_step: int  # 0: in the reset
    number: int  # of the IPC step in the env step, from 1
    status: str
    newton_iterations: int
    residual_n: float  # as the solver reports it
    force_left_n: float | None  # assembled anew; None in a reset before its last IPC step, and in shorter IPC steps
    unstable: bool  # called solved, but the determinant of the Jacobian, assembled anew, is negative
    growing_directions: int | None  # eigenvalues of that Jacobian with a negative real part; None if not asked for
    oscillating_directions: int | None  # those of them that are not real
    smallest_gap_m: float
    smallest_det_f: float
    intersects: bool
    overlooked: bool  # bodies are nearer than the engine says: a contact is missing in its list
    past_end: bool  # played after a flag had ended the episode, as only a re-simulation does


def fuzzed_environment(task: str, random: np.random.Generator, assets_dir: Path | None) -> TactileTaskEnv[Any, Any]:
    """An environment with friction and indentation drawn over their training ranges."""
    indentation_mm = float(random.uniform(0.5, 1.25))
    gel_friction = float(random.uniform(50, 125))
    if task == PEG:
        return PegInsertionEnv(
            assets_dir=assets_dir,
            indentation_mm=indentation_mm,
            peg_friction=float(random.uniform(4, 15)),
            hole_friction=float(random.uniform(0, 1)),
            gripper_x_mm=float(random.uniform(-1, 1)),
            gripper_z_mm=float(random.uniform(-10, -6)),
            physics=PhysicsSettings(gel_friction=gel_friction),
        )
    if task == TILTED:
        tilts = dict.fromkeys(("peg_tilt_deg", "hole_tilt_x_deg", "hole_tilt_y_deg"), (-3.0, 3.0))
        return PegInsertionEnv(assets_dir=assets_dir, contact_model="arena-2", draws=tilts)
    if task == MOVING:
        return MovingHoleEnv(
            assets_dir=assets_dir,
            indentation_mm=indentation_mm,
            gripper_x_mm=float(random.uniform(-1, 1)),
            gripper_z_mm=float(random.uniform(-10, -6)),
            plate_speed_mm_s=float(random.uniform(0, 3)),
        )
    if task == EXPLORE:
        return ExploreEnv(assets_dir=assets_dir, indentation_mm=indentation_mm, press_mm=float(random.uniform(0.1, 1)))
    if task == TURN:
        draws = {"gel_friction": (0.2, 0.45), "indentation_mm": (0.3, 0.6), "held_mm": (-4.0, 4.0)}
        return InHandTurnEnv(assets_dir=assets_dir, draws=draws)
    if task == SLIP:
        drawn = {
            "part_mass_kg": (0.05, 1.0), "centre_of_mass_mm": (-2.5, 2.5), "gel_friction": (0.2, 2.0),
            "load_n": (0.0, 30.0),
        }  # fmt: skip
        return SlipEnv(assets_dir=assets_dir, draws=drawn)
    if task == PLUG:
        drawn = {"plug_modulus_mpa": (0.8, 4.0), "interference_mm": (-0.2, 0.2), "indentation_mm": (0.4, 0.8)}
        return SoftPlugEnv(assets_dir=assets_dir, draws=drawn)
    if task == CABLE:
        drawn = {"plug_modulus_mpa": (2.0, 6.0), "interference_mm": (-0.3, -0.1), "indentation_mm": (0.4, 0.8)}
        return CableEndEnv(assets_dir=assets_dir, draws=drawn)
    if task == ASSEMBLY:
        return AssemblyEnv(assets_dir=assets_dir, draws={"gel_friction": (0.3, 1.5)})
    standard = lock_physics()
    physics = PhysicsSettings(
        gel_friction=gel_friction, time_step_s=standard.time_step_s, contact=standard.contact, solver=standard.solver
    )
    return LockOpeningEnv(
        assets_dir=assets_dir,
        indentation_mm=indentation_mm,
        key_friction=float(random.uniform(0.2, 1)),
        lock_friction=float(random.uniform(0, 1)),
        physics=physics,
    )


def start_options(task: str, random: np.random.Generator) -> dict[str, Any]:
    """A start anywhere in the task's range, blocked or not."""
    if task in {PEG, TILTED, MOVING}:
        x, y, theta = random.uniform(-1, 1, 3) * (5, 5, 10)
        return {"shape": str(random.choice(list(PegShape))), "offset_mm_deg": (float(x), float(y), float(theta))}
    if task == EXPLORE:
        x, y, angle = random.uniform(-1, 1, 3) * (3, 3, 30)
        return {"shape": str(random.choice(list(EndShape))), "end_pose_mm_deg": (float(x), float(y), float(angle))}
    if task == TURN:
        start = tuple(float(random.uniform(*limits)) for limits in DRAWN)
        return {"shape": str(random.choice(list(RodShape))), "start_mm_deg": start}
    if task == SLIP:
        x, z = random.uniform(-1, 1, 2) * (3, 6)
        return {"shape": str(random.choice(list(SlipShape))), "offset_mm": (float(x), float(z))}
    if task == PLUG:
        x, y = random.uniform(-3, 3, 2)
        return {"shape": str(random.choice(list(PlugShape))), "offset_mm": (float(x), float(y))}
    if task == CABLE:
        x, y = random.uniform(-3, 3, 2)
        return {"offset_mm": (float(x), float(y))}
    if task == ASSEMBLY:
        offset = tuple(float(random.uniform(-largest, largest)) for largest in LARGEST_MM_DEG)
        return {"shape": str(random.choice(list(HeadShape))), "offset_mm_deg": offset}
    shape = str(random.choice(list(KeyShape)))
    return {"shape": shape, "offset_mm": (float(random.uniform(0, 5)), 0.0, 0.0)}


def fuzzed_action(random: np.random.Generator, size: int) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Half of the actions have every component at a bound; the others are anywhere."""
    if random.random() < 0.5:
        return random.choice(np.array([-1.0, 1.0]), size).astype(np.float32)
    return random.uniform(-1, 1, size).astype(np.float32)


@dataclass(frozen=True, kw_only=True)
class Seen:
    """What the IPC Toolkit sees after an IPC step, and what forces and Jacobian say that are assembled anew."""

    intersects: bool = False
    smallest_gap_m: float = np.inf
    force_left_n: float | None = None
    negative_determinant: bool = False
    growing_directions: int | None = None
    oscillating_directions: int | None = None


class _Watch:
    """Checks the scene after every IPC step, while the environment is stepping it."""

    def __init__(self, scene: GraspedScene, *, eigenvalues: bool) -> None:
        self._scene, self._check, self._seen = scene, GraspedSceneCheck(scene), list[Seen]()
        self._eigenvalues = eigenvalues
        self._balance = BalanceCheck(scene._scene)
        scene.after_ipc_step = self._look

    def bodies(self) -> Seen:
        """What can be seen without the state before."""
        gap_m = self._check.smallest_gap_m(self._scene)
        return Seen(intersects=self._check.intersects(self._scene), smallest_gap_m=gap_m)

    def _look(self) -> None:
        report = self._scene._last_report
        if report and report.status is StepStatus.SHORTENED:  # What balances is its last part.
            self._seen.append(self.bodies())
            self._balance.remember()
            return
        loads = {number: load(self._scene.time_s) for number, load in self._scene._loads.items()}
        left = self._balance.balance(loads)
        growing, oscillating = left.growing_directions() if self._eigenvalues else (None, None)
        self._seen.append(
            replace(
                self.bodies(),
                force_left_n=left.largest_force_n,
                negative_determinant=left.has_negative_determinant,
                growing_directions=growing,
                oscillating_directions=oscillating,
            )
        )
        self._balance.remember()

    def take(self) -> list[Seen]:
        taken, self._seen = self._seen, []
        return taken


def fuzz_episode(
    task: str, seed: int, *, past_end: bool = False, eigenvalues: bool = False, assets_dir: Path | None = None
) -> Iterator[FuzzedStep]:
    """Play one random episode until it ends, or on to its last env step unless an IPC step does not converge."""
    random = np.random.default_rng(np.random.SeedSequence([1 + TASKS.index(task), seed]))
    env = fuzzed_environment(task, random, assets_dir)
    options = start_options(task, random) | {"rng_seed": (seed,)}
    _, info = env.reset(options=options)
    watch = _Watch(env.scene, eigenvalues=eigenvalues)
    reports: tuple[StepReport, ...] = info["step_reports"]
    # The scene can only be looked at from the end of the reset on.
    seen = [Seen()] * (len(reports) - 1) + [watch.bodies()]
    ended = False
    yield from _steps(task, seed, 0, reports, seen, ended)
    for env_step in range(1, ENV_STEPS + 1):
        if not env.scene.solved or (ended and not past_end):
            return
        *_, info = env.step(fuzzed_action(random, len(env.task.actions)))
        yield from _steps(task, seed, env_step, info["step_reports"], watch.take(), ended)
        ended = ended or info["end_reason"] is not None


def _steps(
    task: str, seed: int, env_step: int, reports: tuple[StepReport, ...], seen: list[Seen], ended: bool
) -> Iterator[FuzzedStep]:
    for number, (report, now) in enumerate(zip(reports, seen, strict=True), start=1):
        yield FuzzedStep(
            task=task,
            seed=seed,
            env_step=env_step,
            number=number,
            status=str(report.status),
            newton_iterations=report.newton_iterations,
            residual_n=report.residual_n,
            force_left_n=now.force_left_n,
            unstable=report.status is not StepStatus.NOT_CONVERGED and now.negative_determinant,
            growing_directions=now.growing_directions,
            oscillating_directions=now.oscillating_directions,
            smallest_gap_m=report.smallest_gap_m,
            smallest_det_f=report.smallest_det_f,
            intersects=now.intersects,
            overlooked=now.smallest_gap_m < report.smallest_gap_m * (1 - 1e-6),
            past_end=ended,
        )


def summary(steps: list[FuzzedStep]) -> dict[str, float]:
    """Counts and extremes over fuzzed steps."""
    status = [step.status for step in steps]
    solved = [step for step in steps if step.status != StepStatus.NOT_CONVERGED]
    left_n = [(step.force_left_n, step.residual_n) for step in solved if step.force_left_n is not None]
    growing = [step.growing_directions for step in solved if step.growing_directions is not None]
    return {
        "episodes": len({(step.task, step.seed) for step in steps}),
        "ipc_steps": len(steps),
        "divided": status.count(StepStatus.DIVIDED),
        "escaped_saddle": status.count(StepStatus.ESCAPED_SADDLE),
        "shortened": status.count(StepStatus.SHORTENED),
        "gave_way": status.count(StepStatus.GAVE_WAY),
        "not_converged": status.count(StepStatus.NOT_CONVERGED),
        "intersections": sum(step.intersects for step in steps),
        "overlooked": sum(step.overlooked for step in steps),
        "smallest_det_f": min(step.smallest_det_f for step in steps),
        "smallest_gap_m": min(step.smallest_gap_m for step in steps),
        "looked_at": len(left_n),
        "largest_force_left_n": max(found for found, _ in left_n),
        "misreported": sum(abs(found - reported) > SAME_FORCE_N for found, reported in left_n),
        "unstable": sum(step.unstable for step in solved),
        "eigenvalues_taken": len(growing),
        "growing": sum(directions > 0 for directions in growing),
        "growing_in_two_directions": sum(directions > 1 for directions in growing),
        "mean_newton_iterations": sum(step.newton_iterations for step in steps) / len(steps),
    }


def _is_remarkable(step: FuzzedStep) -> bool:
    """Whether a person has to look at it."""
    wrong = step.intersects or step.overlooked or step.smallest_det_f <= 0
    return wrong or step.status != StepStatus.CONVERGED or bool(step.growing_directions)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", choices=TASKS, default=PEG)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--past-end", action="store_true", help="play on after a flag ended the episode")
    parser.add_argument("--eigenvalues", action="store_true", help="also count directions that grow; takes much longer")
    parser.add_argument("--assets", type=Path)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    steps: list[FuzzedStep] = []
    began = time.process_time()
    for seed in range(arguments.first, arguments.first + arguments.episodes):
        for step in fuzz_episode(
            arguments.task,
            seed,
            past_end=arguments.past_end,
            eigenvalues=arguments.eigenvalues,
            assets_dir=arguments.assets,
        ):
            steps.append(step)
            if _is_remarkable(step):
                sys.stdout.write(f"{asdict(step)}\n")
                sys.stdout.flush()
    unsolved = [asdict(step) for step in steps if step.status == StepStatus.NOT_CONVERGED]
    result = {
        "task": arguments.task,
        "first_seed": arguments.first,
        "past_end": arguments.past_end,
        **summary(steps),
        "unsolved": unsolved,
        "cpu_s": time.process_time() - began,
    }
    sys.stdout.write(json.dumps(result, indent=1) + "\n")
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
