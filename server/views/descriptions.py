"""What a team writes about a public result."""

from pydantic import Field

from .base import View


class DescriptionView(View):
    """A text and links; all empty where nothing is shown."""

    text: str = Field(default="", description="Plain text of several lines.")
    code: str = Field(default="", description="https address of the code.")
    paper: str = Field(default="", description="https address of the paper.")
    discussion: str = Field(default="", description="https address of a place to discuss it.")
    revision: str = Field(default="", description="Changes with it; empty before anything is written.")
    removed_for: str | None = Field(
        default=None, description="Why an organizer removed it, for its team and organizers; null: nobody did."
    )
