"""How long do boards, the list of submissions and one submission take, as pages and from the API?

Run it as `python benchmarks/boards.py [--submissions 10000] [--teams 200] [--requests 200] [--json [FILE]]`. It starts
a database of its own with completed evaluations of random scores and asks the application in this process, one request
after the other. Times are wall times; `cpu_` is the time of this process without the database. `loop_s` is what ten
million additions of plain Python take here, so that machines can be compared.
"""

import argparse
import asyncio
import json
import shutil
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from pathlib import Path
from statistics import quantiles
from time import perf_counter, process_time
from types import ModuleType
from typing import cast
from uuid import UUID, uuid4

import httpx
import numpy as np
import psycopg
from sqlalchemy import select
from sqlalchemy.orm import Session
from vitac.cli.service.web_server import collect_garbage_rarely
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome
from vitac.evaluator.scoring.score import Rate, Score, rate
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import ListKind, Task, load_track
from vitac.evaluator.version import evaluator_hash, evaluator_version
from vitac.server.accounts import teams, tokens
from vitac.server.database.models import EpisodeResult, Evaluation, Submission
from vitac.server.database.states import EvaluationState, Role
from vitac.server.evaluations.episode_store import EpisodeKey
from vitac.server.evaluations.logs import LogClaim
from vitac.server.evaluations.scores import store_scores
from vitac.server.principals import CONSOLE
from vitac.server.services import Services, open_services
from vitac.server.settings import load_settings
from vitac.web import application
from vitac.web.session import COOKIE, SessionSigner, begin

TRACK = "track_1"
TARGET_P99_MS = 20.0
WARM_UP = 5
TURNS = 10
"""So many submissions of a team have all kinds among them."""
RECORD_BYTES = 8000
ROWS_AT_ONCE = 500
A_CLAIM = LogClaim(team=None, episodes=270, successes=135, success_rate=0.5, mean_steps=5.0)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--submissions", type=int, default=10_000)
    parser.add_argument("--teams", type=int, default=200)
    parser.add_argument("--requests", type=int, default=200, help="how many of each page")
    parser.add_argument(
        "--json", type=Path, nargs="?", const=Path("-"), help="print the figures as JSON, or write them to this file"
    )
    arguments = parser.parse_args()
    if arguments.submissions < TURNS * arguments.teams:
        parser.error(
            f"Expected --submissions {TURNS * arguments.teams} or more, {TURNS} for each of {arguments.teams} teams, "
            f"so that all kinds are among them; got {arguments.submissions}. Lists show 50, and are faster with fewer."
        )
    with service(arguments.submissions, arguments.teams) as services:
        pages = asyncio.run(measure(services, arguments.requests))
    figures = {
        "submissions": arguments.submissions,
        "teams": arguments.teams,
        "target_p99_ms": TARGET_P99_MS,
        "loop_s": time_loop(),
    }
    report(figures, pages, arguments.json)


def time_loop() -> float:
    """Return the time of ten million additions [s]."""
    began, total = perf_counter(), 0
    for number in range(10_000_000):
        total += number
    return round(perf_counter() - began, 2)


def report(figures: Mapping[str, float], pages: Mapping[str, Mapping[str, float]], target: Path | None) -> None:
    """Print a table, or JSON where it is asked for; write the JSON to a file where one is named."""
    content = json.dumps({**figures, "pages": pages}, indent=1)
    if target == Path("-"):
        print(content)
        return
    print("  ".join(f"{name} {value}" for name, value in figures.items()))
    for name, times in pages.items():
        print(f"{name:24}" + "".join(f"  {key} {value:7.2f}" for key, value in times.items()))
    if target is not None:
        target.write_text(content + "\n")


@contextmanager
def service(n_submissions: int, n_teams: int) -> Iterator[Services]:
    """Open services whose database holds that many completed evaluations."""
    folder = Path(tempfile.mkdtemp(prefix="vitac-benchmark-"))
    folder.chmod(0o711)
    rng = np.random.default_rng(1)
    try:
        with open_services(load_settings(state_dir=folder / "state", database_url=None, client_share=1.0)) as services:
            with services.database.transaction() as session:
                team_ids = [teams.register(session, CONSOLE, name=f"Team {n}").id for n in range(n_teams)]
            for begun in range(0, n_submissions, ROWS_AT_ONCE):
                with services.database.transaction() as session:
                    for number in range(begun, min(begun + ROWS_AT_ONCE, n_submissions)):
                        add_submission(session, number, team_ids[number % n_teams], rng, number // n_teams % TURNS)
            with services.database.transaction() as session:
                for kind in (SubmissionKind.MODEL, SubmissionKind.LOG):
                    add_episodes(session, newest(session, team_ids[0], kind), rng)
            make_statistics(services)
            yield services
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def make_statistics(services: Services) -> None:
    """Have the database know its tables, as it does a minute later by itself; only their owner may ask for it."""
    with psycopg.connect(services.database.owner_address, autocommit=True) as connection:
        connection.execute("ANALYZE")


def add_submission(session: Session, number: int, team_id: UUID, rng: np.random.Generator, turn: int) -> None:
    """Add a completed evaluation of a model that plays one task or all; one turn in ten of a log, one of a text log."""
    kind = {8: SubmissionKind.LOG, 9: SubmissionKind.TEXT_LOG}.get(turn, SubmissionKind.MODEL)
    digest = sha256(str(number).encode()).hexdigest()
    tasks = load_track(TRACK).tasks
    plays_all = bool(rng.integers(3)) and kind.form.runs_policy
    chosen = list(tasks) if plays_all else [list(tasks)[number // 3 % len(tasks)]]
    moment = datetime.now(UTC) - timedelta(days=30) + timedelta(seconds=number)
    submission = Submission(
        id=uuid4(), team_id=team_id, kind=kind, track=TRACK, tasks=chosen, name=f"{kind.value} {number}",
        digest=digest, archive_sha256=digest, archive_bytes=1000, submitted_at=moment,
        manifest={"track": TRACK} if kind.form.runs_policy else A_CLAIM.stored(),
    )  # fmt: skip
    evaluation = Evaluation(
        submission=submission, run=1, evaluator_version=evaluator_version(), evaluator_hash=evaluator_hash(),
        platform_class="benchmark", state=EvaluationState.COMPLETED, episodes_reused=0, log_tail="",
        created_at=moment, started_at=moment, finished_at=moment + timedelta(seconds=15), result_hash=digest,
        list_kind=ListKind.PUBLIC,
    )  # fmt: skip
    scores = {name: random_score(tasks[name], rng) for name in chosen}
    store_scores(session, evaluation, scores, dict.fromkeys(chosen, digest), finished_at=moment)
    session.add(evaluation)


def random_score(task: Task, rng: np.random.Generator) -> Score:
    """Return a score of all episodes of a task."""
    shapes = task.episode_list.shapes
    by_shape: dict[str, Rate] = {}
    for shape in shapes:
        episodes = len(task.episodes) // len(shapes)
        by_shape[shape] = rate(int(rng.integers(episodes + 1)), episodes)
    episodes = sum(part.episodes for part in by_shape.values())
    successes = sum(part.successes for part in by_shape.values())
    return Score(
        **dict(rate(successes, episodes)),
        mean_steps=float(rng.uniform(3, 15)) if successes else None,
        by_shape=by_shape,
        outcomes={EpisodeOutcome.SUCCESS: successes, EpisodeOutcome.STEPS: episodes - successes},
    )


def newest(session: Session, team_id: UUID, kind: SubmissionKind) -> Submission:
    """Return the last submission of a team of a kind, a model that plays all tasks."""
    query = select(Submission).where(Submission.team_id == team_id, Submission.kind == kind)
    found = session.scalars(query.order_by(Submission.submitted_at.desc()))
    return next(submission for submission in found if len(submission.tasks) > 1 or not kind.form.runs_policy)


def add_episodes(session: Session, submission: Submission, rng: np.random.Generator) -> None:
    """Store episodes for a submission, with records as large as real ones."""
    evaluation = session.scalars(select(Evaluation).where(Evaluation.submission_id == submission.id)).one()
    key = EpisodeKey.from_evaluation(evaluation, submission)
    for name in submission.tasks:
        for number, episode in enumerate(load_track(TRACK).tasks[name].episodes, start=1):
            record = {
                "shape": episode.shape,
                "actions": ActionSequence.from_array(np.zeros((5, 3), np.float32)).model_dump(mode="json"),
                "filling": rng.bytes(RECORD_BYTES // 2).hex(),
            }
            session.add(
                EpisodeResult(
                    submission_digest=key.submission_digest,
                    evaluator_version=key.evaluator_version,
                    track=key.track,
                    task=name,
                    episode=number,
                    run=key.run,
                    shape=episode.shape,
                    initial_offset=list(episode.offset),
                    outcome="success",
                    success=True,
                    env_steps=5,
                    record=record,
                    record_digest="0" * 64,
                    states_digest=sha256(f"{submission.id} {number}".encode()).hexdigest(),
                    half_way_state=sha256(f"{submission.id} {number} half-way".encode()).hexdigest(),
                    wall_s=0.1,
                    evaluation_id=evaluation.id,
                )
            )


async def measure(services: Services, n_requests: int) -> dict[str, dict[str, float]]:
    """Time each page [ms]."""
    addresses, headers, cookies = list_addresses(services)
    app = application.create(services)
    app.state.services = services
    collect_garbage_rarely()
    transport = httpx.ASGITransport(app)
    # The transport tries this import for each request; where the package is missing, that takes a millisecond.
    sys.modules.setdefault("sniffio", cast(ModuleType, None))
    async with httpx.AsyncClient(transport=transport, base_url="http://benchmark", headers=headers) as client:
        client.cookies.update(cookies)
        return {name: await measure_times(client, address, n_requests) for name, address in addresses.items()}


def list_addresses(services: Services) -> tuple[dict[str, str], dict[str, str], dict[str, str]]:
    """Return the pages by name, and what proves that a team asks for them."""
    with services.database.transaction() as session:
        team = teams.find(session, "Team 0")
        issued = tokens.issue(session, CONSOLE, role=Role.TEAM, label="benchmark", team=team, lifetime=None)
        submission = newest(session, team.id, SubmissionKind.MODEL).id
        log = newest(session, team.id, SubmissionKind.LOG).id
    key = application.signing_key(services.settings)
    cookie = SessionSigner(key=key).sign(begin(issued.token.id, now=datetime.now(UTC)))
    task = next(iter(load_track(TRACK).tasks))
    addresses = {
        "board": f"/tracks/{TRACK}",
        "board of a task": f"/tracks/{TRACK}?task={task}",
        "logs": f"/tracks/{TRACK}/logs",
        "front page": "/",
        "submissions": "/submissions",
        "submission": f"/submissions/{submission}",
        "submission of a log": f"/submissions/{log}",
        "api board": f"/api/v1/leaderboards/{TRACK}",
        "api board of a task": f"/api/v1/leaderboards/{TRACK}?task={task}",
        "api logs": f"/api/v1/leaderboards/{TRACK}/logs",
        "api submissions": "/api/v1/submissions?limit=50",
        "api submission": f"/api/v1/submissions/{submission}",
        "api episodes": f"/api/v1/submissions/{submission}/episodes",
    }
    return addresses, {"Authorization": f"Bearer {issued.secret}"}, {COOKIE: cookie}


async def measure_times(client: httpx.AsyncClient, address: str, n_requests: int) -> dict[str, float]:
    """Ask for one page again and again, and return its times and its size."""
    wall_ms, cpu_ms = [], []
    for _ in range(WARM_UP + n_requests):
        began, began_cpu = perf_counter(), process_time()
        response = await client.get(address)
        wall_ms.append(1000 * (perf_counter() - began))
        cpu_ms.append(1000 * (process_time() - began_cpu))
        response.raise_for_status()
    times = percentiles(wall_ms[WARM_UP:]) | {f"cpu_{name}": ms for name, ms in percentiles(cpu_ms[WARM_UP:]).items()}
    return times | {"kB": round(len(response.content) / 1000, 1)}


def percentiles(times_ms: list[float]) -> dict[str, float]:
    """Return the median and the time that one in a hundred takes longer than."""
    cuts = quantiles(times_ms, n=100, method="inclusive")
    return {"p50_ms": round(cuts[49], 2), "p99_ms": round(cuts[98], 2)}


if __name__ == "__main__":
    main()
