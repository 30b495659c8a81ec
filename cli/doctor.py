"""`vitac doctor`: attacks the sandbox on this machine and says what to install."""

import os
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import typer

from .terminal.output import AsJson, print_json, print_table

if TYPE_CHECKING:
    from vitac.evaluator.agent.isolation.machine import Requirement
    from vitac.evaluator.agent.self_test import Outcome


def command(
    as_json: AsJson = False,
) -> None:
    """Attack the sandbox on this machine: fork bombs, memory, network, files and more; exit 1 if an attack succeeds."""
    from vitac.evaluator.agent.isolation.machine import requirements
    from vitac.evaluator.agent.isolation.memory_files import FILES_VARIABLE, FileIsolation
    from vitac.evaluator.agent.self_test import is_safe, run

    os.environ.setdefault(FILES_VARIABLE, FileIsolation.MEMORY)  # as workers do
    needed = requirements()
    can_run = all(requirement.is_met for requirement in needed if requirement.is_needed)
    if not as_json:
        _print_requirements(needed)
    outcomes = _run_attacks(run(), shown=not as_json) if can_run else []
    safe = can_run and is_safe(outcomes)
    if as_json:
        _print_json(needed, outcomes, safe=safe)
    else:
        print(_conclusion(outcomes, can_run=can_run, safe=safe))
    if not safe:
        raise typer.Exit(1)


def _print_requirements(needed: "list[Requirement]") -> None:
    rows = [(item.name, _state(item), item.found) for item in needed]
    print_table(("machine", "state", "found"), rows, none="")
    for item in needed:
        if item.remedy:
            print(f"  {item.name}: {item.remedy.removesuffix('.')}.")
    print()


def _state(requirement: "Requirement") -> str:
    if requirement.is_met:
        return "ok"
    return "missing" if requirement.is_needed else "note"


def _run_attacks(outcomes: Any, *, shown: bool) -> "list[Outcome]":
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


def _conclusion(outcomes: "list[Outcome]", *, can_run: bool, safe: bool) -> str:
    if not can_run:
        return "\nThis machine cannot isolate policies yet; install what is missing above. No attack was run."
    if safe:
        level = next(outcome.isolation for outcome in outcomes if outcome.isolation)
        return (
            f"\nAll {len(outcomes)} attacks were blocked (user: {level.user}, memory: {level.memory}, "
            f"episodes: {level.episodes}, files: {level.files})."
        )
    names = ", ".join(outcome.name for outcome in outcomes if outcome.state != "held")
    return f"\nNOT SAFE: {names}. Do not run other people's submissions on this machine."


def _print_json(needed: "list[Requirement]", outcomes: "list[Outcome]", *, safe: bool) -> None:
    print_json(
        {
            "safe": safe,
            "machine": [asdict(requirement) | {"is_met": requirement.is_met} for requirement in needed],
            "probes": [asdict(outcome) for outcome in outcomes],
        }
    )
