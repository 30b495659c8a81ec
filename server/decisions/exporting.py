"""Writes a board with its receipts and records to a file that anybody can audit; for `vitac admin receipt export`."""

import zipfile
from collections.abc import Collection, Iterable, Iterator
from io import BytesIO
from pathlib import Path
from uuid import UUID

from sqlalchemy import select
from sqlalchemy.orm import Session
from vitac.evaluator.logs.log import LogHeader, write_log
from vitac.evaluator.strict_model import StrictModel
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks.registry import further_track_files

from ..competitions.competition import Competition
from ..competitions.stages import Stage
from ..database.clock import read_clock
from ..database.engine import among
from ..database.models import AuditEntry, BoardResult, Evaluation, Submission, Team
from ..database.states import FileRole
from ..errors import ProblemCode, ServiceError
from ..evaluations.episode_store import EpisodeKey, read_stored_records
from ..evaluations.provenance import read_provenance
from ..leaderboards.standings import leaderboard
from ..receipts.export import (
    DESCRIPTION_NAME,
    ENDS_NAME,
    LOG_NAME,
    RECEIPTS_NAME,
    SUBMISSIONS_NAME,
    ExportDescription,
    ExportedTeam,
    log_name,
    sensor_name,
    track_name,
)
from ..receipts.issuing import list_entries, receipts_of_board, receipts_of_ends
from ..receipts.receipt import Receipt, SubmissionReceipt
from ..receipts.witnesses import list_witnessed_checkpoints
from ..storage.blobs import BlobStore
from ..storage.scratch import new_file
from ..submissions.files import find_file
from ..submissions.sensors import coefficients_digest
from ..tracks import load_known_track
from ..transparency.log import read_log_state
from ..visibility import is_sealed
from .finishing import judged_entries, winning_entries
from .publishing import ResultsNotWritten
from .rejudging import set_aside


def read_teams(session: Session, evaluations: Collection[UUID]) -> tuple[ExportedTeam, ...]:
    """Return the teams of some evaluations, by name."""
    rows = session.execute(
        select(Team, Evaluation.id, Submission.is_off_boards)
        .join(Submission, Submission.team_id == Team.id)
        .join(Evaluation, Evaluation.submission_id == Submission.id)
        .where(Evaluation.id.in_(evaluations))
        .order_by(Team.name, Evaluation.id)
    )
    by_team: dict[Team, list[UUID]] = {}
    disqualified: set[UUID] = set()
    for team, evaluation, is_off_boards in rows:
        by_team.setdefault(team, []).append(evaluation)
        if is_off_boards:
            disqualified.add(evaluation)
    return tuple(_exported(session, team, ids, disqualified.intersection(ids)) for team, ids in by_team.items())


def _exported(
    session: Session, team: Team, evaluations: Collection[UUID], disqualified: Collection[UUID]
) -> ExportedTeam:
    is_removed = team.erased_at is not None
    return ExportedTeam(
        name=team.name,
        evaluations=tuple(evaluations),
        former_names=() if is_removed else tuple(sorted(set(_former_names(session, str(team.id))) - {team.name})),
        off_boards=f"disqualified, {team.disqualified_for}" if team.disqualified_at is not None else None,
        disqualified=tuple(sorted(disqualified)),
        is_removed=is_removed,
    )


def _former_names(session: Session, team: str) -> Iterator[str]:
    """Yield the names that a team had, and those of the teams that were merged into it; one cannot be merged twice."""
    lines = session.scalars(
        select(AuditEntry).where(
            AuditEntry.subject == f"team:{team}", AuditEntry.action.in_(["team.rename", "team.merge"])
        )
    )
    for line in lines:
        before = line.before or {}
        if line.action == "team.rename":
            yield before["name"]
        else:
            yield before["teams"][0]
            yield from _former_names(session, before["merged"])


def export_receipts(
    session: Session,
    blobs: BlobStore,
    path: Path,
    stage: Stage,
    *,
    task: str | None = None,
    kind: SubmissionKind = SubmissionKind.MODEL,
) -> ExportDescription:
    """Write the board of a track with all that its audit needs to a new file.

    It holds the receipts of all results of the stage, or nobody could see that one was taken off the board. Records
    and sensors of a sealed list are left out until its secret is published, and a sensor that was replaced after the
    evaluation. The file gets its name when it is whole.

    Args:
        session: of a transaction that sees one moment (`Database.snapshot`): results may end meanwhile.
        blobs: where the teams' sensors are.
        path: of the new file.
        stage: whose board.
        task: as for `leaderboard`.
        kind: model or log; logs are ranked task by task.

    Raises:
        ResultsNotWritten: the file exists or cannot be made.
        ServiceError: there is no such board, or a sensor cannot be read.
    """
    _require_board(stage.track, task, kind)
    board = leaderboard(session, stage, task=task, kind=kind, live=True).view
    sealed, state = stage.sealed_list, read_log_state(session)
    of_board, competition = receipts_of_board(session, stage, kind), Competition.read(session, stage.competition)
    receipts = [receipt for receipt in of_board if isinstance(receipt, Receipt)]
    results = [receipt.result.evaluation for receipt in receipts]
    description = ExportDescription(
        made_at=read_clock(session),
        public_key=state.public_key,
        secret=sealed.secret if sealed and sealed.revealed_at else None,
        commitment=stage.commitment,
        competition=stage.competition,
        board=board,
        kind=kind,
        checkpoint=state.checkpoint,
        witnesses=competition.definition.witnesses if competition.is_held else (),
        witnessed=tuple(map(str, list_witnessed_checkpoints(session))),
        teams=read_teams(session, results),
        set_aside=set_aside(session, results),
        copies=_copies(session, results),
        winners=winning_entries(competition),
        judged=judged_entries(session, competition),
    )
    evaluations = [entry.evaluation_id for entry in board.entries]
    try:
        with new_file(path) as unfinished, zipfile.ZipFile(unfinished, "x", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(DESCRIPTION_NAME, description.model_dump_json(indent=1))
            archive.writestr(LOG_NAME, _lines(list_entries(session)))
            archive.writestr(
                SUBMISSIONS_NAME, _lines(receipt for receipt in of_board if isinstance(receipt, SubmissionReceipt))
            )
            archive.writestr(RECEIPTS_NAME, _lines(receipts))
            archive.writestr(ENDS_NAME, _lines(receipts_of_ends(session)))
            if own_file := further_track_files().get(stage.track):
                archive.write(own_file, track_name(stage.track))
            for evaluation_id in evaluations:
                _write_played(session, blobs, archive, session.get_one(Evaluation, evaluation_id))
    except OSError as error:
        raise ResultsNotWritten(f"{path} cannot be written: {error.strerror}. Name a new file.") from error
    return description


def _lines(models: Iterable[StrictModel]) -> str:
    return "".join(f"{model.model_dump_json()}\n" for model in models)


def _require_board(track: str, task: str | None, kind: SubmissionKind) -> None:
    if not kind.form.is_ranked:
        raise ServiceError(
            ProblemCode.UNSUPPORTED_SUBMISSION_KIND, "2025 text logs are not ranked, so there is no board of them."
        )
    if not kind.form.runs_policy and task is None:
        tasks = ", ".join(load_known_track(track).tasks)
        raise ServiceError(ProblemCode.UNKNOWN_TASK, f"Logs are ranked task by task; name one of {tasks}.")


def _copies(session: Session, evaluations: Collection[UUID]) -> tuple[UUID, ...]:
    of_results = among(BoardResult.evaluation_id, evaluations)
    copies = select(BoardResult.evaluation_id).where(BoardResult.is_copy, of_results).distinct()
    return tuple(sorted(session.scalars(copies)))


def _write_played(session: Session, blobs: BlobStore, archive: zipfile.ZipFile, evaluation: Evaluation) -> None:
    """Write what was played for an entry of the board, and with which sensor."""
    submission = evaluation.submission
    if is_sealed(evaluation):
        return
    sensor = find_file(session, submission.id, FileRole.SENSOR)
    if (
        sensor is not None
        and submission.team.erased_at is None
        and coefficients_digest(session, submission.id, evaluation.id, sensor.sha256)  # it is the one played with
    ):
        archive.writestr(sensor_name(evaluation.id), blobs.read(sensor.sha256))
    for task in submission.tasks:
        records = read_stored_records(session, EpisodeKey.from_evaluation(evaluation, submission), task)
        if not records:
            continue
        policy = submission.digest if submission.kind.form.runs_policy else None
        header = LogHeader(
            submission_digest=policy, manifest=read_provenance(session, evaluation, task, evaluation.commitment or "")
        )
        stream = BytesIO()
        write_log(stream, header, records)
        archive.writestr(log_name(evaluation.id, task), stream.getvalue())
