import asyncio

import httpx
import structlog
from fastapi import FastAPI, Request
from starlette.responses import Response
from vitac.server.api import problems
from vitac.server.api.middleware.requests import RequestIds
from vitac.server.errors import ProblemCode, ServiceError


def test_an_answer_its_problem_and_its_service_events_name_one_request() -> None:
    app = FastAPI()
    app.add_middleware(RequestIds)
    problems.install(app)

    @app.get("/refused")
    def refuse(_: Request) -> Response:
        structlog.get_logger().warning("refused")
        raise ServiceError(ProblemCode.TEAM_EXISTS, "Expected another name.")

    async def ask() -> list[httpx.Response]:
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app=app), base_url="http://service") as client:
            return [await client.get("/refused") for _ in range(2)]

    # Not `capture_logs`: it leaves out the processor that adds the id.
    noted: list[str] = []

    def note(_: object, __: str, event: structlog.typing.EventDict) -> structlog.typing.EventDict:
        noted.append(event["request"])
        raise structlog.DropEvent

    before = structlog.get_config()
    structlog.configure(processors=[structlog.contextvars.merge_contextvars, note], cache_logger_on_first_use=False)
    try:
        answers = asyncio.run(ask())
    finally:
        structlog.configure(**before)
    ids = [answer.headers["x-request-id"] for answer in answers]
    assert ids == [answer.json()["request_id"] for answer in answers] == noted
    assert len(set(ids)) == 2
