"""`vitac compare`: submissions on the same episodes, from files or from a service."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from vitac.errors import VitacError

from .client.answers import pick
from .client.http import make_client
from .terminal.output import (
    AsCsv,
    AsJson,
    AsLatex,
    Server,
    TokenFile,
    print_json,
    print_latex,
    print_meanings,
    print_table,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from vitac.evaluator.scoring.comparison import Comparison, FinishedEpisode

Row = dict[str, Any]
"""A result or a pair of them, by the names that JSON and CSV have."""
PAGES = "/submissions/"
"""Comes before the id in the address of a submission's page."""


class OtherEpisodes(VitacError):
    """The two evaluations are not of the same episodes; compare evaluations of one list."""


@dataclass(frozen=True, kw_only=True)
class EndedEpisode:
    """The outcome of an episode, as a service reports it."""

    task: str
    episode: int
    shape: str
    initial_offset: Sequence[float]
    outcome: str
    success: bool
    env_steps: int


@dataclass(frozen=True, kw_only=True)
class Evaluated:
    """One side of a comparison.

    Attributes:
        name: what the user named it.
        track: its track.
        list_hash: of the episode list with all that a task fixes; None if a service does not say.
        episodes: how they ended.
        submission_digest: of what played; None where it is not known.
    """

    name: str
    track: str
    list_hash: str | None
    episodes: Sequence[FinishedEpisode]
    submission_digest: str | None = None


def command(
    submissions: Annotated[
        list[str],
        typer.Argument(help="Two or more: logs, files of `vitac evaluate --json`, ids or addresses of submissions."),
    ],
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
    as_csv: AsCsv = False,
    as_latex: AsLatex = False,
) -> None:
    """Compare submissions episode by episode: differences with 95 % intervals, and exact p-values, by start.

    As CSV come the pairs alone.
    """
    if len(submissions) < 2:
        raise typer.BadParameter("expected two or more submissions, got one.", param_hint="submissions")
    sides = [_evaluated(named, server, token_file) for named in submissions]
    pairs, results = _pairs(sides), _results(sides)
    if as_json:
        print_json({"results": results, "pairs": pairs, "episodes": _episodes(sides)})
    elif as_csv:
        from vitac.server.csv_text import csv_text

        print(csv_text([tuple(pairs[0]), *(tuple(row.values()) for row in pairs)]), end="")
    elif as_latex:
        print_latex(RESULT_COLUMNS, _result_cells(results))
        print_latex(PAIR_COLUMNS, _pair_cells(pairs))
    else:
        _print_text(sides, results, pairs)


RESULT_COLUMNS = ("task", "result", "solved", "of", "starts", "success rate, %", "95 % interval", "env steps")
PAIR_COLUMNS = (
    "task", "first", "second", "difference, points", "95 % interval", "only first", "only second", "p", "adjusted p",
)  # fmt: skip


def _print_text(sides: Sequence[Evaluated], results: Sequence[Row], pairs: Sequence[Row]) -> None:
    differing = [row for row in _episodes(sides) if len({end["success"] for end in row["ends"] if end}) > 1]
    print_table(
        ("task", "episode", "shape", *(side.name for side in sides)),
        [
            (
                row["task"],
                row["episode"],
                row["shape"],
                *(end and f"{end['outcome']}, {end['env_steps']}" for end in row["ends"]),
            )
            for row in differing
        ],
        none="No episode is solved by only some of them.",
    )
    print_meanings(end["outcome"] for row in differing for end in row["ends"] if end)
    print()
    print_table(RESULT_COLUMNS, _result_cells(results), none="")
    print()
    print_table(PAIR_COLUMNS, _pair_cells(pairs), none="")


def _results(sides: Sequence[Evaluated]) -> list[Row]:
    """Return a row for each side and task."""
    from vitac.evaluator.scoring.score import rate_by_start
    from vitac.evaluator.scoring.starts import find_start

    rows = []
    for side in sides:
        for task in sorted({end.task for end in side.episodes}):
            ends = [end for end in side.episodes if end.task == task]
            steps = [end.env_steps for end in ends if end.success]
            rate = rate_by_start((find_start(end), end.success) for end in ends)
            rows.append(
                {
                    "task": task,
                    "name": side.name,
                    "successes": rate.successes,
                    "episodes": rate.episodes,
                    "starts": rate.starts,
                    "success_rate": rate.success_rate,
                    "low": rate.interval.low,
                    "high": rate.interval.high,
                    "mean_steps": sum(steps) / len(steps) if steps else None,
                }
            )
    return sorted(rows, key=lambda row: str(row["task"]))


def _pairs(sides: Sequence[Evaluated]) -> list[Row]:
    """Return a row for each pair of sides and task, whose p-values are adjusted for the number of pairs in the task."""
    from vitac.evaluator.scoring.comparison import adjust_p_values

    by_task: dict[str, list[tuple[Evaluated, Evaluated, Comparison]]] = {}
    for one, other in combinations(sides, 2):
        for task, comparison in _compared(one, other).items():
            by_task.setdefault(task, []).append((one, other, comparison))
    rows = []
    for task, compared in sorted(by_task.items()):
        adjusted = adjust_p_values([comparison.p_value for _, _, comparison in compared])
        rows += [
            {
                "task": task,
                "first": one.name,
                "second": other.name,
                "episodes": len(pair.pairs),
                "episodes_of_one": pair.unpaired,
                "starts": len(pair.by_start),
                "both_solve": pair.both,
                "only_first_solves": pair.only_first,
                "only_second_solves": pair.only_second,
                "neither_solves": pair.neither,
                "difference": pair.difference,
                "low": pair.interval[0],
                "high": pair.interval[1],
                "p_value": pair.p_value,
                "adjusted_p_value": p_value,
            }
            for (one, other, pair), p_value in zip(compared, adjusted, strict=True)
        ]
    return rows


def _result_cells(rows: Sequence[Row]) -> list[tuple[object, ...]]:
    return [
        (
            row["task"],
            row["name"],
            row["successes"],
            row["episodes"],
            row["starts"],
            f"{100 * row['success_rate']:.1f}",
            f"{100 * row['low']:.1f} to {100 * row['high']:.1f}",
            row["mean_steps"],
        )
        for row in rows
    ]


def _pair_cells(rows: Sequence[Row]) -> list[tuple[object, ...]]:
    return [
        (
            row["task"],
            row["first"],
            row["second"],
            f"{100 * row['difference']:+.1f}",
            f"{100 * row['low']:+.1f} to {100 * row['high']:+.1f}",
            row["only_first_solves"],
            row["only_second_solves"],
            f"{row['p_value']:.3g}",
            f"{row['adjusted_p_value']:.3g}",
        )
        for row in rows
    ]


def _evaluated(named: str, server: str | None, token_file: Path | None) -> Evaluated:
    if Path(named).is_file():
        return read_evaluated(named)
    address, _, submission_id = named.rpartition(PAGES)
    client = make_client(address.removesuffix("/api/v1") or server, token_file)
    submission = client.submission(submission_id)
    episodes = [pick(EndedEpisode, episode) for episode in client.episodes(submission_id)]
    return Evaluated(name=submission["name"], track=submission["track"], list_hash=None, episodes=episodes)


def read_evaluated(named: str) -> Evaluated:
    """Read a log, or the report that `vitac evaluate --json` writes."""
    from pydantic import ValidationError
    from vitac.evaluator.evaluation.local import EvaluationReport
    from vitac.evaluator.logs.log import LogReader, is_log, open_log

    path = Path(named)
    if is_log(path):
        with open_log(path) as stream:
            reader = LogReader(stream)
            manifest, digest = reader.header.manifest, reader.header.submission_digest
            episodes = tuple(reader.records())
    else:
        try:
            report = EvaluationReport.model_validate_json(path.read_bytes())
        except ValidationError as error:
            raise VitacError(
                f"Expected a log or a file of `vitac evaluate --json`, got {path} ({error.error_count()} errors)."
            ) from error
        manifest, digest, episodes = report.manifest, report.submission_digest, report.episodes
    return Evaluated(
        name=named,
        track=manifest.track,
        list_hash=manifest.task_hash,
        episodes=episodes,
        submission_digest=digest,
    )


def _compared(one: Evaluated, other: Evaluated) -> dict[str, Comparison]:
    """Compare two evaluations of one list, by task.

    Raises:
        OtherEpisodes: they are of two lists.
        NothingToCompare: they have no episode from the same start in common.
    """
    from vitac.evaluator.scoring.comparison import compare_tasks

    if one.track != other.track:
        raise OtherEpisodes(f"Expected two evaluations of one track, got {one.track} and {other.track}.")
    if None not in (one.list_hash, other.list_hash) and one.list_hash != other.list_hash:
        raise OtherEpisodes(f"Expected two evaluations of one list, got {one.list_hash} and {other.list_hash}.")
    return compare_tasks(one.episodes, other.episodes)


def _episodes(sides: Sequence[Evaluated]) -> list[Row]:
    """Return a row for each episode that two of them have, with how it ended in each."""
    ends = [{(end.task, end.episode): end for end in side.episodes} for side in sides]
    keys = sorted({key for by_key in ends for key in by_key})
    rows = []
    for task, number in keys:
        of_sides = [by_key.get((task, number)) for by_key in ends]
        known = [end for end in of_sides if end is not None]
        if len(known) > 1:
            shown = [
                end and {"outcome": str(end.outcome), "success": end.success, "env_steps": end.env_steps}
                for end in of_sides
            ]
            rows.append({"task": task, "episode": number, "shape": known[0].shape, "ends": shown})
    return rows
