"""Plays a final of some teams and a control policy on two twins, unattended, while everything is killed in turn.

    .venv/bin/python tests/chaos/finals.py [--shape key1] [--starts 10] [--repeats 1] [--minutes 30] [--pause 30]

Each twin breaks in every scripted way once; agents, worker, server and PostgreSQL are killed with -9 until all trials
are over. Exit code 0: no trial was lost or doubled, each was played at its place, and its video agrees with its record.
It also says how long the trials took, by the twins' clocks and by this computer's.
"""

import argparse
import json
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

sys.path += [str(Path(__file__).resolve().parents[1] / "support" / name) for name in ("infrastructure", "service")]

import httpx
import numpy as np
import psycopg
import yaml
from disturbed_service import VITAC, DisturbedService, send
from run import leave, wait_until_ready
from vitac.cli.client.submit import packed
from vitac.cli.demo.laboratory import TRACK, made_for_station, use_station_track
from vitac.envs.geometry.keys_and_locks import KeyShape
from vitac.envs.geometry.pegs import PegShape
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.station.description import StationTask, TwinClass
from vitac.station.twin.grasp import CUBOID_PEG, Mounted
from vitac.station.twin.hidden import FaultScript, ScriptedFault, TwinFault, TwinSecret, make_twin
from vitac.station.twin.laboratory import RunningTwin, twin_process
from vitac.station.verification import verify_video

REPOSITORY = Path(__file__).resolve().parents[2]
STATIONS = ("east", "west")
TEAMS, CONTROL = ("Ants", "Bees", "Cats"), "Controls"
EXAMPLES = {StationTask.PEG: "peg_insertion_trained", StationTask.LOCK: "lock_opening_trained"}
OPEN_S, FIRST_CONTACT = 60.0, 2
CALM_FROM = 0.9
"""Nothing is killed once this part of the trials is over, and everything was killed."""
TRIALS = "SELECT work.state, count(*) FROM work JOIN shards ON shards.id = work.id GROUP BY work.state"
REPEATS = "SELECT work.repeats FROM work JOIN shards ON shards.id = work.id"
PLACES = "SELECT work.turn, work.requires, work.finished_at FROM work JOIN shards ON shards.id = work.id"
RECORDS = "SELECT submission_digest, task, episode, record FROM episode_results"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shape", default=CUBOID_PEG.shape, choices=(*PegShape, *KeyShape), help="of the peg or key")
    parser.add_argument("--teams", type=int, default=3, choices=(1, 2, 3), help="how many teams play")
    parser.add_argument("--starts", type=int, default=10, help="how many starts all play, of 30 of a peg, 20 of a key")
    parser.add_argument("--repeats", type=int, default=1, help="how often each start is played by each")
    parser.add_argument("--minutes", type=float, default=30.0, help="how long it may take")
    parser.add_argument("--pause", type=float, default=30.0, help="seconds between two kills, a third more or less")
    parser.add_argument("--twin", type=TwinClass, default=TwinClass.A, help="class of both twins")
    parser.add_argument("--without", nargs="*", default=[], help="differences of class B that are switched off")
    parser.add_argument("--no-control", action="store_true", help="let no control policy play beside the teams")
    parser.add_argument("--seed", type=int, default=1, help="of the kills and of what the twins hide")
    options = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="vitac-finals-"))
    folder.chmod(0o711)
    (folder / "state").mkdir(mode=0o711)
    options.mounted = Mounted(StationTask.LOCK if options.shape in set(KeyShape) else StationTask.PEG, options.shape)
    use_station_track(folder / "tracks", starts=options.starts, repeats=options.repeats, mounted=options.mounted)
    service = DisturbedService(folder=folder, workers=1, tracks=folder / "tracks")
    problems = ["the run was interrupted"]
    service.start()
    try:
        problems = list(play(service, options))
    finally:
        service.stop()
        leave(folder, problems)
    return 1 if problems else 0


def play(service: DisturbedService, options: argparse.Namespace) -> Iterator[str]:
    """Run the final and yield what was found."""
    wait_until_ready(service)
    teams = TEAMS[: options.teams] if options.no_control else (*TEAMS[: options.teams], CONTROL)
    tokens = register(service, teams)
    closes = begin_stage(service, teams)
    for name, token in tokens.items():
        submit(service, EXAMPLES[options.mounted.task], name, token)
    with ExitStack() as stack:
        twins = [stack.enter_context(start_twin(name, options)) for name in STATIONS]
        for name, twin in zip(STATIONS, twins, strict=True):
            file = service.folder / f"{name}.yaml"
            file.write_text(yaml.safe_dump(twin.description))
            file.with_suffix(".key").write_text(admin(service, "station", "add", name)["key"])
        plan = begin_trials(service, closes)
        service.agents |= {f"agent {name}": service.folder / f"{name}.yaml" for name in STATIONS}
        expected = options.starts * options.repeats * len(teams)
        clocks_s = [time.monotonic(), *(twin.time_s() for twin in twins)]
        kills = disturb(service, expected, options)
        took_s, *by_twins_s = np.subtract([time.monotonic(), *(twin.time_s() for twin in twins)], clocks_s)
        began = {name: set(twin.begun()) for name, twin in zip(STATIONS, twins, strict=True)}
    print(f"{expected} trials, kills: {dict(kills)}", flush=True)
    for name, by_twin_s in zip(STATIONS, by_twins_s, strict=True):
        print(f"{name}: {by_twin_s:.0f} s by its clock in {took_s:.0f} s", flush=True)
    yield from (f"{name}: {missing} never began" for name in STATIONS if (missing := set(TwinFault) - began[name]))
    yield from check(service, plan, expected)


def admin(service: DisturbedService, *words: str) -> Any:
    """Run `vitac admin` where the service runs, and return what it prints as JSON."""
    command = [sys.executable, "-c", VITAC, "admin", *words, "--json"]
    done = subprocess.run(command, env=service.environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(words)}: {done.stderr}")
    return json.loads(done.stdout)


def register(service: DisturbedService, teams: Sequence[str]) -> dict[str, str]:
    found = {}
    for name in teams:
        answer = httpx.post(f"{service.address}/api/v1/teams", json={"name": name}, timeout=60).raise_for_status()
        found[name] = answer.json()["token"]["secret"]
    return found


def begin_stage(service: DisturbedService, teams: Sequence[str]) -> datetime:
    """Apply a competition whose only stage closes as soon as everybody has submitted, and return when."""
    now = datetime.now(UTC)
    closes = now + timedelta(seconds=OPEN_S)
    stage = {
        "name": "finals",
        "title": "Real platform",
        "opens": (now - timedelta(hours=1)).isoformat(),
        "closes": closes.isoformat(),
        "accepts": ["model"],
        "list": "sealed",
        "sealed": "at_once",
        "plan": {"stations": list(STATIONS), "control": CONTROL if CONTROL in teams else None, "live_delay_s": 10},
    }
    tracks = {TRACK: {"title": "Finals", "stages": [stage]}}
    file = service.folder / "cup.yaml"
    file.write_text(yaml.safe_dump({"name": "cup", "title": "Cup", "tracks": tracks}))
    admin(service, "competition", "apply", str(file), "--yes")
    return closes


def submit(service: DisturbedService, example: str, name: str, token: str) -> None:
    """Submit an example with a comment: each team's content is its own."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "Track_1"
        shutil.copytree(REPOSITORY / "examples" / example / "Track_1", copy)
        (copy / "team.txt").write_text(name)
        with made_for_station(copy.parent) as made, packed(made) as archive:
            headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/zip"}
            address = f"{service.address}/api/v1/submissions?track={TRACK}&competition=cup"
            httpx.post(address, content=archive.read_bytes(), headers=headers, timeout=60).raise_for_status()


def begin_trials(service: DisturbedService, closes: datetime) -> list[dict[str, Any]]:
    """Wait until the stage has closed, make the plan, and return it."""
    time.sleep(max((closes - datetime.now(UTC)).total_seconds() + 1.0, 0.0))
    print(admin(service, "competition", "begin-trials", TRACK, "finals", "--yes"), flush=True)
    print(f"Watch it at {service.address}/competitions/cup/tracks/{TRACK}/stages/finals/trials", flush=True)
    places: list[dict[str, Any]] = admin(service, "competition", "trials", TRACK, "finals")
    return places


def start_twin(name: str, options: argparse.Namespace) -> AbstractContextManager[RunningTwin]:
    twin = make_twin(TwinSecret(secret=f"{options.seed} {name}", twin=options.twin, without=tuple(options.without)))
    return twin_process(twin.hidden, mounted=options.mounted, script=make_script(), mark=twin.mark)


def make_script() -> FaultScript:
    """Every fault once, some trials apart."""
    return FaultScript(
        faults=tuple(
            ScriptedFault(fault=fault, contact=FIRST_CONTACT + 2 * number) for number, fault in enumerate(TwinFault)
        )
    )


def disturb(service: DisturbedService, expected: int, options: argparse.Namespace) -> Counter[str]:
    """Kill one thing after the other, a trial at least between two; the last trials end in calm."""
    generator, end = random.Random(options.seed), time.monotonic() + 60 * options.minutes
    names = [*service.agents, *service.worker_names, "server", "database"]
    kills: Counter[str] = Counter()
    done_at_kill = -1
    while (done := count_done(service)) < expected and time.monotonic() < end:
        time.sleep(options.pause * generator.uniform(2 / 3, 4 / 3))
        if done <= done_at_kill or (done >= CALM_FROM * expected and all(kills[each] for each in names)):
            continue
        done_at_kill = done
        name = min(generator.sample(names, len(names)), key=lambda each: kills[each])
        pids = service.database_pids()[:1] if name == "database" else [service.pid(name) or 0]
        send(signal.SIGKILL, *(pid for pid in pids if pid))
        kills[name] += any(pids)
        print(f"{end - time.monotonic():6.0f} s left, {done} of {expected} trials: killed {name}", flush=True)
    return kills


def count_done(service: DisturbedService) -> int:
    try:
        return int(dict(service.query(TRIALS)).get("done", 0))
    except (OSError, psycopg.Error):
        return 0


def check(service: DisturbedService, plan: list[dict[str, Any]], expected: int) -> Iterator[str]:
    """Yield what is lost, doubled, out of order, or not as its video shows it."""
    states = dict(service.query(TRIALS))
    if states != {"done": expected}:
        yield f"trials are {states}, expected {expected} done"
    rows = service.query(RECORDS)
    places = Counter((digest, task, episode) for digest, task, episode, _ in rows)
    if len(places) != expected or max(places.values(), default=0) != 1:
        yield f"{len(places)} of {expected} trials have a record, at most {max(places.values(), default=0)} each"
    if len(plan) != expected:
        yield f"the plan has {len(plan)} places, expected {expected}"
    for name in STATIONS:
        ends = [end for _, requires, end in sorted(service.query(PLACES)) if requires.endswith(f" at {name}") and end]
        if ends != sorted(ends):
            yield f"the trials of {name} did not end in the order of the plan"
    differing = service.query("SELECT count(*) FROM episode_differences")[0][0]
    if differing:
        yield f"{differing} trials were played twice with different records"
    repeats = [each for (found,) in service.query(REPEATS) for each in found]
    stops = [each["reason"] for each in repeats if each["cause"] == "broke"]
    print(f"repeated: {dict(Counter(each['cause'] for each in repeats))}", flush=True)
    for reason in stops:
        print(f"  {reason}", flush=True)
    scripted = len(STATIONS) * len(TwinFault)
    if len(stops) > scripted + max(1, expected // 100):
        yield f"{len(stops)} attempts did not count, expected the {scripted} scripted ones and one in 100 trials"
    yield from check_videos(service, [EpisodeRecord.model_validate(record) for *_, record in rows])


def check_videos(service: DisturbedService, records: list[EpisodeRecord]) -> Iterator[str]:
    """Compare each stored video with its record."""
    stored = {path.name: path for path in (service.state_dir / "blobs").rglob("*") if path.is_file()}
    for record in records:
        assert record.video is not None
        file = stored.get(record.video.sha256)
        if file is None:
            yield f"the video of trial {record.episode} with code {record.video.code} is lost"
            continue
        found = verify_video(file, record)
        yield from (f"trial {record.episode}: {problem}" for problem in found.problems)
    print(f"{len(records)} videos compared with their records", flush=True)


if __name__ == "__main__":
    sys.exit(main())
