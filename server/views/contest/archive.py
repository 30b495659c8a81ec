"""A competition after its end, as everybody sees it."""

from pydantic import Field

from ..base import View
from ..leaderboards import LeaderboardView
from .competition import CompetitionView


class ArchiveView(View):
    """What was final at the end of a competition."""

    competition: CompetitionView
    boards: list[LeaderboardView] = Field(description="Of every stage, as they were when it was finalized.")
    public_key: str = Field(description="That signed the receipts of the results.")
    citation: str = Field(description="How to cite the results, for BibTeX.")
