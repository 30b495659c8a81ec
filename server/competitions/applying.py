"""Applies a competition's definition: warns of what an organizer may not expect, and stores it. Called by its route."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import ColumnElement, func, select
from sqlalchemy.orm import Session
from vitac.evaluator.tracks import ListKind

from ..audit import newest_entries, record
from ..confirmations import Concern, compute_revision, require_base, require_confirmed
from ..database.clock import read_clock
from ..database.models import ALL_TASKS, BoardResult, CompetitionRow, Qualification, Submission
from ..errors import ProblemCode, ServiceError
from ..principals import Principal
from ..transparency.entries import CompetitionApplied
from ..transparency.log import append
from .competition import Competition
from .definition import CompetitionDefinition, StageRules, TrackRules
from .sealing import refuse_reopening, seal, withdraw, withdraw_unplayed
from .stages import Stage

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


WHY_PRACTICE = (
    "A table of actions that were recorded on that list ranks there like a policy, so its boards are for practice; all "
    "pages of the competition would say that it ranks on them. Choose a sealed list."
)


def find_concerns(competition: Competition, new: CompetitionDefinition, at: datetime) -> list[Concern]:
    """Return what a file touches, by its places in the file.

    Args:
        competition: as it is.
        new: the file.
        at: the moment.
    """
    return [Concern(name=place, sentence=sentence) for place, sentence in _touched(competition, new, at)]


def _touched(competition: Competition, new: CompetitionDefinition, at: datetime) -> Iterator[tuple[str, str]]:
    known = competition.definition.public_rankings.values() if competition.is_held else ()
    for place, what in new.public_rankings.items():
        if what not in known:
            yield place, f"{what[0].upper()}{what[1:]}, which plays a public list. {WHY_PRACTICE}"
    if not competition.is_held:
        yield from _list_for_new_competition(competition, new)
        return
    yield from _list_for_all_tracks(competition, new, at)
    for name, track in new.tracks.items():
        old = competition.definition.tracks.get(name)
        if old is None:
            yield from _list_for_new_track(competition, name)
        else:
            yield from _touched_in_track(competition, name, old, track)
    for stage in competition.stages:
        yield from _touched_in_stage(competition, stage, new, at)


def _list_for_new_competition(competition: Competition, new: CompetitionDefinition) -> Iterator[tuple[str, str]]:
    if others := ", ".join(sorted(one.name for one in Competition.read_all(competition.session) if one.is_held)):
        yield (
            "name",
            f"{new.name} becomes a further competition beside {others}. To change an existing one, give the file its "
            "name.",
        )


def _list_for_all_tracks(
    competition: Competition, new: CompetitionDefinition, at: datetime
) -> Iterator[tuple[str, str]]:
    old, count = competition.definition, _count(competition, competition.submissions)
    if count and old.appeal_days != new.appeal_days:
        yield (
            "appeal_days",
            f"{count} submissions were made while teams could appeal for {_days(old.appeal_days)}; from now on it is "
            f"{_days(new.appeal_days)} for them, too.",
        )
    if old.freeze_at != new.freeze_at and count:
        if competition.row.frozen_at is not None and competition.row.frozen_at <= at:
            yield (
                "freeze_at",
                f"Boards have been frozen since {competition.row.frozen_at:%F %T} UTC; that changes at once.",
            )
        elif new.freeze_at is not None and new.freeze_at <= at:
            yield "freeze_at", f"Results after {new.freeze_at:%F %T} UTC, which everybody could see, leave the boards."


def _list_for_new_track(competition: Competition, track: str) -> Iterator[tuple[str, str]]:
    if count := _count(competition, Submission.track == track, Submission.competition == ""):
        yield f"tracks.{track}", f"{track} has {count} submissions for practice; they are in none of its stages."


def _touched_in_track(
    competition: Competition, name: str, old: TrackRules, new: TrackRules
) -> Iterator[tuple[str, str]]:
    count = _count(competition, competition.submissions, Submission.track == name)
    if not count:
        return
    place, submitted = f"tracks.{name}", f"{name} has {count} submissions"
    if old.ranking != new.ranking:
        yield f"{place}.ranking", f"{submitted}, which were made under another ranking rule; their places change."
    if old.taken_here and not new.taken_here:
        yield f"{place}.taken_here", f"{submitted}; its boards close, and no prize is decided by them."
    if old.judging != new.judging:
        yield f"{place}.judging", f"{submitted}, which were made under another rule of judging; their totals change."


def _touched_in_stage(
    competition: Competition, stage: Stage, new: CompetitionDefinition, at: datetime
) -> Iterator[tuple[str, str]]:
    track = new.tracks.get(stage.track)
    rules = track.find_board(stage.name) if track else None
    place = f"tracks.{stage.track}.stages.{stage.name}"
    is_played = track is not None and track.taken_here and rules is not None and rules.list is stage.rules.list
    if not is_played and (sealed := stage.sealed_list) is not None:
        yield (
            f"{place}.list",
            f"The commitment {sealed.commitment} was published at {sealed.made_at:%F %T} UTC; it is withdrawn, and "
            "everybody sees that. The stage has the same list if it is sealed again.",
        )
    if rules is not None:
        yield from _touched_by_times(competition, stage, rules, at)
        confirmed = competition.session.scalar(
            select(func.count()).select_from(Qualification).where(stage.qualifications)
        )
        if confirmed and rules.qualified != stage.rules.qualified:
            yield f"{place}.qualified", f"{confirmed} teams were confirmed by another rule; they stay confirmed."


def _touched_by_times(
    competition: Competition, stage: Stage, new: StageRules, at: datetime
) -> Iterator[tuple[str, str]]:
    old, place = stage.rules, f"tracks.{stage.track}.stages.{stage.name}"
    early = _count(competition, stage.submissions, Submission.submitted_at < new.opens) if new.opens > old.opens else 0
    if early:
        yield (
            f"{place}.opens",
            f"{early} submissions were made before {new.opens:%F %T} UTC; they stay in the stage and rank.",
        )
    late = (
        _count(competition, stage.submissions, Submission.submitted_at >= new.closes) if new.closes < old.closes else 0
    )
    if late:
        yield (
            f"{place}.closes",
            f"{late} submissions were made after {new.closes:%F %T} UTC; they stay in the stage and rank.",
        )
    if stage.is_over(at) and new.closes > at:
        yield (
            f"{place}.closes",
            f"The stage has been over since {old.closes:%F %T} UTC; it takes submissions again, also of teams that "
            "have seen its results.",
        )


def _count(competition: Competition, *conditions: ColumnElement[bool]) -> int:
    return competition.session.scalars(select(func.count()).select_from(Submission).where(*conditions)).one()


def _days(days: int | None) -> str:
    return "no time" if days is None else f"{days} days"
