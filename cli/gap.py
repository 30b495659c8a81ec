"""`vitac gap`: the same policies in simulation and at a station, from files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from vitac.envs.errors import VitacError

from .compare import OtherEpisodes, read_evaluated
from .terminal.output import AsJson, print_json, print_table

if TYPE_CHECKING:
    from collections.abc import Hashable

    from vitac.evaluator.scoring.gap import Gap, Measured, PlayedTwice
    from vitac.station.rehearsal import RehearsalReport


def command(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="Two of each policy: its evaluation in simulation (log or file of `vitac evaluate --json`), then its "
            "trials (file of `vitac evaluate --station ... --json`)."
        ),
    ],
    as_json: AsJson = False,
) -> None:
    """Show how far success in simulation is from success at a station, with 95 % intervals by start."""
    from vitac.evaluator.scoring.gap import measure_gap

    if len(files) % 2:
        raise typer.BadParameter(
            f"expected two files of each policy, simulation and station, got {len(files)} files.", param_hint="files"
        )
    starts: dict[int, Hashable] = {}
    policies = [_played_twice(*pair, starts) for pair in zip(files[::2], files[1::2], strict=True)]
    gap = measure_gap(policies, starts)
    if as_json:
        print_json(gap.model_dump(mode="json"))
    else:
        _print_text(gap)


def _played_twice(simulated: Path, tried: Path, starts: dict[int, Hashable]) -> PlayedTwice:
    """Return the episodes of a policy that both have, and add their starts.

    Raises:
        OtherEpisodes: they are of other policies, or episodes with the same number began elsewhere.
    """
    from vitac.evaluator.scoring.gap import PlayedTwice

    evaluated, report = read_evaluated(str(simulated)), _read_trials(tried)
    if evaluated.submission_digest not in (None, report.submission_digest):
        raise OtherEpisodes(
            f"Expected one policy in {simulated} and {tried}, got the submissions {evaluated.submission_digest} and "
            f"{report.submission_digest}."
        )
    simulation = {end.episode: end for end in evaluated.episodes if end.task == report.task}
    ends = {}
    for trial in report.trials:
        end, start = simulation.get(trial.episode), (trial.shape, tuple(trial.offset))
        if end is None or not trial.outcome.counts:
            continue
        known = starts.setdefault(trial.episode, start)
        for where, other in ((simulated, (end.shape, tuple(end.initial_offset))), ("another policy's trials", known)):
            if other != start:
                raise OtherEpisodes(
                    f"Expected episode {trial.episode} of one list, got {start} in {tried} and {other} in {where}."
                )
        ends[trial.episode] = (end.success, trial.outcome == "success")
    return PlayedTwice(name=report.submission, ends=ends)


def _read_trials(path: Path) -> RehearsalReport:
    from pydantic import ValidationError
    from vitac.station.rehearsal import RehearsalReport

    try:
        return RehearsalReport.model_validate_json(path.read_bytes())
    except (OSError, ValidationError) as error:
        raise VitacError(f"Expected a file of `vitac evaluate --station ... --json`, got {path}: {error}") from error


COLUMNS = (
    "policy", "episodes", "simulation, %", "station, %", "difference, points", "95 % interval",
    "both", "only simulation", "only station", "neither",
)  # fmt: skip


def _print_text(gap: Gap) -> None:
    from vitac.evaluator.scoring.gap import ASKED_POLICIES

    print_table(
        COLUMNS,
        [
            (
                policy.name,
                policy.episodes,
                f"{100 * policy.simulation:.1f}",
                f"{100 * policy.station:.1f}",
                f"{100 * policy.difference.value:+.1f}",
                f"{100 * policy.difference.low:+.1f} to {100 * policy.difference.high:+.1f}",
                policy.both,
                policy.only_simulation,
                policy.only_station,
                policy.neither,
            )
            for policy in gap.policies
        ],
        none="",
    )
    print()
    print(f"Difference of success, mean over policies: {_text(gap.difference, 100, 'points')}")
    print(f"Episodes that end alike: {_text(gap.agreement, 100, '%')}")
    if gap.pearson is not None:
        print(f"Pearson's correlation of success rates: {_text(gap.pearson, 1, '')}")
    if gap.mean_maximum_rank_violation is not None:
        print(f"Mean maximum rank violation: {_text(gap.mean_maximum_rank_violation, 1, '')}")
    if len(gap.policies) < ASKED_POLICIES:
        print(
            f"Correlation and rank violation say little of {len(gap.policies)} policies; play {ASKED_POLICIES} or "
            "more of different kinds."
        )


def _text(measured: Measured, factor: float, unit: str) -> str:
    digits = 1 if factor > 1 else 3
    low, high = factor * measured.low, factor * measured.high
    return f"{factor * measured.value:.{digits}f} {unit} [{low:.{digits}f}, {high:.{digits}f}]".replace("  ", " ")
