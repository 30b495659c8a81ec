"""The HTTP application: the server's API and the pages. Called by `vitac serve` and `vitac demo`."""

from importlib.metadata import version
from urllib.parse import urlsplit

from fastapi import FastAPI
from vitac.evaluator.tracks import list_tracks
from vitac.server.api.app import create_app
from vitac.server.limiter import WindowLimiter
from vitac.server.services import Services
from vitac.server.settings import Settings
from vitac.server.tracks import sort_challenge_first

from .pages import routes
from .public_path import PublicPath
from .session.signer import SessionSigner, load_key
from .sharing.preview import checked_font
from .site import Site

KEY_FILE = "session.key"


def create(services: Services, *, sweeps: bool = True) -> FastAPI:
    """Return the application on open services; the caller closes them.

    Args:
        services: what it works with.
        sweeps: look for lost work; False where the process that started this one does.
    """
    settings = services.settings
    app = create_app(settings, services=services, uploads_at=routes.UPLOADS, sweeps=sweeps)
    site = Site(
        services=services,
        playbacks=WindowLimiter(
            settings.state_dir / "limits" / "playbacks", limit=settings.playbacks_per_address, window_s=3600.0
        ),
        signer=SessionSigner(key=signing_key(settings)),
        version=version("vitac-arena"),
        tracks=sort_challenge_first(list_tracks()),
        public_url=settings.public_url,
        preview_font=checked_font(settings.preview_font),
    )
    routes.install(app, site)
    if path := urlsplit(settings.public_url or "").path.rstrip("/"):
        app.add_middleware(PublicPath, path=path)
    return app


def signing_key(settings: Settings) -> bytes:
    """Return the key that signs page sessions: the configured one, else the state directory's."""
    if settings.session_key is not None:
        return settings.session_key.get_secret_value().encode()
    return load_key(settings.state_dir / KEY_FILE)
