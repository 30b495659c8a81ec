"""What a competition file says; `vitac admin competition` reads it, and everything that follows its rules asks it."""

from collections.abc import Iterator, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, PrivateAttr, model_validator
from vitac.envs.tasks.definition import Family
from vitac.evaluator.isolation_kinds import IsolationKind
from vitac.evaluator.strict_model import DocumentRejected, StrictModel, Word, read_yaml
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import ListKind, Track, UnknownTask, find_task, list_tracks, load_track

from ..transparency.notes import OF_WITNESS, NoteRejected, VerifierKey
from .instants import Instant

Count = Annotated[int, Field(strict=True, gt=0)]
Amount = Annotated[int, Field(strict=True, ge=0)]
Share = Annotated[float, Field(strict=True, ge=0, le=1)]
"""Numbers are strict: `yes` is not 1."""
_ROUNDING = 1e-9


class Advancement(StrictModel):
    """Who may take part in a stage, by the final board of another one: exactly one of the rules."""

    top: Count | None = Field(default=None, description="Number of teams.")
    top_share: Share | None = Field(default=None, gt=0, description="This share of all registered teams.")
    score_at_least: Share | None = Field(default=None, description="Everybody with this success rate.")
    committee: Literal[True] | None = Field(default=None, description="Everybody whose brief the committee accepts.")
    after: str | None = Field(
        default=None,
        pattern=r"^[^/]+/[^/]+$",
        description="TRACK/STAGE by whose board teams advance; null: the stage before of the same track.",
    )

    @model_validator(mode="after")
    def _is_one_rule(self) -> Self:
        rules = (self.top, self.top_share, self.score_at_least, self.committee)
        if sum(value is not None for value in rules) != 1:
            raise ValueError("give exactly one of top, top_share, score_at_least and committee")
        if self.committee and self.after:
            raise ValueError(f"a committee decides by the briefs of the stage before; leave out after: {self.after}")
        return self

    @property
    def sentence(self) -> str:
        """The rule in words."""
        before = "the stage before"
        if self.after is not None:
            track, stage = self.after.split("/")
            before = f"stage {stage} of {track}"
        if self.top is not None:
            teams = "team" if self.top == 1 else f"{self.top} teams"
            return f"the best {teams} of {before}"
        if self.top_share is not None:
            return f"the best {100 * self.top_share:g} % of the registered teams, by {before}"
        if self.committee:
            return "every team whose brief of the stage before the committee accepts"
        return f"every team with a success rate of {100 * (self.score_at_least or 0):g} % or more in {before}"


class Sealing(StrEnum):
    """How the sealed list of a stage is played."""

    LIVE_AND_FINAL = "live_and_final"
    """A live list at each submission, and after the close a final one for each team's chosen submissions."""
    AT_ONCE = "at_once"
    """One list at each submission, which decides."""


FINAL_SUFFIX = ".final"
"""Of the name under which the final list of a stage has its board, submissions and commitment, as a stage has them."""

AT_ONCE_RUNS = 3
"""Scored runs of a team where the list that decides is played at once, and the file names no other number."""


class StageQuotas(StrictModel):
    """Most evaluations of a team in a stage; null: any number.

    What machines failed costs nothing, up to five times a day.
    """

    scored_runs: Count | None = Field(
        default=None, description="That have a score or may still get one, or saw a sealed list."
    )
    attempts: Count | None = Field(default=None, description="However they end.")


class BriefRules(StrictModel):
    """A document in PDF that a committee reads; it gets no score, and its team advances or not."""

    min_pages: Count = 1
    max_pages: Count = 4

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        if self.min_pages > self.max_pages:
            raise ValueError(f"min_pages is {self.min_pages}, expected at most max_pages, {self.max_pages}")
        return self

    @property
    def sentence(self) -> str:
        """What is handed in, in words."""
        pages = "1 page" if self.max_pages == 1 else f"{self.max_pages} pages"
        return f"a brief of {'' if self.min_pages == self.max_pages else f'{self.min_pages} to '}{pages} as PDF"


class EnteredTask(StrictModel):
    """A task that is played elsewhere, such as on a robot, and whose points operators enter."""

    name: Word
    title: str
    prompt: str = Field(default="", description="The task in words, as the policy gets it.")
    points: Count = Field(description="Most points of an attempt.")


class TrialPlan(StrictModel):
    """How the trials of a stage on stations are ordered: in blocks, in each of which everybody plays the same start."""

    stations: tuple[str, ...] = Field(min_length=1, description="Names, as `admin station add` has them.")
    control: str | None = Field(
        default=None, description="Team whose only submission opens every block, to see what changes at a station."
    )
    live_delay_s: Annotated[float, Field(ge=10, le=86_400)] | None = Field(
        default=None, description="Everybody watches the trials so much later [s]; by default nobody does."
    )

    @model_validator(mode="after")
    def _names_each_station_once(self) -> Self:
        _refuse_twice(list(self.stations), "station")
        return self


class StageRules(StrictModel):
    """What the file says of a stage: when it is open, for what and for whom."""

    name: Word
    title: str
    opens: Instant
    closes: Instant = Field(description="What is complete at this instant is too late.")
    accepts: tuple[SubmissionKind, ...] = ()
    list: ListKind = Field(
        default=ListKind.SEALED,
        description="Who may know the episodes that its models rank by. Logs always play the public list.",
    )
    sealed: Sealing | None = Field(
        default=None,
        description="How a sealed list is played; null: live and final where prizes or advancement hang on the stage, "
        "at once elsewhere.",
    )
    final_submissions: Count = Field(
        default=1, description="How many submissions of a team play the final list: chosen by it, or its best ones."
    )
    quotas: StageQuotas = StageQuotas()
    public_pages: bool = Field(
        default=False, description="Everybody may see the results of its submissions, unless their team says otherwise."
    )
    brief: BriefRules | None = Field(default=None, description="Teams hand in a document, which a committee judges.")
    entered: tuple[EnteredTask, ...] = Field(
        default=(),
        description="Operators enter the points of each attempt. Its score is their sum over these tasks, and a team's "
        "best attempt counts.",
    )
    qualified: Advancement | None = Field(default=None, description="Only teams that advance by this rule.")
    witnesses: Amount = Field(
        default=0,
        description="How many of the competition's witnesses must have signed all entries of the stage in the log "
        "of receipts before the competition can be made final.",
    )
    episode_period_s: float | None = Field(
        default=None,
        strict=True,
        gt=0,
        le=10,
        description="Time from the start of an episode to that of the next [s], so that the instant at which one ends "
        "tells the next one nothing; null: as a worker is set.",
    )
    answer_s: float | None = Field(
        default=None,
        strict=True,
        gt=0,
        le=10,
        description="Time that a policy server has for each answer but the first on a line [s], too short for people; "
        "null: as the service limits any action.",
    )
    isolation: Literal[IsolationKind.NAMESPACES, IsolationKind.VM] | None = Field(
        default=None, description="What stands between policies and the machine; null: as a worker is set."
    )
    plan: TrialPlan | None = Field(
        default=None,
        description="Of a stage on stations: its trials wait until it has closed, and are then played by a plan.",
    )

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        if self.closes <= self.opens:
            raise ValueError(f"closes at {self.closes:%F %T} UTC, expected a moment after {self.opens:%F %T} UTC")
        if self.list is ListKind.SEALED and self.accepts and not any(kind.form.runs_policy for kind in self.accepts):
            raise ValueError(
                f"a sealed list ranks models, and the stage accepts only {', '.join(self.accepts)}; a log would need "
                "the episodes that nobody knows. Accept models, too, or make the list public, which is for practice"
            )
        if self.list is ListKind.PUBLIC and self.sealed is not None:
            raise ValueError(f"sealed is {self.sealed}, but the list is public. Leave it out, or make the list sealed")
        _refuse_twice([task.name for task in self.entered], "task")
        if self.brief is not None and self.entered:
            raise ValueError("a stage has a brief or entered results, expected not both; make two stages of it")
        if self.plan is not None and (self.list, self.sealed) != (ListKind.SEALED, Sealing.AT_ONCE):
            raise ValueError(
                "plan: expected list: sealed and sealed: at_once, as starts and order come from the list's secret, got "
                f"list: {self.list} and sealed: {self.sealed or 'null'}"
            )
        if self.name.endswith(FINAL_SUFFIX):
            raise ValueError(
                f"expected a name that does not end in {FINAL_SUFFIX}, which stands for the final list of a stage, got "
                f"{self.name!r}"
            )
        return self

    def make_final(self) -> "StageRules":
        """Return its final list as a stage: nobody submits to it, and it is played once the stage has closed."""
        return self.model_copy(
            update={
                "name": f"{self.name}{FINAL_SUFFIX}",
                "title": f"{self.title}, final list",
                "opens": self.closes,
                "accepts": (),
                "sealed": Sealing.AT_ONCE,
                "quotas": StageQuotas(),
                "qualified": None,
            }
        )


class Prize(StrictModel):
    """What a place wins."""

    place: Word = Field(description="first, second, third, or another name.")
    amount: Amount
    winners: Count = 1
    note: str | None = None


class Criterion(StrictModel):
    """What judges give a mark for, from 0 to 10."""

    name: Word
    title: str


class JudgingWeights(StrictModel):
    """What counts how much in the total of a judged track; together 1. None were published for 2025: they are ours."""

    success: Share = Field(default=0.5, description="Of the success rate.")
    judges: Share = Field(default=0.3, description="Of the judges' mean mark, a tenth of it.")
    figures: Share = Field(default=0.2, description="Of the sensor's figures, compared with the others'.")

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        total = self.success + self.judges + self.figures
        if abs(total - 1) > _ROUNDING:
            raise ValueError(
                f"expected weights that add up to 1, got {self.success:g} for success, {self.judges:g} for judges "
                f"and {self.figures:g} for figures"
            )
        return self


class Judging(StrictModel):
    """How a track is judged."""

    criteria: tuple[Criterion, ...] = Field(min_length=1)
    judges_at_least: Count = Field(default=2, description="Before that there is no total.")
    weights: JudgingWeights = JudgingWeights()
    judges: tuple[str, ...] = Field(
        default=(),
        description="Names of those who judge, as their tokens have them; empty: every judge of the service.",
    )

    @property
    def sentence(self) -> str:
        """How a total comes about, in words."""
        of_total = {
            "the success rate": self.weights.success,
            "the judges' mean mark": self.weights.judges,
            "the figures of the sensor": self.weights.figures,
        }
        shares = ", ".join(f"{100 * weight:g} % {what}" for what, weight in of_total.items() if weight)
        titles = ", ".join(criterion.title for criterion in self.criteria)
        least = "1 judge gives" if self.judges_at_least == 1 else f"{self.judges_at_least} judges give"
        return f"At least {least} marks from 0 to 10 for: {titles}. The total, by which prizes go, is {shares}."

    @model_validator(mode="after")
    def _criteria_have_names_of_their_own(self) -> Self:
        _refuse_twice([criterion.name for criterion in self.criteria], "criterion name")
        _refuse_twice(list(self.judges), "judge")
        if self.judges and len(self.judges) < self.judges_at_least:
            raise ValueError(
                f"judges_at_least is {self.judges_at_least}, expected at most the {len(self.judges)} that judges names"
            )
        return self


class TrackRules(StrictModel):
    """What the file says of a track. One that is not `taken_here` has a schedule and prizes only."""

    title: str
    taken_here: bool = True
    stages: tuple[StageRules, ...] = Field(min_length=1)
    ranking: tuple[Word, ...] | None = Field(
        default=None, description="What entries are compared by; null: as the track's file says."
    )
    ties: str = "The earlier submission is in front."
    picture: Word | None = Field(
        default=None, description="Task of this service whose picture stands for the track; null: its own first one."
    )
    prizes: tuple[Prize, ...] = ()
    judging: Judging | None = None
    _advancing: frozenset[str] = PrivateAttr(default=frozenset())
    """Names of the stages by whose boards teams advance, to whichever track; the competition knows them."""

    @property
    def single_prizes(self) -> tuple[Prize, ...]:
        """What each rank wins, from the first on."""
        return tuple(prize for prize in self.prizes for _ in range(prize.winners))

    def decides(self, stage: StageRules) -> bool:
        """Return whether prizes or advancement hang on a stage."""
        return stage.name in self._advancing or (stage == self.stages[-1] and bool(self.prizes))

    def find_sealing(self, stage: StageRules) -> Sealing | None:
        """Return how the sealed list of a stage is played; None where there is none."""
        if stage.list is ListKind.PUBLIC or not self.taken_here:
            return None
        return stage.sealed or (Sealing.LIVE_AND_FINAL if self.decides(stage) else Sealing.AT_ONCE)

    def list_boards(self) -> Iterator[tuple[StageRules, StageRules | None]]:
        """Yield what has a board of its own: each stage, and after it its final list with the stage that it is of."""
        for stage in self.stages:
            yield stage, None
            if self.find_sealing(stage) is Sealing.LIVE_AND_FINAL:
                yield stage.make_final(), stage

    def find_board(self, name: str) -> StageRules | None:
        """Return the stage, or the final list, of that name."""
        return next((rules for rules, _ in self.list_boards() if rules.name == name), None)

    @model_validator(mode="after")
    def _what_is_entered_is_played_elsewhere(self) -> Self:
        for before, stage in zip((None, *self.stages), self.stages, strict=False):
            if self.taken_here and (stage.brief or stage.entered):
                raise ValueError(
                    f"stage {stage.name} has briefs or entered results, so nothing of the track is played here: write "
                    "`taken_here: false` for it"
                )
            if stage.qualified and stage.qualified.committee and not (before and before.brief):
                raise ValueError(f"a committee decides who enters stage {stage.name}, but no stage before has a brief")
        return self

    @model_validator(mode="after")
    def _stages_follow_each_other(self) -> Self:
        _refuse_twice([stage.name for stage in self.stages], "stage")
        _refuse_twice([prize.place for prize in self.prizes], "prize")
        rule = self.stages[0].qualified
        if rule is not None and rule.after is None:
            raise ValueError(
                f"stage {self.stages[0].name} is the first one, so nobody can be qualified for it; name a stage of "
                "another track with after: TRACK/STAGE"
            )
        for before, after in zip(self.stages, self.stages[1:], strict=False):
            if after.opens < before.closes:
                raise ValueError(f"stage {after.name} opens before stage {before.name} closes")
        return self


class CompetitionDefinition(StrictModel):
    """A whole competition: its tracks with their stages, rules and prizes."""

    name: Word
    title: str
    summary: str = ""
    website: str | None = Field(default=None, pattern=r"^https://[^\s<>\"]+$")
    contact: str | None = None
    rules: tuple[str, ...] = ()
    currency: Word = "USD"
    teams_locked: Instant | None = Field(default=None, description="From then on only organizers register teams.")
    freeze_at: Instant | None = Field(
        default=None, description="From then on boards show no new results to anybody but organizers."
    )
    appeal_days: Count | None = Field(
        default=None, description="How long after the end of an evaluation its team may appeal; null: no appeals."
    )
    anonymous: bool = Field(
        default=False, description="Teams see each other under random names until the competition is final."
    )
    witnesses: tuple[str, ...] = Field(
        default=(), max_length=50, description="Verifier keys (NAME+ID+KEY) of those who sign the log of receipts."
    )
    tracks: dict[Word, TrackRules] = Field(min_length=1)

    @model_validator(mode="after")
    def _has_witnesses_enough(self) -> Self:
        _refuse_twice(list(self.witnesses), "witness key")
        try:
            others = [key for key in self.witnesses if VerifierKey.parse(key).kind != OF_WITNESS]
        except NoteRejected as error:
            raise ValueError(f"witnesses: {error}") from error
        if others:
            raise ValueError(f"witnesses: expected keys of witnesses, got that of a log, {others[0]}")
        for name, track in self.tracks.items():
            for stage in track.stages:
                if stage.witnesses > len(self.witnesses):
                    raise ValueError(
                        f"stage {stage.name} of {name} demands {stage.witnesses} witnesses, expected at most the "
                        f"{len(self.witnesses)} that the competition names"
                    )
        return self

    @model_validator(mode="after")
    def _teams_advance_by_earlier_boards(self) -> Self:
        boards = {
            f"{name}/{stage.name}": stage
            for name, track in self.tracks.items()
            for stage in track.stages
            if track.taken_here
        }
        for name, track in self.tracks.items():
            for stage in track.stages:
                after = stage.qualified.after if stage.qualified else None
                if after is None:
                    continue
                if after not in boards:
                    raise ValueError(
                        f"stage {stage.name} of {name} is for teams of {after}, expected a stage that is played here, "
                        f"one of {', '.join(boards) or 'none'}"
                    )
                if stage.opens < boards[after].closes:
                    raise ValueError(f"stage {stage.name} of {name} opens before {after} closes")
        for _, _, name, before in self.list_advancements():
            self.tracks[name]._advancing |= {before.name}
        return self

    def list_advancements(self) -> Iterator[tuple[str, StageRules, str, StageRules]]:
        """Yield each stage for qualified teams with its track, and by which stage of which track they advance."""
        for name, track in self.tracks.items():
            for before, stage in zip((None, *track.stages), track.stages, strict=False):
                if stage.qualified is not None and stage.qualified.after is not None:
                    other, named = stage.qualified.after.split("/")
                    yield name, stage, other, next(one for one in self.tracks[other].stages if one.name == named)
                elif stage.qualified is not None and before is not None:
                    yield name, stage, name, before

    @property
    def public_rankings(self) -> Mapping[str, str]:
        """What boards of public lists decide, by its place in the file; empty where they are for practice only."""
        of_prizes = {
            f"tracks.{name}.prizes": f"the prizes of {track.title} go by the board of {track.stages[-1].title}"
            for name, track in self.tracks.items()
            if track.taken_here and track.prizes and track.stages[-1].list is ListKind.PUBLIC
        }
        return of_prizes | {
            f"tracks.{name}.stages.{stage.name}.qualified": f"{stage.title} of {self.tracks[name].title} is for teams "
            f"by {before.title}"
            for name, stage, other, before in self.list_advancements()
            if self.tracks[other].taken_here and before.list is ListKind.PUBLIC
        }


def read_competition(path: Path) -> CompetitionDefinition:
    """Read a competition file and check it against the tracks of this service.

    Raises:
        DocumentRejected: with one sentence for each thing that is wrong.
    """
    definition = read_yaml(CompetitionDefinition, path)
    require_known_tracks(definition, path.name)
    return definition


def require_known_tracks(definition: CompetitionDefinition, origin: str) -> None:
    """Check a competition against the tracks of this service.

    Args:
        definition: of the competition.
        origin: name of its file, for the error message.

    Raises:
        DocumentRejected: with one sentence for each thing that is wrong.
    """
    problems = [problem for name, track in definition.tracks.items() for problem in _problems(name, track)]
    if problems:
        raise DocumentRejected(f"{origin}: {' '.join(problems)}")


def _problems(name: str, track: TrackRules) -> Iterator[str]:
    """Yield what does not fit the track's own file."""
    if not track.taken_here:
        return
    if name not in list_tracks():
        yield (
            f"tracks.{name}: there is no such track, expected one of {', '.join(list_tracks())} "
            "(or taken_here: false for one whose submissions are collected elsewhere)."
        )
        return
    known = load_track(name)
    for task in (None, *known.tasks):
        try:
            known.find_ranking(task, track.ranking)
        except ValueError as error:
            yield f"tracks.{name}.{error}."
            break
    yield from _stage_problems(known, track)
    if track.picture is not None:
        try:
            find_task(track.picture)
        except UnknownTask as error:
            yield f"tracks.{name}.picture: {error}"
    if track.judging is not None and track.judging.weights.figures and not known.has_sensor:
        yield (
            f"tracks.{name}.judging.weights.figures: expected 0, got {track.judging.weights.figures:g}; teams bring no "
            "sensors to this track, so nobody would ever get a total."
        )


def _stage_problems(known: Track, track: TrackRules) -> Iterator[str]:
    for stage in track.stages:
        place = f"tracks.{known.name}.stages.{stage.name}"
        if not stage.accepts:
            yield f"{place}.accepts is empty, expected some of {', '.join(known.accepts)}."
        for kind in stage.accepts:
            if kind not in known.accepts:
                yield f"{place}.accepts: the track takes {', '.join(known.accepts)}, got {kind}."
        simulated = [name for name, task in known.tasks.items() if task.family is not Family.STATION]
        if stage.plan is not None and simulated:
            yield f"{place}.plan: expected a track that stations play (vitac station track), got {simulated[0]}."


def _refuse_twice(names: list[str], what: str) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"there are two {what}s {twice[0]!r}; give each one name")
