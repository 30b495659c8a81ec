"""`vitac receipt`: checks receipts of final results, and whole boards by them, without trusting a server."""

from __future__ import annotations

import re
import secrets
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..client.http import make_client
from ..compare import PAGES
from ..terminal.options import Server, TokenFile
from ..terminal.output import AsJson, moment, percent, print_json, print_pairs

if TYPE_CHECKING:
    from vitac.server.receipts.audit import Audit, SampledEpisode
    from vitac.server.receipts.receipt import AnyReceipt, Content

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False)

Key = Annotated[
    str | None, typer.Option(help="Public key of the service, as its page /receipts shows it; store a copy.")
]


@app.command()
def verify(
    receipt: Annotated[
        str, typer.Argument(help="File, or id or address of a submission, whose newest one is checked.")
    ],
    key: Key = None,
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Check signature and content of a receipt; the exit code is 0 if they are right.

    A file is checked without any service. Of a submission at a service it is also checked that the receipt is in the
    chain that the service shows, and signed by the key that it shows.
    """
    from vitac.server.receipts.export import read_receipt

    if Path(receipt).is_file():
        found = read_receipt(Path(receipt))
    else:
        found, shown_key = _read_from_service(receipt, server, token_file)
        key = key or shown_key
    found.require_valid(key)
    if as_json:
        print_json({"verified": True, "key_given": key is not None, "receipt": found.model_dump(mode="json")})
        return
    print_pairs(
        {
            "receipt": found.link.number,
            "of": found.link.content,
            **_shown(found.content),
            "issued": moment(found.link.issued_at),
            "signed by": found.link.public_key,
        }
    )
    print("The receipt is whole and signed by that key.")
    if key is None:
        print("Compare the key with the one that the service shows on its page /receipts, or give it as --key.")


@app.command()
def audit(
    export: Annotated[Path, typer.Argument(help="File that `vitac admin receipt export` wrote.")],
    episodes: Annotated[int, typer.Option(min=0, help="Number of episodes to run again, chosen at random.")] = 10,
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Seed that chooses the episodes; by default a random one, which is printed."),
    ] = None,
    key: Key = None,
    receipt: Annotated[
        list[Path] | None, typer.Option(help="A receipt that you stored; it must be in the chain. May be repeated.")
    ] = None,
    noted: Annotated[
        list[str] | None,
        typer.Option(
            help="NUMBER:DIGEST of a receipt that you noted, such as the last one on the page /receipts; it must be in "
            "the chain. May be repeated."
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Check a board: chain, signatures, scores against receipts, and a sample of its episodes.

    The exit code is 0 only if nothing is wrong and the records of every rank agree with their receipts.
    """
    from vitac.server.receipts.audit import audit as audit_export
    from vitac.server.receipts.export import read_receipt

    from ..terminal.compiling import compiling_shown

    held = [read_receipt(path) for path in receipt or ()]
    for each in held:
        each.require_valid(key)
    seed = secrets.randbits(63) if seed is None else seed
    with compiling_shown():
        found = audit_export(
            export,
            public_key=key,
            held=held,
            noted=dict(map(_noted, noted or ())),
            episodes=episodes,
            seed=seed,
            on_episode=_progress,
        )
    if as_json:
        print_json(asdict(found) | {"seed": seed})
    else:
        _print(found, key, seed)
    if not found.is_believed:
        raise typer.Exit(1)


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
        shown["competition"] = content.contest
        for winner in content.winners:
            shown[f"{winner.track}, {winner.place}"] = f"submission {winner.submission}"
    return shown


def _noted(text: str) -> tuple[int, str]:
    """Return number and digest of a receipt that somebody noted."""
    number, _, digest = text.partition(":")
    if not (number.isdecimal() and re.fullmatch("[0-9a-f]{64}", digest)):
        raise typer.BadParameter(f"expected NUMBER:DIGEST with 64 hexadecimal digits, got {text!r}")
    return int(number), digest


def _read_from_service(named: str, server: str | None, token_file: Path | None) -> tuple[AnyReceipt, str]:
    """Return the receipt of a submission's newest result, else of its arrival, and the key that the service shows.

    Raises:
        ReceiptRejected: it is not in the chain that the service shows.
    """
    from vitac.server.receipts.receipt import Receipt, ReceiptRejected, SubmissionReceipt

    address, _, submission_id = named.rpartition(PAGES)
    client = make_client(address.removesuffix("/api/v1") or server, token_file)
    listed = client.send("GET", f"/api/v1/submissions/{submission_id}/receipts").json()
    found: AnyReceipt
    if listed:
        found = Receipt.model_validate(listed[-1])
    else:
        arrival = client.send("GET", f"/api/v1/submissions/{submission_id}/arrival").json()
        found = SubmissionReceipt.model_validate(arrival)
    chain = client.send("GET", "/api/v1/receipts", params={"after": found.link.number - 1, "limit": 1}).json()
    shown = [link["digest"] for link in chain["items"]]
    if shown != [found.link.digest]:
        raise ReceiptRejected(
            f"Receipt {found.link.number} is not in the chain that the service shows: expected {found.link.digest}, "
            f"got {', '.join(shown) or 'none'}."
        )
    return found, str(chain["public_key"])


def _print(found: Audit, key: str | None, seed: int) -> None:
    print_pairs(
        {
            "signed by": found.public_key,
            "receipts in the chain": found.links,
            "entries of the board": found.entries,
            "logs that agree": found.logs,
            "episodes run again": len(found.resimulated),
            "seed of their choice": seed,
            "findings": len(found.findings),
            "unusual": len(found.unusual),
            "not checked": len(found.unchecked) + (key is None),
        }
    )
    for finding in found.findings:
        print(f"WRONG: {finding}")
    for unusual in found.unusual:
        print(f"unusual: {unusual}")
    if not found.logs:
        print("Nothing was verified: the records of no result could be compared with its receipt.")
    elif found.unverified:
        print(f"Not verified: the records of {', '.join(found.unverified)}, so the order of the board is not either.")
    for unchecked in found.unchecked:
        print(f"not checked: {unchecked}")
    if key is None:
        print("not checked: who owns the key. Compare it with the one that you noted, or give it as --key.")


def _progress(sampled: SampledEpisode) -> None:
    if sys.stderr.isatty():
        print(f"\r\x1b[Kran {sampled.task} {sampled.episode} again", end="", file=sys.stderr, flush=True)
