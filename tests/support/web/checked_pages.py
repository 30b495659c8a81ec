"""Which pages a browser looks at for barriers, and where; a page of the site that is in none of these fails a test."""

from collections.abc import Iterable

from starlette.routing import Route
from vitac.web.pages.briefs import ADDRESS as BRIEFS
from vitac.web.pages.briefs import STAGE
from vitac.web.pages.episodes import EMBED, TRIAL
from vitac.web.pages.routes import EPISODES, pages

TRIALS = f"{STAGE}/trials"
BOARD = "/tracks/track_1?stage=stage1"
COMPETITION = "/competitions/cup"
PAGES_OF_ROLES = {
    "visitor": (
        *("/announcements", "/competition", "/join", "/sign-in", BOARD, "PUBLIC", "SUBMISSION"),
        *("/competitions", COMPETITION, "/status"),
        *(f"{COMPETITION}/tracks/track_1", f"{COMPETITION}/tracks/track_1/logs", f"{COMPETITION}/receipts"),
    ),
    "other": ("/appeals", "PUBLIC", "SUBMISSION"),
    "judge": ("/appeals", "/judging", BOARD, "SUBMISSION"),
    "participant": ("/team", "/announcements", "/appeals", f"{COMPETITION}/appeals", BOARD, "SUBMISSION"),
    "organizer": (
        *(COMPETITION, "/desk", "/appeals", "/judging", "/rejudging", "/operations", BOARD, "SUBMISSION"),
        *("/desk/teams", f"/desk{COMPETITION}", f"/desk{COMPETITION}/tracks/track_1/stages/stage1"),
    ),
}
"""What each role looks at in a service (`test_people_in_browser`).

SUBMISSION is one of the participant's team, PUBLIC another one, which the team shares with everybody.
"""
WITH_SCENES = {
    **dict.fromkeys((*EPISODES, *(EMBED + address for address in EPISODES)), "test_episodes_in_browser"),
    "/submissions/{submission_id}/sensor": "test_sensors_in_browser",
    **dict.fromkeys((BRIEFS, TRIALS, TRIAL), "test_finals_in_browser"),
}
"""Pages that need a browser that draws scenes, or a competition of their own, by the modules that look at them."""
PARTS = ("/scene", "/shape", "/playback", "/events", "/playback/{file}", "/live/{station}")
"""Ends of addresses that a script asks for."""
DOWNLOADS = ("/document", "/video")
"""Ends of addresses of files to save, besides those whose names have a dot."""


def unchecked(paths: Iterable[str]) -> list[str]:
    """Routes of pages that are looked at neither at these paths nor by a role nor with a scene."""
    looked_at = [path.partition("?")[0] for path in [*paths, *(path for of in PAGES_OF_ROLES.values() for path in of)]]
    return [
        route.path
        for route in pages().routes
        if isinstance(route, Route)
        and "GET" in (route.methods or ())
        and not route.path.endswith(PARTS + DOWNLOADS)
        and "." not in route.path
        and route.path not in WITH_SCENES
        and not any(route.path_regex.match(path) for path in looked_at)
    ]
