"""What a changed competition file touches that already happened; whoever applies it confirms each by its place."""

from collections.abc import Iterator
from datetime import datetime

from sqlalchemy import ColumnElement, func, select

from ..confirmations import Concern
from ..database.models import Qualification, Submission
from .competition import Competition
from .definition import CompetitionDefinition, StageRules, TrackRules
from .stages import Stage

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
