"""`vitac train`: collects episodes, trains a policy from a recipe, and makes a submission of it."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from .terminal.output import AsJson, Processes, Ray, print_json, print_pairs
from .terminal.stopping import stopped_by_signals


class _RecipeFirst(TyperGroup):
    """Lets a recipe stand where a verb would: `vitac train RECIPE.yaml` means `vitac train run RECIPE.yaml`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the verb before a recipe."""
        if args and not args[0].startswith("-") and args[0] not in self.commands:
            args = ["run", *args]
        return super().parse_args(ctx, args)


app = typer.Typer(cls=_RecipeFirst, no_args_is_help=True)

RecipeFile = Annotated[Path, typer.Argument(help="YAML file that says what is learned.", exists=True, dir_okay=False)]
RunFolder = Annotated[Path, typer.Option("--out", help="Folder of the run; an existing run is continued.")]
Sensor = Annotated[
    Path | None, typer.Option(help="Folder of your own sensor, for sensor-design.", exists=True, file_okay=False)
]


@app.command()
def run(
    recipe: RecipeFile,
    out: RunFolder,
    processes: Processes = 1,
    ray: Ray = None,
    identified: Annotated[
        Path | None,
        typer.Option(
            help="File of `vitac station identify`: episodes have that station's frictions, gel, grasp and cameras.",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Train a policy, or continue its training; Ctrl-C loses at most the current round.

    Weights that are learned use one thread, so that their bits do not depend on the number of cores.
    """
    _one_thread()
    from vitac.training.recipe import read_recipe
    from vitac.training.run import Folder, Run, best, format_rate

    plan = read_recipe(recipe)
    if identified:
        from vitac.envs.fem.model.settings import ContactModel
        from vitac.evaluator.strict_model import read_yaml
        from vitac.station.identification.station import IdentifiedStation

        station = {"contact_model": ContactModel.ARENA_2, "draws": read_yaml(IdentifiedStation, identified).draws}
        plan = plan.model_copy(update=station)
    training = Run(recipe=plan, folder=Folder(path=out), processes=processes, ray=ray, tell=_tell)
    with _training(out):
        results = training.go()
    chosen = best(results)
    rows = {f"round {result.number}": format_rate(result.student) for result in results}
    if as_json:
        print_json({"rounds": rows, "best": chosen.number})
    else:
        print_pairs({**rows, "best": f"round {chosen.number}; vitac train export {out} --to FOLDER"})


@app.command()
def collect(recipe: RecipeFile, out: RunFolder, processes: Processes = 1, ray: Ray = None) -> None:
    """Play the episodes of the first round only; a later `vitac train` finds them."""
    _one_thread()
    from vitac.training.recipe import read_recipe
    from vitac.training.run import Folder, Run

    training = Run(recipe=read_recipe(recipe), folder=Folder(path=out), processes=processes, ray=ray, tell=_tell)
    with _training(out):
        episodes = training.collect_first()
    print_pairs({"episodes": episodes})


@app.command()
def export(
    folder: Annotated[Path, typer.Argument(help="Folder of a finished run.", exists=True, file_okay=False)],
    submission: Annotated[Path, typer.Option("--to", help="New folder for the submission.")],
) -> None:
    """Export the best round as a submission."""
    from vitac.training.export import export as exported
    from vitac.training.run import Folder, best, read_results

    kept = Folder(path=folder)
    chosen = best(read_results(kept))
    print_pairs({"round": chosen.number, "submission": exported(kept, chosen, submission)})


@app.command()
def search(recipe: RecipeFile, out: RunFolder, processes: Processes = 1, as_json: AsJson = False) -> None:
    """Search the parameters of a policy for locks, or continue a search; the best becomes a submission."""
    _one_thread()
    from vitac.training.run import Folder, format_rate
    from vitac.training.search.method import WeightSearch, best, read_search_recipe

    searching = WeightSearch(
        recipe=read_search_recipe(recipe), folder=Folder(path=out), processes=processes, tell=_tell
    )
    with _training(out):
        generations = searching.go()
    rows = {
        f"generation {each.number}": f"{format_rate(each.solved)}, {each.mean_env_steps:.2f} env steps"
        for each in generations
    }
    if as_json:
        print_json({"generations": rows, "best": best(generations).number})
    else:
        print_pairs({**rows, "best": f"generation {best(generations).number}", "submission": out / "submission"})


@app.command()
def clone(
    task: Annotated[str, typer.Argument(help="A task that has an expert, such as peg-insertion.")],
    out: RunFolder,
    seed: Annotated[int, typer.Option(min=0, help="Seed of starts and learning.")] = 0,
    rounds: Annotated[int, typer.Option(min=1, help="How often the policy is learned.")] = 6,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes before each round.")] = 300,
    sensor: Sensor = None,
    processes: Processes = 1,
    as_json: AsJson = False,
) -> None:
    """Clone an expert that knows the truth, or continue, and compare with a blind policy made in the same way."""
    _one_thread()
    from vitac.training.cloning.method import ClonePlan, clone

    plan = ClonePlan(task=task, seed=seed, rounds=rounds, episodes=episodes)
    with _training(out):
        gain = clone(plan, out, sensor=sensor, processes=processes, tell=_tell)
    if as_json:
        print_json(gain.model_dump())
    else:
        print_pairs(
            {
                "fresh starts": gain.episodes,
                "solved": gain.standard_successes,
                "solved blind": gain.blind_successes,
                "gain by sensing": f"{100 * gain.gain:.1f} % [{100 * gain.low:.1f}, {100 * gain.high:.1f}]",
                "submission": out / "submission",
            }
        )


@app.command()
def reference(
    task: Annotated[str, typer.Argument(help="peg-insertion, lock-opening, fusion-insertion or sensor-design.")],
    out: Annotated[
        Path, typer.Option("--out", help="Folder for checkpoints, log and submission; an existing one is continued.")
    ],
    env_steps: Annotated[
        int | None, typer.Option(min=1, help="Number of env steps; default: the published one.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the training.")] = 0,
    sensor: Sensor = None,
    fidelity: Annotated[str, typer.Option(help="Of the episodes that are learned from: full or training.")] = "full",
    device: Annotated[str, typer.Option(help="Of torch: cpu, or cuda for a GPU; only cpu repeats to the bit.")] = "cpu",
) -> None:
    """Train as the challenge did, with PointNet and TD3, or continue; needs the extra `training`."""
    _one_thread()
    from vitac.training.reference.td3 import train_reference

    with _training(out):
        submission = train_reference(
            task, out, env_steps=env_steps, seed=seed, sensor=sensor, fidelity=fidelity, device=device, tell=_tell
        )
    print_pairs({"submission": submission})


@app.command()
def curves(
    runs: Annotated[list[Path], typer.Argument(help="Folders of trainings, and files stored before.", exists=True)],
    to: Annotated[Path | None, typer.Option(help="Folder for page, pictures and what is read again.")] = None,
) -> None:
    """Show success over env steps of trainings, several seeds of a method together."""
    from itertools import groupby

    from vitac.training.curves import draw_curves, make_page, read_curves, write_curves
    from vitac.training.files import write_text

    read = read_curves(runs)
    tasks = {task: list(of_task) for task, of_task in groupby(read, key=lambda curve: curve.task)}
    page = make_page(read, {task: f"{task}.svg" for task in tasks})
    if to is None:
        print(page)
        return
    for task, of_task in tasks.items():
        write_text(to / f"{task}.svg", draw_curves(of_task))
    write_text(to / "curves.json", write_curves(read))
    write_text(to / "README.md", page)
    print(to / "README.md")


def _one_thread() -> None:
    """Let linear algebra use one thread; it must be said before NumPy is imported."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"


@contextmanager
def _training(folder: Path) -> Iterator[None]:
    """Show what a training waits for before its first episode, and how it is continued when it is stopped."""
    from .terminal.compiling import compiling_shown

    with stopped_by_signals(f"run the same command to continue from {folder}"), compiling_shown():
        yield


def _tell(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
