"""`vitac leaderboard`: the board of a track as a table, for spreadsheets and for papers."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import typer
from vitac.server.csv_text import csv_text
from vitac.server.views.board_table import board_table, measure_keys

from ..terminal.output import AsCsv, AsJson, AsLatex, Server, TokenFile, print_json, print_latex, print_table
from .http import Json, make_client
from .verbs import Door

PAGE_ENTRIES = 500
COLUMNS = ("rank", "team", "submission", "success rate, %", "95 % interval", "solved", "of", "env steps")


def command(
    track: Annotated[str, typer.Argument(help="Name of the track.")],
    task: Annotated[str | None, typer.Option(help="Rank by this task alone; by default by all together.")] = None,
    stage: Annotated[str | None, typer.Option(help="Its stage; by default the one that opened last.")] = None,
    competition: Annotated[str | None, typer.Option(help="Its competition, where several have the track.")] = None,
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
    as_csv: AsCsv = False,
    as_latex: AsLatex = False,
) -> None:
    """Print a leaderboard: ranked results first, then examples for comparison."""
    asked = {"track": track, "task": task, "stage": stage, "competition": competition}
    board = _read_all(Door(client=make_client(server, token_file)), asked)
    measures = measure_keys(board)
    columns = (*COLUMNS, *(key["title"] for key in measures))
    rows = [_cells(entry, measures) for entry in (*board["entries"], *board["baselines"])]
    if as_json:
        print_json(board)
    elif as_csv:
        names, table = board_table(board)
        print(csv_text([names, *table]), end="")
    elif as_latex:
        print_latex(columns, rows)
    else:
        print_table(columns, rows, none="No result is on this leaderboard yet.")


def _read_all(door: Door, asked: dict[str, str | None]) -> Json:
    """Return a board with the entries of all its pages."""
    board: Json = door.call("GET /leaderboards/{track}", asked | {"limit": PAGE_ENTRIES})
    while board["next_after"] is not None:
        page = door.call("GET /leaderboards/{track}", asked | {"limit": PAGE_ENTRIES, "after": board["next_after"]})
        board |= {"entries": board["entries"] + page["entries"], "next_after": page["next_after"]}
    return board


def _cells(entry: Json, measures: Sequence[Mapping[str, Any]]) -> tuple[Any, ...]:
    low, high = entry["success_rate_interval"]
    return (
        entry.get("rank"),
        entry.get("team"),
        entry.get("submission_name") or entry["name"],
        f"{100 * entry['success_rate']:.1f}",
        f"{100 * low:.1f} to {100 * high:.1f}",
        entry["successes"],
        entry["episodes"],
        entry["mean_steps"],
        *(entry.get("measures", {}).get(key["name"]) for key in measures),
    )
