"""Entry point of the `vitac` command: a table of nouns, each imported only when it is used."""

import atexit
import gc
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from io import TextIOWrapper
from typing import Annotated

import typer
from vitac.errors import VitacError


@dataclass(frozen=True, kw_only=True)
class Noun:
    """One entry of `vitac --help`.

    `vitac.cli.<module>` has a function `command` (no verbs) or a `typer.Typer` named `<app>` (several verbs).
    `extra` is that of the package's extras which it needs, if any.
    """

    name: str
    module: str
    summary: str
    extra: str | None = None
    app: str = "app"


_SERVER = "server"

NOUNS = (
    Noun(
        name="demo",
        module="demo.command",
        summary="Run a service and evaluate the example submission on it.",
        extra=_SERVER,
    ),
    Noun(name="check", module="check", summary="Check a submission before its upload."),
    Noun(name="evaluate", module="evaluate", summary="Evaluate a submission here, as the service does."),
    Noun(name="resimulate", module="resimulate", summary="Run recorded actions through the physics."),
    Noun(name="log", module="log", summary="Show, verify, compare, match and import evaluation logs."),
    Noun(name="seeds", module="seeds", summary="Make and verify the secrets of sealed episode lists."),
    Noun(name="show", module="show.command", summary="Draw an episode."),
    Noun(name="play", module="play.command", summary="Play a task by hand, and store it as demonstrations."),
    Noun(name="sensor", module="sensor", summary="Check, mesh and draw a sensor of your own."),
    Noun(
        name="station",
        module="station",
        summary="Check a laboratory's devices, or run twins of them.",
        extra="station",
    ),
    Noun(name="train", module="train", summary="Train a policy from a recipe, and export it."),
    Noun(
        name="data",
        module="data",
        summary="Collect demonstrations, and make and check data sets of them.",
        extra="data",
    ),
    Noun(name="register", module="client.account", app="register", summary="Register a team at a service."),
    Noun(name="login", module="client.account", app="login", summary="Store a team's token for later commands."),
    Noun(name="logout", module="client.account", app="logout", summary="Delete the stored token."),
    Noun(name="whoami", module="client.account", app="whoami", summary="Show team, token and quotas."),
    Noun(name="team", module="client.team", summary="Show the team; invite, join, remove members."),
    Noun(name="question", module="client.team", app="question", summary="Ask the organizers, and read their answers."),
    Noun(name="appeal", module="client.team", app="appeal", summary="Appeal against an evaluation of your team."),
    Noun(name="submit", module="client.submit", summary="Upload a submission to a service."),
    Noun(name="remote", module="client.remote", summary="Play at a service with a policy server of your own."),
    Noun(name="status", module="client.status", summary="Show your submissions on a service."),
    Noun(name="publish", module="client.publish", app="publish", summary="Make a submission's result public."),
    Noun(name="choose", module="client.publish", app="choose", summary="Choose what plays the final list of a stage."),
    Noun(
        name="describe",
        module="client.publish",
        app="describe",
        summary="Say what a public result is; link code and paper.",
    ),
    Noun(
        name="withdraw",
        module="client.publish",
        app="withdraw",
        summary="Take a submission off all boards, or delete it.",
    ),
    Noun(name="leaderboard", module="client.leaderboard", summary="Print a leaderboard, also as CSV or for LaTeX."),
    Noun(name="compare", module="compare", summary="Compare two submissions episode by episode."),
    Noun(name="gap", module="gap", summary="Measure how far simulation is from a station."),
    Noun(name="receipt", module="receipt.app", summary="Verify receipts; audit the public log and boards."),
    Noun(
        name="witness", module="witness", summary="Sign the log of a service, unless it was rewritten.", extra=_SERVER
    ),
    Noun(name="serve", module="service.serve", summary="Run the service: database, API and pages.", extra=_SERVER),
    Noun(name="worker", module="service.worker", summary="Run a worker that evaluates submissions.", extra="worker"),
    Noun(
        name="gate",
        module="service.gate",
        summary="Let policy servers dial in that the service cannot dial.",
        extra=_SERVER,
    ),
    Noun(
        name="scale",
        module="service.scale",
        summary="Start workers on a cluster when there is work.",
        extra=_SERVER,
    ),
    Noun(
        name="admin", module="admin.app", summary="Manage teams, submissions, evaluations and workers.", extra=_SERVER
    ),
    Noun(name="compile", module="compile", summary="Compile the physics, for images and read-only installations."),
    Noun(name="sandbox", module="sandbox", summary="Print what a policy runs with: packages, BLAS, threads, CPU."),
    Noun(name="doctor", module="doctor", summary="Test the sandbox on this machine."),
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; exit with 0 for done, 1 for refused, 2 for wrong usage, 130 for Ctrl-C."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    atexit.register(gc.freeze)  # else Python looks through all that is loaded several times before it ends
    _print_what_a_terminal_lacks()
    try:
        build_app(arguments)(arguments, prog_name="vitac")
    except ModuleNotFoundError as error:
        from vitac.envs.extras import explain_missing, find_extra

        preferred = next((noun.extra for noun in NOUNS if noun.name == _requested(arguments)), None)
        extra = find_extra(error.name or "", preferred)
        if extra is None:
            raise
        print(f"vitac: {explain_missing(error.name or '', extra)}", file=sys.stderr)
        sys.exit(1)
    except VitacError as error:
        print(f"vitac: {error}", file=sys.stderr)
        sys.exit(1)


def _print_what_a_terminal_lacks() -> None:
    """Print letters that the terminal's encoding lacks as escapes, instead of ending at the first one."""
    if isinstance(sys.stdout, TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")


def build_app(arguments: Sequence[str]) -> typer.Typer:
    """Return the command line with every noun listed; import only the requested one."""
    app = typer.Typer(
        callback=_options,
        no_args_is_help=True,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        add_completion=False,
    )
    requested = _requested(arguments)
    for noun in NOUNS:
        if noun.name != requested:
            app.command(noun.name, help=noun.summary)(_listed_only)
            continue
        module = import_module(f"vitac.cli.{noun.module}")
        entry = getattr(module, noun.app, None) or module.command
        if isinstance(entry, typer.Typer):
            app.add_typer(entry, name=noun.name, help=noun.summary)
        else:
            app.command(noun.name)(entry)
    return app


def _requested(arguments: Sequence[str]) -> str | None:
    """Return the noun on the command line, if any."""
    return next((argument for argument in arguments if not argument.startswith("-")), None)


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version  # not above: `--help` would take a fifth longer

        from vitac.evaluator.version import evaluator_version

        print(f"vitac-arena {version('vitac-arena')}, evaluator {evaluator_version()}")
        raise typer.Exit


def _options(
    _: Annotated[
        bool, typer.Option("--version", help="Show the version and exit.", is_eager=True, callback=_show_version)
    ] = False,
) -> None:
    """Serve, evaluate and score submissions for manipulation with vision and touch."""


def _listed_only() -> None:
    """List a noun that was not requested."""
