"""What the demo prints: steps with marks and times, the leaderboard, where to go. Called by `demo`."""

from __future__ import annotations

import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.live import Live
from rich.padding import Padding
from rich.spinner import Spinner
from rich.table import Table
from rich.text import Text

from ..terminal.output import percent
from ..terminal.program import program_name

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from ..client.http import Json

INDENT = 2
LABEL_WIDTH = 12
BAR_WIDTH = 26
ACCENT = "cyan"


class Step:
    """One line of the demo: what was done, said when it is."""

    def __init__(self) -> None:
        self.result = ""

    def done(self, result: str) -> None:
        """Say what came out."""
        self.result = result


class DemoDisplay:
    """Prints to a terminal in colour, with spinners; into a pipe the same lines without."""

    def __init__(self, console: Console | None = None) -> None:
        # A name in another alphabet or a sign that the terminal's encoding lacks shall not end the demo.
        if console is None and hasattr(sys.stdout, "reconfigure"):
            sys.stdout.reconfigure(errors="replace")
        self.console = console or Console(highlight=False)
        unicode = self.console.encoding.lower().startswith("utf")
        self._done, self._remark = ("✓", "·") if unicode else ("+", "-")

    def title(self, version: str) -> None:
        """Print the first line."""
        self.console.print()
        self.console.print(Text.assemble(" " * INDENT, ("ViTac Arena", "bold"), (f"  {version}", "dim")))
        self.console.print()

    @contextmanager
    def step(self, label: str, waiting: str = "") -> Iterator[Step]:
        """Show that something goes on; print its line with the time taken when the block ends without an error.

        Args:
            label: what the step is, one or two words.
            waiting: what is said meanwhile where it takes long; in a pipe it gets a line of its own.
        """
        step = Step()
        began = time.monotonic()
        if self.console.is_terminal:
            spinner = Spinner("dots", Text(f"{label:<{LABEL_WIDTH}} {waiting}"), style=ACCENT)
            with Live(Padding(spinner, (0, 0, 0, INDENT)), console=self.console, transient=True):
                yield step
        else:
            if waiting:
                self.remark(f"{label}: {waiting}")
            yield step
        self._line(label, step.result, time.monotonic() - began)

    def line(self, label: str, result: str, took_s: float = 0.0) -> None:
        """Print the line of a step that showed itself while it went on, or took no time."""
        self._line(label, result, took_s)

    def remark(self, sentence: str) -> None:
        """Print a sentence beside the steps."""
        self.console.print(Text(f"{' ' * INDENT}{self._remark} {sentence}", style="dim"), soft_wrap=True)

    def interrupted(self) -> None:
        """Say what Ctrl-C left behind."""
        self.remark(f"Stopped. Finished episodes are kept; {program_name()} demo goes on with the rest.")

    def leaderboard(self, board: Json, team: str) -> None:
        """Print the standings, the demo team's line in bold, and its rate for each task or each shape."""
        self.console.print()
        of = ", all tasks" if board["task"] is None else f", {board['task']}"
        self.console.print(Text(f"{' ' * INDENT}{board['title']}{of}: leaderboard", style="bold"))
        self.console.print()
        table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
        table.add_column(" " * (INDENT - 1), width=INDENT - 1)
        table.add_column("Rank", justify="right")
        table.add_column("Team", max_width=18, overflow="ellipsis", no_wrap=True)
        table.add_column("Success", justify="right", no_wrap=True)
        table.add_column("0 %" + " " * (BAR_WIDTH - 8) + "100 %", width=BAR_WIDTH, no_wrap=True)
        table.add_column("95 % interval", no_wrap=True)
        table.add_column("Steps", justify="right", no_wrap=True)
        for entry in board["entries"]:
            table.add_row("", *self._entry(entry), style="bold" if entry["team"] == team else "")
        self.console.print(table)
        own = next((entry for entry in board["entries"] if entry["team"] == team), None)
        if own is not None:
            self._parts(own)

    def addresses(self, pairs: Mapping[str, str]) -> None:
        """Print names and addresses below each other, never broken over two lines."""
        self.console.print()
        for name, value in pairs.items():
            self.console.print(
                Text.assemble(" " * INDENT, (f"{name:<{LABEL_WIDTH}} ", "dim"), value), soft_wrap=True, no_wrap=True
            )
        self.console.print()

    def staying(self) -> None:
        """Say that the service goes on."""
        self.console.print(Text(f"{' ' * INDENT}The service keeps running. Ctrl-C stops it."))

    def stopped(self, state_dir: Path) -> None:
        """Say that the service has ended."""
        self.remark(f"The service has stopped. Everything is kept in {state_dir}.")

    def _entry(self, entry: Json) -> tuple[str | Text, ...]:
        rank = "-" if entry["rank"] is None else str(entry["rank"])
        low, high = entry["success_rate_interval"]
        steps = "-" if entry["mean_steps"] is None else f"{entry['mean_steps']:.2f}"
        bar = interval_bar(entry["success_rate"], low, high)
        interval = f"{100 * low:.1f} to {100 * high:.1f} %"
        return rank, entry["team"], percent(entry["success_rate"]) or "-", bar, interval, steps

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


def interval_bar(rate: float, low: float, high: float, width: int = BAR_WIDTH) -> Text:
    """Draw an interval of [0, 1] with its rate as a line of characters."""

    def place(fraction: float) -> int:
        return min(width - 1, int(fraction * width))

    bar = Text()
    for position in range(width):
        if position == place(rate):
            bar.append("●", style=ACCENT)
        elif place(low) <= position <= place(high):
            bar.append("━", style=ACCENT)
        else:
            bar.append("─", style="dim")
    return bar
