"""`vitac serve`: runs the service on this machine."""

import sys
from typing import TYPE_CHECKING, Annotated

import typer

from .database import load_settings
from .process_tree import running_service
from .stop_request import StopRequest
from .web_server import bind, configure_events

if TYPE_CHECKING:
    from vitac.server.settings import Settings


def command(
    host: Annotated[str | None, typer.Option(help="Address to listen on; default: VITAC_HOST or 127.0.0.1.")] = None,
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Port, 0 for any free one; default: VITAC_PORT or 8000.")
    ] = None,
    workers: Annotated[int, typer.Option(min=0, help="Number of worker processes to start as well.")] = 0,
) -> None:
    """Run the service until Ctrl-C: API, pages, and the embedded database unless VITAC_DATABASE_URL is set."""
    settings = load_settings(host=host, port=port)
    _require_public_url(settings)
    configure_events(sys.stderr, settings.log_format)
    listener = bind(settings.host, settings.port)
    with (
        StopRequest().listening() as stop,
        running_service(settings, listener, workers=workers, log=sys.stderr.fileno(), notify=_note) as service,
    ):
        service.workers.start()
        print(f"ViTac Arena is running at {service.address}", flush=True)
        print(f"workers: {workers}" if workers else "workers: none; start them with `vitac worker`", flush=True)
        print("Press Ctrl-C to stop.", flush=True)
        stop.supervise(service.restart_ended)
        print("stopping", flush=True)


def _require_public_url(settings: "Settings") -> None:
    """Refuse to serve other machines without knowing how they call this one: links never follow a request's header.

    Raises:
        ServiceSettingsError: VITAC_PUBLIC_URL is missing.
    """
    from vitac.server.errors import ServiceSettingsError

    is_local = settings.host == "localhost" or settings.host.startswith("127.") or settings.host == "::1"
    if not is_local and settings.public_url is None:
        raise ServiceSettingsError(
            f"The service would listen at {settings.host}, beyond this machine, and does not know its address for "
            "others. Set VITAC_PUBLIC_URL to it (https://arena.example.org/)."
        )


def _note(sentence: str) -> None:
    """Write what became of a server process or a worker as a service event."""
    import structlog

    structlog.get_logger(__name__).warning("process_restarted", message=sentence)
