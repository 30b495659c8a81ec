"""`vitac evaluate`: evaluates a submission on this machine, in the same sandbox and with the same result hash."""

import sys
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated

import typer

from .terminal.output import ASSETS_VARIABLE, Episodes, Workers, note_ignored_folders
from .terminal.own_policy import fall_back_where_nothing_isolates

if TYPE_CHECKING:
    from collections.abc import Sequence

    from vitac.evaluator.episodes.records import EpisodeRecord
    from vitac.evaluator.evaluation.local import LocalEvaluation
    from vitac.evaluator.remote.description import RemoteProtocol
    from vitac.evaluator.scoring.score import ForceSummary, Rate
    from vitac.evaluator.shards.host_process import HostProcess
    from vitac.evaluator.submission.manifest import SubmissionManifest
    from vitac.evaluator.submission_kinds import SubmissionKind
    from vitac.evaluator.tracks import Track


Remote = Annotated[
    str | None,
    typer.Option(help="Address of a policy server that plays, such as ws://127.0.0.1:8000; see docs/remote.md."),
]


Image = Annotated[
    bool, typer.Option("--image", help="The submission is a container image, whatever the name of its tar is.")
]


def find_playing_kind(submission: Path, *, is_image: bool = False) -> "SubmissionKind":
    """Return what kind of policy a submission is: a container image if so said or named, a model else."""
    from vitac.evaluator.submission_kinds import SubmissionKind, kind_of_file

    is_named = not submission.is_dir() and kind_of_file(submission.name).form.is_image
    return SubmissionKind.IMAGE if is_image or is_named else SubmissionKind.MODEL


def find_policy_server(manifest: "SubmissionManifest", remote: str | None) -> str | None:
    """Return the address of the policy server that plays, as given or in submission.yaml; None without one."""
    if remote is None and manifest.remote is None:
        return None
    from vitac.evaluator.remote.protocols import check_address

    server = manifest.server()
    address = remote or server.address
    if address is None:
        raise typer.BadParameter("submission.yaml has a policy server play; give its address.", param_hint="--remote")
    check_address(address, server.protocol)
    return address


def check_lines(protocol: "RemoteProtocol", lines: int, option: str) -> None:
    """Refuse several lines to a policy server that answers one client at a time."""
    if lines > 1 and protocol.has_one_client:
        raise typer.BadParameter(f"a {protocol} server answers one client at a time; leave it out.", param_hint=option)


def parse_episodes(text: str | None) -> tuple[int, ...] | None:
    """Parse episode numbers such as `1:12,20`; ranges include both ends."""
    if text is None:
        return None
    try:
        parts = [part.split(":") for part in text.split(",")]
        ranges = [range(int(part[0]), int(part[-1]) + 1) for part in parts if len(part) <= 2]
    except ValueError:
        ranges = []
    if len(ranges) != text.count(",") + 1 or not all(ranges):
        raise typer.BadParameter(f"expected numbers and ranges such as 1:12,20, got {text!r}.")
    return tuple(sorted({number for numbers in ranges for number in numbers}))


def command(
    submission: Annotated[Path, typer.Argument(help="Zip or folder with submission.yaml, or tar of an image.")],
    task: Annotated[str | None, typer.Option(help="Task to evaluate; needed if the submission has several.")] = None,
    episodes: Episodes = None,
    workers: Workers = None,
    team: Annotated[str | None, typer.Option(help="Team named in the log.")] = None,
    assets: Annotated[
        Path | None, typer.Option(envvar=ASSETS_VARIABLE, help="Folder with the challenge's own meshes; unranked.")
    ] = None,
    secret: Annotated[
        Path | None, typer.Option(help="Play the sealed list of this secret (vitac seeds) instead of the public one.")
    ] = None,
    sensor: Annotated[
        Path | None, typer.Option(help="Folder with a sensor of your own (vitac sensor); unranked.")
    ] = None,
    remote: Remote = None,
    image: Image = False,
    json: Annotated[Path | None, typer.Option(help="Write score, result hash and all records to this file.")] = None,
    log: Annotated[Path | None, typer.Option(help="Write a log that can be verified and uploaded.")] = None,
    output: Annotated[
        Path | None, typer.Option(help="Write what the policy printed in each episode to this file.")
    ] = None,
    station: Annotated[
        str | None, typer.Option(help="Play on a station instead: its file, or `twin` for a simulated one; unranked.")
    ] = None,
    pictures: Annotated[
        Path | None, typer.Option(help="With --station: write pictures of both gels and a page of them here.")
    ] = None,
) -> None:
    """Evaluate a submission here, with the same records, score and result hash as the service."""
    request = _Request(
        task=task,
        episodes=parse_episodes(episodes),
        workers=workers,
        assets=assets,
        secret=secret,
        sensor=sensor,
        remote=remote,
        kind=find_playing_kind(submission, is_image=image),
    )
    outputs = _Outputs(json=json, log=log, printed=output, team=team)
    outputs.check()
    if station is not None:
        if remote is not None:
            raise typer.BadParameter("a station is not played from elsewhere; leave it out.", param_hint="--remote")
        from .rehearsal import rehearse_submission

        request.check(submission)
        note_ignored_folders(submission)
        rehearse_submission(submission, station, request.episodes, json=json, pictures=pictures)
        return
    if remote is None:
        fall_back_where_nothing_isolates()
    evaluation, manifest, digest = _evaluate(request, submission)
    outputs.write(evaluation, manifest, digest)
    _print_summary(evaluation, manifest)
    if evaluation.failure:
        raise typer.Exit(1)


def _evaluate(request: "_Request", submission: Path) -> "tuple[LocalEvaluation, SubmissionManifest, str]":
    """Return the evaluation of a submission, its manifest and its digest; the simulation is loaded meanwhile."""
    from vitac.evaluator.shards.host_process import CAN_FORK, HostProcess

    with HostProcess(loads_all=True) if CAN_FORK else nullcontext() as host:
        from vitac.evaluator.submission.manifest import load_manifest
        from vitac.evaluator.submission.sources import staged, submission_digest

        request.check(submission)
        note_ignored_folders(submission)
        with staged(submission, request.kind) as folder:
            manifest = load_manifest(folder)
            request = replace(request, remote=find_policy_server(manifest, request.remote))
            if request.remote is not None:
                check_lines(manifest.server().protocol, request.workers or 1, "--workers")
            digest = submission_digest(submission, kind=request.kind)
            return request.evaluate(folder, manifest, host), manifest, digest


@dataclass(frozen=True, kw_only=True)
class _Request:
    """What is to be evaluated, and how; None where the submission, the machine or the public list decides.

    Attributes:
        task: its name.
        episodes: their numbers.
        workers: number of processes.
        assets: folder with the challenge's own meshes.
        secret: file with the secret of a sealed list.
        sensor: folder with a sensor to play with.
        remote: address of a policy server.
        kind: of the submission.
    """

    task: str | None
    episodes: tuple[int, ...] | None
    workers: int | None
    assets: Path | None
    secret: Path | None
    sensor: Path | None
    remote: str | None
    kind: "SubmissionKind"

    def check(self, submission: Path) -> None:
        """Refuse a secret that the policy could read, and a sensor against its rules."""
        from vitac.evaluator.sensors.check import accepted_sensor

        if self.secret is not None and self.secret.resolve().is_relative_to(submission.resolve()):
            raise typer.BadParameter("the secret lies in the submission; move it elsewhere.", param_hint="--secret")
        if self.sensor is not None:
            accepted_sensor(self.sensor)

    def evaluate(self, folder: Path, manifest: "SubmissionManifest", host: "HostProcess | None") -> "LocalEvaluation":
        """Evaluate an unpacked submission in processes that a host forks, with a progress bar."""
        from vitac.evaluator.evaluation.local import evaluate

        from .terminal.compiling import compiling_shown

        track = _track(manifest, self.secret)
        definition = track.tasks[_chosen_task(manifest, self.task)]
        with EpisodesProgress(len(self.episodes or definition.episodes)) as progress, compiling_shown(progress.bar):
            return evaluate(
                submission_dir=folder,
                track=track,
                task=definition,
                episodes=self.episodes,
                workers=self.workers or self._default_workers(),
                assets_dir=self.assets,
                secret=self.secret,
                sensor=folder if self.sensor is None and track.has_sensor else self.sensor,
                kind=self.kind,
                remote=self.remote,
                on_episode=progress.advance,
                host=host,
            )

    def _default_workers(self) -> int:
        """Return one process for each core, or one where a policy server may know one line only."""
        from vitac.evaluator.cores import count_cores

        return 1 if self.remote else count_cores()


@dataclass(frozen=True, kw_only=True)
class _Outputs:
    """Files that an evaluation is written to; None where nobody wants one.

    Attributes:
        json: score, result hash and all records.
        log: a log that can be verified.
        printed: what the policy printed.
        team: named in the log.
    """

    json: Path | None
    log: Path | None
    printed: Path | None
    team: str | None

    def check(self) -> None:
        """Refuse unusable outputs before the evaluation rather than after it."""
        from vitac.evaluator.logs.log import is_team_name

        for option, path in {"--json": self.json, "--log": self.log, "--output": self.printed}.items():
            if path is not None and (path.is_dir() or not path.absolute().parent.is_dir()):
                raise typer.BadParameter(f"expected a file in an existing folder, got {path}.", param_hint=option)
        if self.team is not None and not is_team_name(self.team):
            raise typer.BadParameter(
                f"expected one line of at most 200 characters, got {self.team!r:.80}.", param_hint="--team"
            )

    def write(self, evaluation: "LocalEvaluation", manifest: "SubmissionManifest", digest: str) -> None:
        """Write those that are wanted."""
        if self.json:
            self.json.write_text(_report(evaluation, manifest, digest), encoding="utf-8")
        if self.log:
            _write_log(self.log, evaluation, self.team, digest)
        if self.printed:
            self.printed.write_text("".join(map(_printed, evaluation.records)), encoding="utf-8")


def _track(manifest: "SubmissionManifest", secret: Path | None) -> "Track":
    """Return the track of a submission, with the sealed lists of the secret if there is one."""
    from vitac.evaluator.tracks.sealed import load_played_track, read_secret

    return load_played_track(manifest.track, read_secret(secret) if secret else None)


def _chosen_task(manifest: "SubmissionManifest", task: str | None) -> str:
    if task is None and len(manifest.tasks) == 1:
        return manifest.tasks[0]
    if task not in manifest.tasks:
        raise typer.BadParameter(
            f"expected one of the submission's tasks, {', '.join(manifest.tasks)}.", param_hint="--task"
        )
    return task


def _report(evaluation: "LocalEvaluation", manifest: "SubmissionManifest", digest: str) -> str:
    from vitac.evaluator.evaluation.local import EvaluationReport

    return (
        EvaluationReport.from_evaluation(evaluation, name=manifest.name, digest=digest).model_dump_json(indent=1) + "\n"
    )


def _write_log(path: Path, evaluation: "LocalEvaluation", team: str | None, digest: str) -> None:
    from vitac.evaluator.logs.log import LogHeader, write_log

    header = LogHeader(team=team, submission_digest=digest, manifest=evaluation.manifest)
    with path.open("wb") as stream:
        write_log(stream, header, evaluation.records)


def _printed(record: "EpisodeRecord") -> str:
    """Return what the policy printed in an episode, under a line that names it; nothing if it printed nothing."""
    if not record.output:
        return ""
    end = "" if record.output.endswith("\n") else "\n"
    return f"[{record.task}, episode {record.episode}: {record.outcome}]\n{record.output}{end}"


def _print_summary(evaluation: "LocalEvaluation", manifest: "SubmissionManifest") -> None:
    from vitac.evaluator.tracks import load_track

    from .terminal.output import print_table

    print(f"{manifest.name}, {evaluation.manifest.track}, {evaluation.manifest.task}")
    if evaluation.failure:
        print(f"failed: {evaluation.failure.code}. {evaluation.failure.code.sentence}")
        print(evaluation.failure.message)
        print(evaluation.failure.output_tail)
    if evaluation.score:
        score = evaluation.score
        rates = {"all": score, **score.by_shape}
        rows = [(name, rate.episodes, rate.starts, rate.successes, *_percentages(rate)) for name, rate in rates.items()]
        print_table(("shape", "episodes", "starts", "successes", "rate", "95 % interval"), rows, none="")
        print(f"mean env steps of the successes: {'none' if score.mean_steps is None else f'{score.mean_steps:.2f}'}")
        ranking = load_track(evaluation.manifest.track).find_ranking(evaluation.manifest.task)
        for key in ranking.measures:
            value = score.measures.get(key.name)
            print(f"{key.title}, mean of all episodes: {'none' if value is None else f'{value:.4g}'}")
        first = {record.outcome: record.episode for record in reversed(evaluation.records)}
        outcomes = [(outcome, count, first[outcome], outcome.sentence) for outcome, count in score.outcomes.items()]
        print_table(("outcome", "episodes", "first", "meaning"), outcomes, none="")
        print(f"`vitac show {evaluation.manifest.task} --policy SUBMISSION --episode N` draws one of them")
        if score.successes < score.episodes:
            print("docs/failures.md, which a service shows under /docs/failures, says what each failure usually means")
        if score.forces:
            _print_forces(score.forces)
        _print_failures(evaluation.records)
        print("seconds: " + ", ".join(f"{name} {seconds:.1f}" for name, seconds in _seconds(evaluation).items()))
        if answers_s := [answer_s for record in evaluation.records for answer_s in record.timings.answers_s]:
            typical_ms, longest_ms = 1e3 * median(answers_s), 1e3 * max(answers_s)
            print(f"answers of the policy server: {typical_ms:.1f} ms in the median, {longest_ms:.1f} ms at most")
        print(f"result hash {evaluation.result_hash}")


def _print_forces(forces: "ForceSummary") -> None:
    from .terminal.output import print_table

    rows = [
        (name, f"{summary.peak_n:.1f}", f"{summary.p95_n:.1f}", f"{summary.impulse_n_s:.1f}")
        for name, summary in (("the held part", forces.part), ("a gel", forces.gel))
        if summary is not None
    ]
    print_table(("median force on", "peak [N]", "95th percentile [N]", "impulse [N s]"), rows, none="")
    print(
        f"above {forces.over_force_n:g} N on the held part: {forces.over_force_events} times, in "
        f"{forces.over_force_episodes} of {forces.episodes} episodes; largest stretch of a gel: "
        f"{forces.largest_stretch:.2f} (median)"
    )


def _print_failures(records: "Sequence[EpisodeRecord]") -> None:
    """Print each verdict once, with what it said first: why episodes are `policy_failed`."""
    failed = [(record.episode, record.failure) for record in records if record.failure is not None]
    for code in dict.fromkeys(failure.code for _, failure in failed):
        numbers = [number for number, failure in failed if failure.code == code]
        first = next(failure for _, failure in failed if failure.code == code)
        print(f"{code}, episode {', '.join(map(str, numbers))}: {first.sentence}")


def _percentages(rate: "Rate") -> tuple[str, str]:
    return f"{rate.success_rate:.1%}", f"{rate.interval.low:.1%} to {rate.interval.high:.1%}"


def _seconds(evaluation: "LocalEvaluation") -> dict[str, float]:
    """Return the time spent on each part [s], summed over all processes."""
    keys = ("physics", "markers", "policy", "channel")
    timings = [record.timings for record in evaluation.records]
    return {key: sum(getattr(timing, f"{key}_s") for timing in timings) for key in keys}


class EpisodesProgress:
    """A progress bar on stderr."""

    def __init__(self, total: int) -> None:
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TaskProgressColumn,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        self.bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=Console(file=sys.stderr),
        )
        self._successes = 0
        self._total = total
        self._task = self.bar.add_task("starting", total=None)

    def advance(self, record: "EpisodeRecord") -> None:
        """Count an episode."""
        self._successes += record.success
        self.bar.update(self._task, advance=1, total=self._total, description=f"{self._successes} successes")

    def describe(self, step: str) -> None:
        """Say what is done before the first episode, with a bar that moves; as a line where stderr is no terminal."""
        self.bar.update(self._task, description=step)
        if not self.bar.console.is_terminal:
            print(f"vitac: {step}", file=sys.stderr, flush=True)

    def count(self, done: int, total: int) -> None:
        """Show how far the described step is; any thread may call it, and the episodes then begin at 0."""
        if done < total:
            self.bar.update(self._task, completed=done, total=total)
        else:
            self.bar.update(self._task, description="starting", completed=0, total=self._total)

    def __enter__(self) -> "EpisodesProgress":
        self.bar.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.bar.stop()
