"""Entry point of the `vitac` command: a table of nouns, each imported only when it is used."""

import atexit
import gc
import sys
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from importlib import import_module
from io import TextIOWrapper
from typing import Annotated

import typer
from vitac.errors import VitacError


@dataclass(frozen=True)
class Noun:
    """One entry of `vitac --help`.

    `vitac.cli.<module>` has a function `command` (no verbs) or a `typer.Typer` named `<app>` (several verbs); a module
    has the noun's name where no other is said. `extra` is that of the package's extras which it needs, if any.
    """

    name: str
    summary: str
    module: str = ""
    _: KW_ONLY
    extra: str | None = None
    app: str = "app"


_SERVER = "server"

NOUNS = (
    Noun("demo", "Run a service and evaluate the example submission on it.", "demo.command", extra=_SERVER),
    Noun("check", "Check a submission before its upload."),
    Noun("evaluate", "Evaluate a submission here, as the service does."),
    Noun("resimulate", "Run recorded actions through the physics."),
    Noun("log", "Show, verify, compare, match and import evaluation logs."),
    Noun("seeds", "Make and verify the secrets of sealed episode lists."),
    Noun("show", "Draw an episode."),
    Noun("play", "Play a task by hand, and store it as demonstrations.", "play.command"),
    Noun("sensor", "Check, mesh and draw a sensor of your own."),
    Noun("station", "Check a laboratory's devices, or run twins of them.", extra="station"),
    Noun("train", "Train a policy from a recipe, and export it."),
    Noun("data", "Collect demonstrations, and make and check data sets of them.", extra="data"),
    Noun("register", "Register a team at a service.", "client.account", app="register"),
    Noun("login", "Store a team's token for later commands.", "client.account", app="login"),
    Noun("logout", "Delete the stored token.", "client.account", app="logout"),
    Noun("whoami", "Show team, token and quotas.", "client.account", app="whoami"),
    Noun("team", "Show the team; invite, join, remove members.", "client.team"),
    Noun("question", "Ask the organizers, and read their answers.", "client.team", app="question"),
    Noun("appeal", "Appeal against an evaluation of your team.", "client.team", app="appeal"),
    Noun("submit", "Upload a submission to a service.", "client.submit"),
    Noun("remote", "Play at a service with a policy server of your own.", "client.remote"),
    Noun("status", "Show your submissions on a service.", "client.status"),
    Noun("publish", "Make a submission's result public.", "client.publish", app="publish"),
    Noun("choose", "Choose what plays the final list of a stage.", "client.publish", app="choose"),
    Noun("describe", "Say what a public result is; link code and paper.", "client.publish", app="describe"),
    Noun("withdraw", "Take a submission off all boards, or delete it.", "client.publish", app="withdraw"),
    Noun("leaderboard", "Print a leaderboard, also as CSV or for LaTeX.", "client.leaderboard"),
    Noun("compare", "Compare two submissions episode by episode."),
    Noun("gap", "Measure how far simulation is from a station."),
    Noun("receipt", "Verify receipts; audit the public log and boards."),
    Noun("witness", "Sign the log of a service, unless it was rewritten.", extra=_SERVER),
    Noun("serve", "Run the service: database, API and pages.", "service.serve", extra=_SERVER),
    Noun("worker", "Run a worker that evaluates submissions.", "service.worker", extra="worker"),
    Noun("gate", "Let policy servers dial in that the service cannot dial.", "service.gate", extra=_SERVER),
    Noun("scale", "Start workers on a cluster when there is work.", "service.worker", extra=_SERVER, app="scale_app"),
    Noun("admin", "Manage teams, submissions, evaluations and workers.", "admin.app", extra=_SERVER),
    Noun("compile", "Compile the physics, for images and read-only installations."),
    Noun("sandbox", "Print what a policy runs with: packages, BLAS, threads, CPU."),
    Noun("doctor", "Test the sandbox on this machine."),
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
        module = import_module(f"vitac.cli.{noun.module or noun.name}")
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
