"""`vitac gap`: the same policies in simulation and at a station, from files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer
from vitac.errors import VitacError

from .compare import OtherEpisodes, read_evaluated
from .terminal.output import AsJson, print_json, print_table

if TYPE_CHECKING:
    from collections.abc import Hashable

    from vitac.evaluator.scoring.gap import Gap, Measured, PlayedTwice
    from vitac.station.rehearsal import RehearsalReport, TrialRecord
    from vitac.station.touch_gap import TouchGap


def command(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="Two of each policy: its evaluation in simulation (log or file of `vitac evaluate --json`) or trials "
            "at a twin of identified settings, then its trials (file of `vitac evaluate --station ... --json`)."
        ),
    ],
    identified: Annotated[
        Path | None,
        typer.Option(help="File of `vitac station identify`: markers and forces also against that simulation."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Show how far simulation is from a station, with 95 % intervals: success by start, markers and forces by trial.

    Trials of a twin without one more of its differences than the others lack are no policies of their own: they show
    which share it explains.
    """
    from vitac.evaluator.scoring.gap import measure_gap

    if len(files) % 2:
        raise typer.BadParameter(
            f"expected two files of each policy, simulation and station, got {len(files)} files.", param_hint="files"
        )
    starts: dict[int, Hashable] = {}
    tried = [(simulated, file, _read_trials(file)) for simulated, file in zip(files[::2], files[1::2], strict=True)]
    pairs = [(_played_twice(*each, starts), each[-1]) for each in tried]
    lacking = frozenset.intersection(*(_without(report) for _, report in pairs))
    whole = [(policy, report) for policy, report in pairs if _without(report) == lacking]
    gap = measure_gap([policy for policy, _ in whole], starts)
    shares = _measure_shares(pairs, lacking, starts)
    touch = _measure_touch([report for _, report in whole], identified)
    twins = sorted({f"{report.station} is {report.twin}." for _, report in pairs if report.twin})
    if as_json:
        more = {
            "twins": twins,
            "shares": {name: share and share.model_dump() for name, share in shares.items()},
            "touch": {name: each.model_dump() for name, each in touch.items()},
        }
        print_json(gap.model_dump(mode="json") | more)
        return
    for sentence in twins:
        print(sentence)
    _print_text(gap)
    for name, share in shares.items():
        print(f"Share of the difference that {name} explains: {_text(share, 100, '%') if share else 'none to explain'}")
    _print_touch(touch)


def _without(report: RehearsalReport) -> frozenset[str]:
    return frozenset(report.twin.without if report.twin else ())


def _measure_shares(
    pairs: list[tuple[PlayedTwice, RehearsalReport]], lacking: frozenset[str], starts: dict[int, Hashable]
) -> dict[str, Measured | None]:
    """Return by difference which share of the gap it explains, from the policies that were also played without it.

    Args:
        pairs: all of them.
        lacking: what all twins are without.
        starts: of every episode.
    """
    from vitac.evaluator.scoring.gap import measure_share

    played = [(_without(report), report.submission_digest, policy) for policy, report in pairs]
    whole = {digest: policy for names, digest, policy in played if names == lacking}
    shares = {}
    for names in dict.fromkeys(names for names, _, _ in played if names != lacking):
        without = {digest: policy for others, digest, policy in played if others == names}
        both = [digest for digest in without if digest in whole]
        if both:
            shares[", ".join(sorted(names - lacking))] = measure_share(
                [whole[digest] for digest in both], [without[digest] for digest in both], starts
            )
    return shares


def _measure_touch(reports: list[RehearsalReport], identified: Path | None) -> dict[str, TouchGap]:
    """Return the gap of markers and forces of pegs to our simulation, and to that with identified settings."""
    if not any(trial.attempts[-1].regions_px for report in reports for trial in report.trials):
        return {}
    from vitac.evaluator.strict_model import read_yaml
    from vitac.station.description import StationTask
    from vitac.station.identification.station import IdentifiedStation
    from vitac.station.touch_gap import measure_touch_gap
    from vitac.station.twin.hidden import PUBLIC_SETTINGS

    settings = {"simulation": PUBLIC_SETTINGS}
    if identified:
        settings["identified simulation"] = read_yaml(IdentifiedStation, identified).settings
    pegs = [report for report in reports if report.task == StationTask.PEG]
    return {name: measure_touch_gap(pegs, hidden) for name, hidden in settings.items()} if pegs else {}


def _print_touch(touch: dict[str, TouchGap]) -> None:
    for name, gap in touch.items():
        print(f"\nMarkers and forces against the {name}, along the motions of {gap.trials} trials (root mean square)")
        rows = [(part, _text(error, 1, "px")) for part, error in gap.markers_px.items()]
        print_table(("part", "error, 95 % interval"), [*rows, ("force", _text(gap.force_n, 1, "N"))], none="")


def _played_twice(simulated: Path, tried: Path, report: RehearsalReport, starts: dict[int, Hashable]) -> PlayedTwice:
    """Return the episodes of a policy that both have, and add their starts.

    Raises:
        OtherEpisodes: they are of other policies, or episodes with the same number began elsewhere.
    """
    from vitac.evaluator.scoring.gap import PlayedTwice

    digest, simulation = _read_simulated(simulated, report.task)
    if digest not in (None, report.submission_digest):
        raise OtherEpisodes(
            f"Expected one policy in {simulated} and {tried}, got the submissions {digest} and "
            f"{report.submission_digest}."
        )
    ends = {}
    for trial in report.trials:
        end, start = simulation.get(trial.episode), (trial.shape, tuple(trial.offset))
        if end is None or not trial.outcome.counts or trial.start != trial.offset:
            continue
        known = starts.setdefault(trial.episode, start)
        for where, other in ((simulated, end.start), ("another policy's trials", known)):
            if other != start:
                raise OtherEpisodes(
                    f"Expected episode {trial.episode} of one list, got {start} in {tried} and {other} in {where}."
                )
        ends[trial.episode] = (end.success, trial.outcome == "success")
    return PlayedTwice(name=report.submission, ends=ends)


class _SimulatedEnd(NamedTuple):
    """How an episode ended in simulation."""

    start: tuple[str, tuple[float, ...]]
    success: bool


def _read_simulated(path: Path, task: str) -> tuple[str | None, dict[int, _SimulatedEnd]]:
    """Return the submission's digest and the ends of its episodes: of an evaluation, or of trials at another twin."""
    report = _find_identified_twin(path)
    if report is not None:
        counted = [trial for trial in report.trials if trial.outcome.counts]
        return report.submission_digest, {trial.episode: _end_of_trial(trial) for trial in counted}
    evaluated = read_evaluated(str(path))
    return evaluated.submission_digest, {
        end.episode: _SimulatedEnd((end.shape, tuple(end.initial_offset)), end.success)
        for end in evaluated.episodes
        if end.task == task
    }


def _find_identified_twin(path: Path) -> RehearsalReport | None:
    """Return the trials at a twin of identified settings; None for a file of anything else."""
    try:
        report = _read_trials(path)
    except VitacError:
        return None
    return report if report.twin and report.twin.identified else None


def _end_of_trial(trial: TrialRecord) -> _SimulatedEnd:
    return _SimulatedEnd((trial.shape, tuple(trial.offset)), trial.outcome == "success")


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
    violation = gap.by_chance.mean_maximum_rank_violation
    print(
        "Chance alone, without any gap, would show in 95 % of comparisons of this size a difference of up to "
        f"{100 * gap.by_chance.difference:.1f} points"
        + ("." if violation is None else f" and a rank violation of up to {violation:.3f}.")
    )
    if len(gap.policies) < ASKED_POLICIES:
        print(
            f"Correlation and rank violation say little of {len(gap.policies)} policies; play {ASKED_POLICIES} or "
            "more of different kinds."
        )


def _text(measured: Measured, factor: float, unit: str) -> str:
    digits = 1 if factor > 1 else 3
    low, high = factor * measured.low, factor * measured.high
    return f"{factor * measured.value:.{digits}f} {unit} [{low:.{digits}f}, {high:.{digits}f}]".replace("  ", " ")
