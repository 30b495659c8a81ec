"""`vitac resimulate`: runs recorded actions through our physics and compares with the recorded results."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .terminal.output import Assets, existing_file

if TYPE_CHECKING:
    from vitac.evaluator.logs.recordings import Recording
    from vitac.evaluator.logs.resimulation import ReportedEpisode, ReportedStep
    from vitac.evaluator.tracks import Task


def command(
    file: Annotated[
        Path,
        typer.Argument(callback=existing_file, help="Our own log or records, or a 2025 text log, gzipped or not."),
    ],
    task: Annotated[str, typer.Option(help="Task of the recording.")],
    assets: Assets = None,
    profile: Annotated[
        str | None, typer.Option(help="Settings under which it was recorded, by a name in the track file.")
    ] = None,
    contact_model: Annotated[
        str | None,
        typer.Option(help="Play under this contact model (challenge-2025, arena-2), beside what was recorded."),
    ] = None,
    json: Annotated[Path | None, typer.Option(help="Write the report to this file.")] = None,
) -> None:
    """Run recorded actions through the physics, including those after the end of an episode.

    For each env step print our value | the recorded value [mm]: motion of the gel surfaces (left, right), and the
    heights that decide success (the peg's bottom vertices, the key's teeth).
    """
    from vitac.evaluator.episodes.episode import make_environment
    from vitac.evaluator.logs.resimulation import read_recordings, report, resimulate_all
    from vitac.evaluator.tracks import find_task

    from .terminal.compiling import compiling_shown

    _, definition = find_task(task)
    if profile is not None:
        definition = _apply_profile(definition, profile)
    if contact_model is not None:
        settings = definition.settings | {"contact_model": contact_model}
        definition = definition.model_copy(update={"settings": settings})
    recordings = read_recordings(file, definition, on_problems=partial(_tell_problems, file))
    env = make_environment(definition, assets, ())
    episodes = []
    with compiling_shown():
        for recording, played in resimulate_all(env, definition, recordings):
            episodes.append(played)
            for line in _lines(definition, recording, played):
                print(line)
    result = report(env, episodes)
    if json:
        json.write_text(result.model_dump_json(exclude_unset=True, indent=1) + "\n", encoding="utf-8")
    successes = sum(episode.success for episode in episodes)
    print(
        f"{len(episodes)} episodes, {successes} successes; {result.ipc_steps} IPC steps, "
        f"{1000 * result.cpu_s_per_ipc_step:.1f} ms of CPU each; solver {result.solver_version}"
    )


def _apply_profile(task: "Task", name: str) -> "Task":
    if name not in task.profiles:
        expected = ", ".join(task.profiles) or "none"
        raise typer.BadParameter(f"expected a profile of {task.name} ({expected}), got {name!r:.80}.")
    chosen = task.profiles[name]
    print(f"Profile {name}: {', '.join(f'{key} {value}' for key, value in chosen.settings.items())}. {chosen.reason}")
    return task.model_copy(update={"settings": task.settings | chosen.settings})


def _tell_problems(file: Path, count: int) -> None:
    problems = "1 problem" if count == 1 else f"{count} problems"
    print(f"The log has {problems}: see `vitac log import {file}`.")


def _lines(task: "Task", recording: "Recording", played: "ReportedEpisode") -> Iterator[str]:
    from vitac.evaluator.episodes.records import counted_env_steps
    from vitac.evaluator.logs.resimulation import reported_step

    start = " ".join(f"{value:g}" for value in recording.episode.offset)
    yield f"Episode {played.episode}: {recording.episode.shape} at {start}"
    for ours, info in zip(played.steps, recording.infos, strict=False):
        yield _step_line(task, ours, reported_step(task, ours.n, info))
    end = f"{played.end_reason} at env step {played.end_step}" if played.end_reason else "not ended"
    recorded = {True: "success", False: "no success", None: "no result"}[recording.success]
    yield f"  {end} | recorded {recorded} after {counted_env_steps(len(recording.actions))}"


def _step_line(task: "Task", ours: "ReportedStep", recorded: "ReportedStep") -> str:
    line = f"  env step {ours.n:2}"
    for measure in task.definition.measures:
        played, before = ours.measures.get(measure.name), recorded.measures.get(measure.name)
        if played or before:
            line += f"  {measure.label} {_numbers(played)} | {_numbers(before)}"
    return line


def _numbers(values: tuple[float, ...] | None) -> str:
    return " ".join(f"{value:6.3f}" for value in values) if values else "-"
