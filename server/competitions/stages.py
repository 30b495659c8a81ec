"""A stage as an object that answers: when it is open, who may submit, how it ranks, which results count.

Doors look one up by its name (`Competition.shown_stage`, `Competition.stage`); everything below them takes the object.
"""

from dataclasses import dataclass, field
from datetime import UTC, datetime

from sqlalchemy import ColumnElement, and_, select
from sqlalchemy.orm import Session
from vitac.evaluator.ranking import Ranking
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import ListKind
from vitac.evaluator.tracks.registry import find_version

from ..database.clock import read_clock
from ..database.models import (
    Brief,
    CompetitionRow,
    EnteredResult,
    LivePicture,
    Qualification,
    SealedList,
    Submission,
    Team,
)
from ..errors import ProblemCode, ServiceError
from ..tracks import known_track
from .definition import AT_ONCE_RUNS, Sealing, StageQuotas, StageRules, TrackRules

PRACTICE = ""
"""Name of the stage of submissions outside of a competition: to a track that has none, or for practice."""

PRACTICE_RULES = StageRules.model_construct(
    name=PRACTICE,
    title="Practice",
    opens=datetime.min.replace(tzinfo=UTC),
    closes=datetime.max.replace(tzinfo=UTC),
    accepts=tuple(SubmissionKind),
    list=ListKind.PUBLIC,
)
PRACTICE_TRACK = TrackRules.model_construct(title="", stages=(PRACTICE_RULES,))


OfStage = Submission | Qualification | SealedList | Brief | EnteredResult | LivePicture
"""Rows that belong to a stage."""


@dataclass(frozen=True, kw_only=True)
class CountedResults:
    """Which results the boards of a stage are made of.

    Attributes:
        evaluator_version: results of this one are ranked.
        frozen_at: later ones are not shown; None: boards are not frozen.
        final_since: later ones do not count; None: the competition is not final.
    """

    evaluator_version: str
    frozen_at: datetime | None
    final_since: datetime | None


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A stage of a track; a track for practice has one that is always open, for all.

    Attributes:
        competition: name of its competition; empty outside of one.
        track: name of its track.
        name: of the stage; `PRACTICE` outside of a competition.
        session: of the transaction.
        competition_row: to which it belongs; empty and not in the database where there is none.
        rules: what the competition's file says of it.
        track_rules: what the file says of its track.
        before: the stage by whose board its teams advance, or the final list of that; None where it is for all.
        live: of a final list the stage whose chosen submissions it plays; None of a stage itself.
    """

    competition: str
    track: str
    name: str
    session: Session = field(compare=False, repr=False)
    competition_row: CompetitionRow = field(compare=False, repr=False)
    rules: StageRules = field(compare=False, repr=False)
    track_rules: TrackRules = field(compare=False, repr=False)
    before: "Stage | None" = field(default=None, compare=False, repr=False)
    live: "Stage | None" = field(default=None, compare=False, repr=False)

    def __str__(self) -> str:
        """Return how sentences name it."""
        if self.live is not None:
            return f"the final list of {self.live}"
        return f"stage {self.name} of {self.track}" if self.name else self.track

    @property
    def title(self) -> str:
        """What people call it."""
        return self.rules.title

    @property
    def subject(self) -> str:
        """What the audit log calls it."""
        return f"stage:{self.competition}/{self.track}/{self.name}"

    @property
    def is_practice(self) -> bool:
        """Whether it is outside of a competition."""
        return self.name == PRACTICE

    def find_ranking(self, task: str | None = None) -> Ranking:
        """Return what the entries of the board of a task are compared by; None: of all tasks together."""
        track = known_track(self.track)
        if track is None or not (task is None or task in track.tasks):
            return Ranking()  # whose track file is gone
        return track.find_ranking(task, self.track_rules.ranking)

    def describe_ranking(self, task: str | None = None) -> str:
        """Return the order of a board in words."""
        return f"{self.find_ranking(task).sentence} {self.track_rules.ties}" if self.track_rules.ranking else ""

    @property
    def frozen_at(self) -> datetime | None:
        """Time since which its boards show no new results; None if they do."""
        at = None if self.is_practice else self.competition_row.frozen_at
        return at if at is not None and at <= read_clock(self.session) else None

    @property
    def final_since(self) -> datetime | None:
        """Time since which its results are final; None if they are not."""
        return None if self.is_practice else self.competition_row.finalized_at

    @property
    def decides(self) -> bool:
        """Whether prizes or advancement follow from its board."""
        if self.is_practice or self.has_final:
            return False
        return self.track_rules.decides(self.live.rules if self.live else self.rules)

    @property
    def sealing(self) -> Sealing | None:
        """How its sealed list is played; None where the file gives it none."""
        return None if self.is_practice else self.track_rules.find_sealing(self.live.rules if self.live else self.rules)

    @property
    def has_final(self) -> bool:
        """Whether a final list is played after it, which decides in its place."""
        return self.live is None and self.sealing is Sealing.LIVE_AND_FINAL

    @property
    def plays_fresh_lists(self) -> bool:
        """Whether each evaluation plays a list of its own, too, as the one that decides is played at once.

        Not on stations, which play once what is planned.
        """
        return self.live is None and self.decides and self.sealing is Sealing.AT_ONCE and self.rules.plan is None

    @property
    def quotas(self) -> StageQuotas:
        """Most evaluations of a team; few scored ones where the list that decides is played at once."""
        quotas = self.rules.quotas
        if self.sealing is Sealing.AT_ONCE and quotas.scored_runs is None:
            return quotas.model_copy(update={"scored_runs": AT_ONCE_RUNS})
        return quotas

    @property
    def ranks_on_public_list(self) -> bool:
        """Whether its board decides something, although everybody knows its list."""
        return self.decides and self.rules.list is ListKind.PUBLIC

    @property
    def place(self) -> dict[str, str]:
        """By which names rows, entries of the log and answers say that they belong to this stage."""
        return {"competition": self.competition, "track": self.track, "stage": self.name}

    def make_rows(self, table: type[OfStage]) -> tuple[ColumnElement[bool], ...]:
        """Return the conditions by which rows of a table belong to this stage."""
        return table.competition == self.competition, table.track == self.track, table.stage == self.name

    @property
    def submissions(self) -> ColumnElement[bool]:
        """The condition by which a query takes the submissions to this stage."""
        return and_(*self.make_rows(Submission))

    @property
    def qualifications(self) -> ColumnElement[bool]:
        """The condition by which a query takes what the organizers confirmed for this stage."""
        return and_(*self.make_rows(Qualification))

    @property
    def sealed_list(self) -> SealedList | None:
        """The list that only organizers know; None where the public one is played."""
        if self.is_practice:
            return None
        of_stage = select(SealedList).where(*self.make_rows(SealedList))
        return self.session.scalar(of_stage.where(SealedList.withdrawn_at.is_(None)))

    @property
    def is_sealed(self) -> bool:
        """Whether it plays a list that only organizers know."""
        return self.sealed_list is not None

    @property
    def is_revealed(self) -> bool:
        """Whether everybody may know its list, which was sealed before."""
        sealed = self.sealed_list
        return sealed is not None and sealed.revealed_at is not None

    @property
    def plays_sealed_list(self) -> bool:
        """Whether the file wants such a list for it."""
        return self.track_rules.taken_here and self.rules.list is ListKind.SEALED

    @property
    def commitment(self) -> str | None:
        """Commitment of the list that new evaluations play; None for the public list."""
        sealed = self.sealed_list
        return sealed.commitment if sealed else None

    def is_open(self, at: datetime) -> bool:
        """Return whether it takes submissions: in its time, and while its episodes are not published."""
        return self.is_in_time(at) and not self.is_revealed

    def is_in_time(self, at: datetime) -> bool:
        """Return whether a moment lies in its time: from the opening instant to before the closing one."""
        return self.track_rules.taken_here and self.rules.opens <= at < self.rules.closes

    def is_over(self, at: datetime) -> bool:
        """Return whether it has closed."""
        return self.rules.closes <= at

    @property
    def played_since(self) -> datetime | None:
        """Since when the final list is played: of the stage and of that list itself; None before, and without one."""
        if self.live is None and not self.has_final:
            return None
        name = self.name if self.live else self.rules.make_final().name
        of_track = SealedList.competition == self.competition, SealedList.track == self.track, SealedList.stage == name
        return self.session.scalar(select(SealedList.played_at).where(*of_track))

    @property
    def list_sentence(self) -> str | None:
        """Which list its board shows, and when the final one is played; None of a stage without a final list."""
        if self.live is None and not self.has_final:
            return None
        since, submissions = self.played_since, (self.live or self).rules.final_submissions
        chosen = "the chosen submission" if submissions == 1 else f"up to {submissions} chosen submissions"
        when = (
            f"has been played since {since:%F %H:%M} UTC"
            if since
            else f"is played after {self.rules.closes:%F %H:%M} UTC, once, for {chosen} of each team"
        )
        decides = "which alone decides rank, prizes and advancement"
        if self.live is not None:
            return f"This board shows the final list, {decides}. It {when}."
        return f"This board shows the live list, played at each submission. The final list, {decides}, {when}."

    def is_qualified(self, team: Team) -> bool:
        """Return whether the organizers confirmed a team for it."""
        return self.session.get(Qualification, (self.competition, self.track, self.name, team.id)) is not None

    def may_submit(self, team: Team) -> bool:
        """Return whether it is for all teams, or a team is qualified for it."""
        return self.rules.qualified is None or self.is_qualified(team)

    def counted_results(self, *, live: bool = False) -> CountedResults:
        """Return which results count on its boards; once final, those of the version that was current then.

        Args:
            live: for organizers: as if boards were not frozen.
        """
        boards = () if self.is_practice else self.competition_row.boards or ()
        final = (board["evaluator_version"] for board in boards if board["track"] == self.track)
        return CountedResults(
            evaluator_version=next(final, find_version(self.track)),
            frozen_at=None if live else self.frozen_at,
            final_since=self.final_since,
        )

    def require_accepts(self, team: Team, kind: SubmissionKind) -> None:
        """Refuse what it does not take.

        Raises:
            ServiceError: it takes other kinds, or is for qualified teams.
        """
        if kind not in self.rules.accepts:
            raise ServiceError(
                ProblemCode.UNSUPPORTED_SUBMISSION_KIND,
                f"Stage {self.name} of {self.track} takes {', '.join(self.rules.accepts)}, got {kind}.",
                supported=list(self.rules.accepts),
            )
        if self.rules.qualified is not None and not self.is_qualified(team):
            raise ServiceError(
                ProblemCode.NOT_QUALIFIED,
                f"Stage {self.name} of {self.track} is for qualified teams: {self.rules.qualified.sentence}. "
                f"{team.name} is not among those whom the organizers confirmed.",
            )

    def require_over(self) -> None:
        """Refuse what has to wait until it has closed.

        Raises:
            ServiceError: it takes submissions still or later.
        """
        if not self.is_over(read_clock(self.session)):
            raise ServiceError(
                ProblemCode.STAGE_NOT_OVER,
                f"Stage {self.name} of {self.track} closes at {self.rules.closes:%F %T} UTC; wait until then.",
            )
