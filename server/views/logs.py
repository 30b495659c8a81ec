"""Uploaded logs as they are shown: claims, verification result, and how models of the team compare with them."""

from datetime import datetime
from typing import Any
from uuid import UUID

from pydantic import Field
from vitac.evaluator.logs.findings import VerificationResult

from .base import View


class DivergenceView(View):
    """The first env step at which a log's actions led elsewhere; step 0 is after the reset."""

    episode: int
    env_step: int
    recorded_state: str | None = Field(description="SHA-256 of the state, as the log has it.")
    recorded_info: dict[str, Any] | None = Field(description="What the log says about that env step, in our form.")
    resimulated_state: str | None
    resimulated_info: dict[str, Any] | None


class LogView(View):
    """What an uploaded log claims, and what its re-simulation says of it."""

    label: str = Field(description="What a score of it is worth, in a few words.")
    verdict: VerificationResult | None = Field(description="Null before the end, and always for a 2025 text log.")
    reason: str | None = Field(description="The verdict in a sentence; of a 2025 text log, why the rates differ.")
    divergence: DivergenceView | None
    claimed_episodes: int
    claimed_successes: int
    claimed_success_rate: float
    claimed_mean_steps: float | None
    claimed_result_hash: str | None = Field(description="Follows from the log's records; null for a 2025 text log.")
    team_named: str | None
    submission_digest_named: str | None = Field(description="Digest of the model that the log says it is of.")
    made_on: str | None = Field(description="Platform class that the log says it was made on.")
    problems: list[str] = Field(description="Numbers of a 2025 text log that do not follow from each other.")


class MatchedEpisodeView(View):
    """How far a model's own episode went along with the log's."""

    episode: int
    actions: int
    reproduced: int
    first_mismatch: int | None = Field(description="Env step of the first other action; null if there is none.")


class ActionMatchView(View):
    """How many of a log's actions a model that the team uploaded gives.

    Both were played from the same starts. Up to the first other action of an episode both saw the same; what comes
    after it cannot be compared, so it counts as not reproduced.
    """

    submission_id: UUID
    submission_name: str
    evaluated_at: datetime
    actions: int
    reproduced: int
    episodes: int
    episodes_reproduced: int
    others: list[MatchedEpisodeView] = Field(description="The episodes with an other action.")
