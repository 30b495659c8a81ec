"""Records for tests, complete and valid, with what a test cares about changed."""

from typing import Any

import numpy as np
from vitac.evaluator.agent.verdicts import VerdictCode
from vitac.evaluator.episodes.records import (
    ActionSequence,
    EpisodeOutcome,
    EpisodeRecord,
    FailureStage,
    Manifest,
    PolicyFailure,
)


def make_manifest(**changes: Any) -> Manifest:
    return Manifest(
        **{
            "track": "track_1",
            "task": "peg-insertion",
            "list_seed": 0,
            "task_hash": "0" * 64,
            "evaluator_version": "1+000000000000",
            "evaluator_hash": "1" * 64,
            "solver_version": "1",
            "mesh_hash": "2" * 64,
            "platform_class": "x86_64-linux",
            **changes,
        }
    )


def make_failure(**changes: Any) -> PolicyFailure:
    return PolicyFailure(
        **{"stage": FailureStage.EPISODE, "code": VerdictCode.CRASHED, "message": "It ended with signal 11.", **changes}
    )


def make_record(
    episode: int = 1, outcome: EpisodeOutcome = EpisodeOutcome.SUCCESS, env_steps: int = 3, **changes: Any
) -> EpisodeRecord:
    actions = np.arange(3 * env_steps, dtype=np.float32).reshape(env_steps, 3) / np.float32(100)
    return EpisodeRecord(
        **{
            "episode": episode,
            "task": "peg-insertion",
            "shape": ("cuboid", "trapezoid", "concave1")[(episode - 1) % 3],
            "initial_offset": (1.0, -3.0, -float(episode)),
            "outcome": outcome,
            "env_steps": env_steps,
            "total_reward": 1.5,
            "actions": ActionSequence.from_array(actions),
            "state_hashes": tuple(f"{episode:032x}{step:032x}" for step in range(env_steps + 1)),
            "infos": tuple({"steps": step + 1} for step in range(env_steps)),
            "failure": make_failure() if outcome is EpisodeOutcome.POLICY_FAILED else None,
            **changes,
        }
    )
