"""The service that page tests visit: one database with content, made once per process by the server's own functions.

Every test gets the real application over a copy. A test that has written something leaves its copy behind; tests that
only read share one.
"""

import hashlib
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from functools import cache
from html import unescape
from typing import Any
from uuid import UUID

import numpy as np
from asgi_browser import AsgiBrowser
from databases import fresh_database, make_template, state_directory
from fastapi import FastAPI
from service_factories import (
    LOCK,
    TASK,
    TRACK,
    add_result,
    finish_within,
    forget_boards,
    make_failed_record,
    make_principal,
    make_record,
    make_score,
    make_secret,
    make_settings,
    make_upload,
    play_together,
    sha256,
    shard_ids,
    submit_scored,
    take_shard,
)
from sqlalchemy import event, select, update
from sqlalchemy.orm import Session
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome, EpisodeRecord
from vitac.evaluator.shards.order import ShardEnd
from vitac.evaluator.tracks import ListKind, find_task
from vitac.server.accounts import tokens
from vitac.server.database.engine import Database
from vitac.server.database.models import ApiToken, EpisodeResult, Evaluation, SealedList, Submission, Team
from vitac.server.database.states import Role, WorkState
from vitac.server.evaluations.episode_store import missing_episodes, store_episodes
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.leaderboards.public_pages import set_public
from vitac.server.principals import CONSOLE, Principal
from vitac.server.services import Services
from vitac.server.storage.blobs import BlobStore
from vitac.server.submissions import creation
from vitac.web.application import create
from vitac.web.front import Recent
from vitac.web.session import COOKIE, SessionSigner, begin
from vitac.web.site import FRONT_KEPT_S

from competitions import put_in_place

GELBOTS, BEARS, ORGANIZERS = "Gelbots", "Bears", "organizers"
SIGNER = SessionSigner(key=b"k" * 32)
DEFAULTS: dict[str, Any] = {"session_key": SIGNER.key.decode(), "sign_ins_per_hour": 100_000}
WRITES = re.compile(r"\b(INSERT|UPDATE|DELETE|TRUNCATE)\b(?! OF)")
NAMES = ("sharp", "both", "done", "broke", "runs", "waits")
"""The submissions, the oldest first."""
DONE = {TASK: (80, 74, 80)}
BOTH = {TASK: (80, 74, 80), LOCK: (31, 24, 40, 1)}
SHARP = {TASK: (84, 80, 77), LOCK: (40, 38, 2, 0)}
FAILURES = (EpisodeOutcome.TACTILE, EpisodeOutcome.STEPS, EpisodeOutcome.TACTILE, EpisodeOutcome.ERROR)
N_RUNNING = 137
"""Finished episodes of the submission that runs."""


@dataclass(frozen=True, kw_only=True)
class Seed:
    """What the template of all copies holds.

    Attributes:
        template: name of the database.
        people: by their names.
        tokens: of these people.
        submissions: by their names.
    """

    template: str
    people: dict[str, Principal]
    tokens: dict[str, str]
    submissions: dict[str, UUID]


@cache
def seed() -> Seed:
    """Two teams, organizers, and submissions in every state, an hour after each other.

    The Bears have `sharp`, which leads in peg insertion, and `waits`; the Gelbots have `both`, which leads in all tasks
    together, `done`, `broke` and `runs`.
    """
    database = make_template("vitac_pages")
    with database.transaction() as session:
        people = {GELBOTS: make_principal(session, GELBOTS), BEARS: make_principal(session, BEARS), ORGANIZERS: CONSOLE}
        secrets = {name: make_secret(session, by) for name, by in people.items()}
        session.execute(update(ApiToken).values(last_used_at="2100-01-01"))  # pages note a use now and then
        submissions = {
            name: submit_and_play(session, people[team], name, successes)
            for team, name, successes in ((BEARS, "sharp", SHARP), (GELBOTS, "both", BOTH), (GELBOTS, "done", DONE))
        }
        submissions["broke"] = _submit_broken(session, people[GELBOTS])
        submissions["runs"] = _submit_running(session, people[GELBOTS])
        submissions["waits"] = _submit(session, people[BEARS], "waits", [TASK]).id
        people = {name: tokens.authenticate(session, secret) for name, secret in secrets.items()}
    database.dispose()
    return Seed(template="vitac_pages", people=people, tokens=secrets, submissions=submissions)


def _submit(session: Session, by: Principal, name: str, tasks: Iterable[str]) -> Submission:
    played = tuple(tasks)
    upload = make_upload(name, name=name, tasks=played, track=find_task(played[0])[0].name)
    submission = creation.create(session, by, upload)[0]
    if name in NAMES:
        submission.submitted_at -= timedelta(hours=len(NAMES) - NAMES.index(name))
    return submission


def submit_and_play(session: Session, by: Principal, name: str, successes: Mapping[str, tuple[int, ...]]) -> UUID:
    """A submission whose evaluation is complete, with so many successes for each shape of its tasks."""
    submission = _submit(session, by, name, successes)
    play_together(
        session,
        shard_ids(session, submission),
        lambda episode, task: played_record(name, task, episode, successes[task]),
    )
    return submission.id


def played_record(name: str, task: str, episode: int, successes: Sequence[int]) -> EpisodeRecord:
    """An episode of a policy of its own, which solves the first ones of each shape."""
    starts = find_task(task)[1].episodes
    shape = starts[episode - 1].shape
    place = [start.number for start in starts if start.shape == shape].index(episode)
    solved = place < successes[find_task(task)[1].episode_list.shapes.index(shape)]
    steps = 3 + episode % 4
    own = int(sha256(name)[:4], 16) + 1
    sign = 1 - 2 * (episode * own // 7 % 2)
    return make_record(
        episode,
        EpisodeOutcome.SUCCESS if solved else FAILURES[episode % len(FAILURES)],
        task,
        env_steps=steps,
        actions=ActionSequence.from_array(np.full((steps, 3), sign * own / 70_000, np.float32)),
        state_hashes=tuple(sha256(f"{name} {episode} {step}") for step in range(steps + 1)),
        infos=({},) * steps,
    )


def _submit_broken(session: Session, by: Principal) -> UUID:
    submission = _submit(session, by, "broke", [LOCK])
    lease = take_shard(session, shard_ids(session, submission)[0])
    store_episodes(session, lease, [make_record(number, task=LOCK) for number in (1, 2, 3)])
    failed = [make_failed_record(number, task=LOCK, output=f"<script>alert({number})</script>") for number in (4, 5, 6)]
    store_episodes(session, lease, failed)
    finish_within(session, lease, ShardEnd.BROKEN)
    return submission.id


def _submit_running(session: Session, by: Principal) -> UUID:
    submission = _submit(session, by, "runs", [TASK])
    played = 0
    for shard in shard_ids(session, submission):
        if played == N_RUNNING:
            break
        lease = take_shard(session, shard, lease_s=86_400.0)
        episodes = list(lease.episodes)[: N_RUNNING - played]
        store_episodes(session, lease, [played_record("runs", TASK, number, (90, 0, 0)) for number in episodes])
        played += len(episodes)
        if len(episodes) == len(lease.episodes):
            finish_within(session, lease)
    return submission.id


@dataclass(kw_only=True)
class SeededSite:
    """The application over one copy, and who visits it."""

    app: FastAPI
    services: Services
    seed: Seed
    is_changed: bool = False
    added: dict[str, UUID] = field(default_factory=dict)

    @property
    def database(self) -> Database:
        """The copy."""
        return self.services.database

    def id_of(self, name: str) -> UUID:
        """The submission of that name."""
        return (self.seed.submissions | self.added)[name]

    def path_of(self, name: str) -> str:
        """The page of the submission of that name."""
        return f"/submissions/{self.id_of(name)}"

    def token_of(self, name: str) -> str:
        """The API token of somebody."""
        return self.seed.tokens[name]

    def visitor(self, name: str | None = None, **options: Any) -> AsgiBrowser:
        """A browser, which holds a session of one of the people if a name is given."""
        browser = AsgiBrowser(self.app, **options)
        if name is not None:
            token_id = self.seed.people[name].token_id
            assert token_id is not None
            browser.cookies.set(COOKIE, SIGNER.sign(begin(token_id, now=datetime.now(UTC))))
        return browser

    def team_visitor(self, name: str) -> AsgiBrowser:
        """A browser with a session of a team that was added."""
        with self.database.transaction() as session:
            team = session.scalars(select(Team).where(Team.name == name)).one()
            token = tokens.issue(session, CONSOLE, role=Role.TEAM, label="test", team=team, lifetime=None).token
        browser = self.visitor()
        browser.cookies.set(COOKIE, SIGNER.sign(begin(token.id, now=datetime.now(UTC))))
        return browser

    @contextmanager
    def evaluation(self, name: str) -> Iterator[tuple[Session, Evaluation]]:
        """The newest evaluation of a submission, to be changed in this transaction."""
        with self.database.transaction() as session:
            yield session, newest_evaluation(session, session.get_one(Submission, self.id_of(name)))

    def seal(self, name: str, *, is_revealed: bool = False) -> None:
        """Make the newest evaluation of a submission one on a sealed list."""
        with self.evaluation(name) as (session, evaluation):
            sealed = SealedList(
                commitment=sha256(name), competition="cup", track=TRACK, stage=name, secret=sha256("secret"),
                revealed_at=datetime.now(UTC) if is_revealed else None,
            )  # fmt: skip
            session.add(sealed)
            session.flush()
            evaluation.commitment, evaluation.list_kind = sealed.commitment, ListKind.SEALED
            of_evaluation = EpisodeResult.evaluation_id == evaluation.id
            session.execute(update(EpisodeResult).where(of_evaluation).values(commitment=sealed.commitment))

    def hold(self, content: Mapping[str, Any]) -> None:
        """Make that the competition of the service."""
        with self.database.transaction() as session:
            put_in_place(session, dict(content))
        self.forget_front_page()

    def forget_front_page(self) -> None:
        """Read anew what pages say that is cached for some seconds."""
        site = self.app.state.site
        self.app.state.site = replace(site, front=Recent(kept_s=FRONT_KEPT_S), competitions=Recent(kept_s=FRONT_KEPT_S))

    def score(self, team: str, name: str, successes: int, task: str = TASK, **changes: Any) -> UUID:
        """A complete result of a team, which is registered if need be, without the episodes behind it."""
        with self.database.transaction() as session:
            known = session.scalar(select(Team).where(Team.name == team))
            by = make_principal(session, team) if known is None else Principal(
                role=Role.TEAM, team_id=known.id, team_name=known.name, leads_team=True
            )  # fmt: skip
            score = make_score(successes, len(find_task(task)[1].episodes))
            self.added[name] = submit_scored(session, by, name, {task: score}, **changes).id
        return self.added[name]

    def fill_board(self, n_teams: int) -> None:
        """Further teams, `Team 001` and so on, with results in peg insertion that are worse from one to the next."""
        with self.database.transaction() as session:
            for number in range(1, n_teams + 1):
                name = f"Team {number:03d}"
                team = Team(name=name, name_key=name.casefold())
                add_result(session, number, team, {TASK: make_score(201 - number, 270)}, datetime.now(UTC))

    def store(self, content: bytes) -> str:
        """Put a file into the store; returns its digest."""
        digest = hashlib.sha256(content).hexdigest()
        path = self.services.settings.scratch_dir / digest
        path.write_bytes(content)
        self.services.blobs.put(path, digest)
        return digest

    def publish(self, name: str) -> None:
        """Let everybody see a submission."""
        with self.database.transaction() as session:
            set_public(session, CONSOLE, self.id_of(name), public=True)

    def play_on(self, name: str, *, to_end: bool = False) -> None:
        """Store one more episode of the next open shard of a submission, or all that are left."""
        with self.evaluation(name) as (session, evaluation):
            for shard in evaluation.shards:
                if shard.state in {WorkState.DONE, WorkState.FAILED}:
                    continue
                if shard.state is WorkState.RUNNING:
                    shard.state, shard.lease_expires_at, shard.worker_id = WorkState.QUEUED, None, None
                    session.flush()
                lease = take_shard(session, shard.id, lease_s=86_400.0)
                missing = missing_episodes(session, lease)
                episodes = missing if to_end else missing[:1]
                store_episodes(session, lease, [played_record(name, TASK, number, (90, 90, 90)) for number in episodes])
                if len(episodes) == len(missing):
                    finish_within(session, lease)
                if not to_end:
                    break

    def submit(self, team: str, name: str, successes: Mapping[str, tuple[int, ...]]) -> str:
        """A further complete submission; the path of its page."""
        with self.database.transaction() as session:
            self.added[name] = submit_and_play(session, self.seed.people[team], name, successes)
        return self.path_of(name)


def form_token(browser: AsgiBrowser) -> str:
    """What the forms of a browser's session carry."""
    return SIGNER.form_token(browser.cookies[COOKIE])


@contextmanager
def seeded_site(**settings: Any) -> Iterator[SeededSite]:
    """The application over a new copy of the seed; `settings` change the defaults."""
    state_dir = state_directory()
    made = make_settings(**(DEFAULTS | settings | {"state_dir": state_dir}))
    made.scratch_dir.mkdir(parents=True)
    with fresh_database(seed().template) as address:
        services = Services(
            settings=made, database=Database(address), blobs=BlobStore.from_settings(made), postgres=None
        )
        forget_boards()
        site = SeededSite(app=create(services, sweeps=False), services=services, seed=seed())

        def note_write(_: object, __: object, statement: str, *___: object) -> None:
            site.is_changed = site.is_changed or WRITES.search(statement) is not None

        event.listen(services.database.engine, "before_cursor_execute", note_write)
        try:
            yield site
        finally:
            services.database.dispose()
            shutil.rmtree(state_dir)


class SharedSite(ExitStack):
    """The copy that nothing was written to so far; close it at the end."""

    _site: SeededSite | None = None

    @contextmanager
    def visited(self) -> Iterator[SeededSite]:
        """The copy, or a new one where the last test has written something."""
        site = self._site = self._site or self.enter_context(seeded_site())
        site.forget_front_page()
        yield site
        if site.is_changed:
            self._site = None
            self.close()


def words(html: str) -> str:
    """The text of a page, with single spaces."""
    return " ".join(unescape(re.sub(r"<[^>]+>", " ", html.partition("<main")[2] or html)).split())
