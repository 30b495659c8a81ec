"""What the words for ends of episodes mean, under a table that has them."""

from collections.abc import Iterable


def print_meanings(outcomes: Iterable[str]) -> None:
    """Print a line for each of the words, in the order of their first use."""
    from vitac.evaluator.episodes.records import EpisodeOutcome

    for outcome in dict.fromkeys(outcomes):
        print(f"{outcome}: {EpisodeOutcome(outcome).sentence}")
