"""What the demo prints: stages with their times, the leaderboard, addresses. Called by `command`."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.live import Live
from rich.padding import Padding
from rich.spinner import Spinner
from rich.table import Table
from rich.text import Text

from ..client.http import Json
from ..terminal.output import percent, program_name

if TYPE_CHECKING:
    from sqlalchemy.orm import Session
    from vitac.server.database.engine import Database
    from vitac.server.database.models import Team

INDENT = 2
LABEL_WIDTH = 12
BAR_WIDTH = 26
ACCENT = "cyan"


class DemoStep:
    """One line of the demo: a stage and its result."""

    def __init__(self) -> None:
        self.result = ""

    def done(self, result: str) -> None:
        """Set the result to print."""
        self.result = result


class DemoDisplay:
    """Prints with colours and spinners on a terminal, plain lines in a pipe."""

    def __init__(self, console: Console | None = None) -> None:
        # A character that the terminal's encoding lacks must not end the demo.
        if console is None and hasattr(sys.stdout, "reconfigure"):
            sys.stdout.reconfigure(errors="replace")
        self.console = console or Console(highlight=False)
        unicode = self.console.encoding.lower().startswith("utf")
        self._done, self._bullet = ("✓", "·") if unicode else ("+", "-")

    def title(self, version: str) -> None:
        """Print the first line."""
        self.console.print()
        self.console.print(Text.assemble(" " * INDENT, ("ViTac Arena", "bold"), (f"  {version}", "dim")))
        self.console.print()

    @contextmanager
    def stage(self, label: str, activity: str = "") -> Iterator[DemoStep]:
        """Show a stage while the block runs; print its line with the time taken when the block succeeds.

        Args:
            label: name of the stage, one or two words.
            activity: shown while a long stage runs; in a pipe on a line of its own.
        """
        stage = DemoStep()
        began = time.monotonic()
        if self.console.is_terminal:
            spinner = Spinner("dots", Text(f"{label:<{LABEL_WIDTH}} {activity}"), style=ACCENT)
            with Live(Padding(spinner, (0, 0, 0, INDENT)), console=self.console, transient=True):
                yield stage
        else:
            if activity:
                self.note(f"{label}: {activity}")
            yield stage
        self._line(label, stage.result, time.monotonic() - began)

    def line(self, label: str, result: str, took_s: float = 0.0) -> None:
        """Print the line of a stage that showed its own progress or took no time."""
        self._line(label, result, took_s)

    def note(self, sentence: str) -> None:
        """Print a sentence between the stages."""
        self.console.print(Text(f"{' ' * INDENT}{self._bullet} {sentence}", style="dim"), soft_wrap=True)

    def interrupted(self) -> None:
        """Print what is stored after Ctrl-C."""
        self.note(f"Stopped. Finished episodes are stored; {program_name()} demo runs the rest.")

    def leaderboard(self, board: Json, team: str) -> None:
        """Print the leaderboard, the demo team's line in bold, and its rate for each task or each shape.

        Where it ranks by measures they stand in place of the env steps.
        """
        from vitac.server.views.board_table import measure_keys

        measures = measure_keys(board)
        self.console.print()
        of = ", all tasks" if board["task"] is None else f", {board['task']}"
        board_name = "practice board of the public list" if board["is_practice"] else "leaderboard"
        self.console.print(Text(f"{' ' * INDENT}{board['title']}{of}: {board_name}", style="bold"))
        self.console.print()
        table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
        table.add_column(" " * (INDENT - 1), width=INDENT - 1)
        table.add_column("Rank", justify="right")
        table.add_column("Team", max_width=18, overflow="ellipsis", no_wrap=True)
        table.add_column("Success", justify="right", no_wrap=True)
        table.add_column("0 %" + " " * (BAR_WIDTH - 8) + "100 %", width=BAR_WIDTH, no_wrap=True)
        table.add_column("95 % interval", no_wrap=True)
        for title in [key["title"] for key in measures] or ["Env steps"]:
            table.add_column(Text(title), justify="right", no_wrap=True)  # a unit in brackets is no markup
        for entry in board["entries"]:
            values = [entry["measures"].get(key["name"]) for key in measures] or [entry["mean_steps"]]
            cells = ["-" if value is None else f"{value:.2f}" for value in values]
            table.add_row("", *self._entry(entry), *cells, style="bold" if entry["team"] == team else "")
        self.console.print(table)
        own = next((entry for entry in board["entries"] if entry["team"] == team), None)
        if own is not None:
            self._parts(own)

    def addresses(self, pairs: Mapping[str, str]) -> None:
        """Print names and addresses, one pair a line without wrapping."""
        self.console.print()
        for name, value in pairs.items():
            self.console.print(
                Text.assemble(" " * INDENT, (f"{name:<{LABEL_WIDTH}} ", "dim"), value), soft_wrap=True, no_wrap=True
            )
        self.console.print()

    def staying(self) -> None:
        """Print that the service keeps running."""
        self.console.print(Text(f"{' ' * INDENT}The service keeps running. Ctrl-C stops it."))

    def stopped(self, state_dir: Path) -> None:
        """Print that the service has stopped."""
        self.note(f"The service has stopped. All data is stored in {state_dir}.")

    def _entry(self, entry: Json) -> tuple[str | Text, ...]:
        rank = "-" if entry["rank"] is None else str(entry["rank"])
        low, high = entry["success_rate_interval"]
        bar = interval_bar(entry["success_rate"], low, high)
        interval = f"{100 * low:.1f} to {100 * high:.1f} %"
        return rank, entry["team"], percent(entry["success_rate"]) or "-", bar, interval

    def _parts(self, entry: Json) -> None:
        several = len(entry["scores"]) > 1
        by_task = [(score["task"], score) for score in entry["scores"]]
        by_shape = [(shape["shape"], shape) for score in entry["scores"] for shape in score["shapes"]]
        parts = ", ".join(
            f"{name} {percent(part['success_rate'])}" for name, part in (by_task if several else by_shape)
        )
        by = "task" if several else "shape"
        self.console.print()
        self.console.print(Text(f"{' ' * INDENT}{entry['team']} by {by}: {parts}", style="dim"))

    def _line(self, label: str, result: str, took_s: float) -> None:
        took = f"  {took_s:.1f} s" if took_s >= 0.05 else ""
        self.console.print(
            Text.assemble(
                " " * INDENT, (self._done, "green"), f" {label:<{LABEL_WIDTH}} ", (result, "default"), (took, "dim")
            ),
            soft_wrap=True,
        )


def interval_bar(rate: float, low: float, high: float) -> Text:
    """Draw an interval of [0, 1] with its rate as a line of characters."""

    def place(fraction: float) -> int:
        return min(BAR_WIDTH - 1, int(fraction * BAR_WIDTH))

    bar = Text()
    for position in range(BAR_WIDTH):
        if position == place(rate):
            bar.append("●", style=ACCENT)
        elif place(low) <= position <= place(high):
            bar.append("━", style=ACCENT)
        else:
            bar.append("─", style="dim")
    return bar


def warm_up(track: str) -> None:
    """Run one env step of each task, so that Numba compiles and caches its kernels."""
    import gymnasium
    import vitac.envs  # noqa: F401 - registers the environments
    from vitac.evaluator.tracks import load_track

    for task in load_track(track).tasks.values():
        env = gymnasium.make(task.env_id)
        env.reset(seed=1, options=dict(task.episodes[0].options))
        env.step(env.action_space.sample() * 0)
        env.close()


TEAM = "demo"
TOKEN_FILE = "demo-token"  # noqa: S105 - a file's name
TOKEN_LIFETIME = timedelta(days=365)


def team_token(database: Database, state_dir: Path) -> str:
    """Return a valid token of the team `demo`; create team and token if missing or no longer valid."""
    path = state_dir / TOKEN_FILE
    with database.transaction() as session:
        stored = path.read_text().strip() if path.exists() else ""
        if stored and _is_valid(session, stored):
            return stored
        secret = _issue(session)
    _write_private(path, secret)
    return secret


def _is_valid(session: Session, secret: str) -> bool:
    from vitac.server.accounts import tokens
    from vitac.server.errors import ServiceError

    try:
        return tokens.authenticate(session, secret).team_name == TEAM
    except ServiceError:
        return False


def _issue(session: Session) -> str:
    from vitac.server.accounts import tokens
    from vitac.server.database.states import Role
    from vitac.server.principals import CONSOLE

    issued = tokens.issue(
        session, CONSOLE, role=Role.TEAM, label="vitac demo", team=_find_or_register(session), lifetime=TOKEN_LIFETIME
    )
    return issued.secret


def _find_or_register(session: Session) -> Team:
    from vitac.server.accounts import teams
    from vitac.server.errors import ProblemCode, ServiceError
    from vitac.server.principals import CONSOLE

    try:
        return teams.find(session, TEAM)
    except ServiceError as error:
        if error.code is not ProblemCode.UNKNOWN_TEAM:
            raise
    return teams.register(session, CONSOLE, name=TEAM)


def _write_private(path: Path, secret: str) -> None:
    path.unlink(missing_ok=True)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
        file.write(secret + "\n")
