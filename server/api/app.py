"""Builds the HTTP application; `vitac serve` runs it and adds the pages."""

from collections.abc import AsyncIterator, Sequence
from contextlib import ExitStack, asynccontextmanager
from importlib.metadata import version

from fastapi import APIRouter, FastAPI
from fastapi.concurrency import run_in_threadpool
from vitac.server.housekeeping import Housekeeping
from vitac.server.notices.sending import NoticeSender
from vitac.server.operations.exposition import Exposition
from vitac.server.services import Services, open_services
from vitac.server.settings import Settings

from ..limiter import ConcurrencyLimiter, SignInLimiters, WindowLimiter
from . import health, judging, metrics, problems, receipts, submissions, teams, tracks
from .middleware.body_limit import BodyLimit
from .middleware.request_head import RequestHead
from .middleware.request_times import RequestTimes
from .middleware.shutdown import Shutdown
from .people import appeals, members, messages
from .resumable import routes as uploads
from .resumable.protocol import ProtocolVersion

API_PREFIX = "/api/v1"
DESCRIPTION = """Evaluation of policies for manipulation with vision and touch.

Register a team, upload a zip with a policy, follow its evaluation, read the leaderboard. Every error is a problem
document (RFC 9457, `application/problem+json`) with a stable `code`.
"""

UNLIMITED = (
    ("POST", f"{API_PREFIX}{submissions.router.prefix}"),
    ("PATCH", f"{API_PREFIX}{uploads.router.prefix}/"),
)
"""Routes that take uploads, which have limits of their own."""


def create_app(
    settings: Settings,
    routers: Sequence[APIRouter] = (),
    services: Services | None = None,
    uploads_at: Sequence[tuple[str, str]] = (),
    sweeps: bool = True,
) -> FastAPI:
    """Return the application. It opens database and files at its start, unless open `services` are given.

    Args:
        settings: of this process.
        routers: further routes, such as the pages.
        services: already open ones; they are left open at the end.
        uploads_at: methods and paths of further routes that take uploads.
        sweeps: look for lost work; False where the process that started this one does.
    """

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        with ExitStack() as stack:
            app.state.services = services or await run_in_threadpool(stack.enter_context, open_services(settings))
            app.state.exposition = Exposition(app.state.services)
            housekeeping = Housekeeping(app.state.services, sweeps=sweeps)
            housekeeping.start()
            stack.callback(housekeeping.stop)
            notices = NoticeSender(app.state.services.database, app.state.services.settings)
            notices.start()
            stack.callback(notices.stop)
            yield
            await run_in_threadpool(stack.close)

    app = FastAPI(
        title="ViTac Arena",
        version=version("vitac-arena"),
        description=DESCRIPTION,
        lifespan=lifespan,
        # The interactive pages of the framework load scripts from elsewhere; /openapi.json is enough.
        docs_url=None,
        redoc_url=None,
    )
    app.state.settings = settings
    limits = settings.state_dir / "limits"
    app.state.registration_limiter = WindowLimiter(
        limits / "registrations", limit=settings.registrations_per_hour, window_s=3600.0
    )
    app.state.sign_in_limiters = SignInLimiters(
        of_address=WindowLimiter(limits / "sign_ins", limit=settings.sign_ins_per_hour, window_s=3600.0),
        of_member=WindowLimiter(
            limits / "sign_ins_of_members", limit=max(1, settings.sign_ins_per_hour // 4), window_s=3600.0
        ),
    )
    app.state.upload_limiter = ConcurrencyLimiter(limits / "uploads", settings.uploads_at_once)
    app.state.stream_limiter = ConcurrencyLimiter(limits / "event_streams", settings.event_streams)
    for router in (
        teams.router,
        members.router,
        messages.router,
        appeals.router,
        submissions.router,
        receipts.router,
        judging.router,
        uploads.router,
        tracks.router,
    ):
        app.include_router(router, prefix=API_PREFIX)
    for router in (health.router, metrics.router, *routers):
        app.include_router(router)
    app.add_middleware(BodyLimit, unlimited=(*UNLIMITED, *uploads_at))
    app.add_middleware(ProtocolVersion, prefix=f"{API_PREFIX}{uploads.router.prefix}")
    app.add_middleware(RequestHead)
    app.add_middleware(Shutdown)
    app.add_middleware(RequestTimes)
    problems.install(app)
    return app
