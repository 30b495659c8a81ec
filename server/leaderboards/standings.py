"""Standings of a track and of its tasks: reads completed evaluations only, ranks them by the evaluator's rule."""

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from typing import TypeVar
from uuid import UUID

from sqlalchemy import select
from sqlalchemy.orm import Session, defer, selectinload
from vitac.evaluator.ranking import SUCCESS_RATE
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import ListKind, Track

from ..accounts import teams
from ..accounts.shown_names import ShownNames
from ..competitions.stages import CountedResults, Stage
from ..database.models import Evaluation, Submission
from ..evaluations.copies import find_copies
from ..evaluations.scores import (
    bounds,
    combine_scores,
    counted_tasks,
    played_score,
    read_scores,
    task_views,
)
from ..principals import CONSOLE, VISITOR
from ..tracks import is_reference, load_known_track, require_task
from ..views.leaderboards import BaselineView, LeaderboardEntryView, LeaderboardView, LogEntryView
from ..visibility import played_list_kind
from .baselines import list_baselines
from .best_entries import BestEntry, Board, best_entries
from .board_cache import MadeBoard, MadeBoards, compute_revision, kept_until_change


def explain_unranked(
    made_by: Collection[str], counted: CountedResults, track: str, *, kind: SubmissionKind, of: int
) -> str | None:
    """Return why entries of a board have no rank, and what brings it back; None where all were made by its evaluator.

    Args:
        made_by: the evaluator version of each entry without a rank that another one made.
        counted: which results the board ranks.
        track: of the board.
        kind: of the entries.
        of: how many entries there are.
    """
    if not made_by:
        return None
    count = f"{len(made_by)} of {of} entries {'has' if len(made_by) == 1 else 'have'} no rank"
    made = f"evaluator {' or '.join(sorted(set(made_by)))} made {'it' if len(made_by) == 1 else 'them'}"
    return (
        f"{count}: {made}, and this board ranks results of evaluator {counted.evaluator_version}, as results of two "
        f"evaluators are not comparable. {_remedy(counted, track, kind)}"
    )


def explain_unranked_submission(made_by: str, counted: CountedResults, track: str) -> str | None:
    """Return why a scored model has no rank, and what brings it back; None where its board ranks it."""
    if made_by == counted.evaluator_version or counted.final_since is not None:
        return None
    return (
        f"It has no rank: evaluator {made_by} made its result, and the board ranks results of evaluator "
        f"{counted.evaluator_version}, as results of two evaluators are not comparable. "
        f"{_remedy(counted, track, SubmissionKind.MODEL)}"
    )


def _remedy(counted: CountedResults, track: str, kind: SubmissionKind) -> str:
    if counted.final_since is not None:
        return "The results are final, and stay as they are."
    again = "A submission gets a rank once it is evaluated again"
    if not kind.form.runs_policy:
        return f"{again}: upload a log of the present evaluator."
    return f"{again}: organizers do so with `vitac admin rejudge start --track {track} --reason REASON`, then `apply`."


def rank_ranges(intervals: Sequence[tuple[float, float]]) -> list[tuple[int, int]]:
    """Return the first and last rank that each entry could have, given the 95 % intervals of all success rates.

    Ahead for certain is only who is above the whole interval, behind for certain who is below it. Entries of equal rank
    ranges cannot be distinguished by this number of episodes.

    Args:
        intervals: low and high end of each entry.
    """
    lows, highs = sorted(low for low, _ in intervals), sorted(high for _, high in intervals)
    n = len(intervals)
    return [(1 + n - bisect_right(lows, high), n - bisect_left(highs, low)) for low, high in intervals]


EntryT = TypeVar("EntryT", LeaderboardEntryView, LogEntryView)

_made_boards: MadeBoards[LeaderboardView] = MadeBoards()


def leaderboard(
    session: Session,
    stage: Stage,
    *,
    task: str | None = None,
    kind: SubmissionKind = SubmissionKind.MODEL,
    live: bool = False,
    unfrozen: bool = False,
) -> MadeBoard[LeaderboardView]:
    """Return the best entry of each team, ranked; then teams with results of another evaluator version only.

    Args:
        session: of the transaction.
        stage: whose board.
        task: ranks the submissions that play this task by it alone; None: all tasks of the track together.
        kind: what is ranked; logs only task by task.
        live: for what organizers decide by it: as it is, also while boards are frozen or names are hidden.
        unfrozen: for organizers who read it: with results that it does not show to others, under the names shown.

    Raises:
        ServiceError: there is no such track or task.
    """
    track = load_known_track(stage.track)
    if task is not None:
        require_task(track, task)
    counted = stage.counted_results(live=live or unfrozen)
    board = Board.from_results(stage, counted, kind=kind, task=task)
    played = track.tasks[task or next(iter(track.tasks))].episode_list.kind
    list_kind = ListKind.SEALED if stage.is_sealed else played
    is_public = list_kind is ListKind.PUBLIC
    best, named_at, baselines = kept_until_change(
        session,
        ("entries", board, is_public),
        lambda: (
            best_entries(session, board),
            teams.find_last_naming(session),
            list_baselines(session, track, task) if is_public else [],
        ),
    )
    reference = task is not None and is_reference(track.tasks[task])
    if reference:
        best = [replace(entry, rank=None) for entry in best]
    shown_names = ShownNames.read(session, CONSOLE if live else VISITOR)
    names = f"{named_at} {shown_names.hidden and not live}"
    is_practice = is_public and not stage.decides
    list_sentence = stage.list_sentence
    revision = compute_revision(
        f"{board} {counted} {list_kind} {list_sentence} {is_practice} {names}", [*best, *baselines]
    )
    shown = _Shown(
        board=board,
        list_kind=list_kind,
        list_sentence=list_sentence,
        is_practice=is_practice,
        is_reference=reference,
        rule=stage.describe_ranking(task),
        best=best,
        baselines=baselines,
        counted=counted,
        names=shown_names,
        revision=revision,
    )
    made = partial(_view, session, track, shown)
    return _made_boards.get((board, live), revision, made, names=names)


@dataclass(frozen=True, kw_only=True)
class _Shown:
    """What a revision of a board shows.

    Attributes:
        list_kind: of the episodes that submissions to it play.
        list_sentence: which of two sealed lists it shows; None where there are no two.
        is_practice: whether it decides nothing because its list is public.
        is_reference: whether it ranks nobody.
        rule: how it is ranked where the competition's file says it; empty where the track's does.
        baselines: what it is compared with.
        counted: which results it is made of.
        names: under which teams are shown.
    """

    board: Board
    list_kind: ListKind
    list_sentence: str | None
    is_practice: bool
    is_reference: bool
    rule: str
    best: Collection[BestEntry]
    baselines: list[BaselineView]
    counted: CountedResults
    names: ShownNames
    revision: str


def _view(session: Session, track: Track, shown: _Shown, last: LeaderboardView | None) -> LeaderboardView:
    task = shown.board.task
    entry_of = partial(_entry, board=shown.board, names=shown.names)
    made = made_entries(session, shown.best, last.entries if last else (), entry_of)
    if shown.board.ranking.keys[0] == SUCCESS_RATE:  # Of nothing else is it known how it varies by chance.
        made = _add_rank_ranges(made)
    without_rank = [entry.evaluation_id for entry in made if entry.rank is None]
    logs = without_rank if shown.board.kind.form.is_verified else ()
    copies = find_copies(session, without_rank, shown.names, logs=logs)
    entries = [entry.model_copy(update={"copy_of": copies.get(entry.evaluation_id)}) for entry in made]
    return LeaderboardView(
        track=track.name,
        title=track.title,
        tasks=list(track.tasks),
        task=task,
        stage=shown.board.stage or None,
        frozen_at=shown.counted.frozen_at,
        final_since=shown.counted.final_since,
        list_kind=shown.list_kind,
        list_sentence=shown.list_sentence,
        is_practice=shown.is_practice,
        is_reference=shown.is_reference,
        ranking=shown.board.ranking,
        ranking_rule=shown.rule or (track.combination_rule if task is None else None) or shown.board.ranking.sentence,
        evaluator_version=shown.board.evaluator_version,
        unranked=unranked(entries, shown.counted, shown.board),
        revision=shown.revision,
        generated_at=datetime.now(UTC),
        teams=len(entries),
        entries=entries,
        baselines=shown.baselines,
    )


def unranked(
    entries: Collection[LeaderboardEntryView] | Collection[LogEntryView], counted: CountedResults, board: Board
) -> str | None:
    """Return why some of the entries have no rank since the evaluator changed; None if none lacks it."""
    made_by = [entry.evaluator_version for entry in entries if entry.stale]
    return explain_unranked(made_by, counted, board.track, kind=board.kind, of=len(entries))


def _add_rank_ranges(entries: list[LeaderboardEntryView]) -> list[LeaderboardEntryView]:
    ranked = [entry.success_rate_interval for entry in entries if entry.rank is not None]
    ranges = iter(rank_ranges(ranked))
    return [entry.model_copy(update={"rank_range": None if entry.rank is None else next(ranges)}) for entry in entries]


def made_entries(
    session: Session,
    best: Collection[BestEntry],
    last: Iterable[EntryT],
    make: Callable[[BestEntry, Evaluation], EntryT | None],
) -> list[EntryT]:
    """Return the views of entries; those that were there before, too, are not read again.

    Args:
        session: of the transaction.
        best: the entries.
        last: the views that the board had before.
        make: the view of a new entry; None where it is not shown.
    """
    kept = {view.evaluation_id: view for view in last}
    new = completed_evaluations(session, {entry.evaluation_id for entry in best} - kept.keys())
    made = (
        make(entry, new[entry.evaluation_id])
        if entry.evaluation_id in new
        else _add_rank(kept[entry.evaluation_id], entry.rank)
        for entry in best
    )
    return [view for view in made if view is not None]


def _add_rank(view: EntryT, rank: int | None) -> EntryT:
    return view if view.rank == rank else view.model_copy(update={"rank": rank})


def completed_evaluations(session: Session, ids: Collection[UUID]) -> Mapping[UUID, Evaluation]:
    """Return the evaluations behind entries by their ids, with submissions and teams, without what boards leave out."""
    evaluations = session.scalars(
        select(Evaluation)
        .where(Evaluation.id.in_(ids))
        .options(
            defer(Evaluation.log_tail),
            # Not joined: of a join with many rows on one side, the database reads the other one from end to end.
            selectinload(Evaluation.submission).selectinload(Submission.team),
        )
    )
    return {evaluation.id: evaluation for evaluation in evaluations}


def _entry(entry: BestEntry, evaluation: Evaluation, *, board: Board, names: ShownNames) -> LeaderboardEntryView | None:
    """Return an entry as it is shown; None for one in tasks of which none counts."""
    submission, by_task, task = evaluation.submission, read_scores(evaluation), board.task
    scores = [score for score in task_views(evaluation, by_task) if task in {None, score.task}]
    ranked_by = combine_scores(evaluation, by_task) if task is None else by_task[task]
    if ranked_by is None:
        return None
    return LeaderboardEntryView(
        rank=entry.rank,
        rank_range=None,
        stale=evaluation.evaluator_version != board.evaluator_version,
        team=names.show_name(submission.team),
        evaluation_id=evaluation.id,
        submission_id=submission.id,
        submission_name=submission.name,
        kind=submission.kind,
        submitted_at=submission.submitted_at,
        evaluated_at=evaluation.finished_at or evaluation.created_at,
        episodes=sum(score.episodes for score in scores),
        successes=sum(score.successes for score in scores),
        success_rate=entry.ranked_by["success_rate"] or 0.0,
        success_rate_interval=bounds(ranked_by.interval),
        mean_steps=entry.ranked_by["mean_steps"],
        measures=dict(ranked_by.measures),
        played=played_score(counted_tasks(evaluation) if task is None else (task,), by_task),
        scores=scores,
        result_hash=evaluation.result_hash or "",
        evaluator_version=evaluation.evaluator_version,
        list_kind=played_list_kind(evaluation),
    )
