"""Evaluations keep what list they play and which tasks count, so that no later track file changes their results."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import ARRAY
from vitac.envs.errors import VitacError
from vitac.evaluator.tracks import ListKind, load_track

revision = "0042"
down_revision = "0041"
branch_labels = None
depends_on = None

_OF_STAGES = "UPDATE evaluations SET list_kind = 'sealed' WHERE commitment IS NOT NULL"
_OF_FILE = """
    UPDATE evaluations SET list_kind = CASE WHEN tasks && CAST(:sealed AS text[]) THEN 'sealed' ELSE 'public' END
    FROM submissions WHERE submissions.id = submission_id AND track = :track
    AND tasks <@ CAST(:known AS text[]) AND list_kind IS NULL
"""
_OF_LOGS = """
    UPDATE evaluations SET counted_tasks = tasks
    FROM submissions WHERE submissions.id = submission_id AND state = 'completed' AND kind <> 'model'
"""
_OF_MODELS = """
    UPDATE evaluations SET counted_tasks = CAST(:counted AS text[])
    FROM submissions
    WHERE submissions.id = submission_id AND state = 'completed' AND kind = 'model' AND track = :track
"""


def upgrade() -> None:
    """Add the columns, filled as the track files say now: what was shown until now stays.

    Where a track or task was removed before, nothing is known, and both stay empty.
    """
    op.add_column("evaluations", sa.Column("list_kind", sa.String(length=16), nullable=True))
    op.add_column("evaluations", sa.Column("counted_tasks", ARRAY(sa.Text()), nullable=True))
    op.create_check_constraint(op.f("ck_evaluations_list_kind"), "evaluations", "list_kind IN ('public', 'sealed')")
    connection = op.get_bind()
    for statement in (_OF_STAGES, _OF_LOGS):
        op.execute(statement)
    for name in connection.scalars(sa.text("SELECT DISTINCT track FROM submissions")).all():
        try:
            track = load_track(name)
        except VitacError:  # removed, or a file that has to be mended: it is looked up when a result is shown
            continue
        lists = {task: found.episode_list.kind for task, found in track.tasks.items()}
        sealed = [task for task, kind in lists.items() if kind is ListKind.SEALED]
        values = {"track": name, "known": list(lists), "sealed": sealed, "counted": list(track.tasks_that_count)}
        for statement in (_OF_FILE, _OF_MODELS):
            connection.execute(sa.text(statement), values)


def downgrade() -> None:
    """Remove both; results follow the track files again."""
    op.drop_column("evaluations", "list_kind")
    op.drop_column("evaluations", "counted_tasks")
