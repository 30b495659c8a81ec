"""The figures of benchmarks/physics.md: speed, convergence, accuracy against speed, agreement with other simulators.

Usage: python benchmarks/physics.py REFERENCE_DIR [--episodes N] [--ledger] [--write-docs] [--fuzz FILE ...]

Plays the organizers' logged peg episodes and prints JSON. REFERENCE_DIR holds assets/track1,
logs/track1_peg_insertion.repeat0.jsonl and physics_truth.json. One thread, no GPU, about half a minute; run it twice,
for the first run also compiles the kernels. `--ledger` also plays half of the episodes with every solver setting, some
minutes. `--write-docs` does all of it, keeps the figures in benchmarks/physics.json and writes the tables of
benchmarks/physics.md from them; `--fuzz` puts results of tests/support/physics/physics_fuzz.py in.
"""

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

from physics_report.document import keep
from physics_report.figures import against_logs, agreement, convergence, deviation_mm, misses, outcomes, speed
from physics_report.ledger import ledger
from physics_report.pieces import pieces
from physics_report.replay import Reference, Replay, read_reference
from physics_report.tables import Figures
from vitac.envs.fem.model.settings import SolverSettings

LEDGER_EPISODES = 45
LEDGER_ENV_STEPS = 3


def measured(reference: Reference, episodes: int) -> Figures:
    """Return the figures of the standard setting, measured when kernels are compiled and meshes are read."""
    for episode in reference.log[:3]:
        Replay(reference.assets_dir).play(episode)
    replay = Replay(reference.assets_dir)
    for episode in reference.log[:episodes]:
        replay.play(episode)
    return {
        "speed": speed(replay),
        "pieces": pieces(replay, reference),
        "convergence": convergence(replay.reports),
        "agreement": agreement(replay, reference),
        "misses": [row | {"in_parts_mm": solve_in_parts_mm(reference, row)} for row in misses(replay, reference)],
        "logs": against_logs(replay, reference),
        "outcomes": outcomes(replay, reference),
    }


def solve_in_parts_mm(reference: Reference, miss: Figures) -> list[float]:
    """Return how far a missed env step ends from the reference with every driven motion in 2, 4, 8, 16 parts."""
    key, found = (miss["episode"], miss["env_step"]), []
    for level in (1, 2, 3, 4):
        replay = Replay(reference.assets_dir, replace(SolverSettings(), first_division_level=level))
        replay.play(reference.log[miss["episode"] - 1], first_steps=miss["env_step"])
        found.append(deviation_mm(replay.index_by_step()[key], reference.settled[key]))
    return found


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reference_dir", type=Path)
    parser.add_argument("--episodes", type=int, default=90)
    parser.add_argument("--ledger", action="store_true")
    parser.add_argument("--write-docs", action="store_true")
    parser.add_argument("--fuzz", type=Path, nargs="+", default=[], metavar="FILE")
    arguments = parser.parse_args()
    reference = read_reference(arguments.reference_dir)
    figures = measured(reference, arguments.episodes)
    if arguments.ledger or arguments.write_docs:
        figures["ledger"] = ledger(reference, episodes=LEDGER_EPISODES, env_steps=LEDGER_ENV_STEPS)
    if arguments.fuzz:
        figures["fuzz"] = [json.loads(file.read_text()) for file in arguments.fuzz]
    if arguments.write_docs:
        keep(figures)
    sys.stdout.write(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
