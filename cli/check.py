"""`vitac check`: finds what would be refused before an upload, in the same sandbox as the evaluation."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated

import typer

from .evaluate import Image, Remote, find_playing_kind, find_policy_server
from .terminal.output import AsJson, note_ignored_folders, print_json
from .terminal.own_policy import fall_back_where_nothing_isolates

if TYPE_CHECKING:
    from vitac.evaluator.episodes.records import EpisodeRecord
    from vitac.evaluator.submission.manifest import SubmissionManifest
    from vitac.evaluator.submission_kinds import SubmissionKind

_NO_TORCH = "No module named 'torch'"
_TORCH_REMEDY = (
    "The submission needs torch, which is not installed here: ./vitac --torch check adds its build for CPUs, "
    "from an index that PIP_EXTRA_INDEX_URL names if pip's own does not have it. A service has torch only if its page "
    "Sandbox lists it."
)


@dataclass(kw_only=True)
class Findings:
    """Results of the checks, in the order in which they ran.

    Attributes:
        digest: digest of the submission; None until its files are accepted.
        passed: what was checked successfully.
        refused: one or more sentences for each reason to refuse the submission, or for which it would fail.
        output_tail: the last lines of the output of a policy that failed.
    """

    digest: str | None = None
    passed: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    output_tail: str = ""


def command(
    submission: Annotated[Path, typer.Argument(help="Zip or folder with submission.yaml, or tar of an image.")],
    remote: Remote = None,
    image: Image = False,
    as_json: AsJson = False,
) -> None:
    """Check a submission before its upload: archive rules, submission.yaml, two episodes of each task."""
    note_ignored_folders(submission)
    if remote is None:
        fall_back_where_nothing_isolates()
    findings = check(submission, remote, is_image=image)
    if as_json:
        print_json({"ok": not findings.refused, **asdict(findings)})
    else:
        for line in _lines(findings):
            print(line)
    if findings.refused:
        raise typer.Exit(1)


def check(submission: Path, remote: str | None = None, *, is_image: bool = False) -> Findings:
    """Run the checks of an upload and of an evaluation.

    Raises:
        VitacError: the path is not a submission, or this machine cannot evaluate.
    """
    from vitac.evaluator.submission.archive import ArchiveRejected
    from vitac.evaluator.submission.manifest import ManifestRejected, load_manifest
    from vitac.evaluator.submission.sources import staged, submission_digest
    from vitac.evaluator.tracks import load_track

    findings = Findings()
    with ExitStack() as stack:
        try:
            kind = find_playing_kind(submission, is_image=is_image)
            folder = stack.enter_context(staged(submission, kind))
            findings.digest = submission_digest(submission, kind=kind)
            findings.passed.append("the files follow the archive rules")
            manifest = load_manifest(folder)
            if not kind.form.is_image:
                manifest.require_no_needs()
            remote = find_policy_server(manifest, remote)
            findings.passed.append(f"submission.yaml is complete: {manifest.name}, {', '.join(manifest.tasks)}")
        except (ArchiveRejected, ManifestRejected) as error:
            findings.refused.append(str(error))
            return findings
        has_sensor = load_track(manifest.track).has_sensor
        if has_sensor and not _check_sensor(folder, findings):
            return findings
        for task in manifest.tasks:
            sensor = folder if has_sensor else None
            _check_task(folder, manifest, task, findings, sensor=sensor, kind=kind, remote=remote)
    return findings


def _check_sensor(staged: Path, findings: Findings) -> bool:
    """Make the sensor as the service does at the upload, and return whether it follows every rule."""
    from vitac.evaluator.figures.starts import CONTINUUM_NODES, continuum_error
    from vitac.evaluator.sensors.manifest import SensorRejected
    from vitac.evaluator.sensors.package import design_document
    from vitac.evaluator.submission.sensor import make_sensor

    from .terminal.compiling import compiling_shown

    try:
        document = design_document(staged)
        made = make_sensor(staged)
    except SensorRejected as error:
        findings.refused.append(str(error))
        return False
    findings.passed.append(f"the sensor follows every rule: {made.facts.nodes} nodes, digest {made.digest}")
    with compiling_shown():
        mesh_error = continuum_error(made.design())
    if mesh_error is not None:
        findings.passed.append(
            f"under pins its markers' motion is {mesh_error:.0%} (RMS) off that of the same gel with "
            f"{CONTINUUM_NODES:g} times the nodes, which stands for its continuum; a finer mesh is closer, "
            "and takes longer to simulate"
        )
    findings.passed.append(f"the design document is included: {document.path.name}")
    return True


def _check_task(
    staged: Path,
    manifest: "SubmissionManifest",
    task: str,
    findings: Findings,
    *,
    sensor: Path | None,
    kind: "SubmissionKind",
    remote: str | None,
) -> None:
    """Run the first and the last episode of a task's list, which differ in shape and start."""
    from vitac.evaluator.evaluation.local import evaluate
    from vitac.evaluator.tracks import load_track

    from .terminal.compiling import compiling_shown

    track = load_track(manifest.track)
    definition = track.tasks[task]
    numbers = sorted({definition.episodes[0].number, definition.episodes[-1].number})
    with compiling_shown():
        evaluation = evaluate(
            submission_dir=staged,
            track=track,
            task=definition,
            episodes=numbers,
            sensor=sensor,
            kind=kind,
            remote=remote,
        )
    for record in evaluation.records:
        _add_result(record, findings)
    if remote is not None:
        _add_answers(task, evaluation.records, findings)


def _add_answers(task: str, records: "Sequence[EpisodeRecord]", findings: Findings) -> None:
    """Say how long the answers of a policy server took, and what range they had."""
    answers_s = [answer_s for record in records for answer_s in record.timings.answers_s]
    numbers = [float(number) for record in records for number in record.actions.to_array().flat]
    if not answers_s or not numbers:
        return
    low, high = min(numbers), max(numbers)
    clipped = "; what is beyond [-1, 1] is clipped" if max(-low, high) > 1 else ""
    findings.passed.append(
        f"{task}: answers took {1e3 * median(answers_s):.1f} ms in the median, {1e3 * max(answers_s):.1f} ms at most, "
        f"with numbers from {low:.3g} to {high:.3g}{clipped}"
    )


def _add_result(record: "EpisodeRecord", findings: Findings) -> None:
    from vitac.evaluator.episodes.records import counted_env_steps

    where = f"{record.task}, episode {record.episode}"
    failure = record.failure
    if failure is None:
        findings.passed.append(
            f"{where}: {counted_env_steps(record.env_steps)}, outcome {record.outcome}. {record.outcome.sentence}"
        )
        return
    sentences = [f"{where}: {failure.code}. {failure.sentence}"]
    if _NO_TORCH in failure.message:
        sentences.append(_TORCH_REMEDY)
    findings.refused.append(" ".join(sentences))
    findings.output_tail = failure.output_tail or findings.output_tail


def _lines(findings: Findings) -> Iterator[str]:
    for text in findings.passed:
        yield f"ok       {text}"
    for text in findings.refused:
        yield f"refused  {text}"
    if findings.output_tail:
        yield "Last lines of the policy's output:"
        yield from (f"  | {line}" for line in findings.output_tail.splitlines()[-20:])
    yield (
        "This submission would be refused."
        if findings.refused
        else f"All checks passed. Content digest {findings.digest}"
    )
