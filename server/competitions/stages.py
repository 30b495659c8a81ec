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

from ..database.models import CompetitionRow, Qualification, SealedList, Submission, Team
from ..errors import ProblemCode, ServiceError
from ..tracks import known_track
from .definition import StageRules, TrackRules

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
        before: the stage of its track before it; None for the first.
    """

    competition: str
    track: str
    name: str
    session: Session = field(compare=False, repr=False)
    competition_row: CompetitionRow = field(compare=False, repr=False)
    rules: StageRules = field(compare=False, repr=False)
    track_rules: TrackRules = field(compare=False, repr=False)
    before: "Stage | None" = field(default=None, compare=False, repr=False)

    def __str__(self) -> str:
        """Return how sentences name it."""
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
        return at if at is not None and at <= datetime.now(UTC) else None

    @property
    def final_since(self) -> datetime | None:
        """Time since which its results are final; None if they are not."""
        return None if self.is_practice else self.competition_row.finalized_at

    @property
    def decides(self) -> bool:
        """Whether prizes or advancement follow from its board."""
        if self.is_practice:
            return False
        stages = self.track_rules.stages
        after = stages[stages.index(self.rules) + 1 :]
        return after[0].qualified is not None if after else bool(self.track_rules.prizes)

    @property
    def ranks_on_public_list(self) -> bool:
        """Whether its board decides something, although everybody knows its list."""
        return self.decides and self.rules.list is ListKind.PUBLIC

    def make_rows(
        self, table: type[Submission] | type[Qualification] | type[SealedList]
    ) -> tuple[ColumnElement[bool], ...]:
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
        found = self.sealed_list
        return found is not None and found.revealed_at is not None

    @property
    def plays_sealed_list(self) -> bool:
        """Whether the file wants such a list for it."""
        return self.track_rules.taken_here and self.rules.list is ListKind.SEALED

    @property
    def commitment(self) -> str | None:
        """Commitment of the list that new evaluations play; None for the public list."""
        found = self.sealed_list
        return found.commitment if found else None

    def is_open(self, at: datetime) -> bool:
        """Return whether it takes submissions: in its time, and while its episodes are not published."""
        return self.is_in_time(at) and not self.is_revealed

    def is_in_time(self, at: datetime) -> bool:
        """Return whether a moment lies in its time: from the opening instant to before the closing one."""
        return self.track_rules.taken_here and self.rules.opens <= at < self.rules.closes

    def is_over(self, at: datetime) -> bool:
        """Return whether it has closed."""
        return self.rules.closes <= at

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
        if not self.is_over(datetime.now(UTC)):
            raise ServiceError(
                ProblemCode.STAGE_NOT_OVER,
                f"Stage {self.name} of {self.track} closes at {self.rules.closes:%F %T} UTC; wait until then.",
            )
