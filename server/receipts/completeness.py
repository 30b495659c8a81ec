"""Checks that nothing was left out of an export, and that its results are of the teams that they are shown for."""

from collections.abc import Iterator, Mapping, Sequence
from math import inf
from uuid import UUID

from vitac.evaluator.submission_kinds import SubmissionKind

from ..views.leaderboards import LeaderboardEntryView
from .export import ExportDescription, ExportedTeam
from .receipt import CombinedResult, Link, Receipt, Result, TaskResult, board_name


def check_head(described: ExportDescription, chain: Mapping[int, Link]) -> Iterator[str]:
    """Yield a finding where the chain is not as long as the export says, or ends with another link."""
    last = chain[max(chain)].digest if chain else None
    if described.receipts is not None and (described.receipts, described.last) != (len(chain), last):
        yield (
            f"Expected {described.receipts} receipts in the chain, the last one {described.last}, got {len(chain)}, "
            f"the last one {last}."
        )


def check_noted(chain: Mapping[int, Link], number: int, digest: str) -> Iterator[str]:
    """Yield a finding where the chain no longer has the link of that number and digest, which somebody noted."""
    link = chain.get(number)
    if link is None or link.digest != digest:
        found = f"digest {link.digest}" if link else "none: the chain ends before"
        yield f"Expected receipt {number} with the noted digest {digest}, got {found}."


def check_opened(
    described: ExportDescription, chain: Mapping[int, Link], receipts: Mapping[UUID, Receipt]
) -> Iterator[str]:
    """Yield a finding for each link of the board's stage without its receipt in the export."""
    stage = board_name(described.board.track, described.board.stage or "", described.kind)
    opened = {receipt.link.number for receipt in receipts.values()}
    for number, link in chain.items():
        if link.board == stage and number not in opened:
            yield f"Receipt {number} is of this board, but the export does not hold it."


def check_teams(described: ExportDescription, receipts: Mapping[UUID, Receipt]) -> Iterator[tuple[bool, str]]:
    """Yield whether it is wrong, and what, for each result that is not clearly of the team that it is shown for."""
    teams = teams_by_evaluation(described)
    for evaluation, receipt in receipts.items():
        team, number = teams.get(evaluation), receipt.link.number
        if team is None:
            yield True, f"Receipt {number} is of a result that the export gives to no team."
        elif receipt.result.team_sha256 is None:
            yield False, f"{team.name}: receipt {number} names no team; it is of the first format."
        elif receipt.result.is_of_team(team.name):
            continue
        elif former := next((name for name in team.former_names if receipt.result.is_of_team(name)), None):
            why = "the service says that this team was renamed or merged."
            yield False, f"{team.name}: receipt {number} was issued to {former!r}; {why}"
        elif team.is_removed:
            yield False, f"{team.name}: whose receipt {number} is; the service says that the team's names were deleted."
        else:
            yield True, f"{team.name}: receipt {number} was issued to another team."


def check_entries(described: ExportDescription, receipts: Mapping[UUID, Receipt]) -> Iterator[tuple[bool, str]]:
    """Yield whether it is wrong, and what, for each result that is missing on the board.

    All results of a submission that was evaluated again are compared, as its board holds them all; only a rejudgement
    takes some away, and the export says which.
    """
    teams, board = teams_by_evaluation(described), described.board
    copies = described.copies if described.kind is SubmissionKind.LOG else ()
    if len(copies) < len(described.copies):
        n_copies = len(described.copies)
        yield True, f"Expected no copies on a board of kind {described.kind}, got {n_copies}: only logs can be."
    entries = {entry.team: entry for entry in board.entries}
    for entry in board.entries:
        team = teams.get(entry.evaluation_id)
        if team is not None and team.name != entry.team:
            yield True, f"{entry.team}: the export gives its result to {team.name}."
        is_current = entry.evaluator_version == board.evaluator_version
        if entry.rank is None and is_current and entry.evaluation_id not in copies:
            yield True, f"{entry.team}: its result has no rank, though it is of the board's evaluator version."
    for receipt in receipts.values():
        team, ranked_by = teams.get(receipt.result.evaluation), reached(board.task, receipt.result)
        if team is None or ranked_by is None or receipt.result.evaluator_version != board.evaluator_version:
            continue
        shown, told = entries.get(team.name), f"{team.name}: receipt {receipt.link.number}"
        if team.off_boards:
            yield False, f"{told}; the service leaves the team out: {team.off_boards}."
            continue
        if receipt.result.evaluation in copies:
            if _copies_another_teams(described, receipts, receipt.result):
                continue
            yield False, f"{told}; the service says that this log is a copy of an earlier one, so it is not ranked."
            continue
        if shown is None:
            missing = f"{told} is of this board, but the team is not on it"
        elif shown.rank is not None and _place_of_result(described, receipt.result) < place(described.ranking, shown):
            missing = f"{told} is better than its entry on the board"
        else:
            continue
        if receipt.result.evaluation in described.set_aside:
            yield False, f"{missing}; the service says that a rejudgement took it away."
        else:
            yield True, f"{missing}."


def _copies_another_teams(described: ExportDescription, receipts: Mapping[UUID, Receipt], result: Result) -> bool:
    """Return whether another team was the first with these result hashes, which cover the states of all episodes."""
    teams, hashes = teams_by_evaluation(described), _hashes(described, result)
    alike = [receipt.result for receipt in receipts.values() if _hashes(described, receipt.result) == hashes]
    first = teams.get(min(alike, key=lambda one: one.submitted_at).evaluation)
    return first is not None and first != teams.get(result.evaluation)


def _hashes(described: ExportDescription, result: Result) -> list[str]:
    task = described.board.task
    return [found.result_hash for found in result.tasks if task in {None, found.task}]


def reached(task: str | None, result: Result) -> TaskResult | CombinedResult | None:
    """Return what a board compares of a result; None where it is on no such board."""
    if task is None:
        return result.combined
    return next((found for found in result.tasks if found.task == task), None)


def place(ranking: Sequence[str], entry: LeaderboardEntryView) -> tuple[float, ...]:
    """Return what sorts entries as the board does."""
    return _place(ranking, entry.success_rate, entry.mean_steps, entry.submitted_at.timestamp())


def teams_by_evaluation(described: ExportDescription) -> Mapping[UUID, ExportedTeam]:
    """Return the team of each result."""
    return {evaluation: team for team in described.teams for evaluation in team.evaluations}


def _place_of_result(described: ExportDescription, result: Result) -> tuple[float, ...]:
    ranked_by = reached(described.board.task, result)
    if ranked_by is None:
        return (inf,)
    return _place(described.ranking, ranked_by.success_rate, ranked_by.mean_steps, result.submitted_at.timestamp())


def _place(
    ranking: Sequence[str], success_rate: float, mean_steps: float | None, submitted_at: float
) -> tuple[float, ...]:
    values = {
        "success_rate": -success_rate,
        "mean_steps": inf if mean_steps is None else mean_steps,
        "submitted_at": submitted_at,
    }
    return tuple(values[key] for key in ranking)
