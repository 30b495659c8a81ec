"""`vitac log`: shows, verifies, compares and imports evaluation logs."""

import json as json_module
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .terminal.output import AsJson, existing_file, print_json, print_table

if TYPE_CHECKING:
    from vitac.evaluator.episodes.records import EpisodeRecord
    from vitac.evaluator.logs.log import LogHeader

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False)

LogFile = Annotated[Path, typer.Argument(callback=existing_file, help="A log written by `vitac evaluate --log`.")]


@app.command()
def show(log: LogFile, json: AsJson = False) -> None:
    """Print the header, a table of the episodes and the claimed score."""
    from vitac.evaluator.episodes.records import NOT_HASHED
    from vitac.evaluator.scoring.score import score

    from .terminal.output import print_meanings

    header, records = _read(log)
    claimed = score(records) if records else None
    if json:
        episodes = [record.model_dump(mode="json", exclude={*NOT_HASHED, "infos"}) for record in records]
        content = {"header": header.model_dump(mode="json"), "episodes": episodes}
        print_json(content | {"claimed_score": claimed.model_dump(mode="json") if claimed else None})
        return
    manifest = header.manifest
    print(f"team {header.team or '-'}, {manifest.track}, {manifest.task}, evaluator {manifest.evaluator_version}")
    print(f"solver {manifest.solver_version}, {manifest.platform_class}, submission {header.submission_digest or '-'}")
    rows = [
        (record.episode, record.shape, _offset(record), record.outcome.value, record.env_steps, record.total_reward)
        for record in records
    ]
    print_table(("episode", "shape", "offset", "outcome", "env steps", "reward"), rows, none="no episodes")
    print_meanings(record.outcome for record in records)
    if claimed:
        print(f"claimed: {claimed.successes} of {claimed.episodes} successes, {claimed.success_rate:.1%}")


@app.command()
def verify(
    log: LogFile,
    episodes: Annotated[
        str | None, typer.Option(help="Required episodes, such as 1:12; those in the log by default.")
    ] = None,
    json: AsJson = False,
) -> None:
    """Re-simulate a log's actions; exit code 0 if it is verified, 1 if it diverges or is impossible.

    A log of a part of the list is verified as far as it goes, and the output says what is missing. A 2025 text log
    cannot be verified: its numbers are checked, and claimed and re-simulated rate printed; exit code 0 if it is
    complete and its numbers agree with each other.
    """
    from vitac.evaluator.logs.resimulation import is_text_log_file

    if is_text_log_file(log):
        if episodes is not None:
            raise typer.BadParameter("--episodes is for logs of `vitac evaluate`; a 2025 text log is checked whole.")
        _check_text_log(log, json=json)
        return
    from vitac.evaluator.episodes.episode import make_environment
    from vitac.evaluator.logs.verification import verify as verify_log
    from vitac.evaluator.tracks import find_task

    from .evaluate import parse_episodes
    from .terminal.compiling import compiling_shown
    from .terminal.own_policy import fall_back_where_nothing_isolates

    header, records = _read(log)
    fall_back_where_nothing_isolates()
    track, task = find_task(header.manifest.task)
    missing = sorted({episode.number for episode in task.episodes} - {record.episode for record in records})
    with compiling_shown():
        verification = verify_log(
            env=make_environment(task, None, ()),
            track=track,
            task=task,
            header=header,
            records=records,
            episodes=parse_episodes(episodes) or [record.episode for record in records] or None,
            on_episode=lambda record: _progress(f"re-simulated {record.episode}"),
        )
    _progress("")
    if json:
        content = verification.model_dump(mode="json", exclude={"records"})
        earned = verification.score
        content["missing_episodes"] = missing
        print_json(content | {"score": earned.model_dump(mode="json") if earned else None})
    else:
        part = f"{len(records)} of {len(task.episodes)} episodes " if verification.score and missing else ""
        print(f"{part}{verification.verdict}: {verification.reason}")
        if verification.divergence:
            print(verification.divergence.model_dump_json(indent=1))
        if verification.score:
            print(f"{verification.score.successes} of {verification.score.episodes} successes")
        if verification.score and missing:
            print(
                f"only a part: {len(records)} of {len(task.episodes)} episodes, the first missing one is {missing[0]}; "
                "a service takes whole logs only"
            )
    if not verification.records:
        raise typer.Exit(1)


def _check_text_log(log: Path, *, json: bool) -> None:
    """Print what a 2025 text log can be checked for, and where its actions lead here."""
    from vitac.evaluator.logs.resimulation import CANNOT_BE_VERIFIED, TextLogCheck
    from vitac.evaluator.logs.text_2025 import WHY_RATES_DIFFER

    from .terminal.compiling import compiling_shown

    with compiling_shown():
        check = TextLogCheck.from_file(log, lambda number: _progress(f"re-simulated {number}"))
    _progress("")
    summary, count = check.summary, len(check.tests)
    if json:
        verdict = {"successes": check.successes, "same_ends": check.same_ends, "is_consistent": check.is_consistent}
        print_json(check.model_dump(mode="json") | verdict)
    else:
        print(CANNOT_BE_VERIFIED)
        print(f"{check.task} of {check.track}, team {summary.team}: {count} tests, {check.missing_tests} missing")
        print(f"claimed:      {summary.successes} of {summary.episodes} successes, {summary.success_rate:.1%}")
        print(f"re-simulated: {check.successes} of {count} successes, {check.successes / max(1, count):.1%}")
        print(f"{check.same_ends} of {count} tests end here as in the log, at the same env step. {WHY_RATES_DIFFER}")
        for problem in summary.problems:
            print(f"problem: {problem}")
    if not check.is_consistent:
        raise typer.Exit(1)


@app.command()
def diff(first: LogFile, second: LogFile, json: AsJson = False) -> None:
    """Print the first difference between two logs; exit code 0 if there is none, 1 otherwise."""
    from vitac.evaluator.logs.comparison import first_difference

    difference = first_difference(_read(first), _read(second))
    if json:
        print_json(difference.model_dump(mode="json") if difference else None)
    elif difference is None:
        print("no difference")
    else:
        places = (("episode", difference.episode), ("env step", difference.env_step))
        place = " ".join(f"{name} {number}" for name, number in places if number is not None) or "header"
        print(f"{place}: {difference.key} is {difference.first} in the first log, {difference.second} in the second")
    if difference:
        raise typer.Exit(1)


@app.command("import")
def import_(
    file: Annotated[Path, typer.Argument(callback=existing_file, help="A 2025 text log.")],
    output: Annotated[Path | None, typer.Option(help="Write the episodes to this file as JSON lines.")] = None,
    json: AsJson = False,
) -> None:
    """Read a 2025 text log, check it against itself and the published rules, and convert it."""
    from vitac.evaluator.logs.log import open_log
    from vitac.evaluator.logs.text_2025 import read_text_log, summarize, to_json_lines

    with open_log(file) as stream:
        log = read_text_log(stream)
    kind, summary = summarize(log)
    if output:
        lines = (json_module.dumps(line) + "\n" for line in to_json_lines(log, kind))
        output.write_text("".join(lines), encoding="utf-8")
    if json:
        print_json(summary.model_dump())
        return
    print(f"{kind.name}, team {summary.team}: {summary.successes} of {summary.episodes} successes")
    if summary.era:
        print(f"era: {summary.era}")
    claimed = "no totals" if summary.claimed_success_rate is None else f"{summary.claimed_success_rate:.2%}"
    print(f"success rate {summary.success_rate:.2%}, claimed {claimed}")
    print(f"claimed average of env steps {summary.claimed_average_steps or '-'}")
    for problem in summary.problems:
        print(f"problem: {problem}")


@app.command()
def match(
    log: LogFile,
    submission: Annotated[Path, typer.Argument(help="Zip or folder of the model, or tar of an image.")],
    json: AsJson = False,
) -> None:
    """Count how many of a log's actions a model gives; exit code 0 if all, 1 otherwise."""
    from vitac.evaluator.agent.limits import Limits
    from vitac.evaluator.episodes.episode import make_environment
    from vitac.evaluator.episodes.records import make_reading
    from vitac.evaluator.logs.comparison import match_actions
    from vitac.evaluator.shards.policy import load_in_sandbox
    from vitac.evaluator.submission.manifest import load_manifest
    from vitac.evaluator.submission.sources import staged
    from vitac.evaluator.tracks import find_task

    from .evaluate import find_playing_kind
    from .terminal.compiling import compiling_shown

    header, records = _read(log)
    track, task = find_task(header.manifest.task)
    kind = find_playing_kind(submission)
    with (
        staged(submission, kind) as folder,
        load_in_sandbox(folder, Limits(), track.packages, kind=kind) as session,
        compiling_shown(),
    ):
        reading = make_reading(task, load_manifest(folder).observation_keys)
        result = match_actions(
            env=make_environment(task, None, reading.sent),
            task=task,
            records=records,
            open_session=lambda: session,
            reading=reading,
            on_episode=lambda episode: _progress(f"compared {episode.episode}"),
        )
    _progress("")
    if json:
        print_json(result.model_dump() | {"actions": result.actions, "reproduced": result.reproduced})
    else:
        print(f"the model gives {result.reproduced} of {result.actions} actions")
        for episode in result.episodes:
            if episode.first_mismatch:
                print(
                    f"episode {episode.episode}: {episode.reproduced} of {episode.actions}, different from env step "
                    f"{episode.first_mismatch} {episode.failure or ''}"
                )
    if result.reproduced != result.actions:
        raise typer.Exit(1)


def _read(log: Path) -> tuple["LogHeader", list["EpisodeRecord"]]:
    from vitac.evaluator.logs.log import LogReader, open_log

    with open_log(log) as stream:
        reader = LogReader(stream)
        return reader.header, list(reader.records())


def _offset(record: "EpisodeRecord") -> str:
    return " ".join(f"{value:g}" for value in record.initial_offset)


def _progress(text: str) -> None:
    """Overwrite a progress line on stderr; an empty text clears it."""
    if sys.stderr.isatty():
        print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)
