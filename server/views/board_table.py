"""Boards as tables, of what the API answers. Called by pages and commands that write CSV."""

from collections.abc import Mapping
from typing import Any

from vitac.evaluator.ranking import EVERY_SCORE_HAS

Json = Mapping[str, Any]
BOARD_COLUMNS = (
    "rank", "team", "submission", "success_rate", "interval_low", "interval_high", "mean_env_steps", "successes",
    "episodes", "submitted_at", "evaluator_version", "result_hash", "peak_force_n",
    "twin_trials",
)  # fmt: skip
_FIELDS = (
    "mean_steps", "successes", "episodes", "submitted_at", "evaluator_version", "result_hash",
)  # fmt: skip


def board_table(board: Json) -> tuple[tuple[str, ...], list[tuple[object, ...]]]:
    """Return the columns of a leaderboard, and a row for each entry."""
    names = [str(key["name"]) for key in measure_keys(board)]
    rows = [(*ranked_cells(entry), *(entry["measures"].get(name) for name in names)) for entry in board["entries"]]
    return (*BOARD_COLUMNS, *names), rows


def measure_keys(board: Json) -> list[Json]:
    """Return the keys by which a board ranks that not every score has."""
    usual = {key.name for key in EVERY_SCORE_HAS}
    return [key for key in board["ranking"]["keys"] if key["name"] not in usual]


def ranked_cells(entry: Json) -> tuple[object, ...]:
    """Return the cells of an entry of any board that ranks."""
    return (
        *(entry["rank"], entry["team"], entry["submission_name"], entry["success_rate"]),
        *entry["success_rate_interval"],
        *(entry[name] for name in _FIELDS),
        _peak_force_n(entry),
        sum(sum(score["twins"].values()) for score in entry.get("scores", ())),
    )


def _peak_force_n(entry: Json) -> float | None:
    """Return the median peak of the force on the held part; of several tasks, and of logs, there is none."""
    scores = entry.get("scores", ())
    forces = scores[0]["forces"] if len(scores) == 1 else None
    peak_n: float | None = forces["part"]["peak_n"] if forces else None
    return peak_n
