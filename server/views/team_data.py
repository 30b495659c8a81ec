"""All that the service knows of a team, as one document."""

from datetime import datetime

from pydantic import Field

from .base import View
from .by_hand import BriefView
from .correspondence import AnnouncementView, AppealView, NoticeView, QuestionView, WebhookView
from .submissions import SubmissionView
from .teams import AuditEntryView, OwnTeamView, TokenView


class TeamDataView(View):
    """Everything that the service has of a team, as far as the team may see it."""

    made_at: datetime
    team: OwnTeamView
    tokens: list[TokenView]
    submissions: list[SubmissionView]
    webhooks: list[WebhookView]
    notices: list[NoticeView]
    messages: list[AnnouncementView] = Field(description="Of organizers to this team alone.")
    questions: list[QuestionView]
    appeals: list[AppealView]
    briefs: list[BriefView]
    audit_log: list[AuditEntryView] = Field(description="What people changed of the team.")
