"""Checks a board against its receipts and the records behind it, from an export alone: nothing asks a server.

Called by `vitac receipt audit`. Whoever has the database could make a whole new log with its key. The
receipts that teams store (`held`) show that: they are not in the new one.
"""

import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from re import fullmatch
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any, TypeVar
from uuid import UUID

import numpy as np
from vitac.errors import VitacError
from vitac.evaluator.episodes.episode import Environment, make_environment
from vitac.evaluator.episodes.records import EpisodeRecord, result_hash
from vitac.evaluator.logs.checks import explain_impossible, known_without_running
from vitac.evaluator.logs.log import LogHeader, LogReader, LogRejected
from vitac.evaluator.logs.verification import check_episode
from vitac.evaluator.scoring.score import score
from vitac.evaluator.sensors.made import read_made_sensor
from vitac.evaluator.tracks import Track, load_track
from vitac.evaluator.tracks.registry import TRACKS_FOLDER_VARIABLE, find_version
from vitac.evaluator.tracks.sealed import load_played_track, make_commitment

from ..transparency.entries import LogEntry
from ..transparency.merkle import Tree, make_tree
from ..views.leaderboards import LeaderboardEntryView
from . import completeness
from .export import ExportDescription, ExportReader
from .receipt import (
    AnyReceipt,
    Receipt,
    ReceiptRejected,
    Result,
    SignedContent,
    SubmissionReceipt,
    TaskResult,
)

ReceiptT = TypeVar("ReceiptT", bound=SignedContent[Any])


@dataclass(frozen=True, kw_only=True)
class SampledEpisode:
    """An episode that was run through the physics again."""

    evaluation: UUID
    task: str
    episode: int


@dataclass(kw_only=True)
class Audit:
    """What an audit looked at, and what it found.

    Attributes:
        public_key: that signed the receipts.
        log_entries: of the log.
        entries: of the board.
        logs: whose records agree with the receipts.
        resimulated: episodes that were run again.
        unverified: teams with a rank whose records could not be compared with the receipt.
        findings: what is wrong; nothing in a board that can be believed.
        unusual: what is not wrong, but should be explained.
        unchecked: what could not be checked, and why.
        unknowable: what nobody can see in the export alone, and what shows it.
    """

    public_key: str
    log_entries: int = 0
    entries: int = 0
    logs: int = 0
    resimulated: list[SampledEpisode] = field(default_factory=list)
    unverified: list[str] = field(default_factory=list)
    findings: list[str] = field(default_factory=list)
    unusual: list[str] = field(default_factory=list)
    unchecked: list[str] = field(default_factory=list)
    unknowable: list[str] = field(default_factory=list)

    @property
    def is_believed(self) -> bool:
        """Whether nothing is wrong, and the records of each rank, of one at least, agree with the receipts."""
        return self.logs > 0 and not self.findings and not self.unverified


@dataclass(frozen=True, kw_only=True)
class _Log:
    """A log of an export whose records agree with the receipt, and the track with the list that it was made on."""

    evaluation: UUID
    track: Track
    task: str
    header: LogHeader
    episodes: Sequence[int]


def audit(
    path: Path,
    *,
    public_key: str | None = None,
    held: Collection[AnyReceipt] = (),
    noted: Mapping[int, str] = MappingProxyType({}),
    episodes: int = 10,
    seed: int = 0,
    on_episode: Callable[[SampledEpisode], None] = lambda _: None,
) -> Audit:
    """Check an export: log, signature, board, records, and some episodes through the physics.

    Args:
        path: the export.
        public_key: of the service [hex], from elsewhere; None: that of the export.
        held: receipts that were stored elsewhere and must be in the log.
        noted: roots of the log by the number of its entries, noted elsewhere, such as on a past day.
        episodes: how many are run again.
        seed: chooses them.
        on_episode: called after each of these.

    Raises:
        ExportRejected: the file is no export.
    """
    with ExportReader.opened(path) as reader:
        described = reader.description
        result = Audit(public_key=described.public_key)
        if public_key is not None and described.public_key != public_key:
            result.findings.append(f"Expected the key {public_key}, got {described.public_key}.")
        listed = _read_entries(reader.entries(), result)
        tree, logged = make_tree([entry.leaf_hash for entry in listed]), {entry.number: entry for entry in listed}
        result.findings += completeness.check_head(described, tree)
        for receipt in held:
            result.findings += completeness.check_held(tree, logged, receipt)
        for size, root in noted.items():
            result.findings += completeness.check_noted(tree, size, root)
        result.findings += completeness.check_order(listed)
        result.findings += completeness.check_witnessed(described, tree, listed)
        result.unusual += completeness.list_late(listed)
        result.unknowable += _list_unknowable(described, tree, key=public_key, is_noted=bool(held or noted))
        arrivals = {one.submission.submission: one for one in _signed(reader.submissions(), logged, result)}
        receipts = {receipt.result.evaluation: receipt for receipt in _signed(reader.receipts(), logged, result)}
        all_ends = _signed(reader.ends(), logged, result)
        ends = [receipt for receipt in all_ends if receipt.end.competition == described.competition]
        _check_board(described, receipts, result)
        result.findings += completeness.check_opened(
            described, logged, [*arrivals.values(), *receipts.values(), *all_ends]
        )
        result.findings += completeness.check_secret(described, [receipt.result for receipt in receipts.values()])
        result.findings += completeness.check_end(described, ends)
        for is_wrong, sentence in completeness.check_winners(described, receipts.values()):
            (result.findings if is_wrong else result.unchecked).append(sentence)
        result.unusual += completeness.check_repeated_end(ends)
        _check_results(described, arrivals, receipts, result)
        with _find_track(reader, result):
            logs = list(_check_logs(reader, receipts, result))
            _resimulate(reader, logs, count=episodes, seed=seed, result=result, on_episode=on_episode)
        return result


def _list_unknowable(described: ExportDescription, tree: Tree, *, key: str | None, is_noted: bool) -> Iterator[str]:
    if key is None:
        yield "Whose key signed this log: compare it with the one that you noted, or give that as --key."
    if not is_noted and not completeness.find_signed_sizes(described, tree, described.witnesses):
        yield (
            "Whether others were shown this log: whoever has the database could have made all of it anew, with other "
            "results and winners, and signed it. A checkpoint that you noted (--noted), a receipt that you stored "
            "(--receipt) or a witness would show it."
        )


def _read_entries(entries: Iterator[LogEntry], result: Audit) -> list[LogEntry]:
    """Return the entries of the log; report gaps and wrong order."""
    listed = list(entries)
    for number, entry in enumerate(listed, start=1):
        if entry.number != number:
            result.findings.append(f"Expected entry {number} of the log, got {entry.number}.")
            break
    result.log_entries = len(listed)
    return listed


def _signed(receipts: Iterator[ReceiptT], logged: Mapping[int, LogEntry], result: Audit) -> list[ReceiptT]:
    """Return the receipts that are whole and in the log; report the others."""
    good: list[ReceiptT] = []
    for receipt in receipts:
        try:
            receipt.require_content()
        except ReceiptRejected as error:
            result.findings.append(str(error))
            continue
        if logged.get(receipt.entry.number) == receipt.entry:
            good.append(receipt)
        else:
            result.findings.append(f"Receipt {receipt.entry.number} is not in the log.")
    return good


def _check_board(described: ExportDescription, receipts: Mapping[UUID, Receipt], result: Audit) -> None:
    board = described.board
    result.entries = len(board.entries)
    for entry in board.entries:
        receipt = receipts.get(entry.evaluation_id)
        if receipt is None:
            result.findings.append(f"{entry.team}: there is no receipt of evaluation {entry.evaluation_id}.")
            continue
        differences = _differences(described, entry, receipt.result)
        result.findings += [f"{entry.team}: {difference}" for difference in differences]
    ranked = [entry for entry in board.entries if entry.rank is not None]
    if [entry.rank for entry in ranked] != list(range(1, len(ranked) + 1)):
        result.findings.append("The ranks of the board do not count from 1.")
    if ranked != sorted(ranked, key=lambda entry: completeness.place(board, entry)):
        result.findings.append("The order of the board is not that of its scores.")


def _check_results(
    described: ExportDescription,
    arrivals: Mapping[UUID, SubmissionReceipt],
    receipts: Mapping[UUID, Receipt],
    result: Audit,
) -> None:
    """Report results without their submission, of other teams, or missing on the board."""
    result.findings += completeness.check_arrivals(described, arrivals)
    for is_wrong, sentence in completeness.check_submissions(arrivals, receipts.values()):
        (result.findings if is_wrong else result.unusual).append(sentence)
    for is_wrong, sentence in (
        *completeness.check_teams(described, receipts),
        *completeness.check_entries(described, receipts),
    ):
        (result.findings if is_wrong else result.unchecked).append(sentence)


@contextmanager
def _find_track(reader: ExportReader, result: Audit) -> Iterator[None]:
    """Know the board's track while the block runs, also where its file is in the export and not on this machine."""
    name = reader.description.board.track
    content = reader.track_file(name)
    if content is None or not fullmatch(r"[\w-]+", name):
        yield
        return
    before = os.environ.get(TRACKS_FOLDER_VARIABLE)
    with TemporaryDirectory(prefix="vitac-audit-") as folder:
        (Path(folder) / f"{name}.yaml").write_bytes(content)
        os.environ[TRACKS_FOLDER_VARIABLE] = folder
        try:
            yield
        except VitacError as error:
            result.findings.append(f"The file of track {name} in the export cannot be used. {error}")
        finally:
            if before is None:
                del os.environ[TRACKS_FOLDER_VARIABLE]
            else:
                os.environ[TRACKS_FOLDER_VARIABLE] = before


def _differences(described: ExportDescription, entry: LeaderboardEntryView, result: Result) -> Iterator[str]:
    board = described.board
    tasks = {task.task: task for task in result.tasks}
    ranked_by = completeness.reached(board.task, result)
    values = board.ranking.values(ranked_by, result.submitted_at) if ranked_by else {}
    pairs: list[tuple[str, object, object]] = [
        ("competition", described.competition, result.competition),
        ("track", board.track, result.track),
        ("stage", board.stage or "", result.stage),
        ("kind", described.kind, result.kind.board),
        ("submission", entry.submission_id, result.submission),
        ("submission time", entry.submitted_at, result.submitted_at),
        ("evaluator version", entry.evaluator_version, result.evaluator_version),
        ("success rate", entry.success_rate, values.get("success_rate")),
        ("mean env steps", entry.mean_steps, values.get("mean_steps")),
        ("what is measured", entry.measures, ranked_by and ranked_by.measures),
    ]
    for shown in entry.scores:
        signed = tasks.get(shown.task)
        pairs += [
            (f"{name.replace('_', ' ')} of {shown.task}", getattr(shown, name), signed and getattr(signed, name))
            for name in ("episodes", "successes", "success_rate", "mean_steps", "measures", "result_hash")
        ]
    for name, on_board, in_receipt in pairs:
        if on_board != in_receipt:
            yield f"{name} is {on_board} on the board, {in_receipt} in the receipt."


def _check_logs(reader: ExportReader, receipts: Mapping[UUID, Receipt], result: Audit) -> Iterator[_Log]:
    """Yield the logs whose records have the result hash and the score of the receipt."""
    described = reader.description
    for entry in described.board.entries:
        receipt = receipts.get(entry.evaluation_id)
        verified = 0
        for task in receipt.result.tasks if receipt else ():
            if receipt is None or not reader.has_log(entry.evaluation_id, task.task):
                result.unchecked.append(f"{entry.team}, {task.task}: the records are not in the export.")
            elif receipt.result.evaluator_version != find_version(receipt.result.track):
                result.unchecked.append(
                    f"{entry.team}, {task.task}: made by evaluator {receipt.result.evaluator_version}, this is "
                    f"{find_version(receipt.result.track)}."
                )
            else:
                log = _checked_log(reader, receipt.result, task, entry.team, result)
                if log is not None:
                    result.logs += 1
                    verified += 1
                    yield log
        if entry.rank is not None and (receipt is None or verified < len(receipt.result.tasks)):
            result.unverified.append(entry.team)


def _checked_log(reader: ExportReader, result: Result, task: TaskResult, team: str, outcome: Audit) -> _Log | None:
    track = _track(reader.description, result)
    if track is None:
        outcome.unchecked.append(f"{team}, {task.task}: the secret of its sealed list is not published.")
        return None
    try:
        header, records = _read(reader, result.evaluation, task.task)
    except LogRejected as error:
        outcome.findings.append(f"{team}, {task.task}: the records cannot be read. {error}")
        return None
    wrong = _wrong_records(track, header, records, task)
    if wrong:
        outcome.findings.append(f"{team}, {task.task}: {wrong}")
        return None
    numbers = [record.episode for record in records]
    return _Log(evaluation=result.evaluation, track=track, task=task.task, header=header, episodes=numbers)


def _wrong_records(track: Track, header: LogHeader, records: Sequence[EpisodeRecord], signed: TaskResult) -> str | None:
    task = track.tasks[signed.task]
    impossible = explain_impossible(known_without_running(track, task), task, header, records)
    if impossible:
        return f"the records are not those of such an evaluation. {impossible.message}"
    if result_hash(header.manifest, records) != signed.result_hash:
        return "the records have another result hash than the receipt."
    earned = score(records, task.definition.measures)
    if (earned.successes, earned.mean_steps) != (signed.successes, signed.mean_steps):
        return f"the records have {earned.successes} successes, the receipt {signed.successes}."
    if earned.measures != signed.measures:
        return f"the records measure {earned.measures}, the receipt {signed.measures}."
    return None


def _resimulate(
    reader: ExportReader,
    logs: Sequence[_Log],
    *,
    count: int,
    seed: int,
    result: Audit,
    on_episode: Callable[[SampledEpisode], None],
) -> None:
    """Run a sample of all episodes through the physics again, and report those that give other states."""
    everything = [(log, number) for log in logs for number in log.episodes]
    chosen = np.random.default_rng(seed).choice(len(everything), size=min(count, len(everything)), replace=False)
    for log in logs:
        numbers = {everything[index][1] for index in chosen if everything[index][0] is log}
        if numbers:
            _resimulate_log(reader, log, numbers, result, on_episode)


def _resimulate_log(
    reader: ExportReader,
    log: _Log,
    numbers: Collection[int],
    result: Audit,
    on_episode: Callable[[SampledEpisode], None],
) -> None:
    _, records = _read(reader, log.evaluation, log.task)
    task = log.track.tasks[log.task]
    env = _environment(reader, log, result)
    if env is None:
        return
    for record in (record for record in records if record.episode in numbers):
        sampled = SampledEpisode(evaluation=log.evaluation, task=log.task, episode=record.episode)
        checked = check_episode(env, task, record)
        if checked.finding:
            result.findings.append(
                f"Evaluation {log.evaluation}, {log.task}, episode {record.episode}: {checked.finding.reason}"
            )
        result.resimulated.append(sampled)
        on_episode(sampled)


def _environment(reader: ExportReader, log: _Log, result: Audit) -> Environment | None:
    """Return what a log was played in; None, with the reason in `result`, where it is another one or not here."""
    place = f"Evaluation {log.evaluation}, {log.task}"
    has_sensor = log.track.has_sensor
    if has_sensor and not reader.has_sensor(log.evaluation):
        result.unchecked.append(
            f"{place}: its episodes are not run again, because the export does not hold its sensor."
        )
        return None
    try:
        sensor = read_made_sensor(reader.sensor(log.evaluation)).design() if has_sensor else None
    except (VitacError, IndexError, ValueError) as error:
        result.findings.append(f"{place}: the sensor cannot be used. {error}")
        return None
    try:
        env = make_environment(log.track.tasks[log.task], None, (), sensor=sensor)
    except VitacError as error:
        result.unchecked.append(f"{place}: its episodes cannot be run again here. {error}")
        return None
    if env.mesh_hash() != log.header.manifest.mesh_hash:
        what = "the sensor in the export is not the one that was" if sensor else "other meshes than these were"
        result.findings.append(f"{place}: {what} played with.")
        return None
    return env


def _track(described: ExportDescription, result: Result) -> Track | None:
    """Return the track with the list that a result was made on; None where its secret is not known."""
    if result.commitment is None:
        return load_track(result.track)
    if described.secret is None or make_commitment(bytes.fromhex(described.secret)) != result.commitment:
        return None
    return load_played_track(result.track, bytes.fromhex(described.secret))


def _read(reader: ExportReader, evaluation: UUID, task: str) -> tuple[LogHeader, list[EpisodeRecord]]:
    with reader.log(evaluation, task) as stream:
        log = LogReader(stream)
        return log.header, list(log.records())
