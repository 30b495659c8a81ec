"""Which episodes an episode can be shown beside: the same start played by others, and others of the same submission."""

from uuid import UUID

from sqlalchemy import and_, or_, select
from sqlalchemy.orm import Session
from vitac.evaluator.episodes.records import EpisodeOutcome

from ..accounts.shown_names import ShownNames
from ..database.models import EpisodeResult, Submission
from ..errors import ProblemCode, ServiceError
from ..leaderboards.public_pages import readable
from ..principals import Principal
from ..views.comparisons import EpisodeChoiceView
from .asking import find_episode

LISTED = 8
"""Maximum number of other submissions that are listed."""
_LOOKED_AT = 40


def list_choices(
    session: Session, by: Principal, submission_id: UUID, task: str, number: int, *, best: UUID | None = None
) -> tuple[EpisodeChoiceView, ...]:
    """Return episodes to show beside one, those of other submissions first; only such as the principal may see.

    Args:
        session: of the transaction.
        by: who asks.
        submission_id: whose episode it is.
        task: of the episode.
        number: of the episode.
        best: the submission that leads the leaderboard of the task, if any; it comes first.

    Raises:
        ServiceError: there is no such episode that the principal may see.
    """
    submission = readable(session, by, submission_id)
    episode = find_episode(session, by, submission_id, task, number)
    return (
        *_same_start(session, by, submission, episode, best),
        *_choose_within_submission(session, by, submission, episode),
    )


def _same_start(
    session: Session, by: Principal, own: Submission, episode: EpisodeResult, best: UUID | None
) -> list[EpisodeChoiceView]:
    """Return the same start as others played it: the best of the board, then who solved it, then the newest."""
    played = and_(Submission.digest == EpisodeResult.submission_digest, Submission.track == EpisodeResult.track)
    others = session.scalars(
        select(Submission)
        .join(EpisodeResult, played)
        .where(
            EpisodeResult.track == episode.track,
            EpisodeResult.evaluator_version == episode.evaluator_version,
            EpisodeResult.task == episode.task,
            EpisodeResult.episode == episode.episode,
            EpisodeResult.commitment == episode.commitment,
            Submission.digest != own.digest,
            or_(Submission.is_public, Submission.team_id == by.team_id),
        )
        .order_by(
            (Submission.id == best).desc(), EpisodeResult.success.desc(), Submission.submitted_at.desc(), Submission.id
        )
        .limit(_LOOKED_AT)
    )
    names = ShownNames.read(session, by)
    choices: list[EpisodeChoiceView] = []
    for submission in others.unique():
        shown = _visible_episode(session, by, submission.id, episode.task, episode.episode)
        if shown is not None and len(choices) < LISTED:
            leads = ", first of the board" if submission.id == best else ""
            label = f"{names.show_name(submission.team)}: {submission.name}{leads}"
            choices.append(_choice(submission.id, shown, label))
    return choices


def _choose_within_submission(
    session: Session, by: Principal, own: Submission, episode: EpisodeResult
) -> list[EpisodeChoiceView]:
    """Return the next episode of the same shape that was solved, and the next that was not."""
    choices = []
    for is_solved in (True, False):
        number = session.scalar(
            select(EpisodeResult.episode)
            .where(
                EpisodeResult.submission_digest == episode.submission_digest,
                EpisodeResult.track == episode.track,
                EpisodeResult.evaluator_version == episode.evaluator_version,
                EpisodeResult.task == episode.task,
                EpisodeResult.shape == episode.shape,
                EpisodeResult.episode != episode.episode,
                EpisodeResult.commitment == episode.commitment,
                EpisodeResult.success == is_solved,
            )
            .order_by((EpisodeResult.episode < episode.episode), EpisodeResult.episode)
            .limit(1)
        )
        if number is not None and (shown := _visible_episode(session, by, own.id, episode.task, number)) is not None:
            choices.append(_choice(own.id, shown, f"this submission, episode {number}"))
    return choices


def _visible_episode(
    session: Session, by: Principal, submission_id: UUID, task: str, number: int
) -> EpisodeResult | None:
    try:
        return find_episode(session, by, submission_id, task, number)
    except ServiceError as error:
        if error.code in {ProblemCode.MISSING_CREDENTIALS, ProblemCode.NOT_FOUND}:
            return None
        raise


def _choice(submission_id: UUID, episode: EpisodeResult, label: str) -> EpisodeChoiceView:
    return EpisodeChoiceView(
        submission_id=submission_id, episode=episode.episode, label=label, outcome=EpisodeOutcome(episode.outcome)
    )
