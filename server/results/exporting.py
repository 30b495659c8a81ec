"""Writes a board with its receipts and records to a file that anybody can audit; for `vitac admin receipt export`."""

import zipfile
from collections.abc import Iterable
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path

from sqlalchemy.orm import Session
from vitac.evaluator.logs.log import LogHeader, write_log
from vitac.evaluator.strict_model import StrictModel
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.accounts.visibility import is_sealed
from vitac.server.competition.definition import DEFAULT_RANKING
from vitac.server.competition.schedule import track_rules
from vitac.server.competition.sealing import list_of_stage
from vitac.server.db.models import Evaluation
from vitac.server.evaluations.episode_store import EpisodeKey, records_of
from vitac.server.evaluations.provenance import manifest_of
from vitac.server.leaderboards.standings import leaderboard
from vitac.server.receipts.chain import chain_state, links, receipts_of_board
from vitac.server.receipts.export import (
    CHAIN_NAME,
    DESCRIPTION_NAME,
    RECEIPTS_NAME,
    ExportDescription,
    log_name,
)

from .exported_teams import teams_of
from .publishing import ResultsNotWritten
from .rejudging import set_aside


def export_receipts(
    session: Session, path: Path, track: str, *, task: str | None = None, stage: str | None = None
) -> ExportDescription:
    """Write the board of a track with all that its audit needs to a new file.

    It holds the receipts of all results of the stage, or nobody could tell that one was taken off the board. Records
    of a sealed list are left out until its secret is published.

    Args:
        session: of a transaction that sees one moment (`Database.snapshot`): results may end meanwhile.
        path: of the new file.
        track: whose board.
        task: as for `leaderboard`.
        stage: as for `leaderboard`.

    Raises:
        ResultsNotWritten: the file exists or cannot be made.
        ServiceError: there is no such board.
    """
    board = leaderboard(session, track, task=task, stage=stage, live=True).view
    rules = track_rules(session, track)
    sealed = list_of_stage(session, track, board.stage) if board.stage else None
    state = chain_state(session)
    receipts = receipts_of_board(session, track, board.stage or "", SubmissionKind.MODEL)
    results = [receipt.result.evaluation for receipt in receipts]
    description = ExportDescription(
        made_at=datetime.now(UTC),
        public_key=state.public_key,
        ranking=tuple(key.value for key in (rules.ranking if rules else DEFAULT_RANKING)),
        secret=sealed.secret if sealed and sealed.revealed_at else None,
        board=board,
        receipts=state.receipts,
        last=state.last,
        teams=teams_of(session, results),
        set_aside=set_aside(session, results),
    )
    evaluations = [entry.evaluation_id for entry in board.entries]
    try:
        with zipfile.ZipFile(path, "x", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(DESCRIPTION_NAME, description.model_dump_json(indent=1))
            archive.writestr(CHAIN_NAME, _lines(links(session)))
            archive.writestr(RECEIPTS_NAME, _lines(receipts))
            for evaluation_id in evaluations:
                _write_logs(session, archive, session.get_one(Evaluation, evaluation_id))
    except OSError as error:
        raise ResultsNotWritten(f"{path} cannot be written: {error.strerror}. Name a new file.") from error
    return description


def _lines(models: Iterable[StrictModel]) -> str:
    return "".join(f"{model.model_dump_json()}\n" for model in models)


def _write_logs(session: Session, archive: zipfile.ZipFile, evaluation: Evaluation) -> None:
    submission = evaluation.submission
    if is_sealed(evaluation):
        return
    for task in submission.tasks:
        records = records_of(session, EpisodeKey.of(evaluation, submission), task)
        if not records:
            continue
        header = LogHeader(submission_digest=submission.digest, manifest=manifest_of(session, evaluation, task))
        stream = BytesIO()
        write_log(stream, header, records)
        archive.writestr(log_name(evaluation.id, task), stream.getvalue())
