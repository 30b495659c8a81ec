"""Competitions for tests: two stages around now, the second sealed and for the best team."""

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import yaml
from service_factories import TRACK
from sqlalchemy.orm import Session
from vitac.server.competitions.competition import Competition
from vitac.server.competitions.definition import CompetitionDefinition
from vitac.server.competitions.stages import Stage
from vitac.server.database.models import CompetitionRow
from vitac.server.leaderboards.standings import leaderboard

FIRST, SECOND = "stage1", "stage2"
PUBLIC_RANKING = f"tracks.{TRACK}.stages.{SECOND}.qualified"
"""What an organizer confirms of it: teams advance by the board of a public list."""
OPENS = datetime(2031, 1, 1, tzinfo=UTC)
CLOSES = OPENS + timedelta(days=31)
LATER_OPENS = CLOSES + timedelta(days=1)
LATER_CLOSES = LATER_OPENS + timedelta(days=31)


def make_competition(**changes: Any) -> dict[str, Any]:
    """The content of a competition file; `stages` and others of the track may be given."""
    of_track = {key: changes.pop(key) for key in ("stages", "ranking", "prizes", "taken_here") if key in changes}
    track: dict[str, Any] = {
        "title": "Touch",
        "stages": [
            {
                "name": FIRST,
                "title": "Simulation",
                "opens": OPENS.isoformat(),
                "closes": CLOSES.isoformat(),
                "accepts": ["model", "log"],
                "list": "public",
            },
            {
                "name": SECOND,
                "title": "Final",
                "opens": LATER_OPENS.isoformat(),
                "closes": LATER_CLOSES.isoformat(),
                "accepts": ["model"],
                "quotas": {"scored_runs": 2},
                "qualified": {"top": 1},
            },
        ],
    }
    return {"name": "cup", "title": "The cup", "tracks": {TRACK: track | of_track}} | changes


def open_now(content: dict[str, Any], stage: int = 0, track: str = TRACK) -> dict[str, Any]:
    """Moves all times so that a stage has been open for a day."""
    opens = datetime.fromisoformat(content["tracks"][track]["stages"][stage]["opens"])
    return moved(content, days=(datetime.now(UTC) - opens) / timedelta(days=1) - 1)


def moved(content: dict[str, Any], days: float) -> dict[str, Any]:
    """Moves all times of all stages by so many days."""
    for track in content["tracks"].values():
        for stage in track["stages"]:
            for name in ("opens", "closes"):
                stage[name] = (datetime.fromisoformat(stage[name]) + timedelta(days=days)).isoformat()
    return content


def put_in_place(session: Session, content: dict[str, Any]) -> CompetitionDefinition:
    """Makes it the competition of the service, without the checks of `apply`."""
    definition = CompetitionDefinition.model_validate(content)
    row = session.get(CompetitionRow, definition.name)
    if row is None:
        session.add(CompetitionRow(name=definition.name, definition=definition.model_dump(mode="json")))
    else:
        row.definition = definition.model_dump(mode="json")
    session.flush()
    return definition


def sealed_competition() -> dict[str, Any]:
    """The same with both lists sealed, for everybody and with models only."""
    content = make_competition()
    for stage in content["tracks"][TRACK]["stages"]:
        stage |= {"list": "sealed", "accepts": ["model"], "qualified": None}
    return content


def write_competition(folder: Path, content: dict[str, Any]) -> Path:
    """Writes it to a file."""
    path = folder / "cup.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def stored_stage(session: Session, track: str, name: str) -> Stage:
    """The stage that a row names, also where no competition has it."""
    return Competition.read(session).stored_stage(track, name)


def shown_stage(session: Session, track: str, name: str | None = None) -> Stage:
    """The stage whose board a track shows now."""
    return Competition.find_by_track(session, track).shown_stage(track, name)


def teams_on_board(session: Session, name: str | None = None, *, task: str | None = None) -> list[str]:
    """The teams on the board of a stage, best first."""
    board = leaderboard(session, shown_stage(session, TRACK, name), task=task)
    return [entry.team for entry in board.view.entries]


def competition_of(content: dict[str, Any]) -> Competition:
    """A competition without a database."""
    definition = CompetitionDefinition.model_validate(content)
    return Competition(session=Session(), row=CompetitionRow(name=definition.name), definition=definition, is_held=True)
