"""Sends what a station's cameras see in its trials to the service, for visitors who watch later. Used by its agent."""

from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Event, Thread
from typing import Final, Self

import structlog
from sqlalchemy.exc import DBAPIError
from vitac.server.decisions.station_trials import store_picture
from vitac.server.services import Services

logger = structlog.get_logger(__name__)

_PERIOD_S: Final = 1.0


@dataclass(kw_only=True)
class LivePictures:
    """Sends the newest picture each second; use it in `with`. A database that is away costs pictures, no trial.

    Attributes:
        services: open.
        find_station: returns the name of the station whose agent this is; empty before the service knows it.
    """

    services: Services
    find_station: Callable[[], str]
    _newest: tuple[str, bytes] | None = None
    _unwatched: str = ""
    _over: Event = field(default_factory=Event)

    def __enter__(self) -> Self:
        self._thread = Thread(target=self._run, name="live pictures", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def show(self, code: str, picture: bytes) -> None:
        """Take a picture (JPEG) of the trial with a code; it is sent if no newer one comes first."""
        self._newest = (code, picture)

    def _run(self) -> None:
        while not self._over.wait(_PERIOD_S):
            newest, self._newest = self._newest, None
            if newest is None or newest[0] == self._unwatched:
                continue
            code, picture = newest
            try:
                with self.services.database.transaction() as session:
                    is_watched = store_picture(session, self.find_station(), code, picture)
                self._unwatched = "" if is_watched else code
            except DBAPIError as error:
                logger.warning("live_picture_lost", error=" ".join(str(error).split())[:200])
