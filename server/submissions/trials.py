"""Trials of stations, one by one: a team sees its own as soon as they are played, others once the list is published."""

from uuid import UUID

from sqlalchemy import Select, select
from sqlalchemy.orm import Session
from vitac.evaluator.episodes.records import EpisodeRecord

from ..accounts.shown_names import ShownNames
from ..database.models import EpisodeResult, Evaluation, SubmissionFile, Trial
from ..database.states import FileRole
from ..errors import ServiceError, not_found
from ..evaluations.episode_store import EpisodeKey
from ..evaluations.history import newest_evaluation
from ..leaderboards.public_pages import readable
from ..principals import Principal
from ..queue.work import find_station
from ..views.trials import TrialMomentView, TrialView
from ..visibility import decide_sight


def find_trial(session: Session, by: Principal, submission_id: UUID, task: str, number: int) -> TrialView:
    """Return a trial of a submission's newest evaluation.

    Raises:
        ServiceError: there is none that the principal may see.
    """
    submission = readable(session, by, submission_id)
    if task not in submission.tasks:
        raise _missing(submission_id, task, number)
    episode = _find_episode(session, by, newest_evaluation(session, submission), task, number)
    record = EpisodeRecord.model_validate(episode.record)
    evidence = record.evidence
    if evidence is None:
        raise _missing(submission_id, task, number)
    trial = session.scalars(_select_trial(newest_evaluation(session, submission), task, number)).first()
    return TrialView.from_row(
        record,
        submission_id=submission.id,
        submission_name=submission.name,
        team=ShownNames.read(session, by).show_name(submission.team),
        track=episode.track,
        station=(find_station(trial.requires) if trial else "") or evidence.station,
        twin=evidence.twin,
        moments=_list_moments(record),
        help=evidence.help,
        video=evidence.video,
        evaluator_version=episode.evaluator_version,
        record_digest=episode.record_digest,
    )


def find_video(session: Session, by: Principal, submission_id: UUID, task: str, number: int) -> SubmissionFile:
    """Return the stored video of a trial.

    Raises:
        ServiceError: there is none that the principal may see, or it was deleted with the submission's files.
    """
    trial = find_trial(session, by, submission_id, task, number)
    of_trial = (SubmissionFile.submission_id == submission_id, SubmissionFile.role == FileRole.VIDEO)
    digest = trial.video.sha256 if trial.video else ""
    video = session.scalars(select(SubmissionFile).where(*of_trial, SubmissionFile.sha256 == digest)).first()
    if video is None:
        raise not_found("video", f"of trial {number} of {task} of submission {submission_id}")
    return video


def _find_episode(session: Session, by: Principal, evaluation: Evaluation, task: str, number: int) -> EpisodeResult:
    """Return the stored row; of a planned trial its team may see it while the list is sealed: the stage has closed."""
    submission = evaluation.submission
    trial = session.scalars(_select_trial(evaluation, task, number)).first()
    is_own = by.may_see(submission.team_id, submission.competition)
    is_planned = trial is not None and bool(find_station(trial.requires))
    episode = None
    if decide_sight(by, evaluation).episodes or (is_own and is_planned):
        key = EpisodeKey.from_evaluation(evaluation, submission)
        wanted = (EpisodeResult.task == task, EpisodeResult.episode == number)
        episode = session.scalar(select(EpisodeResult).where(*key.conditions(), *wanted))
    if episode is None:
        raise _missing(submission.id, task, number)
    return episode


def _select_trial(evaluation: Evaluation, task: str, number: int) -> Select[Trial]:
    return select(Trial).where(
        Trial.evaluation_id == evaluation.id, Trial.task == task, Trial.episodes.contains([number])
    )


def _missing(submission_id: UUID, task: str, number: int) -> ServiceError:
    return not_found("trial", f"{number} of {task} of submission {submission_id}")


def _list_moments(record: EpisodeRecord) -> tuple[TrialMomentView, ...]:
    """Return what was measured after each env step; a motion that was stopped has nothing."""
    return tuple(
        TrialMomentView.model_validate(
            {
                "env_step": number,
                "frame": video["frame"] if isinstance(video := info.get("video"), dict) else None,
                "encoders": info["encoders"],
                "movement_px": info["movement_px"],
            }
        )
        for number, info in enumerate(record.infos, start=1)
        if info
    )
