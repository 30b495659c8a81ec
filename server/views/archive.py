"""A competition after its end, as everybody sees it."""

from datetime import datetime

from pydantic import Field

from .base import View
from .contest import CompetitionView
from .leaderboards import LeaderboardView


class ArchiveView(View):
    """What was final at the end of a competition."""

    competition: CompetitionView
    boards: list[LeaderboardView] = Field(description="Of every stage, as of the end or `find_last_decision`.")
    public_key: str = Field(description="That signed the receipts of the results.")
    decided_again_at: datetime | None = Field(
        default=None, description="When it was last decided without teams that were disqualified then; null: never."
    )
    citation: str = Field(description="How to cite the results, for BibTeX.")
