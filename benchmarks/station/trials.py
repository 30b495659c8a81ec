"""Plays trials by the real agent at a twin of hidden settings, with every fault once and `kill -9` of the agent.

    .venv/bin/python benchmarks/station/trials.py [--trials 200] [--kills 10] [--minutes 60] [--state DIR]

Service, twin and agent (`vitac station run`) are processes of their own. With --state the next run takes the trials
that are left, so that a long run can be made in parts. Exit code 0: every aim is reached; 1: one is not; 2: trials are
left.
"""

import argparse
import json
import re
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from subprocess import Popen
from tempfile import TemporaryDirectory
from time import monotonic, sleep
from typing import Any
from uuid import UUID

import numpy as np
from sqlalchemy import select
from vitac.cli.client.http import Client
from vitac.cli.client.submit import packed
from vitac.cli.demo.display import team_token
from vitac.cli.demo.laboratory import (
    TRACK,
    Laboratory,
    made_for_station,
    running_laboratory,
    stop_agent,
    use_station_track,
)
from vitac.cli.service.database import load_settings
from vitac.server.database.models import EpisodeResult, Evaluation, Shard
from vitac.server.database.states import EvaluationState, RepeatCause, WorkState
from vitac.station.twin.hidden import FaultScript, ScriptedFault, TwinFault, draw_hidden

EXAMPLE = Path("examples/peg_insertion_trained")
STARTS = 10
LOOK_S = 0.2
LONGEST_S = 6.0
"""The agent is killed this long after a trial has begun, at most."""
SAYS = {
    TwinFault.UNPLUGGED_CAMERA: "stopped sending pictures|cannot be opened",
    TwinFault.FROZEN_STREAM: "is frozen",
    TwinFault.STUCK_GRIPPER: "its fingers move|is stuck",
    TwinFault.DROPPED_PEG: "has lost its peg",
    TwinFault.TORN_GEL: "gel is damaged or covered|markers",
    TwinFault.FORCE_SPIKE: "^Trial .*Force ",
    TwinFault.STAGE_ALARM: "limit switch|in alarm",
    TwinFault.NETWORK_CUT: "force/torque box",
}
"""What the reason of an attempt says that a fault has ended."""


@dataclass(frozen=True, kw_only=True)
class State:
    """What the service knows of the evaluation."""

    state: EvaluationState
    verdict: str
    outcomes: list[tuple[int, str]]
    repeats: list[tuple[str, str]]
    running_for_s: float | None


def read_state(laboratory: Laboratory, evaluation_id: UUID) -> State:
    """Ask the database, as an organizer can."""
    with laboratory.service.database.transaction() as session:
        evaluation = session.get_one(Evaluation, evaluation_id)
        shards = session.scalars(select(Shard).where(Shard.evaluation_id == evaluation_id)).all()
        results = session.scalars(select(EpisodeResult).where(EpisodeResult.evaluation_id == evaluation_id)).all()
        begun = [shard.started_at for shard in shards if shard.state is WorkState.RUNNING and shard.started_at]
        return State(
            state=evaluation.state,
            verdict=evaluation.verdict_message or "",
            outcomes=[(each.episode, each.outcome) for each in results],
            repeats=[(each["cause"], each["reason"]) for shard in shards for each in shard.repeats],
            running_for_s=(datetime.now(UTC) - max(begun)).total_seconds() if begun else None,
        )


def count_kills(found: State) -> int:
    """Count the trials that were queued again because their agent was killed."""
    return [cause for cause, _ in found.repeats].count(RepeatCause.LOST)


def replace_agent(laboratory: Laboratory, agent: Popen[bytes], evaluation_id: UUID) -> Popen[bytes]:
    """Kill the agent, start another one, and wait until the killed one's trial is queued again."""
    kills = count_kills(read_state(laboratory, evaluation_id))
    agent.kill()
    agent.wait()
    successor = laboratory.start_agent()
    while count_kills(read_state(laboratory, evaluation_id)) == kills:
        sleep(LOOK_S)
    return successor


def play(laboratory: Laboratory, evaluation_id: UUID, given: argparse.Namespace) -> State:
    """Run the agent, and kill it now and then, until everything is played or the time is over."""
    generator, end_s = np.random.default_rng(1), monotonic() + 60 * given.minutes
    agent = laboratory.start_agent()
    shown: set[tuple[object, ...]] = set()
    try:
        while True:
            found = read_state(laboratory, evaluation_id)
            for line in [*((f"trial {n}: {outcome}",) for n, outcome in found.outcomes), *found.repeats]:
                if line not in shown:
                    shown.add(line)
                    print(": ".join(map(str, line)), flush=True)
            if found.state not in (EvaluationState.QUEUED, EvaluationState.RUNNING) or monotonic() > end_s:
                return found
            kills, running_s = count_kills(found), found.running_for_s or 0.0
            is_due = kills < given.kills and len(found.outcomes) >= (kills + 1) * given.trials / (given.kills + 1)
            if is_due and running_s > generator.uniform(0.5, LONGEST_S):
                print(f"agent {agent.pid} is killed, {running_s:.1f} s after a trial has begun", flush=True)
                agent = replace_agent(laboratory, agent, evaluation_id)
            if agent.poll() is not None:
                print(f"the agent ended with code {agent.returncode}; it is started again", flush=True)
                agent = laboratory.start_agent()
            sleep(LOOK_S)
    finally:
        stop_agent(agent)


def check_aims(found: State, begun: set[TwinFault], given: argparse.Namespace) -> Iterator[tuple[bool, str]]:
    """Yield each aim and whether it is reached."""
    counted = Counter(number for number, _ in found.outcomes)
    lost = sorted(set(range(1, given.trials + 1)) - set(counted))
    reasons = [reason for cause, reason in found.repeats if cause == RepeatCause.BROKE]
    yield found.state is EvaluationState.COMPLETED, f"the evaluation is {found.state} {found.verdict}"
    yield not lost, f"{len(counted)} of {given.trials} trials have a result; lost: {lost or 'none'}"
    yield max(counted.values(), default=0) == 1, f"results of one trial, at most: {max(counted.values(), default=0)}"
    yield count_kills(found) == given.kills, f"{count_kills(found)} of {given.kills} kills, each repeated"
    for fault in TwinFault:
        named = sum(bool(re.search(SAYS[fault], reason)) for reason in reasons)
        yield (
            fault in begun and named > 0,
            f"{fault}: {'begun' if fault in begun else 'never'}, named by {named} attempts",
        )
    yield all(reasons), f"{len(reasons)} attempts that did not count, each with a reason"


def parse() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("submission", nargs="?", type=Path, default=EXAMPLE)
    parser.add_argument("--trials", type=int, default=200, help="a multiple of ten, or fewer than ten")
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--state", type=Path, help="folder of a run in parts")
    parser.add_argument("--secret", default="benchmark", help="of what the twin hides")
    return parser.parse_args()


def faults_left(begun: set[TwinFault], given: argparse.Namespace) -> FaultScript:
    """Spread the faults that did not come yet over the trials."""
    every = max(given.trials // (len(TwinFault) + 1), 4)  # a trial that is repeated meets no other one
    left = enumerate((fault for fault in TwinFault if fault not in begun), start=1)
    return FaultScript(faults=tuple(ScriptedFault(fault=fault, contact=every * n) for n, fault in left))


def submit(laboratory: Laboratory, submission: Path) -> UUID:
    """Submit, unless an earlier part has, and return the evaluation's id."""
    service = laboratory.service
    client = Client(server=service.address, token=team_token(service.database, laboratory.state_dir))
    with made_for_station(submission) as folder, packed(folder) as archive:
        found: Any = client.upload(archive, track=TRACK, on_position=lambda _: None)
    return UUID(found["evaluation"]["id"])


def main() -> int:
    """Print each attempt with its outcome, then the aims."""
    given = parse()
    starts = min(given.trials, STARTS)
    with ExitStack() as stack:
        state_dir = (given.state or Path(stack.enter_context(TemporaryDirectory()))).absolute()
        state_dir.mkdir(parents=True, exist_ok=True)
        state_dir.chmod(0o711)  # where this runs as root, the database has a user of its own
        use_station_track(state_dir / "tracks", starts=starts, repeats=given.trials // starts)
        notes = state_dir / "run.json"
        earlier: dict[str, Any] = {"begun": [], "twin_s": 0.0, "real_s": 0.0}
        earlier |= json.loads(notes.read_text()) if notes.exists() else {}
        begun = {TwinFault(each) for each in earlier["begun"]}
        settings = load_settings(state_dir=state_dir, port=0)
        log = stack.enter_context((state_dir / "agent.log").open("ab"))
        laboratory = stack.enter_context(
            running_laboratory(
                settings,
                log=log.fileno(),
                notify=print,
                hidden=draw_hidden(given.secret.encode()),
                script=faults_left(begun, given),
            )
        )
        evaluation_id, began_s = submit(laboratory, given.submission), monotonic()
        found = play(laboratory, evaluation_id, given)
        begun |= set(laboratory.twin.begun())
        twin_s, real_s = earlier["twin_s"] + laboratory.twin.time_s(), earlier["real_s"] + monotonic() - began_s
        notes.write_text(json.dumps({"begun": sorted(begun), "twin_s": twin_s, "real_s": real_s}))
    print(dict(Counter(outcome for _, outcome in found.outcomes)))
    if found.state in (EvaluationState.QUEUED, EvaluationState.RUNNING):
        print(f"{given.trials - len(found.outcomes)} trials are left; run it again with --state {state_dir}")
        return 2
    aims = [*check_aims(found, begun, given)]
    aims.append(
        (twin_s > real_s, f"{twin_s:.0f} s of the twin in {real_s:.0f} s: {twin_s / real_s:.1f} times real time")
    )
    for is_reached, sentence in aims:
        print("reached" if is_reached else "MISSED ", sentence)
    return 0 if all(is_reached for is_reached, _ in aims) else 1


if __name__ == "__main__":
    sys.exit(main())
