"""A final on stations that pages show: places, trials with video and help, in complete blocks."""

from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
import yaml
from evaluation_records import make_record
from seeded_site import SeededSite
from service_factories import TRACK, make_principal, make_upload, play_within
from sqlalchemy.orm import Session
from vitac.envs.geometry.pegs import PegShape
from vitac.evaluator.episodes.records import (
    EpisodeOutcome,
    EpisodeRecord,
    HelpKind,
    HumanHelp,
    TrialEvidence,
    TrialVideo,
)
from vitac.server.accounts import stations
from vitac.server.competitions.applying import apply
from vitac.server.competitions.competition import Competition
from vitac.server.competitions.definition import CompetitionDefinition
from vitac.server.competitions.stages import Stage
from vitac.server.database.models import SubmissionFile
from vitac.server.database.states import OPEN_WORK_STATES, FileRole
from vitac.server.decisions.station_trials import begin, planned_trials
from vitac.server.principals import CONSOLE, Principal
from vitac.server.submissions import creation
from vitac.station.description import make_station_track

from competitions import FIRST, make_competition, moved, open_now, put_in_place

STATION, PLAYED, STARTS = "station", "peg-insertion-station", 4
ADDRESS = f"/competitions/cup/tracks/{STATION}/stages/{FIRST}/trials"
TEAMS = ("Ants", "Bees", "Controls")
VIDEO = b"frames"
DIGEST = sha256(VIDEO).hexdigest()


def cup() -> dict[str, Any]:
    content = open_now(make_competition())
    rules = content["tracks"].pop(TRACK)
    plan = {"stations": ["east", "west"], "control": "Controls", "live_delay_s": 60}
    stage = rules["stages"][0] | {"accepts": ["model"], "list": "sealed", "sealed": "at_once", "plan": plan}
    content["tracks"][STATION] = rules | {"stages": [stage]}
    return content


def hold_final(site: SeededSite, folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Principal]:
    """A final whose trials have begun: three teams, four starts, two stations; its track file is in the folder."""
    (folder / f"{STATION}.yaml").write_text(yaml.safe_dump(make_station_track(PegShape.CUBOID, 1, starts=STARTS)))
    monkeypatch.setenv("VITAC_TRACKS_DIR", str(folder))
    with site.database.transaction() as session:
        apply(session, CONSOLE, CompetitionDefinition.model_validate(cup()), confirmed=None)
        for name in ("east", "west"):
            stations.add_station(session, CONSOLE, name)
        teams = {name: make_principal(session, name) for name in TEAMS}
        for name, principal in teams.items():
            upload = make_upload(name, track=STATION, tasks=(PLAYED,), manifest={"track": STATION, "name": "zero"})
            creation.create(session, principal, upload)
        put_in_place(session, moved(cup(), days=-300))
    with stage_of(site) as (session, stage):
        begin(session, CONSOLE, stage)
    return teams


@contextmanager
def stage_of(site: SeededSite) -> Iterator[tuple[Session, Stage]]:
    with site.database.transaction() as session:
        yield session, Competition.read(session).stage(STATION, FIRST)


def record_of(outcome: EpisodeOutcome, twin: str | None = None, **changes: Any) -> Any:
    def record(episode: int, *, task: str) -> EpisodeRecord:
        video = TrialVideo(code="0123456789ABCDEF", frames=9, link="a" * 64, sha256=DIGEST, n_bytes=len(VIDEO))
        pause = HumanHelp(kind=HelpKind.PAUSE, at_s=-2.0, length_s=31.0, note="<b>cable</b>")
        measured = {"encoders": [1.0, 2.0, -40.25, 3.0], "movement_px": [0.5, 0.25]}
        return make_record(
            episode,
            outcome,
            env_steps=2,
            task=task,
            shape="cuboid",
            infos=({**measured, "video": {"frame": 4, "link": "b" * 64}}, {}),
            evidence=TrialEvidence(station="lab", twin=twin, video=video, help=(pause,)),
            **changes,
        )

    return record


def play(site: SeededSite, *, first_blocks: int = STARTS, twin: str | None = None) -> None:
    """Ants solve every start, the others none; at each station, or its twin, as the plan says."""
    with stage_of(site) as (session, stage):
        trials = planned_trials(session, stage)[: first_blocks * len(TEAMS)]
        for trial in (each for each in trials if each.state in OPEN_WORK_STATES):
            solved = trial.evaluation.submission.team.name == "Ants"
            outcome = EpisodeOutcome.SUCCESS if solved else EpisodeOutcome.TACTILE
            play_within(session, trial.id, record_of(outcome, twin))
            of_trial = {"submission_id": trial.evaluation.submission_id, "role": FileRole.VIDEO, "sha256": DIGEST}
            if session.get(SubmissionFile, tuple(of_trial.values())) is None:
                session.add(SubmissionFile(**of_trial, n_bytes=len(VIDEO), name="trial.mjpeg", facts={}))
