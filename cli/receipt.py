"""`vitac receipt`: checks receipts, the public log and whole boards, without trusting a server."""

from __future__ import annotations

import json
import re
import secrets
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from vitac.errors import VitacError

from .client.answers import RequestRefused, decode, decode_object
from .client.http import make_client
from .compare import PAGES
from .terminal.output import AsJson, Server, TokenFile, moment, percent, print_json, print_pairs

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from datetime import datetime
    from typing import TypeVar

    from vitac.server.receipts.audit import Audit, SampledEpisode
    from vitac.server.receipts.log_audit import LogAudit
    from vitac.server.receipts.receipt import AnyReceipt
    from vitac.server.transparency.entries import Content
    from vitac.server.transparency.notes import Checkpoint, VerifierKey

    from .client.answers import Answer
    from .client.http import Client

    ReceiptT = TypeVar("ReceiptT", bound=AnyReceipt)
    from vitac.server.transparency.tiles import Fetch, PublishedLog


app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False)
Key = Annotated[
    str | None,
    typer.Option(help="Public key of the service, as its page /receipts or /log/key shows it; store a copy."),
]


@app.command()
def verify(
    receipt: Annotated[
        str, typer.Argument(help="File of a receipt, or a submission's id or address, whose newest receipt is checked.")
    ],
    key: Key = None,
    witness: Annotated[
        list[str] | None,
        typer.Option(help="Key of a witness (NAME+ID+KEY); those of the service without it. May be repeated."),
    ] = None,
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Check content, signature and proof of a receipt, and who witnessed it; the exit code is 0 if they are right.

    A file is checked without any service. For a submission at a service it also checks that the receipt is in the log
    that the service shows, and signed by the key that it shows.
    """
    from vitac.server.receipts.export import read_receipts
    from vitac.server.transparency.notes import VerifierKey

    key = _read_key(key)
    if Path(receipt).is_file() or Path(receipt).suffix == ".json":
        receipts, witnesses = read_receipts(Path(receipt)), witness or []
    else:
        fetched, shown_key, named = _read_from_service(receipt, server, token_file)
        receipts, key, witnesses = [fetched], key or shown_key, witness or named
    for each in receipts:
        each.require_valid(key)
    witnessed = [each.find_witnesses(map(VerifierKey.parse, witnesses)) for each in receipts]
    if as_json:
        rows = [
            {
                "verified": True,
                "key_given": key is not None,
                "witnessed": {one.name: at for one, at in by.items()},
                "receipt": each.model_dump(mode="json"),
            }
            for each, by in zip(receipts, witnessed, strict=True)
        ]
        print_json(rows[0] if len(rows) == 1 else rows)
        return
    for each, by in zip(receipts, witnessed, strict=True):
        _print_verified(each, by, n_witnesses=len(witnesses))
    if key is None:
        print("Compare the key with the one that the service shows on its page /receipts, or give it as --key.")


def _print_verified(verified: AnyReceipt, witnessed: Mapping[VerifierKey, datetime], *, n_witnesses: int) -> None:
    print_pairs(
        {
            "receipt": verified.entry.number,
            "of": verified.entry.content,
            **_shown(verified.content),
            "issued": moment(verified.entry.issued_at),
            "signed by": verified.public_key,
            **{f"witness {each.name}": moment(at) for each, at in witnessed.items()},
            **({"witnessed by": f"{len(witnessed)} of {n_witnesses}"} if n_witnesses else {}),
        }
    )
    print("The receipt is complete, and in the log that this key signed.")


@app.command()
def fetch(
    submission: Annotated[str, typer.Argument(help="Id or address of a submission.")],
    to: Annotated[Path, typer.Option(help="Folder for the files.")] = Path(),
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Store the receipts of a submission, of its arrival and of each final result, as receipt-NUMBER.json."""
    client, submission_id = _find_service(submission, server, token_file)
    listed = decode(client.send("GET", f"/api/v1/submissions/{submission_id}/receipts"))
    arrival = decode_object(client.send("GET", f"/api/v1/submissions/{submission_id}/arrival"))
    to.mkdir(parents=True, exist_ok=True)
    files = []
    for receipt in (arrival, *listed):
        files.append(to / f"receipt-{int(receipt['entry']['number'])}.json")
        files[-1].write_text(json.dumps(receipt, indent=1) + "\n", encoding="utf-8")
    if as_json:
        print_json({"files": list(map(str, files))})
    else:
        print("\n".join(map(str, files)))


@app.command()
def audit(
    named: Annotated[
        str,
        typer.Argument(
            metavar="ADDRESS|FOLDER|EXPORT",
            help="Address of a service or folder with its /log/ files: the public log. File of `vitac admin receipt "
            "export`: a board with its log.",
        ),
    ],
    episodes: Annotated[
        int, typer.Option(min=0, help="For an export: number of episodes to run again, chosen at random.")
    ] = 10,
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Seed that chooses the episodes; by default a random one, which is printed."),
    ] = None,
    key: Key = None,
    receipt: Annotated[
        list[Path] | None, typer.Option(help="A receipt that you stored; it must be in the log. May be repeated.")
    ] = None,
    noted: Annotated[
        list[str] | None,
        typer.Option(
            help="File of a checkpoint that you stored, or NUMBER:ROOT of the log as you noted it from the page "
            "/receipts; the log must continue it. May be repeated."
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Check the public log and say what it leaves in doubt, or check a board against it.

    For an export it checks log, signature, scores against receipts, and a sample of its episodes. The exit code is 0
    only if nothing is wrong, and for an export only if the records of every rank agree with their receipts.
    """
    from vitac.server.receipts.export import read_receipts

    held = [each for path in receipt or () for each in read_receipts(path)]
    if Path(named).is_file():
        _audit_export(Path(named), key, held, dict(map(_noted, noted or ())), episodes, seed, as_json=as_json)
    else:
        _audit_log(named, key, held, noted or (), as_json=as_json)


@app.command()
def compare(
    earlier: Annotated[Path, typer.Argument(help="File of the checkpoint that was stored first.")],
    later: Annotated[Path, typer.Argument(help="File of the checkpoint that was stored later, by anybody.")],
    log: Annotated[
        str | None,
        typer.Option(help="Address of the service, or folder with its /log/ files; needed where the sizes differ."),
    ] = None,
    key: Key = None,
    as_json: AsJson = False,
) -> None:
    """Compare two checkpoints of a log (curl ADDRESS/log/checkpoint): rolled back, or two views? Exit code 1 if so."""
    from vitac.server.receipts.log_audit import compare as compare_checkpoints

    first, second = read_checkpoint(earlier), read_checkpoint(later)
    published = open_log(log, key) if log else None
    if key is None and published is None:
        raise typer.BadParameter("give the log's key as --key, or the log as --log")
    of_log = published.key if published else parse_log_key(key or "")
    findings = list(compare_checkpoints(first, second, of_log, published))
    is_unknown = published is None and first.size != second.size and not findings
    if as_json:
        print_json({"sizes": [first.size, second.size], "findings": findings, "compared": not is_unknown})
    else:
        for finding in findings:
            print(f"WRONG: {finding}")
        if is_unknown:
            print("Not compared: their sizes differ, so the tiles are needed; give the log as --log.")
        elif not findings:
            print(f"The log of {second.size} entries continues that of {first.size}: nothing in it was changed.")
    if findings or is_unknown:
        raise typer.Exit(1)


def read_checkpoint(path: Path) -> Checkpoint:
    """Return the checkpoint in a file.

    Raises:
        VitacError: it cannot be read, or is none.
    """
    from vitac.server.transparency.notes import MAX_NOTE_CHARS, Checkpoint

    try:
        with path.open(encoding="utf-8", errors="replace", newline="") as file:
            return Checkpoint.parse(file.read(MAX_NOTE_CHARS + 1))
    except OSError as error:
        raise VitacError(f"{path} cannot be read: {error.strerror}.") from error


def _audit_export(
    export: Path,
    key: str | None,
    held: list[AnyReceipt],
    noted: dict[int, str],
    episodes: int,
    seed: int | None,
    *,
    as_json: bool,
) -> None:
    from vitac.server.receipts.audit import audit as audit_export

    from .terminal.compiling import compiling_shown

    key = _read_key(key)
    for each in held:
        each.require_valid(key)
    seed = secrets.randbits(63) if seed is None else seed
    with compiling_shown():
        result = audit_export(
            export, public_key=key, held=held, noted=noted, episodes=episodes, seed=seed, on_episode=_progress
        )
    if as_json:
        print_json(asdict(result) | {"seed": seed})
    else:
        _print(result, seed)
    if not result.is_believed:
        raise typer.Exit(1)


def _audit_log(named: str, key: str | None, held: list[AnyReceipt], noted: Sequence[str], *, as_json: bool) -> None:
    from vitac.server.receipts.log_audit import audit_log

    log = open_log(named, key)
    stored = [read_checkpoint(Path(text)) for text in noted if Path(text).is_file()]
    roots = dict(_noted(text) for text in noted if not Path(text).is_file())
    result = audit_log(log, held=held, checkpoints=stored, roots=roots)
    if key is None:
        result.doubts.insert(0, "Whose key it is: compare it with the one that you noted, or give that as --key.")
    if as_json:
        print_json(asdict(result))
    else:
        _print_log(result)
    if result.findings:
        raise typer.Exit(1)


def _read_key(key: str | None) -> str | None:
    """Return the hexadecimal digits of a key, which `/log/key` shows as NAME+ID+KEY.

    Raises:
        NoteRejected: it is none.
    """
    return None if key is None else parse_log_key(key).public_key.hex()


def _shown(content: Content) -> dict[str, object]:
    """Return what a receipt says, by label."""
    from vitac.server.receipts.receipt import End, OfSubmission, Result

    shown: dict[str, object] = {}
    if isinstance(content, OfSubmission):
        shown["submission"] = content.submission
        shown["track"] = f"{content.track} {content.stage}".strip()
        shown["submitted"] = moment(content.submitted_at)
    if isinstance(content, Result):
        for task in content.tasks:
            share = percent(task.success_rate)
            shown[task.task] = f"{task.successes} of {task.episodes}, {share}, result hash {task.result_hash}"
        shown["evaluator"] = content.evaluator_version
        shown["list"] = content.commitment or "public"
    if isinstance(content, End):
        shown["competition"] = content.competition
        for winner in content.winners:
            shown[f"{winner.track}, {winner.place}"] = (
                f"{winner.team}, submission {winner.submission}"
                if winner.submission
                else f"{winner.team}, {winner.points:g} points, evidence {winner.evidence}"
            )
    return shown


def _noted(text: str) -> tuple[int, str]:
    """Return size and root of a log that somebody noted, or has as the file of a checkpoint."""
    if Path(text).is_file():
        checkpoint = read_checkpoint(Path(text))
        return checkpoint.size, checkpoint.root.hex()
    number, _, root = text.partition(":")
    if not (number.isdecimal() and re.fullmatch("[0-9a-f]{64}", root)):
        raise typer.BadParameter(f"expected a file, or NUMBER:ROOT with 64 hexadecimal digits, got {text!r}")
    return int(number), root


def _find_service(named: str, server: str | None, token_file: Path | None) -> tuple[Client, str]:
    """Return a client of the service of a submission, and its id."""
    address, _, submission_id = named.rpartition(PAGES)
    return make_client(address.removesuffix("/api/v1") or server, token_file), submission_id


def _read_from_service(named: str, server: str | None, token_file: Path | None) -> tuple[AnyReceipt, str, list[str]]:
    """Return the receipt of a submission's newest result, else of its arrival, and the key that the service shows.

    Raises:
        ReceiptRejected: it is not in the log that the service shows.
    """
    from vitac.server.receipts.receipt import Receipt, ReceiptRejected, SubmissionReceipt

    client, submission_id = _find_service(named, server, token_file)
    listed = decode(client.send("GET", f"/api/v1/submissions/{submission_id}/receipts"))
    newest: AnyReceipt
    if listed:
        newest = _read_signed(Receipt, listed[-1])
    else:
        arrival = decode(client.send("GET", f"/api/v1/submissions/{submission_id}/arrival"))
        newest = _read_signed(SubmissionReceipt, arrival)
    log = decode_object(client.send("GET", "/api/v1/receipts", params={"after": newest.entry.number - 1, "limit": 1}))
    shown = [entry["leaf_hash"] for entry in log["items"]]
    if shown != [newest.entry.leaf_hash.hex()]:
        raise ReceiptRejected(
            f"Receipt {newest.entry.number} is not in the log that the service shows: expected "
            f"{newest.entry.leaf_hash.hex()}, got {', '.join(shown) or 'none'}."
        )
    return newest, str(log["public_key"]), [witness["witness"] for witness in log["witnesses"]]


def _read_signed(model: type[ReceiptT], answer: Answer) -> ReceiptT:
    """Return the receipt of an answer; what stands beside it is left alone, in what is signed nothing may be.

    Raises:
        DocumentRejected: it does not have the form.
    """
    from vitac.evaluator.strict_model import validate

    return validate(model, {name: answer[name] for name in model.model_fields}, "The receipt that the service shows")


def _print(result: Audit, seed: int) -> None:
    if result.unknowable:
        print("What this file alone cannot show:")
    for unknowable in result.unknowable:
        print(f"  - {unknowable}")
    print_pairs(
        {
            "signed by": result.public_key,
            "entries of the log": result.log_entries,
            "entries of the board": result.entries,
            "logs that agree": result.logs,
            "episodes run again": len(result.resimulated),
            "seed of their choice": seed,
            "findings": len(result.findings),
            "unusual": len(result.unusual),
            "not checked": len(result.unchecked),
        }
    )
    for finding in result.findings:
        print(f"WRONG: {finding}")
    for unusual in result.unusual:
        print(f"unusual: {unusual}")
    if not result.logs:
        print("Nothing was verified: the records of no result could be compared with its receipt.")
    elif result.unverified:
        print(f"Not verified: the records of {', '.join(result.unverified)}, so the order of the board is not either.")
    for unchecked in result.unchecked:
        print(f"not checked: {unchecked}")


def _print_log(result: LogAudit) -> None:
    print_pairs(
        {
            "signed by": result.key,
            "entries": result.size,
            "root": result.root,
            **{f"  {kind}": count for kind, count in result.entries.items()},
            **{f"witness {name}": f"signed the first {size} entries" for name, size in result.witnesses.items()},
            "findings": len(result.findings),
            "unusual": len(result.unusual),
        }
    )
    for finding in result.findings:
        print(f"WRONG: {finding}")
    for unusual in result.unusual:
        print(f"unusual: {unusual}")
    for winner in result.winners:
        print(f"winner: {winner}")
    print("Do not trust this log." if result.findings else "Nothing in the log was changed, removed or moved.")
    if result.doubts:
        print("What you may still doubt:")
    for doubt in result.doubts:
        print(f"  - {doubt}")


def _progress(sampled: SampledEpisode) -> None:
    if sys.stderr.isatty():
        print(f"\r\x1b[Kran {sampled.task} {sampled.episode} again", end="", file=sys.stderr, flush=True)


_MAX_FILE_BYTES = 256 * 65_537 + 1


def open_log(named: str, key: str | None = None) -> PublishedLog:
    """Return the log at an address, or in a folder.

    Args:
        named: address of a service, or folder with the files that it has below `/log/`.
        key: of the log, as hexadecimal digits or NAME+ID+KEY; None: the one that the log says is its own.

    Raises:
        VitacError: there is none, or it is not signed by that key.
    """
    from vitac.server.transparency.tiles import PublishedLog, read_key

    fetch = _fetch_from_folder(Path(named)) if Path(named).is_dir() else _fetch_from_service(named)
    return PublishedLog(fetch, parse_log_key(key) if key else read_key(fetch))


def parse_log_key(text: str) -> VerifierKey:
    """Return the key of a log, as hexadecimal digits or NAME+ID+KEY.

    Raises:
        NoteRejected: it is none.
    """
    from vitac.server.transparency.notes import VerifierKey, make_log_key

    is_plain = len(text) == 64 and set(text) <= set("0123456789abcdef")
    return make_log_key(bytes.fromhex(text)) if is_plain else VerifierKey.parse(text)


def _fetch_from_folder(folder: Path) -> Fetch:
    def fetch(path: str) -> bytes | None:
        try:
            with (folder / path).open("rb") as file:
                return file.read(_MAX_FILE_BYTES)
        except (FileNotFoundError, NotADirectoryError):
            return None

    return fetch


def _fetch_from_service(address: str) -> Fetch:
    client = make_client(address.removesuffix("/").removesuffix("/log"), None, with_token=False)

    def fetch(path: str) -> bytes | None:
        try:
            return client.send("GET", f"/log/{path}", headers={"Accept": "*/*"}).content
        except RequestRefused as error:
            if error.status == 404:
                return None
            raise

    return fetch
