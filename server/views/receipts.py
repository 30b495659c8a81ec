"""The log of receipts as everybody sees it."""

from datetime import datetime
from typing import Any
from uuid import UUID

from pydantic import Field
from vitac.evaluator.logs.findings import VerificationResult

from .base import View


class PublicLogEntryView(View):
    """One entry of the log; of submissions, results and ends it shows nothing but a hash."""

    number: int = Field(description="From 1; the index in the tree is one less.")
    content: str = Field(
        description="What it stands for: submission, result, end, competition, sealed_list, advancement, rejudgement "
        "or board."
    )
    content_sha256: str = Field(description="SHA-256 of the content, salted where the statement is null.")
    issued_at: datetime = Field(description="Never before that of the entry before.")
    board: str = Field(description="Competition, track, stage and kind of the submission.")
    statement: dict[str, Any] | None = Field(description="The content, where everybody may read it.")
    leaf_hash: str = Field(description="RFC 6962 hash of the entry's bytes, as in the tiles of /log/.")


class WitnessView(View):
    """A witness of a competition, and how far it has come."""

    witness: str = Field(description="Its verifier key: NAME+ID+KEY.")
    size: int = Field(description="Number of entries of the longest log that it has signed; 0 before the first.")
    behind: int = Field(description="Number of entries that it has not signed.")
    behind_s: float = Field(description="Age of the oldest entry that it has not signed; 0 where there is none.")
    signed_at: datetime | None = Field(description="When it signed last, as it says; null before.")


class PublicLogView(View):
    """A page of the log, or of the entries of one competition, from the beginning."""

    public_key: str = Field(description="Ed25519 key of this service (32 bytes, hexadecimal); keep a copy of it.")
    verifier_key: str = Field(description="The same key as NAME+ID+KEY, for tools that read signed notes.")
    receipts: int = Field(description="Length of the whole log.")
    root: str = Field(description="RFC 6962 root hash of the whole log.")
    checkpoint: str = Field(description="Signed by the service and by witnesses; the same as /log/checkpoint.")
    witnesses: list[WitnessView] = Field(description="Of all competitions of this service.")
    items: list[PublicLogEntryView]
    next_after: int | None = Field(description="Give this as `after` for the next page; null on the last one.")


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
