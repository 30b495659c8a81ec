"""Checks that nothing was left out of an export or added to it later, and that its results are of the teams shown."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from typing import Any, Final
from uuid import UUID

from vitac.evaluator.ranking import RankedScore
from vitac.evaluator.tracks.sealed import make_commitment

from ..competitions.definition import FINAL_SUFFIX
from ..transparency.entries import EntryKind, LogEntry
from ..transparency.merkle import Tree
from ..transparency.notes import Checkpoint, NoteRejected, VerifierKey, make_log_key
from ..views.leaderboards import LeaderboardEntryView, LeaderboardView
from .export import ExportDescription, ExportedTeam
from .receipt import (
    CombinedResult,
    EndReceipt,
    Receipt,
    Result,
    SignedContent,
    SubmissionReceipt,
    TaskResult,
    board_name,
)

_ARRIVAL: Final = timedelta(minutes=10)
"""How long after it has arrived a submission has its receipt at the latest; it is issued in the same transaction."""
_USUAL_WAIT: Final = timedelta(days=2)
"""First results of a submission that take longer are noted: the submission may have been made up afterwards."""


def check_head(described: ExportDescription, tree: Tree) -> Iterator[str]:
    """Yield a finding where the entries are not those that the export's checkpoint signs."""
    try:
        checkpoint = Checkpoint.parse(described.checkpoint)
        checkpoint.require_signature(make_log_key(bytes.fromhex(described.public_key)))
    except NoteRejected as error:
        yield str(error)
        return
    if (checkpoint.size, checkpoint.root) != (tree.size, tree.root()):
        yield (
            f"Expected {checkpoint.size} entries in the log with the root {checkpoint.root.hex()}, got {tree.size} "
            f"with {tree.root().hex()}."
        )


def check_noted(tree: Tree, size: int, root: str) -> Iterator[str]:
    """Yield a finding where the log no longer begins with the entries of a root, which somebody noted."""
    if size > tree.size:
        yield f"Expected at least {size} entries with the noted root {root}, got {tree.size}: the log ends before."
    elif (root_here := tree.root(size).hex()) != root:
        yield f"Expected the noted root {root} over the first {size} entries, got {root_here}: the log was rewritten."


def check_held(tree: Tree, entries: Mapping[int, LogEntry], receipt: SignedContent[Any]) -> Iterator[str]:
    """Yield a finding where a receipt that somebody stored elsewhere is not in the log, or proofs of it differ."""
    if entries.get(receipt.entry.number) != receipt.entry:
        yield f"Receipt {receipt.entry.number}, which was stored elsewhere, is not in the log."
    for proof in receipt.parsed_proofs():
        yield from check_noted(tree, proof.checkpoint.size, proof.checkpoint.root.hex())


def check_opened(
    described: ExportDescription, entries: Mapping[int, LogEntry], receipts: Iterable[SignedContent[Any]]
) -> Iterator[str]:
    """Yield a finding for each entry of the board's stage, and of an end, without its receipt in the export."""
    stage = board_name(described.competition, described.board.track, described.board.stage or "", described.kind)
    opened = {receipt.entry.number for receipt in receipts}
    for number, entry in entries.items():
        if (entry.board == stage or entry.content is EntryKind.END) and number not in opened:
            yield f"Receipt {number} is of this board, but the export does not hold it."


def check_witnessed(described: ExportDescription, tree: Tree, entries: Sequence[LogEntry]) -> Iterator[str]:
    """Yield a finding where fewer witnesses than the stage demands have signed a log with all that it has of the stage.

    What is demanded, and of whom, says the competition's file in the log.
    """
    definition = _find_definition(described.competition, entries)
    keys = tuple(definition.get("witnesses", ()))
    if keys != described.witnesses:
        yield "The witnesses that the export names are not those of the competition's file in the log."
    board = described.board
    stages = definition.get("tracks", {}).get(board.track, {}).get("stages", ())
    name = (board.stage or "").removesuffix(FINAL_SUFFIX)
    demanded = next((stage.get("witnesses", 0) for stage in stages if stage["name"] == name), 0)
    place = f"{described.competition}/{board.track}/{board.stage or ''}/"
    last = max((entry.number for entry in entries if entry.board.startswith(place)), default=0)
    signed = [key for key, size in find_signed_sizes(described, tree, keys).items() if size >= last]
    if len(signed) < demanded:
        yield (
            f"Expected {demanded} witnesses that have signed entry {last} of the log, the last one of this stage, got "
            f"{len(signed)}: whoever has the database could have made this log anew."
        )


def find_signed_sizes(described: ExportDescription, tree: Tree, keys: Iterable[str]) -> Mapping[str, int]:
    """Return how many entries of the export's log each witness has signed, by its key."""
    sizes: dict[str, int] = {}
    witnesses = [VerifierKey.parse(key) for key in keys]
    for text in (described.checkpoint, *described.witnessed):
        checkpoint = Checkpoint.parse(text)
        if checkpoint.size > tree.size or tree.root(checkpoint.size) != checkpoint.root:
            continue
        for key, _ in checkpoint.find_witnesses(witnesses):
            sizes[str(key)] = max(checkpoint.size, sizes.get(str(key), 0))
    return sizes


def _find_definition(competition: str, entries: Iterable[LogEntry]) -> Mapping[str, Any]:
    """Return the last file of a competition in the log; empty where there is none."""
    files = [entry for entry in entries if entry.content is EntryKind.COMPETITION and entry.board == f"{competition}/"]
    return (files[-1].statement or {}).get("definition", {}) if files else {}


def list_late(entries: Iterable[LogEntry]) -> Iterator[str]:
    """Yield each arrival after its stage had closed, and what follows the end of its competition."""
    closes: dict[str, datetime] = {}
    ended: dict[str, LogEntry] = {}
    for entry in entries:
        statement, competition = entry.statement or {}, entry.board.partition("/")[0]
        if entry.content is EntryKind.COMPETITION:
            for track, rules in statement["definition"]["tracks"].items():
                for stage in rules["stages"]:
                    closes[f"{competition}/{track}/{stage['name']}"] = datetime.fromisoformat(stage["closes"])
        if entry.content is EntryKind.END:
            if statement.get("finalized_at"):
                ended[statement["competition"]] = entry
            else:
                ended.pop(statement["competition"], None)
        elif competition in ended and statement.get("change") != "published":
            end = ended[competition].number
            yield f"{name_entry(entry)} follows the end of {competition}, entry {end}; ask why."
        closed_at = closes.get(entry.board.rpartition("/")[0])
        if entry.content is EntryKind.SUBMISSION and closed_at is not None and entry.issued_at >= closed_at:
            late = entry.issued_at - closed_at
            yield (
                f"{name_entry(entry)}: a submission arrived {late.total_seconds():.0f} s after its stage had closed "
                f"({_moment(closed_at)}); ask why."
            )


def name_entry(entry: LogEntry) -> str:
    """Return how sentences name an entry."""
    at = datetime.astimezone(entry.issued_at, UTC)
    return f"Entry {entry.number} ({entry.board.strip('/') or 'practice'}, {at:%F %T} UTC)"


def check_order(entries: Iterable[LogEntry]) -> Iterator[str]:
    """Yield a finding for each entry that was issued before the one that it follows."""
    for before, entry in pairwise(entries):
        if entry.issued_at < before.issued_at:
            yield (
                f"Receipt {entry.number} was issued at {_moment(entry.issued_at)}, before receipt {before.number}, "
                f"which it follows, at {_moment(before.issued_at)}."
            )


def check_arrivals(described: ExportDescription, arrivals: Mapping[UUID, SubmissionReceipt]) -> Iterator[str]:
    """Yield a finding for each submission whose receipt was not issued when it is said to have arrived.

    One that plays a final list arrived as the one that was chosen, of the same team and content.
    """
    for receipt in arrivals.values():
        arrival = receipt.submission
        if arrival.final_of is not None:
            yield from _check_chosen(described, receipt, arrivals.get(arrival.final_of))
            continue
        late = arrival.issued_at - arrival.submitted_at
        if not timedelta() <= late <= _ARRIVAL:
            yield (
                f"Receipt {receipt.entry.number} of submission {arrival.submission} was issued at "
                f"{_moment(arrival.issued_at)}, but the submission is said to have arrived at "
                f"{_moment(arrival.submitted_at)}."
            )


def _check_chosen(
    described: ExportDescription, receipt: SubmissionReceipt, chosen: SubmissionReceipt | None
) -> Iterator[str]:
    """Yield a finding where a submission that plays a final list is not the one that was chosen."""
    arrival, subject = receipt.submission, f"Receipt {receipt.entry.number} of a submission that plays a final list"
    if chosen is None or chosen.submission.final_of is not None or chosen.entry.number > receipt.entry.number:
        yield f"{subject}: the arrival of the chosen one, {arrival.final_of}, has no receipt before it."
        return
    expected = chosen.submission.model_copy(update={"stage": f"{chosen.submission.stage}{FINAL_SUFFIX}"})
    for name in ("submission_digest", "competition", "track", "stage", "kind", "submitted_at"):
        if getattr(arrival, name) != getattr(expected, name):
            yield f"{subject}: its {name.replace('_', ' ')} is not that of the chosen one."
    names = {name for team in described.teams for name in (team.name, *team.former_names)}
    if not any(arrival.is_of_team(name) and expected.is_of_team(name) for name in names):
        yield f"{subject}: the chosen one is not clearly of the same team."


def check_submissions(
    arrivals: Mapping[UUID, SubmissionReceipt], receipts: Iterable[Receipt]
) -> Iterator[tuple[bool, str]]:
    """Yield whether it is wrong, and what, for each result that does not follow from a submission in the log."""
    seen: set[UUID] = set()
    for receipt in receipts:
        result, number = receipt.result, receipt.entry.number
        is_first = result.submission not in seen
        seen.add(result.submission)
        arrival = arrivals.get(result.submission)
        if arrival is None:
            yield True, f"Receipt {number} is of submission {result.submission}, whose arrival has no receipt."
            continue
        if arrival.entry.number > number:
            yield True, f"Receipt {number} is of a submission that arrived later, with receipt {arrival.entry.number}."
        for name in ("submission_digest", "competition", "track", "stage", "kind", "submitted_at"):
            expected, got = getattr(arrival.submission, name), getattr(result, name)
            if got != expected:
                what = name.replace("_", " ")
                yield True, f"Receipt {number}: {what} is {got}, in receipt {arrival.entry.number} it is {expected}."
        waited = result.issued_at - result.submitted_at
        if is_first and waited > _USUAL_WAIT:
            yield False, f"Receipt {number}: its result was issued {waited.days} days after the submission; ask why."


def check_secret(described: ExportDescription, results: Iterable[Result]) -> Iterator[str]:
    """Yield a finding where the published secret is not the one that was committed to."""
    if described.secret is None:
        return
    made = make_commitment(bytes.fromhex(described.secret))
    if described.commitment != made:
        yield f"The published secret has the commitment {made}, expected {described.commitment}."
    for commitment in sorted({result.commitment for result in results if result.commitment} - {made}):
        yield f"Results were played on a list with the commitment {commitment}, the published secret has {made}."


def check_end(described: ExportDescription, ends: Sequence[EndReceipt]) -> Iterator[str]:
    """Yield a finding for winners, prizes and marks that are not those of the signed end."""
    end = ends[-1].end if ends else None
    for what, got, signed in (
        ("winners and prizes", described.winners, end.winners if end else ()),
        ("judges' marks", described.judged, end.judged if end else ()),
    ):
        if got != signed:
            where = f"receipt {ends[-1].entry.number}" if ends else "the log, which has no end of the competition"
            yield f"The {what} of the export are not those of {where}."


def check_repeated_end(ends: Sequence[EndReceipt]) -> Iterator[str]:
    """Yield each time that an end was signed again: only the last one counts, and the holder of the key can sign it."""
    for receipt in ends[1:]:
        reason = f": {receipt.end.reason}" if receipt.end.reason else ""
        yield f"Receipt {receipt.entry.number}: the end of {receipt.end.competition} was signed again{reason}; ask why."


def check_winners(described: ExportDescription, receipts: Iterable[Receipt]) -> Iterator[tuple[bool, str]]:
    """Yield whether it is wrong, and what, where the winners of the board's track are not the first ones of the board.

    A team that was disqualified after the end has left the board, while its place stays until the end is decided again.
    """
    board = described.board
    winners = [winner for winner in described.winners if winner.track == board.track]
    if board.task is not None or not described.kind.form.runs_policy or not winners:
        return
    teams = teams_by_evaluation(described)
    of_stage = {receipt.result.submission: teams.get(receipt.result.evaluation) for receipt in receipts}
    if of_stage.keys().isdisjoint(winner.submission for winner in winners):
        yield False, f"The winners of {board.track} have no result in this stage; audit the board of its last stage."
        return
    left = []
    for winner in winners:
        team = of_stage.get(winner.submission) if winner.submission else None
        if team is not None and team.off_boards:
            yield False, f"{team.name}: wins {winner.place}; the service leaves the team out: {team.off_boards}."
        else:
            left.append(winner)
    totals = {entry.submission: entry.total for entry in described.judged if entry.track == board.track}
    ranked = [entry for entry in board.entries if entry.rank is not None]
    if totals:
        ranked.sort(key=lambda entry: -(totals.get(entry.submission_id) or 0.0))
    expected = [(entry.submission_id, entry.result_hash) for entry in ranked][: len(left)]
    if [(winner.submission, winner.result_hash) for winner in left] != expected:
        yield True, "The winners are not the first ones of the board."
    if [winner.rank for winner in winners] != list(range(1, len(winners) + 1)):
        yield True, "The ranks of the winners do not count from 1."


def check_teams(described: ExportDescription, receipts: Mapping[UUID, Receipt]) -> Iterator[tuple[bool, str]]:
    """Yield whether it is wrong, and what, for each result that is not clearly of the team that it is shown for."""
    teams = teams_by_evaluation(described)
    for evaluation, receipt in receipts.items():
        team, number = teams.get(evaluation), receipt.entry.number
        if team is None:
            yield True, f"Receipt {number} is of a result that the export gives to no team."
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
    copies = described.copies
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
        shown, subject = entries.get(team.name), f"{team.name}: receipt {receipt.entry.number}"
        if team.off_boards:
            yield False, f"{subject}; the service leaves the team out: {team.off_boards}."
            continue
        if receipt.result.evaluation in team.disqualified:
            yield False, f"{subject}; the service leaves the result out: its submission was disqualified or withdrawn."
            continue
        if receipt.result.evaluation in copies:
            if _copies_another_teams(described, receipts, receipt.result):
                continue
            yield False, f"{subject}; the service says that this is a copy of an earlier one, so it is not ranked."
            continue
        if shown is None:
            missing = f"{subject} is of this board, but the team is not on it"
        elif shown.rank is not None and _is_better(board, ranked_by, receipt.result.submitted_at, than=shown):
            missing = f"{subject} is better than its entry on the board"
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
    return [one.result_hash for one in result.tasks if task in {None, one.task}]


def reached(task: str | None, result: Result) -> TaskResult | CombinedResult | None:
    """Return what a board compares of a result; None where it is on no such board."""
    if task is None:
        return result.combined
    return next((one for one in result.tasks if one.task == task), None)


def place(board: LeaderboardView, entry: LeaderboardEntryView) -> tuple[float, ...]:
    """Return what sorts the entries of a board, by the values that it shows."""
    shown = {"success_rate": entry.success_rate, "mean_steps": entry.mean_steps, **entry.measures}
    return board.ranking.sort_key({**shown, "submitted_at": entry.submitted_at.timestamp()})


def _is_better(
    board: LeaderboardView, score: RankedScore, submitted_at: datetime, *, than: LeaderboardEntryView
) -> bool:
    return board.ranking.sort_key(board.ranking.values(score, submitted_at)) < place(board, than)


def teams_by_evaluation(described: ExportDescription) -> Mapping[UUID, ExportedTeam]:
    """Return the team of each result."""
    return {evaluation: team for team in described.teams for evaluation in team.evaluations}


def _moment(at: datetime) -> str:
    return f"{at:%F %T} UTC"
