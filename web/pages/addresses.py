"""What the addresses of pages name. Called by the pages."""

from dataclasses import dataclass
from typing import Self
from urllib.parse import urlencode
from uuid import UUID

from starlette.requests import Request
from vitac.server.errors import not_found


def as_id(text: str) -> UUID:
    """Return the id in an address.

    Raises:
        ServiceError: it is not an id, so there is no such submission.
    """
    try:
        parsed = UUID(text)
    except ValueError as error:
        raise not_found("submission", text) from error
    if str(parsed) != text.lower():  # UUID also reads braces and digits of other scripts
        raise not_found("submission", text)
    return parsed


def read_competition_name(request: Request) -> str | None:
    """Return the name of the competition in an address below `/competitions`; None in others."""
    name: str | None = request.path_params.get("competition")
    return name


def competition_address(competition: str | None) -> str:
    """Return the address of a competition's page; `competition` None: of the one that opened last."""
    return "/competition" if competition is None else f"/competitions/{competition}"


def board_address(competition: str | None, track: str) -> str:
    """Return the address of a track's boards; `competition` None: in the competition that opened last."""
    return f"/tracks/{track}" if competition is None else f"/competitions/{competition}/tracks/{track}"


def board_data_address(competition: str | None, track: str) -> str:
    """Return where the API answers with a track's board; `competition` None: in the competition that opened last."""
    return f"/api/v1{'' if competition is None else competition_address(competition)}/leaderboards/{track}"


def board_query(task: str | None, stage: str | None) -> str:
    """Return what the address of a board asks for; empty: all tasks, in the stage that opened last."""
    asked = {name: value for name, value in (("task", task), ("stage", stage)) if value}
    return f"?{urlencode(asked)}" if asked else ""


@dataclass(frozen=True, kw_only=True)
class AskedBoard:
    """The boards that a request asks for.

    Attributes:
        competition: name of the competition; None: the one that opened last.
        track: name of the track.
        task: name of the task; None: all together.
        stage: name of the stage; None: the one that opened last.
        part: what follows the address of the track's boards: `/logs`, or nothing.
    """

    competition: str | None
    track: str
    task: str | None
    stage: str | None
    part: str = ""

    @classmethod
    def read(cls, request: Request, *, logs: bool = False) -> Self:
        """Return what a request asks for; boards of logs are those of all tasks."""
        query = request.query_params
        return cls(
            competition=read_competition_name(request),
            track=request.path_params["track"],
            task=None if logs else query.get("task"),
            stage=query.get("stage"),
            part="/logs" if logs else "",
        )

    def query(self) -> str:
        """Return task and stage as the query of an address."""
        return board_query(self.task, self.stage)

    def address(self, stage: str | None = None) -> str:
        """Return the address of these boards, or of the same ones in another stage."""
        return f"{board_address(self.competition, self.track)}{self.part}{board_query(self.task, stage or self.stage)}"
