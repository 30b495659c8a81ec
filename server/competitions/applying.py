"""Makes a competition file a competition of this service: what changes by it, and the change itself."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session
from vitac.evaluator.tracks import ListKind

from ..audit import newest_entries, record
from ..confirmations import Concern, compute_revision, require_base, require_confirmed
from ..database.clock import read_clock
from ..database.models import ALL_TASKS, BoardResult, CompetitionRow, Submission
from ..errors import ProblemCode, ServiceError
from ..principals import Principal
from ..transparency.entries import CompetitionApplied
from ..transparency.log import append
from .apply_warnings import find_concerns
from .competition import Competition
from .definition import CompetitionDefinition
from .sealing import refuse_reopening, seal, withdraw, withdraw_unplayed

_NAMES = ("name", "place")
"""Fields that identify the members of a list."""

_SHOWN_CHANGES = 10
_HIDING = (
    "anonymous is switched on: from now on others see teams under random names, but whoever has seen results with the "
    "real names still knows them."
)
_SHOWING = "anonymous is switched off: from now on everybody sees the real names of all teams, also on older results."
"""Warnings where names become hidden or visible."""


@dataclass(frozen=True, kw_only=True)
class Change:
    """One value that a new file changes.

    Attributes:
        place: where in the file, with dots.
        before: None where there was nothing.
        after: None where the file no longer has it.
    """

    place: str
    before: object
    after: object


def list_concerns(session: Session, definition: CompetitionDefinition) -> list[Concern]:
    """Return what applying a file touches that already happened; `apply` wants each confirmed by its name."""
    return find_concerns(Competition.read(session, definition.name), definition, read_clock(session))


def list_changes(session: Session, definition: CompetitionDefinition) -> list[Change]:
    """Return what applying a file would change, in the order of the file.

    Raises:
        ServiceError: the competition is final, submissions were made by what it takes away, or a stage whose secret is
            published would open again.
    """
    competition = Competition.read(session, definition.name)
    if competition.definition != definition:
        competition.require_not_final()
    _refuse_loss(competition, definition)
    refuse_reopening(competition, definition, read_clock(session))
    return list(_differences(competition.definition if competition.is_held else None, definition))


def apply(
    session: Session,
    by: Principal,
    definition: CompetitionDefinition,
    *,
    base: str | None = None,
    confirmed: Collection[str] | None = (),
) -> list[Change]:
    """Make it the competition of its name, with a sealed list for each stage that plays one; return what changed.

    Others stay as they are. Applying the same file again changes nothing.

    Args:
        session: of the transaction.
        by: an organizer.
        definition: the content of the file.
        base: revision of the competition that the file was made from; None: the caller compares the changes itself.
        confirmed: names of the concerns (`list_concerns`) that the organizer confirms; None: the caller asks.

    Raises:
        ServiceError: not an organizer, the competition is at another revision, a concern is not confirmed, or as
            `list_changes`.
    """
    by.require_organizer(definition.name)
    competition = Competition.lock(session, definition.name)
    before = competition.row.definition if competition.is_held else None
    changes = list_changes(session, definition)
    after = definition.model_dump(mode="json")
    if changes:
        require_base(
            "the competition",
            base=base,
            revision=competition.revision,
            difference=lambda: _describe_difference_since(competition, base, definition),
        )
        require_confirmed(list_concerns(session, definition), confirmed)
    if not competition.is_held:
        session.add(CompetitionRow(name=definition.name, definition=after, frozen_at=definition.freeze_at))
    elif before != after:
        if competition.definition.freeze_at != definition.freeze_at:
            competition.row.frozen_at = definition.freeze_at
        competition.row.definition, competition.row.applied_at = after, read_clock(session)
    session.flush()
    _sort_again(Competition.read(session, definition.name), competition.definition)
    if before != after:
        record(
            session, by, "competition.apply", Competition.read(session, definition.name).subject, after, before=before
        )
        shown = {key: value for key, value in after.items() if key != "contact"}
        append(session, lambda at: CompetitionApplied(issued_at=at, competition=definition.name, definition=shown))
    for stage in Competition.read(session, definition.name).stages:
        change = seal if stage.plays_sealed_list else withdraw
        change(session, by, stage)
    withdraw_unplayed(session, by, Competition.read(session, definition.name))
    return changes


def _sort_again(competition: Competition, before: CompetitionDefinition) -> None:
    """Give the results of each track whose ranking has changed the keys of the new one."""
    tracks = competition.definition.tracks
    changed = [name for name in before.tracks.keys() & tracks if before.tracks[name].ranking != tracks[name].ranking]
    results = select(BoardResult).where(BoardResult.competition == competition.name, BoardResult.track.in_(changed))
    for result in competition.session.scalars(results):
        stage = competition.stored_stage(result.track, result.stage)
        ranking = stage.find_ranking(None if result.board == ALL_TASKS else result.board)
        result.sort_key = list(ranking.sort_key(result.ranked_by))


def list_warnings(
    definition: CompetitionDefinition, changes: Sequence[Change] | None = None, *, at: datetime
) -> list[str]:
    """Return what takes effect at once where a file is applied, and cannot be taken back or is easily overlooked.

    Args:
        definition: the file.
        changes: what it changes (`list_changes`); None: nobody knows, so all of it counts.
        at: the moment.
    """
    warnings = [
        _HIDING if change.after else _SHOWING
        for change in changes or ()
        if change.place == "anonymous" and change.before is not None
    ]
    if definition.teams_locked is not None and definition.teams_locked <= at:
        warnings.append(
            f"teams_locked is {definition.teams_locked:%F %T} UTC, which is past: from now on only organizers register "
            "teams."
        )
    changed = None if changes is None else {change.place for change in changes}
    over: dict[tuple[str, datetime], list[str]] = {}
    for name, track in definition.tracks.items():
        for stage in track.stages if track.taken_here else ():
            is_new = changed is None or f"tracks.{name}.stages.{stage.name}.closes" in changed
            if is_new and stage.closes <= at:
                over.setdefault((stage.name, stage.closes), []).append(name)
    return warnings + [
        f"Stage {stage} of {', '.join(tracks)} closed at {closes:%F %T} UTC, which is past: it takes no submissions."
        for (stage, closes), tracks in over.items()
    ]


def _describe_difference_since(competition: Competition, base: str | None, definition: CompetitionDefinition) -> str:
    """Return what was changed since a revision; where nobody knows that, what the file would change."""
    known = (
        content
        for entry in newest_entries(competition.session, action="competition.apply", subject=competition.subject)
        for content in (entry.after, entry.before)
    )
    old = next((content for content in known if base and compute_revision(content) == base), None)
    if old is None:
        present = competition.definition if competition.is_held else None
        return f"The file would change {_listed(_differences(present, definition))}."
    since = _differences(CompetitionDefinition.model_validate(old), competition.definition)
    return f"Since then changed: {_listed(since)}."


def _listed(changes: Iterator[Change]) -> str:
    sentences = [f"{change.place}: {change.before} -> {change.after}" for change in changes]
    more = f"; and {len(sentences) - _SHOWN_CHANGES} more" if len(sentences) > _SHOWN_CHANGES else ""
    return "; ".join(sentences[:_SHOWN_CHANGES]) + more


def _refuse_loss(competition: Competition, definition: CompetitionDefinition) -> None:
    """Refuse to take away a stage that has submissions, and to change its list."""
    boards = ((name, rules) for name, track in definition.tracks.items() for rules, _ in track.list_boards())
    lists = {(name, rules.name): rules.list for name, rules in boards}
    used = competition.session.execute(
        select(Submission.track, Submission.stage).where(competition.submissions).distinct().order_by(Submission.track)
    )
    for track, name in used:
        kind = lists.get((track, name))
        is_sealed = competition.stored_stage(track, name).is_sealed
        if kind is None or (kind is ListKind.SEALED) != is_sealed:
            lost = "taken away" if kind is None else f"played on a {kind} list"
            raise ServiceError(
                ProblemCode.STAGE_IN_USE,
                f"Stage {name} of {track} has submissions, so it cannot be {lost}. Keep it as it is.",
            )


def _differences(old: CompetitionDefinition | None, new: CompetitionDefinition) -> Iterator[Change]:
    before = dict(_values(old.model_dump(mode="json"))) if old else {}
    after = dict(_values(new.model_dump(mode="json")))
    for place in dict.fromkeys([*after, *before]):
        if before.get(place) != after.get(place):
            yield Change(place=place, before=before.get(place), after=after.get(place))


def _values(content: object, place: str = "") -> Iterator[tuple[str, object]]:
    """Yield each single value with its place; members of lists by their names, whose order is a value too."""
    if isinstance(content, Mapping):
        for key, value in content.items():
            yield from _values(value, f"{place}.{key}" if place else key)
    elif isinstance(content, list) and content and isinstance(content[0], Mapping):
        yield place, [_read_name(member) for member in content]
        for member in content:
            yield from _values(member, f"{place}.{_read_name(member)}")
    elif content is not None:
        yield place, content


def _read_name(member: Mapping[str, Any]) -> str:
    return next(str(member[name]) for name in _NAMES if name in member)


def freeze_boards(session: Session, by: Principal, name: str | None = None) -> None:
    """Show no new results on the boards of all stages to anybody but organizers; results are still stored.

    Raises:
        ServiceError: not an organizer, or there is no competition, or it is final.
    """
    competition = Competition.lock_to_change(session, by, name)
    if competition.frozen_at is None:
        competition.row.frozen_at = read_clock(session)
        after = {"frozen_at": competition.row.frozen_at.isoformat()}
        record(session, by, "competition.freeze", competition.subject, after)


def unfreeze_boards(session: Session, by: Principal, name: str | None = None) -> None:
    """Show all results again; a time at which the file would freeze them no longer does.

    Raises:
        ServiceError: not an organizer, or there is no competition, or it is final.
    """
    competition = Competition.lock_to_change(session, by, name)
    if competition.row.frozen_at is not None:
        before = {"frozen_at": competition.row.frozen_at.isoformat()}
        competition.row.frozen_at = None
        record(session, by, "competition.unfreeze", competition.subject, {"frozen_at": None}, before=before)
