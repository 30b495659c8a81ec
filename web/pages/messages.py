"""Announcements, and questions with their answers: one page for everybody, with the form that asks."""

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response
from vitac.server.accounts.messages import list_announcements, list_questions
from vitac.server.principals import VISITOR
from vitac.server.views.correspondence import AnnouncementView, QuestionView

from ..site import get_site, get_viewer, page

ADDRESS = "/announcements"


async def messages(request: Request) -> Response:
    """Show what organizers say to everybody, and the questions that the visitor may see."""
    viewer = await get_viewer(request)
    by = viewer.principal if viewer is not None else None

    def read(session: Session) -> tuple[list[AnnouncementView], list[QuestionView]]:
        return list_announcements(session, by or VISITOR), list_questions(session, by)

    said, asked = await get_site(request).ask(read)
    return page(request, "messages.html", viewer=viewer, section=ADDRESS, said=said, asked=asked)
