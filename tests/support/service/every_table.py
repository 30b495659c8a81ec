"""A row in every table of the service, and what all rows are: for what must lose none of them."""

from datetime import UTC, datetime, timedelta
from uuid import uuid4

from sqlalchemy import select, text
from sqlalchemy.orm import Session
from vitac.server.competitions.sealing import seal
from vitac.server.database.engine import Database
from vitac.server.database.models import (
    ActionTrace,
    Announcement,
    Appeal,
    AppealReplay,
    ArchiveCopy,
    Base,
    Brief,
    Cosignature,
    DeclaredEvaluator,
    EnteredResult,
    EpisodeDifference,
    EpisodeResult,
    Evaluation,
    FreshList,
    HumanBaseline,
    Invitation,
    JudgingConflict,
    JudgingMark,
    LivePicture,
    LogCopy,
    MetricTotal,
    NearCopy,
    Notice,
    PartialUpload,
    Playback,
    Qualification,
    Question,
    Rejudgement,
    SensorCheck,
    Station,
    Submission,
    SubmissionFile,
    Team,
    TeamQuota,
    TreeNode,
    UploadPart,
    Webhook,
    Worker,
)
from vitac.server.database.states import AppealState, FileRole, NoticeChannel, NoticeKind, Quota, WorkerState, WorkState
from vitac.server.principals import CONSOLE

from competitions import make_competition, put_in_place, stored_stage

TEXT = "Ünïcode, 'quotes', \\ and\ttabs\nover lines"


def fill_every_table(session: Session, submission: Submission, evaluation: Evaluation, file_sha256: str) -> None:
    """Adds a row to each table that an evaluated submission leaves empty; `file_sha256` is of a stored file."""
    definition = put_in_place(session, make_competition())
    track, found = next(iter(definition.tracks.items()))
    stage, team_id, now = found.stages[0].name, submission.team_id, datetime.now(UTC)
    episode = session.scalars(select(EpisodeResult).limit(1)).one()
    earlier = session.scalars(select(Submission).limit(1)).one()
    upload = PartialUpload(
        team_id=team_id, kind=submission.kind, track=None, again=False, file_name=None, total_bytes=9, expires_at=now
    )
    appeal = Appeal(
        team_id=team_id, evaluation_id=evaluation.id, text=TEXT, state=AppealState.UPHELD, ended_at=now, ruling=TEXT
    )
    seal(session, CONSOLE, stored_stage(session, track, stage))
    session.add_all([upload, appeal])
    session.flush()
    session.add_all(
        [
            ActionTrace(evaluation_id=evaluation.id, task="gone", action_size=3, actions=b"\0\x7f\xff\\n"),
            FreshList(evaluation_id=evaluation.id, commitment="2" * 64, secret="3" * 64),
            Announcement(title="News", text=TEXT),
            Cosignature(witness="ants+0+0", size=1, signature=b"\0\x7f\xff\\n", signed_at=now),
            TreeNode(level=1, number=9, hash=b"\0\x7f\xff\\n"),
            AppealReplay(
                appeal_id=appeal.id, task=episode.task, episode=1, policy_sha256="1" * 64, corrected=True,
                outcome="success", env_steps=3, same_states=False, old_outcome="steps", old_env_steps=4,
                owner="appeal:1", requires="1 tactile", priority=2,
            ),
            EpisodeDifference(
                evaluation_id=evaluation.id, task=episode.task, episode=1,
                stored_digest="0" * 64, differing_digest="3" * 64,
            ),
            Invitation(team_id=team_id, code_sha256="2" * 64, expires_at=now + timedelta(days=1)),
            JudgingConflict(team_id=team_id, judge="Ann", reason=TEXT),
            JudgingMark(submission_id=submission.id, judge="Bob", criterion="novelty", mark=7.1),
            LogCopy(evaluation_id=evaluation.id, earlier_submission_id=earlier.id, episodes=1),
            NearCopy(
                evaluation_id=evaluation.id, earlier_submission_id=earlier.id, task="gone", near=1, episodes=2,
                difference=0.1,
            ),
            ArchiveCopy(submission_id=submission.id, earlier_submission_id=earlier.id, code=0.9, weights=None),
            Brief(
                competition="cup", track=track, stage=stage, team_id=team_id, content=b"%PDF-1.7\0", sha256="7" * 64,
                pages=2,
            ),
            EnteredResult(
                competition="cup", track=track, stage=stage, baseline="ours", attempt=1, points={"tube": 1.5},
                evidence=TEXT, entered_by="console",
            ),
            HumanBaseline(track="gone", task="gone", episodes=[("cuboid", True, 4)], published_by="console"),
            DeclaredEvaluator(track="track_1", version="1+abc"),
            MetricTotal(name="vitac_episodes_total", labels="{}", value=0.1),
            Notice(
                kind=NoticeKind.FINISHED, team_id=team_id, subject="evaluation:9", channel=NoticeChannel.MAIL,
                target="ann@example.org", facts={"name": TEXT}, problem=TEXT,
            ),
            Playback(
                key="4" * 64, episode_id=episode.id, evaluator_version="1", state=WorkState.FAILED,
                owner="visitor", requires="1 tactile", priority=3, problem=TEXT,
            ),
            Qualification(competition="cup", track=track, stage=stage, team_id=team_id),
            Announcement(competition="cup", team_id=team_id, title=TEXT, text=TEXT),
            Question(team_id=team_id, text=TEXT, public=True),
            Rejudgement(track=track, stage=stage, reason=TEXT),
            SubmissionFile(
                submission_id=submission.id, role=FileRole.DOCUMENT, sha256=file_sha256, n_bytes=1, name="design.pdf",
                facts={"pages": 2},
            ),
            TeamQuota(team_id=team_id, quota=Quota.TOKENS, most=None),
            UploadPart(upload_id=upload.id, first_byte=0, n_bytes=4, key=str(uuid4())),
            SensorCheck(
                evaluation_id=evaluation.id, state=WorkState.FAILED, problem=TEXT,
                owner="team:9", requires="1 tactile", priority=1,
            ),
            Station(name="station-1", key_sha256="6" * 64, worker_id=None, twin=TEXT),
            Webhook(team_id=team_id, address="https://hook.example.org/", secret="5" * 64),
            Worker(
                host="gone", pid=1, slots=1, state=WorkerState.STOPPED, evaluator_version="1", platform_class="x",
                isolation="",
            ),
        ]
    )  # fmt: skip
    session.flush()
    session.add(
        LivePicture(
            station="station-1", competition="cup", track=track, stage=stage, picture=b"\0\x7f\xff\\n", taken_at=now
        )
    )  # fmt: skip
    session.get_one(Team, team_id).contact = "ann@example.org"


def rows_of_every_table(database: Database) -> dict[str, list[str]]:
    """All rows as the database writes them, by table, in the order of their text."""
    with database.transaction() as session:
        return {
            table.name: list(session.scalars(text(f"SELECT t::text FROM {table.name} t ORDER BY 1")))  # noqa: S608
            for table in Base.metadata.sorted_tables
        }
