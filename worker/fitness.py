"""Which queues a worker takes shards from, and why it takes none of some tracks. Called by worker and heartbeat."""

from collections.abc import Collection, Iterator, Mapping

from vitac.envs.tasks.definition import Family
from vitac.evaluator.agent.isolation.packages import installed_packages
from vitac.evaluator.package_sets import package_differences, shown_sets
from vitac.evaluator.tracks import Track, list_tracks, load_track
from vitac.evaluator.tracks.registry import current_versions, find_version
from vitac.evaluator.version import evaluator_version
from vitac.server.queue.declared import explain_other_tracks
from vitac.server.queue.jobs import queue_name
from vitac.server.tracks import find_family

from .families import families_here


def queues_here(families: Collection[Family] | None = None) -> list[str]:
    """Return the queues that the worker takes shards from; those of given families in place of what it can run."""
    able = families_here() if families is None else families
    unfit = {queue for track in tracks_with_other_packages(able) for queue in _list_queues(load_track(track))}
    names = (queue_name(version, family) for version in sorted(current_versions()) for family in able)
    return [name for name in names if name not in unfit]


def fit_families(families: Collection[Family] | None = None) -> tuple[Family, ...]:
    """Return the families of whose tasks it takes shards."""
    able = families_here() if families is None else families
    queues = set(queues_here(able))
    return tuple(family for family in able if queue_name(evaluator_version(), family) in queues)


def explain_unfit(declared: Mapping[str, str], families: Collection[Family] | None = None) -> str:
    """Return why the worker takes no shards of some tracks, one sentence after the other; empty where it takes all.

    Args:
        declared: versions by track, as the service says.
        families: that it takes shards of.
    """
    reasons = explain_other_tracks(declared) | tracks_with_other_packages(families)
    return f"Takes no shards of {' '.join(reasons.values())}" if reasons else ""


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


def _list_queues(track: Track) -> Iterator[str]:
    return (queue_name(find_version(track.name), find_family(track.name, task)) for task in track.tasks)
