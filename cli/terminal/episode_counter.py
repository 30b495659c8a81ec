"""How far a command is that plays many episodes, on one line of a terminal."""

import sys
from pathlib import Path


class EpisodeCounter:
    """A line on a terminal that says how far a command is."""

    def __enter__(self) -> "EpisodeCounter":
        return self

    def show_collected(self, task: str, wanted: int, episodes: int, successes: int) -> None:
        """Show how many demonstrations there are."""
        self._show(f"{task}: {successes} of {wanted} successes in {episodes} episodes")

    def show_played(self, folder: Path, episodes: int) -> None:
        """Show how many episodes were played again."""
        self._show(f"{folder.name}: played {episodes} episodes again")

    def __exit__(self, *_: object) -> None:
        self._show("")

    def _show(self, text: str) -> None:
        if sys.stderr.isatty():
            print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)
