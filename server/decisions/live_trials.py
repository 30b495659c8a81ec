"""Pictures of running trials, which everybody sees later by the organizer's delay: nothing says whose they are."""

from datetime import timedelta

from sqlalchemy import delete, func, select
from sqlalchemy.orm import Session

from ..competitions.competition import Competition, find_stage
from ..database.clock import read_clock
from ..database.models import LivePicture, Trial
from ..errors import not_found

_KEPT = timedelta(minutes=1)
"""Beyond the delay."""


def store_picture(session: Session, station: str, code: str, picture: bytes) -> bool:
    """Store what a station's cameras see in the trial with a code; whether anybody will see it."""
    trial = session.scalars(select(Trial).where(Trial.code == code)).first()
    if trial is None:
        return False
    stage = find_stage(session, trial.evaluation.submission)
    plan = stage.rules.plan
    if plan is None or plan.live_delay_s is None:
        return False
    oldest = read_clock(session) - timedelta(seconds=plan.live_delay_s) - _KEPT
    session.execute(delete(LivePicture).where(LivePicture.station == station, LivePicture.taken_at < oldest))
    session.add(LivePicture(station=station, picture=picture, **stage.place))
    return True


def find_picture(session: Session, competition: str, track: str, stage: str, station: str) -> LivePicture:
    """Return what everybody may see of a station now.

    Raises:
        ServiceError: there is no such stage, or nothing to see.
    """
    played = Competition.find(session, competition, track=track).stage(track, stage)
    delay_s = played.rules.plan.live_delay_s if played.rules.plan else None
    shown = None
    if delay_s is not None:
        latest = func.now() - timedelta(seconds=delay_s)
        window = (LivePicture.taken_at <= latest, LivePicture.taken_at > latest - _KEPT)
        query = select(LivePicture).where(LivePicture.station == station, *played.make_rows(LivePicture), *window)
        shown = session.scalars(query.order_by(LivePicture.taken_at.desc()).limit(1)).first()
    if shown is None:
        raise not_found("live picture", f"of station {station}")
    return shown
