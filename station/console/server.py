"""Serves the console on the station's own machine: it stops the station whether or not the service is there."""

import math
from collections.abc import Mapping
from http.server import ThreadingHTTPServer
from pathlib import Path
from typing import Any, Final

from vitac.evaluator.own_page import OwnPageServer, PageFile

from ..eyes import OpenStation
from ..operators import OperatorDecision
from ..perception.markers import MarkerFlow, cut_picture
from ..trials import TrialPlayer

_PAGE_FILES: Final = {
    "": PageFile(Path(__file__).with_name("page.html"), "text/html"),
    "page.js": PageFile(Path(__file__).with_name("page.js"), "text/javascript"),
}
_STOP: Final = "An operator stopped it at the console."


class ConsoleServer(OwnPageServer, ThreadingHTTPServer):
    """The page of a player's station; several may have it open."""

    daemon_threads = True

    def __init__(self, player: TrialPlayer, port: int = 0) -> None:
        """Serve on a port, 0 for any that is free."""
        super().__init__(_PAGE_FILES, port)
        self._player, self._operator = player, player.operator

    def read_picture(self, named: str) -> bytes | None:
        """Return the picture of a camera as JPEG, a gel's as its markers are counted; None where there is none."""
        import cv2

        station = self._player.station
        pictures = {} if station is None else _find_pictures(station)
        picture = pictures.get(named.removesuffix(".jpg"))
        return None if picture is None else bytes(cv2.imencode(".jpg", picture)[1])

    def answer(self, asked: str, content: Mapping[str, Any]) -> dict[str, Any]:
        """Do what the page asks for, and return what it shows.

        Raises:
            DecisionRefused: it cannot be done now.
            ValueError: something else is asked for.
        """
        operator = self._operator
        match asked:
            case "state":
                pass
            case "decide":
                operator.decide(
                    int(content["number"]), OperatorDecision(content["decision"]), str(content.get("note", ""))
                )
            case "pause":
                operator.pause()
            case "resume":
                operator.resume()
            case "note":
                operator.write_note(str(content["note"]))
            case "stop":
                self._player.stop_by_operator(_STOP)
            case _:
                raise ValueError(f"There is no {asked!r:.40}; expected state, decide, pause, resume, note or stop.")
        station = self._player.description
        named = {"station": station.name, "twin": station.twin_words}
        return operator.describe() | named | _describe(self._player.station)


def _find_pictures(station: OpenStation) -> dict[str, Any]:
    gels = station.eyes.pictures[0] if station.eyes.pictures else ()
    pictures = {side: cut_picture(picture) for side, picture in zip(("left", "right"), gels, strict=bool(gels))}
    if station.overview is not None and station.overview.latest is not None:
        pictures["overview"] = station.overview.latest
    return pictures


def _describe(station: OpenStation | None) -> dict[str, Any]:
    """Return what is measured now."""
    if station is None:
        return {"reason": "The devices are not open.", "force_n": None, "pose": None, "markers": [], "cameras": []}
    wrench, sight = station.guard.wrench(), station.eyes.latest
    return {
        "reason": station.guard.reason,
        "force_n": None if wrench is None else round(math.hypot(*wrench[:3]), 3),
        "limit_n": station.description.limits.force_n,
        "markers": [] if sight is None else [_describe_markers(flow) for flow in (sight.left, sight.right)],
        "cameras": list(_find_pictures(station)),
    }


def _describe_markers(flow: MarkerFlow) -> dict[str, Any]:
    """Return where markers were and are, in pixels of 320 x 240."""
    return {"reference": flow.reference.round(1).tolist(), "current": flow.current.round(1).tolist()}
