"""`vitac data`: collects demonstrations of an expert, and makes, checks and describes data sets of them."""

from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer

from .terminal.episode_counter import EpisodeCounter
from .terminal.output import AsJson, Processes, Ray, existing, print_json, print_table
from .terminal.stopping import stopped_by_signals

app = typer.Typer(no_args_is_help=True)

Form = Literal["lerobot-v3.0", "lerobot-v2.1", "minari"]
DataSet = Annotated[Path, typer.Argument(callback=existing, help="Folder of the data set.")]


@app.command()
def collect(
    out: Annotated[Path, typer.Option("--out", help="Folder; collections in it are continued.")],
    tasks: Annotated[list[str] | None, typer.Argument(help="Tasks, by default all that have an expert.")] = None,
    successes: Annotated[int, typer.Option(min=1, help="Successful demonstrations of each task.")] = 290,
    policy: Annotated[
        Path | None,
        typer.Option(callback=existing, help="Zip or folder of a submission that plays in place of the expert."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the starts.")] = 0,
    processes: Processes = 1,
    ray: Ray = None,
    as_json: AsJson = False,
) -> None:
    """Let an expert that knows the truth play; the same bytes however many processes play, and after any kill.

    Of ten episodes five are its own actions, four have noise from which it recovers, and in one it is misled. A policy
    of yours knows what the learner will know; every other of its episodes has noise.
    """
    from vitac.training.demonstrations.collecting import collect as collect_task
    from vitac.training.demonstrations.collecting import count_outcomes, list_tasks

    from .terminal.compiling import compiling_shown
    from .terminal.own_policy import fall_back_where_nothing_isolates

    if policy is not None:
        if not tasks or ray is not None:
            raise typer.BadParameter("Name the tasks that it plays; it plays on this machine.", param_hint="--policy")
        fall_back_where_nothing_isolates()
    rows = []
    for task in tasks or list_tasks():
        remedy = f"run the same command to continue from {out}"
        with stopped_by_signals(remedy), compiling_shown(), EpisodeCounter() as counter:
            report = partial(counter.show_collected, task, successes)
            path = collect_task(
                task, out, successes=successes, policy=policy, seed=seed, processes=processes, ray=ray, report=report
            )
        rows += [{"task": task, **row, "file": str(path)} for row in count_outcomes(path)]
    if as_json:
        print_json({"demonstrations": rows})
    else:
        columns = ("task", "kind", "episodes", "successes", "env steps")
        print_table(columns, [[row[column.replace(" ", "_")] for column in columns] for row in rows], none="none")


@app.command()
def export(
    collection: Annotated[Path, typer.Argument(callback=existing, help="Folder of a task, or of several.")],
    to: Annotated[Path, typer.Option("--to", help="New folder; of several tasks each gets one in it.")],
    form: Annotated[Form, typer.Option("--format", help="Format of the data set.")] = "lerobot-v3.0",
    key: Annotated[
        list[str] | None,
        typer.Option(help="Observation key to store, repeated; default: coloured pictures and all that is small."),
    ] = None,
    only_successes: Annotated[bool, typer.Option(help="Leave failures out.")] = False,
    only_vectors: Annotated[
        bool, typer.Option(help="For LeRobot: vectors and pictures alone, which its own policies read.")
    ] = False,
    processes: Processes = 1,
) -> None:
    """Play demonstrations again, compare every state, and write what was seen as a data set with a card."""
    from vitac.training.demonstrations.collecting import FILE
    from vitac.training.demonstrations.exporting import DatasetFormat
    from vitac.training.demonstrations.exporting import export as export_task

    from .terminal.compiling import compiling_shown

    if only_vectors and form == "minari":
        raise typer.BadParameter("Minari's format has no columns to leave out.", param_hint="--only-vectors")
    is_one = (collection / FILE).exists()
    files = [collection / FILE] if is_one else sorted(collection.glob(f"*/{FILE}"))
    if not files:
        raise typer.BadParameter(f"{collection} holds no demonstrations; make some with `vitac data collect`.")
    for file in files:
        folder = to if is_one else to / file.parent.name
        remedy = f"{folder} was not written; run the same command again"
        with stopped_by_signals(remedy), compiling_shown(), EpisodeCounter() as counter:
            export_task(
                file,
                folder,
                DatasetFormat(form),
                keys=key,
                only_successes=only_successes,
                only_vectors=only_vectors,
                processes=processes,
                report=partial(counter.show_played, folder),
            )
        print(folder)


@app.command("import")
def import_(
    folder: DataSet,
    to: Annotated[Path, typer.Option("--to", help="Folder, in which the task gets one.")],
) -> None:
    """Read the demonstrations back from a LeRobotDataset that was exported here, exactly as they were collected."""
    from vitac.training.demonstrations.lerobot.reading import import_lerobot

    print(import_lerobot(folder, to))


@app.command()
def check(
    folder: DataSet,
    replay: Annotated[int, typer.Option(min=0, help="Play this number of random episodes again.")] = 0,
    processes: Processes = 1,
    as_json: AsJson = False,
) -> None:
    """Name what is broken in a LeRobotDataset or a collection, by file and row; exit code 1 if anything is.

    A LeRobotDataset may be anybody's; `--replay` needs one that was exported here.
    """
    from vitac.training.demonstrations.collecting import FILE
    from vitac.training.demonstrations.lerobot.checking import check_lerobot
    from vitac.training.demonstrations.replaying import read_folder
    from vitac.training.demonstrations.replaying import replay as replay_some

    is_collection = (folder / FILE).exists()
    faults = [] if is_collection else [str(fault) for fault in check_lerobot(folder)]
    replayed = 0
    if not faults and (replay or is_collection):
        source, demonstrations = read_folder(folder)
        with EpisodeCounter() as counter:
            report = partial(counter.show_played, folder)
            replayed = len(replay_some(source, demonstrations, count=replay, processes=processes, report=report))
    if as_json:
        print_json({"faults": faults, "replayed": replayed})
    else:
        print("\n".join(faults) or f"no fault found; {replayed} episodes replayed")
    if faults:
        raise typer.Exit(1)


@app.command()
def card(
    folder: Annotated[Path, typer.Argument(callback=existing, help="Folder of a task's demonstrations or a data set.")],
) -> None:
    """Print what a data set is: who acted, from which starts, with which success, and its licence."""
    from vitac.training.demonstrations.exporting import make_card_of

    print(make_card_of(folder))
