"""`vitac compare`: two submissions on the same episodes, from files or from a service."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from vitac.envs.errors import VitacError

from .client.answers import pick
from .client.http import make_client
from .terminal.output import AsJson, Server, TokenFile, print_json, print_meanings, print_pairs, print_table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from vitac.evaluator.scoring.comparison import Comparison, FinishedEpisode

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
    """

    name: str
    track: str
    list_hash: str | None
    episodes: Sequence[FinishedEpisode]


def command(
    first: Annotated[
        str, typer.Argument(help="Log, file of `vitac evaluate --json`, or id or address of a submission.")
    ],
    second: Annotated[str, typer.Argument(help="The submission to compare it with, in the same form.")],
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Compare two submissions episode by episode, with the exact p-value of McNemar's test."""
    one, other = (_evaluated(named, server, token_file) for named in (first, second))
    found = _compared(one, other)
    if as_json:
        print_json(_summary(found) | {"episodes": _rows(found)})
        return
    differing = [row for row, pair in zip(_rows(found), found.pairs, strict=True) if pair.differs]
    print_table(
        ("task", "episode", "shape", "first", "env steps", "second", "env steps"),
        [tuple(row.values()) for row in differing],
        none="No episode is solved by only one of them.",
    )
    print_meanings(str(end.outcome) for pair in found.pairs if pair.differs for end in (pair.first, pair.second))
    print()
    print_pairs({"first": one.name, "second": other.name} | _summary(found) | {"p_value": f"{found.p_value:.3g}"})


def _evaluated(named: str, server: str | None, token_file: Path | None) -> Evaluated:
    if Path(named).is_file():
        return _from_file(named)
    address, _, submission_id = named.rpartition(PAGES)
    client = make_client(address.removesuffix("/api/v1") or server, token_file)
    submission = client.submission(submission_id)
    episodes = [pick(EndedEpisode, episode) for episode in client.episodes(submission_id)]
    return Evaluated(name=submission["name"], track=submission["track"], list_hash=None, episodes=episodes)


def _from_file(named: str) -> Evaluated:
    """Read a log, or the report that `vitac evaluate --json` writes."""
    from pydantic import ValidationError
    from vitac.evaluator.evaluation.local import EvaluationReport
    from vitac.evaluator.logs.log import LogReader, is_log
    from vitac.evaluator.logs.packing import open_log

    path = Path(named)
    if is_log(path):
        with open_log(path) as stream:
            reader = LogReader(stream)
            manifest, episodes = reader.header.manifest, tuple(reader.records())
    else:
        try:
            report = EvaluationReport.model_validate_json(path.read_bytes())
        except ValidationError as error:
            raise VitacError(
                f"Expected a log or a file of `vitac evaluate --json`, got {path} ({error.error_count()} errors)."
            ) from error
        manifest, episodes = report.manifest, report.episodes
    return Evaluated(name=named, track=manifest.track, list_hash=manifest.task_hash, episodes=episodes)


def _compared(one: Evaluated, other: Evaluated) -> Comparison:
    """Compare two evaluations of one list.

    Raises:
        OtherEpisodes: they are of two lists.
        NothingToCompare: they have no episode in common.
    """
    from vitac.evaluator.scoring.comparison import compare

    if one.track != other.track:
        raise OtherEpisodes(f"Expected two evaluations of one track, got {one.track} and {other.track}.")
    if None not in (one.list_hash, other.list_hash) and one.list_hash != other.list_hash:
        raise OtherEpisodes(f"Expected two evaluations of one list, got {one.list_hash} and {other.list_hash}.")
    found = compare(one.episodes, other.episodes)
    for pair in found.pairs:
        if pair.first.shape != pair.second.shape:
            raise OtherEpisodes(
                f"Expected two evaluations of one list, got {pair.first.shape} and {pair.second.shape} in episode "
                f"{pair.first.episode} of {pair.first.task}."
            )
    return found


def _summary(found: Comparison) -> dict[str, object]:
    return {
        "episodes_of_both": len(found.pairs),
        "episodes_of_one": found.unpaired,
        "both_solve": found.both,
        "only_first_solves": found.only_first,
        "only_second_solves": found.only_second,
        "neither_solves": found.neither,
        "p_value": found.p_value,
    }


def _rows(found: Comparison) -> list[dict[str, object]]:
    return [
        {
            "task": pair.first.task,
            "episode": pair.first.episode,
            "shape": pair.first.shape,
            "first_outcome": str(pair.first.outcome),
            "first_env_steps": pair.first.env_steps,
            "second_outcome": str(pair.second.outcome),
            "second_env_steps": pair.second.env_steps,
        }
        for pair in found.pairs
    ]
