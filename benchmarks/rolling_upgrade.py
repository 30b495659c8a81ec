"""Measures an upgrade while evaluations run, with old and new servers and workers on one database.

Run it as `python benchmarks/rolling_upgrade.py [--submissions 4] [--json FILE]`. Releases are copies of this tree: the
new one has another evaluator and a further migration that adds a column; a third one has a migration that old processes
cannot work with. For each rule of `VITAC_OUTDATED_EVALUATIONS` the old server is asked for pages all the time, the new
server and a worker of its release start beside the old ones, and the old worker is drained. The figures are void, and
it exits with 1, if the old server failed a request, if an evaluation is not completed, or if one has shards or episodes
of two evaluators.
"""

import argparse
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.request import Request, urlopen
from uuid import UUID

from service import PEG_INSERTION, newest, service, upload, wait_until
from sqlalchemy import func, select
from vitac.evaluator.version import evaluator_version
from vitac.server.accounts import tokens
from vitac.server.database.models import EpisodeResult, Evaluation, Shard, Worker
from vitac.server.database.schema import newest_revision
from vitac.server.database.states import EvaluationState, Role, WorkerOrder, WorkerState
from vitac.server.principals import CONSOLE
from vitac.server.queue import workers
from vitac.server.services import Services
from vitac.server.settings import OutdatedRule

ROOT = Path(__file__).parents[1]
FOLDERS = ("cli", "docs", "envs", "errors", "evaluator", "migrations", "server", "station", "training", "web", "worker")
VITAC = "import sys; from vitac.cli.main import main; main(sys.argv[1:])"
LOOK_S = 0.2
MIGRATION = '''
"""A migration of the benchmark."""
import sqlalchemy as sa
from alembic import op

revision, down_revision, branch_labels, depends_on = "{revision}", "{before}", None, None
works_with_older = {works_with_older}


def upgrade() -> None:
    op.add_column("teams", sa.Column("bench_{revision}", sa.Text()))


def downgrade() -> None:
    op.drop_column("teams", "bench_{revision}")
'''


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--submissions", type=int, default=4, help="peg insertion policies that wait at the start")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    arguments = parser.parse_args()
    figures = {}
    with tempfile.TemporaryDirectory(prefix="vitac-releases-") as folder:
        trees = releases(Path(folder))
        for rule in OutdatedRule:
            figures[rule.value] = upgraded(rule, arguments.submissions, trees)
            print(json.dumps({rule.value: figures[rule.value]}, indent=1), flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1) + "\n")
    wrong = [found for rule in figures.values() for found in rule["wrong"]]
    if wrong:
        sys.exit("\n".join(wrong))


def upgraded(rule: OutdatedRule, n: int, trees: tuple[Path, Path, Path]) -> dict[str, Any]:
    """Upgrade a service with evaluations at work; return what was seen."""
    with service(0, 1) as (services, principal), ExitStack() as stack:
        old, new, newest_tree = trees
        ids = [upload(services, principal, PEG_INSERTION, note=f"# {number}\n") for number in range(n)]
        old_server = stack.enter_context(running(services, old, "serve"))
        stack.enter_context(running(services, old, "worker"))
        asked = stack.enter_context(asking(old_server, services, ids[0]))
        wait_until(lambda: count_episodes(services) > 20, LOOK_S)
        began = time.monotonic()

        def since() -> float:
            return round(time.monotonic() - began, 1)

        new_server = stack.enter_context(running(services, new, "serve", outdated=rule))
        seen: dict[str, Any] = {"new_server_ready_after_s": since()}
        stack.enter_context(running(services, new, "worker"))
        wait_until(lambda: any(one.evaluator_version != evaluator_version() for one in ready(services)), LOOK_S)
        seen["new_worker_ready_after_s"] = since()
        if rule is OutdatedRule.FINISH:
            wait_until(lambda: completed(services, evaluator_version()) > 0, LOOK_S)
            seen["old_evaluation_completed_after_s"] = since()
        drain(services)
        wait_until(lambda: not [one for one in ready(services) if one.evaluator_version == evaluator_version()], LOOK_S)
        seen["old_worker_gone_after_s"] = since()
        wait_until(lambda: all(newest(services, one).state is EvaluationState.COMPLETED for one in ids), LOOK_S)
        seen["all_completed_after_s"] = since()
        seen["old_server"] = asked.figures()
        seen |= look(services, ids)
        seen["wrong"] += asked.failed
        seen["new_server_answers"] = get(f"{new_server}/ready")[0]
        stack.enter_context(running(services, newest_tree, "serve"))
        status, answer = get(f"{old_server}/ready")
        seen["beside_a_schema_that_old_ones_cannot_use"] = [status, json.loads(answer)["migrations"]]
    return seen


def releases(folder: Path) -> tuple[Path, Path, Path]:
    """Make the trees of three releases."""
    own = newest_revision()
    further = [f"{int(own) + 1:04}", f"{int(own) + 2:04}"]
    trees = (folder / "old", folder / "new", folder / "newest")
    for number, tree in enumerate(trees):
        for name in FOLDERS:
            shutil.copytree(ROOT / name, tree / "vitac" / name, ignore=shutil.ignore_patterns("__pycache__"))
        for revision, before, adds in ((further[0], own, True), (further[1], further[0], False))[:number]:
            text = MIGRATION.format(revision=revision, before=before, works_with_older=adds)
            (tree / "vitac" / "migrations" / "versions" / f"v{revision}_bench.py").write_text(text)
        if number:
            version = tree / "vitac" / "evaluator" / "version.py"
            version.write_text(
                version.read_text().replace('EVALUATOR_RELEASE = "1"', f'EVALUATOR_RELEASE = "{1 + number}"')
            )
    return trees


@contextmanager
def running(services: Services, tree: Path, what: str, outdated: OutdatedRule = OutdatedRule.RESTART) -> Iterator[str]:
    """Run `vitac serve` or `vitac worker` of a release; yield the server's address once it is ready."""
    port = free_port()
    state = Path(tempfile.mkdtemp(prefix="state-", dir=tree))
    environment = os.environ | {
        "PYTHONPATH": str(tree),
        "VITAC_STATE_DIR": str(state),
        "VITAC_DATABASE_URL": services.database.address,
        "VITAC_DATABASE_OWNER_URL": services.database.owner_address,
        "VITAC_STORAGE_URL": (services.settings.state_dir / "blobs").as_uri(),
        "VITAC_OUTDATED_EVALUATIONS": outdated.value,
        "VITAC_PORT": str(port),
    }
    with (tree / f"{what}.log").open("ab") as log:
        process = subprocess.Popen(  # noqa: S603 - our own interpreter and command
            [sys.executable, "-P", "-c", VITAC, what], env=environment, stdout=log, stderr=log, cwd=tree
        )
    address = f"http://127.0.0.1:{port}"
    try:
        if what == "serve":
            wait_until(lambda: get(f"{address}/ready")[0] == 200 or process.poll() is not None, LOOK_S)
        yield address
    finally:
        process.terminate()
        process.wait()


@dataclass(kw_only=True)
class Asked:
    """What a server answered to somebody who asks all the time."""

    failed: list[str] = field(default_factory=list)
    times_s: list[float] = field(default_factory=list)

    def figures(self) -> dict[str, float]:
        """Return how many requests there were and how long they took."""
        times = sorted(self.times_s)
        return {
            "requests": len(times),
            "failed": len(self.failed),
            "p99_ms": round(1000 * times[int(0.99 * len(times))], 1),
            "longest_ms": round(1000 * times[-1], 1),
        }


@contextmanager
def asking(address: str, services: Services, submission: UUID) -> Iterator[Asked]:
    """Ask a server for its state, a board and a submission, over and over, while the block runs."""
    with services.database.transaction() as session:
        secret = tokens.issue(session, CONSOLE, role=Role.ORGANIZER, label="bench", lifetime=None).secret
    asked, over = Asked(), threading.Event()
    paths = ("/ready", "/tracks/track_1", "/api/v1/leaderboards/track_1", f"/api/v1/submissions/{submission}")

    def ask() -> None:
        while not over.wait(LOOK_S):
            for path in paths:
                began = time.monotonic()
                status, answer = get(f"{address}{path}", secret)
                asked.times_s.append(time.monotonic() - began)
                if status != 200:
                    asked.failed.append(f"the old server answered {path} with {status}: {answer[:200]}")

    thread = threading.Thread(target=ask, daemon=True)
    thread.start()
    try:
        yield asked
    finally:
        over.set()
        thread.join()


def get(address: str, secret: str = "") -> tuple[int, str]:
    """Return status and body of an answer; 0 where nobody answers."""
    request = Request(address, headers={"authorization": f"Bearer {secret}"} if secret else {})  # noqa: S310 - ours
    with suppress(URLError, OSError):
        try:
            with urlopen(request, timeout=30) as answer:  # noqa: S310 - ours
                return answer.status, answer.read().decode()
        except HTTPError as error:
            return error.code, error.read().decode()
    return 0, "no answer"


def look(services: Services, ids: list[UUID]) -> dict[str, Any]:
    """Return by which evaluators the submissions were evaluated, and what is wrong with that."""
    with services.database.transaction() as session:
        evaluations = session.scalars(select(Evaluation).order_by(Evaluation.created_at)).all()
        wrong = []
        for one in evaluations:
            played = {shard.manifest["evaluator_version"] for shard in one.shards if shard.manifest}
            stored = select(EpisodeResult.evaluator_version).where(EpisodeResult.evaluation_id == one.id).distinct()
            if one.state is EvaluationState.COMPLETED and {*played, *session.scalars(stored)} != {
                one.evaluator_version
            }:
                wrong.append(f"evaluation {one.id} of {one.evaluator_version} was played with {sorted(played)}")
        done = [one for one in evaluations if one.state is EvaluationState.COMPLETED]
        if len(done) != len(ids):
            wrong.append(f"expected {len(ids)} completed evaluations, got {len(done)}")
        hashes = {(one.evaluator_version, one.result_hash) for one in done}
        if len({version for version, _ in hashes}) != len(hashes):
            wrong.append("one policy has several results under one evaluator")
        versions = [one.evaluator_version for one in done]
        restarted = [one.id for one in evaluations if one.state is EvaluationState.CANCELLED]
        repeated = select(func.count()).where(EpisodeResult.evaluation_id.in_(restarted))
        return {
            "completed": {version: versions.count(version) for version in sorted(set(versions))},
            "restarted": len(restarted),
            "episodes_played_again": session.scalar(repeated),
            "shards_tried_again": session.scalar(select(func.count()).where(Shard.token > 1, Shard.state == "done")),
            "wrong": wrong,
        }


def ready(services: Services) -> list[Worker]:
    """Return the workers that take shards."""
    with services.database.transaction() as session:
        return list(session.scalars(select(Worker).where(workers.is_alive(services.settings))))


def drain(services: Services) -> None:
    """Ask the workers of the old release to end after the shards that they run."""
    with services.database.transaction() as session:
        for worker in workers.list_workers(session):
            if worker.evaluator_version == evaluator_version() and worker.state is not WorkerState.STOPPED:
                workers.give_order(session, CONSOLE, worker.id, WorkerOrder.DRAIN)


def count_episodes(services: Services) -> int:
    """Return how many episodes are stored."""
    with services.database.transaction() as session:
        return session.scalar(select(func.count()).select_from(EpisodeResult)) or 0


def completed(services: Services, version: str) -> int:
    """Return how many evaluations of an evaluator are completed."""
    is_done = Evaluation.state == EvaluationState.COMPLETED, Evaluation.evaluator_version == version
    with services.database.transaction() as session:
        return session.scalar(select(func.count()).select_from(Evaluation).where(*is_done)) or 0


def free_port() -> int:
    """Return a port that nobody listens on."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


if __name__ == "__main__":
    main()
