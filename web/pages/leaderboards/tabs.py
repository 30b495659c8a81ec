"""Links from a page of a track to its siblings: other tracks, competitions, stages and tasks, and the logs."""

from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from itertools import pairwise

from sqlalchemy.orm import Session
from starlette.exceptions import HTTPException
from vitac.evaluator.tracks import Track
from vitac.server.competitions.view import competition_list_view, track_stages
from vitac.server.errors import ServiceError
from vitac.server.tracks import is_challenge_track, load_known_track
from vitac.server.views.competition import StageView

from ...site import Site, Tab
from ..addresses import AskedBoard, board_address, board_data_address, board_query, competition_address


def known_track(name: str) -> Track:
    """Return a track.

    Raises:
        HTTPException: 404, there is none of that name.
    """
    try:
        return load_known_track(name)
    except ServiceError as error:
        raise HTTPException(404, error.detail) from error


def accepts_logs(track: Track) -> bool:
    """Return whether a track accepts logs of any kind."""
    return any(not kind.form.runs_policy for kind in track.accepts)


def read_surroundings(
    session: Session, site: Site, track: Track, asked: AskedBoard, *, shown_stage: str | None
) -> dict[str, object]:
    """Return what a page of boards shows around them.

    Args:
        session: database session.
        site: with the tracks.
        track: whose boards are shown.
        asked: which ones.
        shown_stage: the stage that they are of.
    """
    competition, part, stages = asked.competition, asked.part, track_stages(session, track.name, asked.competition)
    has_page = accepts_logs if part else lambda _: True
    of_stages = stage_tabs(stages, shown_stage, asked.address)
    return {
        "section": f"/tracks/{track.name}",
        "track": track,
        "stage": asked.stage,
        "stage_title": find_stage_title(stages, shown_stage),
        "query": asked.query(),
        "board_address": board_address(competition, track.name),
        "board_data": board_data_address(competition, track.name),
        "competition_url": competition_address(competition),
        "track_tabs": () if competition else track_tabs(site, track, part, has_page=has_page),
        "competition_tabs": competition_tabs(session, competition, track.name, part),
        "stage_tabs": of_stages,
        "earlier_stage": next((tab for tab, after in pairwise(of_stages) if after.current), None),
        "tabs": task_tabs(track, asked.task, logs=bool(part), stage=asked.stage, competition=competition),
    }


def find_stage_title(stages: Sequence[StageView], name: str | None) -> str | None:
    """Return the title of a stage; its name where the competition's file has just lost it, None outside of stages."""
    return next((stage.title for stage in stages if stage.name == name), name)


def track_tabs(
    site: Site, shown: Track, page_of_track: str = "", *, has_page: Callable[[Track], bool] = lambda _: True
) -> tuple[Tab, ...]:
    """Return the same page of every track that has it; empty if there is only one."""
    tracks = [track for track in map(known_track, site.tracks) if has_page(track)]
    return _several(
        Tab(
            title=track.title,
            target=f"/tracks/{track.name}{page_of_track}",
            current=track.name == shown.name,
            further=not is_challenge_track(track),
        )
        for track in tracks
    )


def competition_tabs(session: Session, shown: str | None, track: str, page_of_track: str = "") -> tuple[Tab, ...]:
    """Return the same boards of every competition that holds a track; empty if there is only one."""
    holding = [one for one in competition_list_view(session).items if track in one.tracks]
    current = shown or (holding[0].name if holding else None)
    return _several(
        Tab(title=one.title, target=board_address(one.name, track) + page_of_track, current=one.name == current)
        for one in holding
    )


def stage_tabs(stages: Sequence[StageView], shown: str | None, find_address: Callable[[str], str]) -> tuple[Tab, ...]:
    """Return the boards of the stages that have opened, and of the shown one; empty if there is only one.

    Args:
        stages: of the track.
        shown: name of the stage whose board is shown.
        find_address: the address of a stage's board.
    """
    now = datetime.now(UTC)
    return _several(
        Tab(title=stage.title, target=find_address(stage.name), current=stage.name == shown)
        for stage in stages
        if stage.opens <= now or stage.name == shown
    )


def task_tabs(
    track: Track, task: str | None, *, logs: bool = False, stage: str | None = None, competition: str | None = None
) -> tuple[Tab, ...]:
    """Return the leaderboards of a track: all tasks, each task, and the logs; empty if there is only one."""
    address = board_address(competition, track.name)
    shown = [Tab(title="All tasks", target=address + board_query(None, stage), current=task is None and not logs)]
    if len(track.tasks) > 1:
        shown += [
            Tab(title=definition.title, target=address + board_query(name, stage), current=name == task)
            for name, definition in track.tasks.items()
        ]
    if accepts_logs(track):
        shown.append(Tab(title="Logs", target=f"{address}/logs{board_query(None, stage)}", current=logs))
    return _several(shown)


def _several(tabs: Iterable[Tab]) -> tuple[Tab, ...]:
    shown = tuple(tabs)
    return shown if len(shown) > 1 else ()
