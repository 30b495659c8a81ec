"""Plays the organizers' logged peg episodes, their actions and past every flag, and keeps what came of each step."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vitac.envs.fem.model.settings import SolverSettings
from vitac.envs.fem.scene.report import StepReport
from vitac.envs.scene.grasped_scene import PhysicsSettings
from vitac.envs.tasks.peg_insertion.env import PegInsertionEnv

FloatArray = NDArray[np.float64]
Episode = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Reference:
    """What the reference folder holds of the peg task.

    Attributes:
        assets_dir: the challenge's meshes.
        log: the organizers' episodes of repeat 0, in order.
        settled: settled states from an independent implementation, by (episode, env step).
    """

    assets_dir: Path
    log: list[Episode]
    settled: dict[tuple[int, int], dict[str, Any]]


def read_reference(folder: Path) -> Reference:
    """Read the reference folder."""
    lines = (folder / "logs" / "track1_peg_insertion.repeat0.jsonl").read_text().splitlines()
    truth = json.loads((folder / "physics_truth.json").read_text())["episodes"]
    return Reference(
        assets_dir=folder / "assets" / "track1",
        log=[json.loads(line) for line in lines],
        settled={(e["episode"], step["n"]): step for e in truth for step in e["steps"]},
    )


@dataclass(frozen=True, kw_only=True)
class EnvStep:
    """One env step as played: `surface_diff` of both sensors [mm], the info, and whether its physics was solved."""

    episode: int
    n: int
    surface_diff_mm: FloatArray
    info: dict[str, Any]
    solved: bool


@dataclass
class Replay:
    """Episodes played one after another, with CPU times of the physics alone."""

    assets_dir: Path
    solver: SolverSettings = field(default_factory=SolverSettings)
    steps: list[EnvStep] = field(default_factory=list)
    reports: list[StepReport] = field(default_factory=list)
    step_ms: list[float] = field(default_factory=list)
    reset_ms: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.env = PegInsertionEnv(assets_dir=self.assets_dir, physics=PhysicsSettings(solver=self.solver))
        self._clock_s = 0.0

    def play(self, episode: Episode, *, first_steps: int | None = None) -> None:
        """Play an episode, or its first env steps."""
        before_s = self.env.physics_cpu_s
        _, info = self.env.reset(options={"shape": episode["shape"], "offset_mm_deg": episode["initial_offset"]})
        self.reset_ms.append((self.env.physics_cpu_s - before_s) * 1e3)
        self.reports.extend(info["step_reports"])
        self.env.scene.after_ipc_step = self._lap
        for logged in episode["steps"][:first_steps]:
            self._clock_s = self.env.physics_cpu_s
            *_, info = self.env.step(np.array(logged["action"], dtype=np.float32))
            self.reports.extend(info["step_reports"])
            self.steps.append(
                EnvStep(
                    episode=episode["episode"],
                    n=logged["n"],
                    surface_diff_mm=info["surface_diff_m"] * 1e3,
                    info=info,
                    solved=self.env.scene.solved,
                )
            )

    def index_by_step(self) -> dict[tuple[int, int], EnvStep]:
        """Return the solved env steps by (episode, env step)."""
        return {(step.episode, step.n): step for step in self.steps if step.solved}

    def _lap(self) -> None:
        now_s = self.env.physics_cpu_s
        self.step_ms.append((now_s - self._clock_s) * 1e3)
        self._clock_s = now_s
