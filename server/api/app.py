"""Builds the HTTP application; `vitac serve` runs it and adds the pages."""

from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AbstractAsyncContextManager, ExitStack, asynccontextmanager
from functools import cache
from importlib.metadata import version
from pathlib import Path

from fastapi import APIRouter, FastAPI
from fastapi.concurrency import run_in_threadpool
from starlette.routing import BaseRoute

from .. import traces
from ..accounts.sending import NoticeSender
from ..limiter import ConcurrencyLimiter, SignInLimiters, WindowLimiter
from ..operations.exposition import Exposition
from ..operations.housekeeping import Housekeeping
from ..principals import Principal
from ..services import Services, open_services
from ..settings import Settings
from ..submissions.watch import SubmissionWatch
from . import (
    by_hand,
    competitions,
    evaluations,
    health,
    judging,
    members,
    messages,
    operations,
    problems,
    receipts,
    submissions,
    teams,
    tracks,
    uploads,
)
from .middleware.requests import BodyLimit, RelativeRedirects, RequestHead, RequestIds, RequestTimes, Shutdown
from .middleware.shares import Shares
from .uploads import ProtocolVersion

API_PREFIX = "/api/v1"
DESCRIPTION = """Evaluation of policies for manipulation with vision and touch.

Register a team, upload a zip with a policy, follow its evaluation, read the leaderboard. Every error is a problem
document (RFC 9457, `application/problem+json`) with a stable `code`.
"""

PASSWORDS_AT_ONCE = 2
"""Maximum simultaneous password checks for one address or device."""
UNLIMITED = (
    ("POST", f"{API_PREFIX}{submissions.router.prefix}"),
    ("PATCH", f"{API_PREFIX}{uploads.router.prefix}/"),
    ("PUT", f"{API_PREFIX}/briefs/"),
)
"""Routes that take uploads, which have limits of their own."""


def create_app(
    settings: Settings,
    services: Services | None = None,
    uploads_at: Sequence[tuple[str, str]] = (),
    sweeps: bool = True,
    caller: Principal | None = None,
) -> FastAPI:
    """Return the application. It opens database and files at its start, unless open `services` are given.

    Args:
        settings: of this process.
        services: already open ones; they are left open at the end.
        uploads_at: methods and paths of further routes that take uploads.
        sweeps: look for lost work; False where the process that started this one does.
        caller: who asks without a token; only for an application that listens to nobody outside of this process.
    """
    app = FastAPI(
        title="ViTac Arena",
        version=version("vitac-arena"),
        description=DESCRIPTION,
        lifespan=_lifespan(settings, services, sweeps=sweeps),
        telemetry={"auto_configure": traces.are_asked_for(), "metrics": False, "logs": False},
        # The interactive pages of the framework load scripts from elsewhere; /openapi.json is enough.
        docs_url=None,
        redoc_url=None,
    )
    app.state.settings = settings
    app.state.services = services
    app.state.caller = caller
    app.state.changes = SubmissionWatch()
    set_limiters(app, settings)
    _add_routes(app)
    _add_middleware(app, settings, uploads_at)
    problems.install(app)
    return app


def _lifespan(
    settings: Settings, services: Services | None, *, sweeps: bool
) -> Callable[[FastAPI], AbstractAsyncContextManager[None]]:
    """Return what opens database and files for an application, and runs the work beside its requests."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        with ExitStack() as stack:
            opened = services
            if opened is None:
                opened = await run_in_threadpool(stack.enter_context, open_services(settings))
            app.state.services = opened
            app.state.exposition = Exposition(opened)
            for work in (Housekeeping(opened, sweeps=sweeps), NoticeSender(opened.database, opened.settings)):
                work.start()
                stack.callback(work.stop)
            async with app.state.changes.listening(opened.database.address):
                yield
            await run_in_threadpool(stack.close)

    return lifespan


def set_limiters(app: FastAPI, settings: Settings) -> None:
    """Give an application what counts the requests of its clients."""
    folder = settings.state_dir / "limits"
    app.state.registration_limiter = _hourly(folder / "registrations", settings.registrations_per_hour)
    app.state.sign_in_limiters = SignInLimiters(
        of_address=_hourly(folder / "sign_ins", settings.sign_ins_per_hour),
        of_member=_hourly(folder / "sign_ins_of_members", max(1, settings.sign_ins_per_hour // 4)),
        at_once=ConcurrencyLimiter(folder / "passwords", PASSWORDS_AT_ONCE),
    )
    app.state.upload_limiter = ConcurrencyLimiter(folder / "uploads", settings.uploads_at_once)
    app.state.stream_limiter = ConcurrencyLimiter(folder / "event_streams", settings.event_streams)


def _hourly(folder: Path, limit: int) -> WindowLimiter:
    return WindowLimiter(folder, limit=limit, window_s=3600.0)


def _add_routes(app: FastAPI) -> None:
    app.router.routes.extend(_routes())
    for router in (health.router, receipts.log_router):
        app.include_router(router)


@cache
def _routes() -> Sequence[BaseRoute]:
    """Return the routes of the API, which have no state: put together once for all applications of this process.

    A route is analysed at the first request and keeps what was found, together 40 ms of CPU.
    """
    together = APIRouter()
    for router in (  # tried in turn, so what is asked for most often comes first
        tracks.router,
        submissions.router,
        submissions.comparisons,
        teams.router,
        members.router,
        judging.rejudging_router,
        messages.router,
        messages.appeals_router,
        receipts.router,
        judging.router,
        by_hand.router,
        uploads.router,
        competitions.router,
        evaluations.router,
        operations.router,
    ):
        together.include_router(router, prefix=API_PREFIX)
    return together.routes


def _add_middleware(app: FastAPI, settings: Settings, uploads_at: Sequence[tuple[str, str]]) -> None:
    """Put the middleware around an application; the last one is the outermost."""
    uploads_apart = (*UNLIMITED, *uploads_at)
    app.add_middleware(BodyLimit, unlimited=uploads_apart)
    app.add_middleware(ProtocolVersion, prefix=f"{API_PREFIX}{uploads.router.prefix}")
    app.add_middleware(RelativeRedirects)
    app.add_middleware(RequestHead)
    app.add_middleware(Shares, share=settings.client_share, apart=uploads_apart)
    app.add_middleware(Shutdown)
    app.add_middleware(RequestTimes)
    app.add_middleware(RequestIds)
