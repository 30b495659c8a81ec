"""The evaluator that the service declares: its server writes it, and workers with another one take no shards.

A server writes when it starts, so the last one started decides, and what becomes of evaluations of another version.
"""

from collections.abc import Mapping

from sqlalchemy import delete, exists, select
from sqlalchemy.orm import Session
from vitac.evaluator.tracks import list_tracks
from vitac.evaluator.tracks.registry import current_versions, find_version
from vitac.evaluator.version import evaluator_version

from ..database.models import DeclaredEvaluator, Evaluation
from ..database.states import ACTIVE_EVALUATION_STATES
from ..settings import OutdatedRule

OWN_SOURCES = ""
"""Stands in place of a track for the version of our own sources."""


def versions_here() -> dict[str, str]:
    """Return the versions of this process, by track."""
    return {OWN_SOURCES: evaluator_version(), **{track: find_version(track) for track in list_tracks()}}


def declare(session: Session, versions: Mapping[str, str], outdated: OutdatedRule = OutdatedRule.RESTART) -> None:
    """Store that the service evaluates with these versions, and what becomes of evaluations of others."""
    session.execute(delete(DeclaredEvaluator).where(DeclaredEvaluator.track.not_in(versions)))
    for track, version in sorted(versions.items()):
        session.merge(DeclaredEvaluator(track=track, version=version, outdated=outdated))


def declared_versions(session: Session) -> dict[str, str]:
    """Return the declared versions by track; none where no server has run yet."""
    return {row.track: row.version for row in session.scalars(select(DeclaredEvaluator))}


def read_outdated_rule(session: Session) -> OutdatedRule:
    """Return what becomes of evaluations of another version than the declared one."""
    rule = session.scalar(select(DeclaredEvaluator.outdated).where(DeclaredEvaluator.track == OWN_SOURCES))
    return rule or OutdatedRule.RESTART


def explain_left_work(session: Session) -> str | None:
    """Return what a worker of another evaluator than the declared one still does; None if it has nothing to do."""
    own = exists().where(
        Evaluation.evaluator_version.in_(current_versions()), Evaluation.state.in_(ACTIVE_EVALUATION_STATES)
    )
    if read_outdated_rule(session) is not OutdatedRule.FINISH or not session.scalar(select(own)):
        return None
    return f"Finishes what began with evaluator {evaluator_version()}; the service has another one now."


def explain_other_evaluator(declared: Mapping[str, str]) -> str | None:
    """Return why a worker with the sources of this process may take no shard of the service; None if it may."""
    expected, got = declared.get(OWN_SOURCES), evaluator_version()
    if expected is None or expected == got:
        return None
    return (
        f"This worker has evaluator {got}, the service {expected}: it takes no shards. Install the release of the "
        "service on this machine and start the worker again."
    )


def explain_other_tracks(declared: Mapping[str, str]) -> dict[str, str]:
    """Return by track why a worker with the track files of this process gets none of its shards."""
    own_sources, here = declared.get(OWN_SOURCES), versions_here()
    return {
        track: f"{track}: the service has version {version} of it, this worker {here.get(track, 'none')}. Give it the "
        "same files in VITAC_TRACKS_DIR, and the same packages of its tasks."
        for track, version in sorted(declared.items())
        if version != own_sources and here.get(track) != version
    }
