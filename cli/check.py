"""`vitac check`: what would be refused of a submission, found before the upload, in the sandbox that evaluates it."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from vitac.evaluator.episodes.records import EpisodeRecord
    from vitac.evaluator.submission.manifest import SubmissionManifest


@dataclass(kw_only=True)
class Findings:
    """What was found, in the order in which it was looked for."""

    digest: str | None = None
    passed: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    """Each one sentence or more; a submission with any of them is refused or fails."""
    output_tail: str = ""
    """The last lines that the policy printed, where it failed."""


def command(
    submission: Annotated[Path, typer.Argument(help="Zip or folder with submission.yaml.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Tell what would be refused: the rules of archives, submission.yaml, two episodes of each task in the sandbox."""
    findings = check(submission)
    if as_json:
        from .terminal.output import print_json

        print_json({"ok": not findings.refused, **asdict(findings)})
    else:
        for line in _lines(findings):
            print(line)
    if findings.refused:
        raise typer.Exit(1)


def check(submission: Path) -> Findings:
    """Look at everything that an upload and an evaluation look at.

    Raises:
        VitacError: the path is no submission, or this machine cannot evaluate.
    """
    from vitac.evaluator.submission.archive import ArchiveRejected
    from vitac.evaluator.submission.manifest import ManifestRejected, load_manifest, stage, submission_digest

    findings = Findings()
    with TemporaryDirectory(prefix="vitac-check-") as folder:
        Path(folder).chmod(0o755)  # Under root the sandbox has a user of its own, which must reach the submission.
        try:
            staged = stage(submission, Path(folder) / "submission")
            findings.digest = submission_digest(submission)
            findings.passed.append("the files keep the rules of archives")
            manifest = load_manifest(staged)
            findings.passed.append(f"submission.yaml is complete: {manifest.name}, {', '.join(manifest.tasks)}")
        except (ArchiveRejected, ManifestRejected) as error:
            findings.refused.append(str(error))
            return findings
        for task in manifest.tasks:
            _check_task(staged, manifest, task, findings)
    return findings


def _check_task(staged: Path, manifest: "SubmissionManifest", task: str, findings: Findings) -> None:
    """Play the first and the last episode of a task's list, which differ in shape and start."""
    from vitac.evaluator.evaluation.local import evaluate
    from vitac.evaluator.tracks import load_track

    track = load_track(manifest.track)
    definition = track.tasks[task]
    numbers = sorted({definition.episodes[0].number, definition.episodes[-1].number})
    evaluation = evaluate(submission_dir=staged, track=track, task=definition, episodes=numbers)
    for record in evaluation.records:
        _judge(record, findings)


def _judge(record: "EpisodeRecord", findings: Findings) -> None:
    where = f"{record.task}, episode {record.episode}"
    failure = record.failure
    if failure is None:
        findings.passed.append(f"{where}: played {record.env_steps} env steps, ended by {record.outcome}")
        return
    findings.refused.append(f"{where}: {failure.code}. {failure.message} {failure.code.sentence}")
    findings.output_tail = failure.output_tail or findings.output_tail


def _lines(findings: Findings) -> Iterator[str]:
    for text in findings.passed:
        yield f"ok       {text}"
    for text in findings.refused:
        yield f"refused  {text}"
    if findings.output_tail:
        yield "The last lines of its output:"
        yield from (f"  | {line}" for line in findings.output_tail.splitlines()[-20:])
    yield "Refused." if findings.refused else f"Nothing would be refused. Digest {findings.digest}"
