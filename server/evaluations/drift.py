"""The drift test of stages whose one sealed list decides at once: who learns it; for the organizers' desk."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

from sqlalchemy import select
from sqlalchemy.orm import Session, defer
from vitac.evaluator.scoring.score import ALARM_BELOW, CombinedScore, drift_p_value

from ..competitions.stages import Stage
from ..database.models import Evaluation, Submission, Team
from ..database.states import EvaluationState
from .scores import combine_scores, combined_score, read_fresh_scores


@dataclass(frozen=True, kw_only=True)
class Drift:
    """How the results of a team changed over its runs.

    Attributes:
        sealed: success rates on the sealed list, the first run first.
        fresh: the same on fresh lists, each of which was played once.
        p_value: how likely so steep a rise of the first against the second is by chance.
    """

    team: str
    stage: str
    sealed: tuple[float, ...]
    fresh: tuple[float, ...]
    p_value: float

    @property
    def is_alarm(self) -> bool:
        """Whether chance does not explain it."""
        return self.p_value < ALARM_BELOW


def list_drifts(session: Session, stage: Stage) -> Iterator[Drift]:
    """Yield the drift of each team with two runs or more in a stage, by name."""
    rows = session.execute(
        select(Team.name, Evaluation)
        .join(Submission, Submission.team_id == Team.id)
        .join(Evaluation, Evaluation.submission_id == Submission.id)
        .where(
            stage.submissions,
            Evaluation.state == EvaluationState.COMPLETED,
            Evaluation.fresh_scores.is_not(None),
            ~Evaluation.is_proposed,
        )
        .order_by(Team.name, Evaluation.created_at, Evaluation.id)
        .options(defer(Evaluation.log_tail))
    )
    for team, of_team in groupby(rows, key=lambda row: row[0]):
        runs = [pair for _, evaluation in of_team if (pair := _read_pair(evaluation)) is not None]
        p_value = drift_p_value(runs)
        if p_value is not None:
            yield Drift(
                team=team,
                stage=f"{stage.title} of {stage.track_rules.title}",
                sealed=tuple(sealed.success_rate for sealed, _ in runs),
                fresh=tuple(fresh.success_rate for _, fresh in runs),
                p_value=p_value,
            )


def _read_pair(evaluation: Evaluation) -> tuple[CombinedScore, CombinedScore] | None:
    sealed = combined_score(evaluation)
    fresh = combine_scores(evaluation, read_fresh_scores(evaluation))
    return None if sealed is None or fresh is None else (sealed, fresh)
