"""Table of what completed evaluations are ranked by on each board, filled from their scores."""

from collections.abc import Iterator
from fractions import Fraction
from statistics import fmean
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None

ALL_TASKS = "*"
TRACK_TASKS = {"track_1": frozenset({"peg-insertion", "lock-opening"})}
"""The tracks with several tasks, as they are at this revision: track files may change later, history may not."""
RANKING = (sa.text("success_rate DESC"), sa.text("mean_steps"), sa.text("submitted_at"), sa.text("evaluation_id"))
ROWS_AT_ONCE = 1000

COMPLETED = """
    SELECT evaluations.id, scores, track, kind, team_id, submission_id, evaluator_version, created_at, tasks
    FROM evaluations JOIN submissions ON submissions.id = submission_id WHERE state = 'completed'
"""


def upgrade() -> None:
    """Make the table and fill it."""
    op.create_table(
        "board_results",
        sa.Column("evaluation_id", sa.Uuid(), nullable=False),
        sa.Column("board", sa.Text(), nullable=False),
        sa.Column("track", sa.Text(), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("team_id", sa.Uuid(), nullable=False),
        sa.Column("submission_id", sa.Uuid(), nullable=False),
        sa.Column("evaluator_version", sa.Text(), nullable=False),
        sa.Column("success_rate", sa.Float(), nullable=False),
        sa.Column("mean_steps", sa.Float(), nullable=True),
        sa.Column("submitted_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint(
            "success_rate >= 0 AND success_rate <= 1", name=op.f("ck_board_results_success_rate_is_a_fraction")
        ),
        sa.CheckConstraint("mean_steps < 'Infinity'", name=op.f("ck_board_results_mean_steps_is_finite")),
        sa.CheckConstraint("kind IN ('model', 'log', 'text_log')", name=op.f("ck_board_results_kind")),
        sa.ForeignKeyConstraint(
            ["evaluation_id"], ["evaluations.id"], name=op.f("fk_board_results_evaluation_id"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_board_results_team_id"), ondelete="RESTRICT"),
        sa.ForeignKeyConstraint(
            ["submission_id"], ["submissions.id"], name=op.f("fk_board_results_submission_id"), ondelete="RESTRICT"
        ),
        sa.PrimaryKeyConstraint("evaluation_id", "board", name=op.f("pk_board_results")),
    )
    fill()
    of_team = ("track", "kind", "board", "team_id", *RANKING)
    of_version = ("track", "kind", "board", "evaluator_version", "team_id", *RANKING)
    op.create_index("ix_board_results_of_version", "board_results", of_version)
    op.create_index("ix_board_results_of_team", "board_results", of_team)


def downgrade() -> None:
    """Remove the table; the scores that it repeats stay."""
    op.drop_table("board_results")


def fill() -> None:
    """Add the rows of all completed evaluations."""
    connection = op.get_bind()
    table = sa.Table("board_results", sa.MetaData(), autoload_with=connection)
    evaluations = connection.execute(sa.text(COMPLETED)).partitions(ROWS_AT_ONCE)
    for some in evaluations:
        rows = [row for evaluation in some for row in rows_of(evaluation)]
        if rows:
            connection.execute(sa.insert(table), rows)


def rows_of(evaluation: Any) -> Iterator[dict[str, Any]]:
    """Yield the row of each task that was played, and that of all together for a model."""
    common = {
        "evaluation_id": evaluation.id,
        "submitted_at": evaluation.created_at,
        **{
            name: getattr(evaluation, name)
            for name in ("track", "kind", "team_id", "submission_id", "evaluator_version")
        },
    }
    for score in evaluation.scores:
        yield common | {
            "board": score["task"],
            "success_rate": score["success_rate"],
            "mean_steps": score["mean_steps"],
        }
    if evaluation.kind == "model":
        yield common | {"board": ALL_TASKS, **combination(evaluation.scores, tasks_of(evaluation))}


def combination(scores: list[dict[str, Any]], tasks: frozenset[str]) -> dict[str, float | None]:
    """Return mean success rate and mean of mean env steps, as `evaluator.scoring.ranking.combine` at this revision."""
    played = [score for score in scores if score["task"] in tasks]
    rates = sum((Fraction(score["successes"], score["episodes"]) for score in played), Fraction(0))
    steps = [score["mean_steps"] for score in played if score["mean_steps"] is not None]
    return {
        "success_rate": float(rates / len(tasks)),
        "mean_steps": fmean(steps) if len(steps) == len(tasks) else None,
    }


def tasks_of(evaluation: Any) -> frozenset[str]:
    """Return the tasks of its track; those of the submission where this revision does not know the track."""
    return TRACK_TASKS.get(evaluation.track, frozenset(evaluation.tasks))
