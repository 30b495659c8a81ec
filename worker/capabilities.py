"""What this machine can do: families of tasks, packages that policies see, isolation. For worker and heartbeat."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cache

from vitac.envs.maniskill.abilities import abilities
from vitac.envs.tasks.definition import Family
from vitac.evaluator.agent.description import SandboxDescription, describe_sandbox
from vitac.evaluator.agent.isolation.memory_files import FILES_VARIABLE, FileIsolation, default_file_isolation
from vitac.evaluator.agent.isolation.packages import installed_packages
from vitac.evaluator.agent.self_test import PROBES, Outcome, Probe, ProbeState, has_kind
from vitac.evaluator.agent.self_test import run as run_probes
from vitac.evaluator.agent.verdicts import SandboxFailed
from vitac.evaluator.isolation_kinds import IsolationKind
from vitac.evaluator.package_sets import package_differences, shown_sets
from vitac.evaluator.tracks import Track, list_tracks, load_track
from vitac.evaluator.tracks.registry import current_versions, find_version
from vitac.evaluator.version import evaluator_version
from vitac.server.queue.work import at_station, name_requirement
from vitac.server.queue.workers import explain_other_tracks
from vitac.server.tracks import find_family

SLOW_PROBES = frozenset({"memory of many processes capped", "CPU time capped", "wall time capped"})
"""Probes that wait for a limit and take seconds each: `vitac doctor` runs them, a worker's start does not."""

RunProbes = Callable[[tuple[Probe, ...]], Iterable[Outcome]]
Describe = Callable[[], SandboxDescription]


def families_here() -> tuple[Family, ...]:
    """Return the families that have here what they need; the service gives the worker their work."""
    of_maniskill = abilities()
    able = {
        Family.TACTILE: True,
        Family.MANISKILL: of_maniskill.physics,
        Family.MANISKILL_PICTURES: of_maniskill.physics and of_maniskill.pictures,
        Family.MANISKILL_CUDA: of_maniskill.physics and of_maniskill.cuda and of_maniskill.pictures,
    }
    return tuple(family for family in Family if able.get(family))


def list_abilities(
    families: Collection[Family] | None = None, *, has_gpu: bool = False, station: str | None = None
) -> list[str]:
    """Return the requirements that the worker meets.

    Args:
        families: in place of those that it can run.
        has_gpu: whether it plays images that need a GPU, too, which isolation vm has none of.
        station: whose agent it is.
    """
    able = families_here() if families is None else families
    unfit = {name for track in tracks_with_other_packages(able) for name in _list_requirements(load_track(track))}
    pairs = [(version, family) for version in sorted(current_versions()) for family in able]
    fit = [pair for pair in pairs if name_requirement(*pair) not in unfit]
    lists = (False,) if explain_no_sealed_lists() else (False, True)
    kinds = [(IsolationKind.NAMESPACES, False)]
    kinds += [(IsolationKind.NAMESPACES, True)] if has_gpu else []
    kinds += [(IsolationKind.VM, False)] if _has_kind(IsolationKind.VM) else []
    names = [
        name_requirement(version, family, sealed=sealed, isolation=kind, needs_gpu=needs_gpu)
        for version, family in fit
        for sealed in lists
        for kind, needs_gpu in kinds
    ]
    return names if station is None else names + [at_station(name, station) for name in names]


_has_kind = cache(has_kind)


def fit_families(families: Collection[Family] | None = None) -> tuple[Family, ...]:
    """Return the families of whose tasks it takes work."""
    able = families_here() if families is None else families
    fit = set(list_abilities(able))
    return tuple(family for family in able if name_requirement(evaluator_version(), family) in fit)


def explain_unfit(declared: Mapping[str, str], families: Collection[Family] | None = None) -> str:
    """Return why the worker takes no shards of some tracks, one sentence after the other; empty where it takes all.

    Args:
        declared: versions by track, as the service says.
        families: that it takes shards of.
    """
    reasons = [*explain_other_tracks(declared).values(), *tracks_with_other_packages(families).values()]
    unfit = f"Takes no shards of {' '.join(reasons)}" if reasons else ""
    return " ".join(filter(None, (unfit, explain_no_sealed_lists())))


def explain_no_sealed_lists() -> str:
    """Return why the worker plays no sealed lists; empty where it does."""
    files = default_file_isolation()
    if files is FileIsolation.MEMORY:
        return ""
    return (
        f"Takes no shards of sealed lists: expected {FILES_VARIABLE} to be {FileIsolation.MEMORY}, got {files}, with "
        "which a policy finds in the machine's caches what an earlier one has read, and learns the list."
    )


def tracks_with_other_packages(families: Collection[Family] | None = None) -> dict[str, str]:
    """Return by track why its policies would not see here the packages that it declares."""
    able, reasons = set(families_here() if families is None else families), {}
    for track in map(load_track, list_tracks()):
        if not able.intersection(find_family(track.name, task) for task in track.tasks):
            continue
        different = package_differences(shown_sets(track.packages), installed_packages(track.packages).versions)
        if different:
            reasons[track.name] = (
                f"{track.name}: its policies would see other packages than it declares: {'; '.join(different)}. "
                "Install the expected versions beside the worker and start it again."
            )
    return reasons


def _list_requirements(track: Track) -> Iterator[str]:
    return (name_requirement(find_version(track.name), find_family(track.name, task)) for task in track.tasks)


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
    try:
        outcomes = list(run(tuple(probe for probe in PROBES if probe.name not in SLOW_PROBES)))
    except SandboxFailed as error:
        return IsolationReport(level="none", problems=(str(error),))
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
    words = [f"{name.replace('_', ' ')}: {value}" for name, value in asdict(levels[0]).items()]
    has_vm = levels[0].kind is IsolationKind.NAMESPACES and _has_kind(IsolationKind.VM)
    return ", ".join([*words, *([f"also {IsolationKind.VM}"] if has_vm else [])])
