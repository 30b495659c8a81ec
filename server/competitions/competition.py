"""The competition as an object that answers: its stages, what its file says, whether it is frozen or final.

A service may hold several; each is one object in a transaction. Called by doors to look up a stage by its name, and by
everything that follows its rules.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from typing import Self

from sqlalchemy import ColumnElement, and_, select
from sqlalchemy.orm import Session

from ..confirmations import compute_revision
from ..database.clock import read_clock
from ..database.engine import READS_ONLY
from ..database.models import CompetitionRow, Rejudgement, Submission
from ..errors import ProblemCode, ServiceError
from ..principals import Principal
from ..tracks import known_track, load_known_track
from .definition import CompetitionDefinition, StageRules, TrackRules
from .stages import PRACTICE, PRACTICE_RULES, PRACTICE_TRACK, Stage

_NO_COMPETITION = CompetitionDefinition.model_construct(name="", title="", tracks={})


@dataclass(frozen=True, kw_only=True, eq=False)
class Competition:
    """A competition of this service as a transaction sees it. Without one, all tracks are for practice.

    Attributes:
        session: of the transaction.
        row: of the competition; empty and not in the database where there is none.
        definition: what its file says; without tracks where there is none.
        is_held: whether there is a competition.
    """

    session: Session
    row: CompetitionRow
    definition: CompetitionDefinition
    is_held: bool

    @classmethod
    def read(cls, session: Session, name: str | None = None) -> Self:
        """Return a competition as far as the session has read it.

        Args:
            session: of the transaction.
            name: of the competition; empty: none, for practice; None: the one that opened last.
        """
        if name is None:
            return cls.read_all(session)[0]
        return cls._from_row(session, session.get(CompetitionRow, name) if name else None)

    @classmethod
    def read_all(cls, session: Session) -> Sequence[Self]:
        """Return all competitions, the one that opened last first; without any a single one that is not held.

        A page asks for them several times: a session that only reads does so once.
        """
        if not session.info.get(READS_ONLY):
            return cls._read_all(session)
        if cls not in session.info:
            session.info[cls] = cls._read_all(session)
        competitions: Sequence[Self] = session.info[cls]
        return competitions

    @classmethod
    def _read_all(cls, session: Session) -> Sequence[Self]:
        rows = session.scalars(select(CompetitionRow).order_by(CompetitionRow.name)).all()
        if len(rows) <= 1:
            return [cls._from_row(session, rows[0] if rows else None)]
        now = read_clock(session)
        return sorted((cls._from_row(session, row) for row in rows), key=lambda one: _shown_first(one.opens, now))

    @classmethod
    def find(cls, session: Session, name: str | None = None, *, track: str | None = None) -> Self:
        """Return the competition that somebody names.

        Args:
            session: of the transaction.
            name: of the competition; None: the only one, which is not held where there is none.
            track: without a name, only competitions that hold this track are looked at.

        Raises:
            ServiceError: there is none of that name, or several and no name.
        """
        competitions = cls.read_all(session)
        looked_at = competitions if track is None else cls.read_by_track(session, track)
        if name is None and len(looked_at) == 1:
            return looked_at[0]
        names = ", ".join(sorted(one.name for one in looked_at if one.is_held)) or "none"
        named = next((one for one in competitions if one.is_held and one.name == name), None)
        if name is None:
            raise ServiceError(
                ProblemCode.INVALID_REQUEST, f"This service has several competitions; name one of {names}."
            )
        if named is None:
            raise ServiceError(ProblemCode.NOT_FOUND, f"There is no competition {name!r:.80}, expected one of {names}.")
        return named

    @classmethod
    def find_organized(cls, session: Session, by: Principal, name: str) -> Self:
        """Return the competition of that name to its organizer.

        Raises:
            ServiceError: there is none of that name, or it is somebody else's.
        """
        competition = cls.find(session, name)
        by.require_organizer(competition.name)
        return competition

    @classmethod
    def read_by_track(cls, session: Session, track: str) -> Sequence[Self]:
        """Return the competitions that hold a track, in the order of `read_all`; without any, practice."""
        competitions = cls.read_all(session)
        return [one for one in competitions if one.holds(track)] or competitions[:1]

    @classmethod
    def find_by_track(cls, session: Session, track: str, name: str | None = None) -> Self:
        """Return the competition whose boards a track shows.

        Args:
            session: of the transaction.
            track: which one.
            name: of the competition; None: of those that hold the track the one that opened last.

        Raises:
            ServiceError: there is none of that name, or it does not hold the track.
        """
        if name is None:
            return cls.read_by_track(session, track)[0]
        competition = cls.find(session, name)
        competition.require_holds(track)
        return competition

    @classmethod
    def lock(cls, session: Session, name: str, *, shared: bool = False) -> Self:
        """Return a competition as it is now; nobody else changes it until the end of the transaction.

        Args:
            session: of the transaction.
            name: of the competition; empty: none, for practice.
            shared: whether others may lock it so at the same time.
        """
        lock = {"read": True} if shared else True
        row = session.get(CompetitionRow, name, with_for_update=lock, populate_existing=True) if name else None
        return cls._from_row(session, row)

    @classmethod
    def lock_held(cls, session: Session, by: Principal, name: str | None) -> Self:
        """Return the same for an organizer; of the only competition where `name` is None.

        Raises:
            ServiceError: not an organizer, there is no competition, or `find`.
        """
        wanted = name or by.competition
        by.require_organizer(wanted)
        competition = cls.lock(session, cls.find(session, wanted).name)
        competition.require_held()
        return competition

    @classmethod
    def lock_to_change(cls, session: Session, by: Principal, name: str | None = None) -> Self:
        """Return the same for an organizer who changes it.

        Raises:
            ServiceError: as `lock_held`, or it is final.
        """
        competition = cls.lock_held(session, by, name)
        competition.require_not_final()
        return competition

    @classmethod
    def _from_row(cls, session: Session, row: CompetitionRow | None) -> Self:
        """Return the competition of a row; its content is validated again only where that was changed or read again."""
        if row is None:
            return cls(session=session, row=CompetitionRow(name=""), definition=_NO_COMPETITION, is_held=False)
        known: tuple[object, Self] | None = session.info.get((cls, row.name))
        if known is not None and known[0] is row.definition:
            return known[1]
        definition = CompetitionDefinition.model_validate(row.definition)
        competition = cls(session=session, row=row, definition=definition, is_held=True)
        session.info[cls, row.name] = row.definition, competition
        return competition

    @property
    def name(self) -> str:
        """Name that rows of the competition hold; empty where there is no competition."""
        return self.row.name

    @property
    def opens(self) -> datetime:
        """When its first stage opens."""
        return min((stage.rules.opens for stage in self.stages), default=datetime.max.replace(tzinfo=UTC))

    @property
    def closes(self) -> datetime:
        """When its last stage closes."""
        return max((stage.rules.closes for stage in self.stages), default=datetime.max.replace(tzinfo=UTC))

    @property
    def subject(self) -> str:
        """What the audit log calls it."""
        return f"competition:{self.definition.name}"

    @property
    def submissions(self) -> ColumnElement[bool]:
        """The condition by which a query takes the submissions to all its stages."""
        return and_(Submission.competition == self.name, Submission.stage != PRACTICE)

    @property
    def revision(self) -> str:
        """What a changed file says it was made from; empty where there is no competition."""
        return compute_revision(self.row.definition)

    @property
    def frozen_at(self) -> datetime | None:
        """Time since which its boards show no new results; None if they do."""
        at = self.row.frozen_at
        return at if at is not None and at <= read_clock(self.session) else None

    @property
    def hides_names(self) -> bool:
        """Whether teams are shown to others under random names: the file says so, and it is not final."""
        return self.definition.anonymous and self.row.finalized_at is None

    @property
    def stage_titles(self) -> Mapping[tuple[str, str], str]:
        """The titles of all stages, by the names of track and stage."""
        return {(stage.track, stage.name): stage.title for stage in self.stages}

    @cached_property
    def stages(self) -> tuple[Stage, ...]:
        """All stages in the order of the file, each followed by its final list; also of tracks not held here."""
        stages: list[Stage] = []
        for track, rules in self.definition.tracks.items():
            for board, of in rules.list_boards():
                live = None if of is None else stages[-1]
                stages.append(self._make_stage(track, board.name, board, rules, live))
        deciding = {(stage.track, (stage.live or stage).name): stage for stage in stages}
        before = {
            (track, stage.name): deciding[other, of.name]
            for track, stage, other, of in self.definition.list_advancements()
        }
        return tuple(replace(stage, before=before.get((stage.track, stage.name))) for stage in stages)

    @property
    def stages_held_here(self) -> tuple[Stage, ...]:
        """Stages whose submissions this service takes."""
        return tuple(stage for stage in self.stages if stage.track_rules.taken_here)

    @property
    def last_stages(self) -> tuple[Stage, ...]:
        """The last stage of each track that is held here, or its final list: its boards decide who wins."""
        return tuple({stage.track: stage for stage in self.stages_held_here}.values())

    @property
    def last_entered_stages(self) -> tuple[Stage, ...]:
        """The last stage of each track that is not held here, where its results are entered."""
        last = {stage.track: stage for stage in self.stages if not stage.track_rules.taken_here}
        return tuple(stage for stage in last.values() if stage.rules.entered)

    def holds(self, track: str) -> bool:
        """Return whether submissions to a track are taken here."""
        return any(stage.track == track for stage in self.stages_held_here)

    def takes_submissions(self, track: str, at: datetime) -> bool:
        """Return whether a moment lies in the time of a stage of a track."""
        return any(stage.is_in_time(at) for stage in self.list_stages(track))

    def list_stages(self, track: str) -> tuple[Stage, ...]:
        """Return the stages of a track that are held here; outside of a competition that is one for practice."""
        of_track = tuple(stage for stage in self.stages_held_here if stage.track == track)
        return of_track or (self.stored_stage(track, PRACTICE),)

    def stage(self, track: str, name: str) -> Stage:
        """Return a stage of the competition.

        Raises:
            ServiceError: there is none of that name.
        """
        named = next((stage for stage in self.stages if (stage.track, stage.name) == (track, name)), None)
        if named is None:
            raise ServiceError(
                ProblemCode.UNKNOWN_STAGE, f"The competition has no stage {name!r:.80} of {track!r:.80}."
            )
        return named

    def stored_stage(self, track: str, name: str) -> Stage:
        """Return the stage that a row names; without rules for practice, or where the file no longer has it."""
        named = next((stage for stage in self.stages if (stage.track, stage.name) == (track, name)), None)
        return named or self._make_stage(track, name, PRACTICE_RULES, PRACTICE_TRACK)

    def shown_stage(self, track: str, wanted: str | None = None, *, at: datetime | None = None) -> Stage:
        """Return the stage whose board a track shows: the wanted one, else the one that opened last, else the first.

        Args:
            track: whose board.
            wanted: name of a stage; None: whichever is shown now.
            at: the moment; None: now.

        Raises:
            ServiceError: there is no such track or stage.
        """
        load_known_track(track)
        stages = self.list_stages(track)
        if wanted is None and len(stages) == 1:
            return stages[0]
        if wanted is None:
            return _last_opened(stages, at or read_clock(self.session)) or stages[0]
        names = [stage.name for stage in stages if not stage.is_practice]
        if wanted not in names:
            listed = f"its stages are {', '.join(names)}" if names else "it has none"
            raise ServiceError(ProblemCode.UNKNOWN_STAGE, f"{track} has no stage {wanted!r:.80}; {listed}.")
        return stages[names.index(wanted)]

    def open_stage(self, track: str, by: Principal, at: datetime) -> Stage:
        """Return the stage of a track that takes submissions at a moment.

        Organizers submit also after the end, to the stage that opened last, for instance what reached them by mail in
        time.

        Raises:
            ServiceError: none does, or its episodes are published.
        """
        stages = self.list_stages(track)
        opened = next((stage for stage in stages if stage.is_in_time(at)), None)
        if opened is None and by.organizes_service:
            opened = _last_opened(tuple(stage for stage in stages if stage.live is None), at)
        if opened is None:
            raise ServiceError(ProblemCode.STAGE_CLOSED, f"{track} takes no submissions now: {_times(stages, at)}.")
        if opened.is_revealed:
            raise ServiceError(ProblemCode.STAGE_CLOSED, f"The episodes of {opened} are published, so it is over.")
        return opened

    def track_title(self, track: str) -> str:
        """Return what people call a track: in the competition, else by its file; its name where that is gone."""
        rules = self.definition.tracks.get(track)
        named = rules if rules and rules.taken_here else known_track(track)
        return named.title if named else track

    def require_holds(self, track: str) -> None:
        """Refuse a track of which it takes no submissions.

        Raises:
            ServiceError: it is no track of this competition, or not held here.
        """
        if not self.holds(track):
            held = ", ".join(dict.fromkeys(stage.track for stage in self.stages_held_here)) or "none"
            raise ServiceError(
                ProblemCode.INVALID_REQUEST,
                f"The competition {self.name} takes no submissions to {track!r:.80}, expected one of {held}.",
            )

    def require_held(self) -> None:
        """Refuse what needs a competition.

        Raises:
            ServiceError: there is none.
        """
        if not self.is_held:
            raise ServiceError(
                ProblemCode.NOT_FOUND, "There is no competition; `vitac admin competition apply FILE` makes one."
            )

    def require_not_final(self) -> None:
        """Refuse what would change a competition after its end.

        Raises:
            ServiceError: it is final.
        """
        if self.row.finalized_at is not None:
            raise ServiceError(
                ProblemCode.COMPETITION_FINAL,
                f"{self.definition.title} has been final since {self.row.finalized_at:%F %T} UTC.",
            )

    def _make_stage(
        self,
        track: str,
        name: str,
        rules: StageRules,
        track_rules: TrackRules,
        live: Stage | None = None,
    ) -> Stage:
        return Stage(
            session=self.session,
            competition_row=self.row,
            competition="" if name == PRACTICE else self.name,
            track=track,
            name=name,
            rules=rules,
            track_rules=track_rules,
            live=live,
        )


def find_stage(session: Session, row: Submission | Rejudgement) -> Stage:
    """Return the stage that a row names."""
    return Competition.read(session, row.competition).stored_stage(row.track, row.stage)


def choose_competition(session: Session, track: str, at: datetime, name: str | None = None) -> Competition:
    """Return the competition to which a submission to a track belongs.

    Args:
        session: of the transaction.
        track: which one.
        at: when it is submitted.
        name: of the competition; None: the one that takes submissions to the track, or else the one that opened last.

    Raises:
        ServiceError: there is no such competition, it does not hold the track, or several take submissions and no name.
    """
    if name is not None:
        return Competition.find_by_track(session, track, name)
    competitions = Competition.read_by_track(session, track)
    taking = [one for one in competitions if one.takes_submissions(track, at)]
    if len(taking) > 1:
        names = sorted(one.name for one in taking)
        raise ServiceError(
            ProblemCode.COMPETITION_REQUIRED,
            f"Several competitions take submissions to {track} now: {', '.join(names)}. Name one of them with "
            "`--competition`, in requests with `competition`.",
            competitions=names,
        )
    return (taking or competitions)[0]


def list_competition_choices(session: Session, at: datetime) -> Sequence[Competition]:
    """Return the competitions that take submissions to a track to which another one takes them too; else none."""
    competitions = Competition.read_all(session)
    taking = {
        track: {one.name for one in competitions if one.holds(track) and one.takes_submissions(track, at)}
        for track in {stage.track for one in competitions for stage in one.stages_held_here}
    }
    names = {name for chosen in taking.values() if len(chosen) > 1 for name in chosen}
    return [one for one in competitions if one.name in names]


def _shown_first(opens: datetime, now: datetime) -> tuple[bool, float]:
    """Return by what competitions are ordered: the one that opened last first, then by when the others open."""
    return opens > now, abs((now - opens).total_seconds())


def _last_opened(stages: tuple[Stage, ...], at: datetime) -> Stage | None:
    """Return the stage that opened last, or its final list once that is played."""
    opened = (stage for stage in reversed(stages) if stage.rules.opens <= at)
    return next((stage for stage in opened if stage.live is None or stage.played_since is not None), None)


def _times(stages: tuple[Stage, ...], at: datetime) -> str:
    """Return what comes next, or what was last, for a message."""
    following = next((stage for stage in stages if at < stage.rules.opens), None)
    if following is not None:
        return f"stage {following.name} opens at {following.rules.opens:%F %T} UTC"
    return f"its last stage closed at {stages[-1].rules.closes:%F %T} UTC"
