"""Sealed lists of stages: made from a secret before the first submission, published after the last evaluation.

The commitment is public from the start. The secret is read by workers, which play the list, and by organizers.
"""

import secrets
from datetime import datetime
from typing import Literal

from sqlalchemy import delete, exists, func, select
from sqlalchemy.orm import Session
from vitac.evaluator.tracks import Track
from vitac.evaluator.tracks.sealed import SECRET_BYTES, load_played_track, make_commitment

from ..audit import record
from ..database.clock import read_clock
from ..database.models import Evaluation, FreshList, SealedList
from ..database.states import ACTIVE_EVALUATION_STATES
from ..errors import ProblemCode, ServiceError, not_found
from ..principals import Principal
from ..transparency.entries import SealedListChanged
from ..transparency.log import append
from .competition import Competition
from .definition import CompetitionDefinition
from .stages import Stage


def seal(session: Session, by: Principal, stage: Stage, secret: bytes | None = None) -> SealedList:
    """Give a stage a sealed list; one that it has stays, and one that was withdrawn is its list again.

    A commitment that everybody could read never changes, so nobody can draw secrets until one suits them.

    Args:
        session: of the transaction.
        by: an organizer.
        stage: which one.
        secret: of the list; None: a new one, where the stage never had one.

    Raises:
        ServiceError: not an organizer, or another secret was committed to.
    """
    by.require_organizer(stage.competition)
    sealed = session.scalar(select(SealedList).where(*stage.make_rows(SealedList)))
    if sealed is None:
        return _make_list(session, by, stage, secret or secrets.token_bytes(SECRET_BYTES))
    if secret is not None and make_commitment(secret) != sealed.commitment:
        raise ServiceError(
            ProblemCode.LIST_SEALED,
            f"Stage {stage.name} of {stage.track} is committed to {sealed.commitment}, expected the secret behind it; "
            "a published commitment does not change.",
        )
    if sealed.withdrawn_at is not None:
        before = {"withdrawn_at": sealed.withdrawn_at.isoformat()}
        sealed.withdrawn_at = None
        record(session, by, "list.seal", stage.subject, {"commitment": sealed.commitment}, before=before)
        _log_change(session, sealed, "sealed")
    return sealed


def withdraw(session: Session, by: Principal, stage: Stage) -> None:
    """Take the list of a stage that is to play the public one out of play; nothing happens where it has none.

    Its commitment stays public, as a withdrawn one.

    Raises:
        ServiceError: not an organizer, or an evaluation plays the list.
    """
    by.require_organizer(stage.competition)
    if stage.sealed_list is not None:
        _withdraw(session, by, stage, stage.sealed_list)


def withdraw_unplayed(session: Session, by: Principal, competition: Competition) -> None:
    """Take the lists of stages out of play that the competition's file no longer has.

    Raises:
        ServiceError: not an organizer, or an evaluation plays one of the lists.
    """
    by.require_organizer(competition.name)
    known = {(stage.track, stage.name) for stage in competition.stages}
    for sealed in sealed_lists(session, competition):
        if (sealed.track, sealed.stage) not in known and sealed.withdrawn_at is None:
            _withdraw(session, by, competition.stored_stage(sealed.track, sealed.stage), sealed)


def refuse_reopening(competition: Competition, definition: CompetitionDefinition, at: datetime) -> None:
    """Refuse a file by which a stage would take submissions after its secret was published, or its final list played.

    Raises:
        ServiceError: stage_in_use.
    """
    for sealed in sealed_lists(competition.session, competition):
        track = definition.tracks.get(sealed.track)
        rules = track.find_board(sealed.stage) if track else None
        over_since = sealed.revealed_at or sealed.played_at
        if over_since is not None and rules is not None and rules.closes > at:
            what = "secret" if sealed.revealed_at else "list"
            how = "published" if sealed.revealed_at else "played"
            raise ServiceError(
                ProblemCode.STAGE_IN_USE,
                f"The {what} of stage {sealed.stage} of {sealed.track} was {how} at {over_since:%F %T} UTC, "
                f"so it never opens again: expected closes before now, got {rules.closes:%F %T} UTC. Add another "
                "stage with a list of its own.",
            )


def _make_list(session: Session, by: Principal, stage: Stage, secret: bytes) -> SealedList:
    made = SealedList(
        commitment=make_commitment(secret),
        **stage.place,
        secret=secret.hex(),
    )
    session.add(made)
    session.flush()
    record(session, by, "list.seal", stage.subject, {"commitment": made.commitment})
    _log_change(session, made, "sealed")
    return made


def _withdraw(session: Session, by: Principal, stage: Stage, sealed: SealedList) -> None:
    if session.scalar(select(exists().where(Evaluation.commitment == sealed.commitment))):
        raise ServiceError(
            ProblemCode.STAGE_IN_USE,
            f"Stage {stage.name} of {stage.track} has evaluations on its sealed list. Keep it sealed.",
        )
    sealed.withdrawn_at = read_clock(session)
    session.flush()
    before = {"commitment": sealed.commitment}
    record(session, by, "list.withdraw", stage.subject, {"commitment": None}, before=before)
    _log_change(session, sealed, "withdrawn")


def reveal(session: Session, by: Principal, stage: Stage) -> SealedList:
    """Publish the secret of a stage's list, which cannot be undone; the caller says when it is time.

    Raises:
        ServiceError: not an organizer, there is no such list, or an evaluation of it has not ended.
    """
    by.require_organizer(stage.competition)
    of_stage = *stage.make_rows(SealedList), SealedList.withdrawn_at.is_(None)
    sealed = session.scalar(select(SealedList).where(*of_stage).with_for_update())
    if sealed is None:
        raise not_found("sealed list of", f"{stage.track}/{stage.name}")
    active = select(func.count()).where(
        Evaluation.commitment == sealed.commitment, Evaluation.state.in_(ACTIVE_EVALUATION_STATES)
    )
    if stage.live is not None and sealed.played_at is None:
        raise ServiceError(
            ProblemCode.LIST_SEALED, f"Expected {stage} to be played before its secret is published; wait until then."
        )
    if waiting := session.scalar(active):
        raise ServiceError(
            ProblemCode.LIST_SEALED,
            f"Expected no evaluation of {stage} that waits or runs, got {waiting}; wait or cancel.",
        )
    if sealed.revealed_at is None:
        sealed.revealed_at = read_clock(session)
        record(session, by, "list.reveal", stage.subject, {"commitment": sealed.commitment})
        _log_change(session, sealed, "published")
    return sealed


def _log_change(session: Session, of: SealedList, change: Literal["sealed", "withdrawn", "published"]) -> None:
    """Add it to the log, with the secret only where that is published."""
    append(
        session,
        lambda at: SealedListChanged(
            issued_at=at,
            competition=of.competition,
            track=of.track,
            stage=of.stage,
            change=change,
            commitment=of.commitment,
            secret=of.secret if change == "published" else None,
        ),
    )


def sealed_lists(session: Session, competition: Competition) -> list[SealedList]:
    """Return the sealed lists of a competition, by track and stage, also withdrawn ones."""
    of_competition = select(SealedList).where(SealedList.competition == competition.name)
    return list(session.scalars(of_competition.order_by(SealedList.track, SealedList.stage)))


def find_secret(session: Session, commitment: str) -> bytes:
    """Return the secret that belongs to a commitment, for the worker that plays the list."""
    fresh = session.get(FreshList, commitment)
    return bytes.fromhex((fresh or session.get_one(SealedList, commitment)).secret)


def make_fresh_list(session: Session, evaluation: Evaluation) -> None:
    """Give an evaluation a list of its own, by the same law as the sealed one, which nobody plays again."""
    secret = secrets.token_bytes(SECRET_BYTES)
    evaluation.fresh_commitment = make_commitment(secret)
    session.add(FreshList(commitment=evaluation.fresh_commitment, evaluation_id=evaluation.id, secret=secret.hex()))
    session.flush()


def throw_away_fresh_list(session: Session, evaluation: Evaluation) -> None:
    """Forget the list of an evaluation that has ended."""
    session.execute(delete(FreshList).where(FreshList.evaluation_id == evaluation.id))


def played_track(session: Session, track: str, commitment: str | None) -> Track:
    """Return a track with the lists that were played: by the secret of a commitment, or the public ones for None."""
    return load_played_track(track, None if commitment is None else find_secret(session, commitment))


def derive_list_seed(session: Session, commitment: str, track: str, task: str) -> int | None:
    """Return the seed of a sealed list, with which its episodes are played again; None for the public one (empty)."""
    if not commitment:
        return None
    return played_track(session, track, commitment).task(task).episode_list.list_seed
