"""`vitac evaluate --station`: plays a submission on a station or its twin, and shows the outcome of each trial."""

import threading
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from .terminal.output import print_table

if TYPE_CHECKING:
    from vitac.station.description import StationDescription
    from vitac.station.eyes import SensorReading
    from vitac.station.operators import Operator
    from vitac.station.rehearsal import RehearsalReport, TrialRecord
    from vitac.station.trials import TrialPlayer

STATION_MODULES = ("cv2", "pymodbus", "serial")
"""What every station and twin needs, some of it in a process of its own."""
_PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>Trials</title>
<style>body{{font:15px system-ui;margin:2em;max-width:64em}}img{{width:28em;display:block}}
figure{{display:inline-block;margin:.5em}}</style>
<h1>{title}</h1>{body}</html>
"""


def rehearse_submission(
    submission: Path, named: str, episodes: Sequence[int] | None, *, json: Path | None, pictures: Path | None
) -> None:
    """Play a submission's trials on the station of a file, or on `twin`; print and write the outcomes."""
    from vitac.envs.extras import require_extra
    from vitac.evaluator.submission.manifest import load_manifest
    from vitac.evaluator.submission.sources import staged, submission_digest
    from vitac.evaluator.tracks import load_track
    from vitac.station.eyes import find_procedure
    from vitac.station.held_part import HeldPart
    from vitac.station.rehearsal import TWIN, RehearsalReport, find_station_task, found_station, rehearse
    from vitac.station.trials import TrialPlayer

    require_extra("station", *STATION_MODULES, user="A station")
    album = Album(pictures) if pictures else None
    folder = pictures or (json.absolute().parent if json else Path.cwd())
    with staged(submission) as staged_folder:
        manifest = load_manifest(staged_folder)
        track = load_track(manifest.track)
        with (
            found_station(named, find_station_task(manifest.tasks)) as description,
            TrialPlayer(
                description=description,
                folder=folder,
                operator=make_operator(description),
                show=album.show if album else no_pictures,
                held=HeldPart() if named == TWIN else HeldPart.of_station(Path(named)),
            ) as player,
            serving_console(player) as console,
        ):
            procedure = find_procedure(description)
            typer.echo(f"Console: {console}", err=True)
            trials = rehearse(player, staged_folder, track, episodes=episodes, on_trial=print_trial)
        report = RehearsalReport.from_trials(
            trials,
            twin=description.twin,
            hole=tuple(procedure.hole.model_dump().values()),
            station=description.name,
            submission=manifest.name,
            submission_digest=submission_digest(submission),
            track=manifest.track,
            task=procedure.task,
        )
    if json:
        json.write_text(report.model_dump_json(indent=1) + "\n", encoding="utf-8")
    if album:
        outcomes = {trial.episode: trial.outcome for trial in trials}
        album.write_page(
            f"{report.submission} on {report.station}{f', {report.twin}' if report.twin else ''}", outcomes
        )
    print_report(report)
    if report.without_result:
        raise typer.Exit(1)


def print_trial(trial: "TrialRecord") -> None:
    """Print a line for each attempt at a trial."""
    for number, attempt in enumerate(trial.attempts, start=1):
        steps = attempt.actions.shape[0]
        reason = f" {attempt.reason}" if attempt.reason else ""
        print(
            f"trial {trial.episode}, attempt {number}: {attempt.outcome} after {steps} env steps.{reason}", flush=True
        )


def print_report(report: "RehearsalReport") -> None:
    """Print how often each outcome occurred, and the rate of what counts."""
    if report.twin:
        print(f"{report.station} is {report.twin}.")
    outcomes = Counter(trial.outcome for trial in report.trials)
    rows = [
        (outcome, count, "yes" if outcome.counts else "no", outcome.sentence) for outcome, count in outcomes.items()
    ]
    print_table(("outcome", "trials", "counts", "meaning"), rows, none="")
    if report.rate:
        low, high = report.rate.interval.low, report.rate.interval.high
        print(
            f"{report.rate.successes} of {report.rate.episodes} trials with a result succeeded, "
            f"{report.rate.success_rate:.1%} (95 % interval {low:.1%} to {high:.1%})"
        )
    if report.without_result:
        print(f"{report.without_result} trials have no result: none of their attempts counted. Play them again.")


class Album:
    """Pictures of both gels in a folder, and a page that shows them."""

    def __init__(self, folder: Path) -> None:
        """Make the folder."""
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder

    def show(self, episode: int, attempt: int, word: str, sight: "SensorReading") -> None:
        """Write the pictures of the left and the right gel, side by side."""
        import cv2
        import numpy as np

        name = f"trial-{episode}-attempt-{attempt}-{word}.png"
        cv2.imwrite(str(self._folder / name), np.hstack(sight.pictures))

    def write_page(self, title: str, outcomes: Mapping[int, str]) -> Path:
        """Write a page with the pictures of each trial, by its number, in the order in which they were taken."""
        from vitac.station.outcome import TrialOutcome

        body = "".join(
            f"<h2>Trial {trial}: {escape(TrialOutcome(outcome).sentence)}</h2>" + "".join(map(_figure, self._of(trial)))
            for trial, outcome in outcomes.items()
        )
        page = self._folder / "index.html"
        page.write_text(_PAGE.format(title=escape(title), body=body), encoding="utf-8")
        return page

    def _of(self, trial: int) -> list[str]:
        taken = sorted(self._folder.glob(f"trial-{trial}-attempt-*.png"), key=lambda file: file.stat().st_mtime_ns)
        return [file.stem for file in taken]


def _figure(name: str) -> str:
    picture = f'<img src="{name}.png" alt="{name}, left and right gel">'
    return f"<figure>{picture}<figcaption>{name}</figcaption></figure>"


def no_pictures(_episode: int, _attempt: int, _word: str, _sight: "SensorReading") -> None:
    """Show nothing."""


def make_operator(description: "StationDescription") -> "Operator":
    """Return the people at a console; they are asked unless the station's file says that it is released by itself."""
    from vitac.station.description import Release
    from vitac.station.operators import Operator

    return Operator(asks=description.procedure is None or description.procedure.release is not Release.AUTOMATIC)


@contextmanager
def serving_console(player: "TrialPlayer", port: int = 0) -> Iterator[str]:
    """Serve the console of a player's station on this machine; yield its address."""
    from vitac.station.console.server import ConsoleServer

    with ConsoleServer(player, port) as server:
        thread = threading.Thread(target=server.serve_forever, name="console of the station", daemon=True)
        thread.start()
        try:
            yield server.address
        finally:
            server.shutdown()
            thread.join()
