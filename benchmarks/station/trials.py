"""Plays trials of a submission against a twin whose settings are hidden, with every scripted fault once.

    .venv/bin/python benchmarks/station/trials.py [--trials 20] [--secret TEXT] [SUBMISSION]

200 trials: `--trials 200`. Each attempt is printed with its outcome; at the end, whether every trial has exactly one
result, and how much faster than real time the twin ran.
"""

import argparse
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic

from vitac.evaluator.strict_model import validate
from vitac.evaluator.submission.manifest import load_manifest
from vitac.evaluator.submission.sources import staged
from vitac.evaluator.tracks import load_track
from vitac.station.description import StationDescription
from vitac.station.records import TrialRecord
from vitac.station.rehearsal import rehearse
from vitac.station.trials import Player
from vitac.station.twin.faults import Fault, FaultScript, ScriptedFault
from vitac.station.twin.hidden import draw_hidden
from vitac.station.twin.process import twin_process

EXAMPLE = Path("examples/peg_insertion_trained/Track_1")
CONTACTS_BETWEEN_FAULTS = 2


def show(trial: TrialRecord) -> None:
    """Print the attempts at a trial."""
    for number, attempt in enumerate(trial.attempts, start=1):
        line = f"trial {trial.episode}, attempt {number}: {attempt.outcome}, {attempt.actions.shape[0]} env steps"
        print(f"{line}. {attempt.reason}".rstrip(" ."), flush=True)


def main() -> None:
    """Print a line for each attempt, and the totals."""
    import cv2

    cv2.setNumThreads(1)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("submission", nargs="?", type=Path, default=EXAMPLE)
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--secret", default="benchmark")
    given = parser.parse_args()
    faults = enumerate(Fault, start=1)
    script = FaultScript(
        faults=tuple(ScriptedFault(fault=fault, contact=n * CONTACTS_BETWEEN_FAULTS) for n, fault in faults)
    )
    with (
        twin_process(draw_hidden(given.secret.encode()), script=script) as twin,
        staged(given.submission) as folder,
        TemporaryDirectory() as records,
        Player(description=validate(StationDescription, twin.description, "twin"), folder=Path(records)) as player,
    ):
        track = load_track(load_manifest(folder).track)
        cuboids = [each.number for each in track.tasks["peg-insertion"].episodes if each.shape == "cuboid"]
        numbers = [cuboids[n % len(cuboids)] for n in range(given.trials)]
        began_s, trials = monotonic(), []
        for start in range(0, len(numbers), len(cuboids)):
            trials += rehearse(player, folder, track, episodes=numbers[start : start + len(cuboids)], on_trial=show)
        real_s, twin_s = monotonic() - began_s, twin.time_s()
    attempts = Counter(attempt.outcome for trial in trials for attempt in trial.attempts)
    results = Counter(trial.outcome for trial in trials if trial.outcome.counts)
    print(f"{len(trials)} trials, {results.total()} with a result: {dict(results)}; attempts: {dict(attempts)}")
    print(f"{twin_s:.0f} s of the twin in {real_s:.0f} s: {twin_s / real_s:.1f} times faster than real time")


if __name__ == "__main__":
    main()
