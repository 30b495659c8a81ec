"""Who advances to a stage, as organizers see it by API and command."""

from pydantic import Field

from .base import View


class ProposedTeamView(View):
    """A team on the board of the stage before."""

    team: str
    rank: int
    success_rate: float
    interval: tuple[float, float] = Field(description="95 % interval of the success rate.")
    mean_steps: float | None
    advances: bool = Field(description="Whether the rule takes it.")
    at_border: bool = Field(
        description="Whether chance may have decided: its interval reaches across the border of the rule."
    )


class AdvancementView(View):
    """Who would advance by the rule, and who was confirmed."""

    track: str
    stage: str
    before: str = Field(description="Name of the stage whose board decides.")
    rule: str = Field(description="In words.")
    registered: int = Field(
        description="Teams that the rule counts: accepted, not disqualified, registered before the stage before closed."
    )
    teams: list[ProposedTeamView]
    unranked: list[str] = Field(
        description="Teams whose only results are of another evaluator version: evaluate them again first."
    )
    running: int = Field(description="Evaluations of the stage before that have not ended.")
    confirmed: list[str] = Field(description="Teams that take part, as confirmed last.")
    revision: str = Field(description="Of the confirmed teams; a confirmation names it. Empty if there are none.")
