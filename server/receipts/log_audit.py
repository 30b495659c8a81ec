"""Checks a log by its public files alone, and says what they cannot show; for `vitac receipt audit` and `compare`."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from pydantic import ValidationError
from vitac.evaluator.tracks.sealed import make_commitment

from ..transparency.entries import EntryKind, LogEntry
from ..transparency.merkle import TILE_HEIGHT, TILE_WIDTH, ProofRejected, Tree, check_consistency, make_tree
from ..transparency.notes import Checkpoint, NoteRejected, VerifierKey
from ..transparency.tiles import PublishedLog, TileMissing
from .completeness import check_held, check_noted, check_order, list_late, name_entry
from .receipt import AnyReceipt, ReceiptRejected


@dataclass(kw_only=True)
class LogAudit:
    """What an audit of a log found.

    Attributes:
        key: that signed the checkpoint.
        size: number of entries.
        root: over all of them.
        entries: how many stand for what.
        witnesses: number of entries that each witness has signed, by its name; 0 for none.
        findings: what is wrong; nothing in a log that can be believed.
        unusual: what is not wrong, but should be explained.
        winners: who won what by the last end of each competition, a sentence for each.
        doubts: what these files cannot show.
    """

    key: str
    size: int
    root: str
    entries: dict[str, int] = field(default_factory=dict)
    witnesses: dict[str, int] = field(default_factory=dict)
    findings: list[str] = field(default_factory=list)
    unusual: list[str] = field(default_factory=list)
    winners: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)


def audit_log(
    log: PublishedLog,
    *,
    held: Sequence[AnyReceipt] = (),
    checkpoints: Collection[Checkpoint] = (),
    roots: Mapping[int, str] = MappingProxyType({}),
) -> LogAudit:
    """Check all files of a log: hashes, order, times, secrets, what others noted, and who witnesses it.

    Args:
        log: as it is published; the signature of its checkpoint is checked already.
        held: receipts that were stored elsewhere and must be in it.
        checkpoints: that were stored elsewhere, of which it must be the continuation.
        roots: the same as somebody noted them, by the number of entries.

    Raises:
        TileMissing: a file is not there.
    """
    result = LogAudit(key=str(log.key), size=log.checkpoint.size, root=log.checkpoint.root.hex())
    entries = _read_entries(log, result)
    if entries is None:
        return result
    result.entries = dict(Counter(entry.content.value for entry in entries))
    tree = make_tree([entry.leaf_hash for entry in entries])
    for checkpoint in checkpoints:
        result.findings += _check_stored(log.key, tree, checkpoint)
    for size, root in roots.items():
        result.findings += check_noted(tree, size, root)
    by_number = {entry.number: entry for entry in entries}
    for receipt in held:
        result.findings += _check_receipt(log.key, tree, by_number, receipt)
    result.findings += check_order(entries)
    result.findings += _check_secrets(entries)
    result.unusual += [*list_unusual(entries), *list_late(entries)]
    result.winners = list(_list_winners(entries))
    demanded = _find_witnesses(log, tree, entries, result)
    result.doubts += _list_doubts(result, entries, held, demanded)
    return result


def compare(first: Checkpoint, second: Checkpoint, key: VerifierKey, log: PublishedLog | None = None) -> Iterator[str]:
    """Yield what is wrong with two checkpoints of a log, the first of which was noted earlier.

    Args:
        first: the earlier one.
        second: the later one.
        key: of the log.
        log: whose tiles show whether one continues the other; None: unknown where their sizes differ.
    """
    unsigned = [reason for checkpoint in (first, second) for reason in _explain_unsigned(key, checkpoint)]
    if unsigned:
        yield from unsigned
        return
    if second.size < first.size:
        yield (
            f"The later checkpoint has {second.size} entries, the earlier one {first.size}: the log was rolled back. "
            "Both are signed by its key, which proves it."
        )
    elif second.size == first.size and second.root != first.root:
        yield (
            f"Both checkpoints have {first.size} entries and other roots: two views of the log. Both are signed by "
            "its key, which proves it."
        )
    smaller, larger = sorted((first, second), key=lambda one: one.size)
    if log is None or smaller.size == larger.size:
        return
    if larger.size > log.checkpoint.size:
        yield f"The log has {log.checkpoint.size} entries now, fewer than the {larger.size} that it has signed."
        return
    try:
        proof = log.tree.prove_consistency(smaller.size, larger.size)
        check_consistency(smaller.size, larger.size, proof, smaller.root, larger.root)
    except (ProofRejected, TileMissing) as error:
        yield (
            f"The tiles of the log do not show that the {larger.size} entries of one checkpoint begin with the "
            f"{smaller.size} of the other. {error}"
        )


def list_unusual(entries: Sequence[LogEntry]) -> Iterator[str]:
    """Yield what organizers may do, and should explain where it happens after submissions have arrived."""
    first: dict[str, LogEntry] = {}
    ended: set[str] = set()
    for entry in entries:
        competition, _, rest = entry.board.partition("/")
        if entry.content is EntryKind.SUBMISSION:
            for place in (f"{competition}/", f"{competition}/{rest.rpartition('/')[0]}/"):
                first.setdefault(place, entry)
        elif entry.content in {EntryKind.COMPETITION, EntryKind.SEALED_LIST} and entry.board in first:
            statement = entry.statement or {}
            what = (
                "the competition file was applied"
                if entry.content is EntryKind.COMPETITION
                else f"the sealed list was {statement.get('change')}"
            )
            if statement.get("change") != "published":
                yield f"{name_entry(entry)}: {what} after submission {first[entry.board].number} had arrived; ask why."
        elif entry.content is EntryKind.REJUDGEMENT:
            statement = entry.statement or {}
            replaced, withdrawn = statement.get("replaced"), statement.get("withdrawn")
            yield f"{name_entry(entry)}: {replaced} results were replaced, {withdrawn} withdrawn; ask why."
        elif entry.content is EntryKind.END:
            if entry.board in ended:
                yield f"{name_entry(entry)} was signed again, so winners changed or it was reopened; ask why."
            ended.add(entry.board)


def _list_winners(entries: Sequence[LogEntry]) -> Iterator[str]:
    ends = {entry.board: entry for entry in entries if entry.content is EntryKind.END}
    for entry in ends.values():
        statement = entry.statement or {}
        for winner in statement.get("winners", ()):
            yield (
                f"{statement['competition']}, {winner['track']}: {winner['team']} wins {winner['place']}, "
                f"{winner['amount']} {winner['currency']}."
            )


def _read_entries(log: PublishedLog, result: LogAudit) -> list[LogEntry] | None:
    """Return all entries; None, with the reason in `result`, where the files are not those of the checkpoint."""
    entries = []
    try:
        for number, content in enumerate(log.entries(), start=1):
            entry = LogEntry.model_validate_json(content)
            if entry.leaf() != content or entry.number != number:
                raise ProofRejected(f"Entry {number} is written as entry {entry.number}, or in another form.")
            entries.append(entry)
    except ProofRejected as error:
        result.findings.append(str(error))
    except ValidationError:
        result.findings.append(f"Entry {len(entries) + 1} does not have the form of one.")
    else:
        tree = make_tree([entry.leaf_hash for entry in entries])
        result.findings += _check_tiles(log, tree)
    return None if result.findings else entries


def _check_tiles(log: PublishedLog, tree: Tree) -> Iterator[str]:
    if tree.root() != log.checkpoint.root:
        yield f"The {tree.size} entries have the root {tree.root().hex()}, the checkpoint {log.checkpoint.root.hex()}."
    level, width = 1, tree.size // TILE_WIDTH
    while width:
        for first in range(0, width, TILE_WIDTH):
            where = level, first // TILE_WIDTH, min(TILE_WIDTH, width - first)
            try:
                if list(log.tree.read_tile(*where)) != list(tree.read_tile(*where)):
                    yield f"Tile {where[1]} of level {level} has other hashes than those of its entries."
            except ProofRejected as error:
                yield str(error)
        level, width = level + 1, width >> TILE_HEIGHT


def _explain_unsigned(key: VerifierKey, checkpoint: Checkpoint) -> Iterator[str]:
    try:
        checkpoint.require_signature(key)
    except NoteRejected as error:
        yield str(error)


def _check_stored(key: VerifierKey, tree: Tree, checkpoint: Checkpoint) -> Iterator[str]:
    unsigned = list(_explain_unsigned(key, checkpoint))
    yield from unsigned or check_noted(tree, checkpoint.size, checkpoint.root.hex())


def _check_receipt(key: VerifierKey, tree: Tree, entries: Mapping[int, LogEntry], receipt: AnyReceipt) -> Iterator[str]:
    try:
        receipt.require_valid(key.public_key.hex())
    except ReceiptRejected as error:
        yield str(error)
    else:
        yield from check_held(tree, entries, receipt)


def _check_secrets(entries: Sequence[LogEntry]) -> Iterator[str]:
    """Yield a finding for each published secret that does not belong to its commitment, or was never committed to."""
    sealed: set[tuple[str, str]] = set()
    for entry in entries:
        if entry.content is not EntryKind.SEALED_LIST:
            continue
        statement = entry.statement or {}
        commitment, secret = str(statement.get("commitment")), statement.get("secret")
        if secret is not None and make_commitment(bytes.fromhex(secret)) != commitment:
            yield f"{name_entry(entry)}: the published secret is not the one behind the commitment {commitment}."
        if secret is not None and (entry.board, commitment) not in sealed:
            yield f"{name_entry(entry)}: its commitment {commitment} was not in the log before."
        sealed.add((entry.board, commitment))


def _find_witnesses(log: PublishedLog, tree: Tree, entries: Sequence[LogEntry], result: LogAudit) -> int:
    """Write how far each named witness has come, and return how many of them a stage demands at most."""
    files: dict[str, Mapping[str, Any]] = {
        entry.board: (entry.statement or {}).get("definition", {})
        for entry in entries
        if entry.content is EntryKind.COMPETITION
    }
    keys = [VerifierKey.parse(key) for definition in files.values() for key in definition.get("witnesses", ())]
    result.witnesses = dict.fromkeys((key.name for key in keys), 0)
    for checkpoint in (log.checkpoint, *log.read_witnessed()):
        for key, _ in checkpoint.find_witnesses(keys):
            result.findings += check_noted(tree, checkpoint.size, checkpoint.root.hex())
            result.witnesses[key.name] = max(result.witnesses[key.name], checkpoint.size)
    return max(
        (
            stage.get("witnesses", 0)
            for definition in files.values()
            for track in definition.get("tracks", {}).values()
            for stage in track["stages"]
        ),
        default=0,
    )


def _list_doubts(
    result: LogAudit, entries: Sequence[LogEntry], held: Sequence[AnyReceipt], demanded: int
) -> Iterator[str]:
    sizes = sorted(result.witnesses.values(), reverse=True)
    witnessed = sizes[max(demanded, 1) - 1] if len(sizes) >= max(demanded, 1) else 0
    if not witnessed:
        yield (
            "Whether everybody sees this log: no witness has signed it, or fewer than the competition demands. The "
            "organizers could show others another one. Compare checkpoints with other teams: `vitac receipt compare`."
        )
    else:
        if witnessed < result.size:
            yield (
                f"Whether everybody sees the entries after {witnessed}: too few witnesses have signed them so far. Run "
                "the audit again later."
            )
        yield "Whether witnesses and organizers work together: whoever knows a witness can ask it for its checkpoint."
    if not held:
        yield "Whether your submission is in the log: give the file of your receipt as --receipt."
    yield (
        "Which results are right: of results the log has salted hashes only. The audit of a board's export compares "
        "them with records, and runs episodes again: `vitac receipt audit EXPORT`."
    )
    yield (
        "Whether your policy chose the actions: it ran on the organizers' machines. Playing the public list yourself "
        "with `vitac evaluate` must give the same result hash."
    )
    published = {
        (entry.board, (entry.statement or {}).get("change"))
        for entry in entries
        if entry.content is EntryKind.SEALED_LIST
    }
    for board in sorted({board for board, change in published if change == "sealed"}):
        place = board.strip("/").replace("/", ", ")
        if (board, "published") not in published:
            yield f"What the sealed list of {place} holds: its secret is not published yet."
        yield f"Who knew the sealed list of {place} before: the organizers did, and the log cannot show whom they told."
    yield "Whether an upload that got no receipt was refused rightly: only what arrived is in the log."
    if EntryKind.END in result.entries:
        yield "Whether judges marked fairly, and whether two teams are the same people: no log shows that."
