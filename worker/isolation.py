"""Decides at the start of a worker whether this machine may run other people's code, by trying to break out."""

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass

from vitac.evaluator.agent.description import SandboxDescription, describe_sandbox
from vitac.evaluator.agent.self_test import PROBES, Outcome, Probe, ProbeState
from vitac.evaluator.agent.self_test import run as run_probes
from vitac.evaluator.package_sets import package_differences, shown_sets

SLOW_PROBES = frozenset({"memory of many processes capped", "CPU time capped", "wall time capped"})
"""Probes that wait for a limit and take seconds each: `vitac doctor` runs them, a worker's start does not."""

RunProbes = Callable[[tuple[Probe, ...]], Iterable[Outcome]]
Describe = Callable[[], SandboxDescription]


@dataclass(frozen=True, kw_only=True)
class IsolationReport:
    """What the probes found. `problems` is empty on a machine that is fit; a sound one has a description."""

    level: str
    problems: tuple[str, ...]
    sandbox: SandboxDescription | None = None

    @property
    def is_sound(self) -> bool:
        """Whether untrusted work may run here."""
        return not self.problems


def probe_isolation(run: RunProbes = run_probes, describe: Describe = describe_sandbox) -> IsolationReport:
    """Run the quick probes in real sandboxes; let a sound one say what a policy finds in it, and compare packages."""
    outcomes = list(run(tuple(probe for probe in PROBES if probe.name not in SLOW_PROBES)))
    problems = tuple(_sentences(outcomes))
    sandbox = None if problems else describe()
    if sandbox is not None and (different := package_differences(shown_sets(), sandbox.packages)):
        problems = (
            f"Policies would see other packages than the locked ones: {'; '.join(different)}. Install the expected "
            "versions beside the worker.",
        )
    return IsolationReport(level=_find_level(outcomes), problems=problems, sandbox=sandbox)


def _sentences(outcomes: Iterable[Outcome]) -> Iterable[str]:
    for outcome in outcomes:
        if outcome.state is not ProbeState.HELD:
            yield f"{outcome.name}: {outcome.state} ({outcome.detail})"


def _find_level(outcomes: Iterable[Outcome]) -> str:
    levels = [outcome.isolation for outcome in outcomes if outcome.isolation is not None]
    if not levels:
        return "none"
    return ", ".join(f"{name.replace('_', ' ')}: {value}" for name, value in asdict(levels[0]).items())
