"""`vitac doctor`: really tries the isolation of submissions on this machine and says what to install."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from vitac.evaluator.agent.isolation.machine import Requirement
    from vitac.evaluator.agent.self_test import Outcome


def command(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    """Try the isolation of submissions here: fork bombs, memory, network, files, and more; exit 1 where one escapes."""
    from vitac.evaluator.agent.isolation.machine import requirements
    from vitac.evaluator.agent.self_test import is_safe, run

    found = requirements()
    can_try = all(requirement.is_met for requirement in found if requirement.is_needed)
    if not as_json:
        _print_requirements(found)
    outcomes = _try_all(run(), shown=not as_json) if can_try else []
    safe = can_try and is_safe(outcomes)
    if as_json:
        _print_json(found, outcomes, safe=safe)
    else:
        print(_conclusion(outcomes, can_try=can_try, safe=safe))
    if not safe:
        raise typer.Exit(1)


def _print_requirements(found: "list[Requirement]") -> None:
    from .terminal.output import print_table

    rows = [(item.name, _state(item), item.found) for item in found]
    print_table(("machine", "state", "found"), rows, none="")
    for item in found:
        if item.remedy:
            print(f"  {item.name}: {item.remedy}.")
    print()


def _state(requirement: "Requirement") -> str:
    if requirement.is_met:
        return "ok"
    return "missing" if requirement.is_needed else "note"


def _try_all(outcomes: Any, *, shown: bool) -> "list[Outcome]":
    from vitac.evaluator.agent.self_test import PROBES

    width = max(len(probe.name) for probe in PROBES)
    done = []
    for outcome in outcomes:
        done.append(outcome)
        if shown:
            print(f"{outcome.name:<{width}}  {outcome.state:<8}{_short(outcome.detail)}", flush=True)
    return done


def _short(detail: str) -> str:
    line = " ".join(detail.split())
    return line if len(line) <= 100 else f"{line[:97]}..."


def _conclusion(outcomes: "list[Outcome]", *, can_try: bool, safe: bool) -> str:
    if not can_try:
        return "\nThis machine cannot isolate submissions yet; install what is missing above. Nothing was run."
    if safe:
        level = next(outcome.isolation for outcome in outcomes if outcome.isolation)
        return (
            f"\nAll {len(outcomes)} attempts were held (user: {level.user}, memory: {level.memory}, "
            f"episodes: {level.episodes})."
        )
    names = ", ".join(outcome.name for outcome in outcomes if outcome.state != "held")
    return f"\nNOT SAFE: {names}. Run no submissions of others on this machine."


def _print_json(found: "list[Requirement]", outcomes: "list[Outcome]", *, safe: bool) -> None:
    from .terminal.output import print_json

    print_json(
        {
            "safe": safe,
            "machine": [asdict(requirement) for requirement in found],
            "probes": [asdict(outcome) for outcome in outcomes],
        }
    )
