"""Who may call which route, and that a dry run of each changes nothing: all routes of the API's description, tried."""

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any
from uuid import UUID, uuid4

import drawn_gels
import pytest
from databases import fresh_database
from every_table import rows_of_every_table
from httpx import Response
from sensor_checks import check_sensors
from service_client import POLICY, Service, bearer, copied_service, make_archive, running_service
from service_factories import TASK, TRACK, make_principal, make_score, make_settings, play_all, submit, submit_scored
from sqlalchemy import delete, select
from vitac.server.accounts import members, messages, stations, tokens
from vitac.server.api.app import create_app
from vitac.server.database.engine import Database
from vitac.server.database.models import (
    ApiToken,
    Appeal,
    Brief,
    CompetitionRow,
    EpisodeResult,
    Invitation,
    Notice,
    Question,
    Rejudgement,
    Submission,
    SubmissionFile,
    Team,
    Webhook,
    Worker,
)
from vitac.server.database.states import FileRole, NoticeChannel, NoticeKind, Role, WorkerState
from vitac.server.decisions.rejudging import compute_revision
from vitac.server.evaluations.episode_store import EpisodeKey
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.leaderboards.baselines import publish_human_baseline
from vitac.server.principals import CONSOLE, Audience
from vitac.server.submissions import appeals

from competitions import make_competition, put_in_place


class Who(StrEnum):
    VISITOR = "visitor"  # without a token
    OWNER = "owner"  # the team whose thing it is
    MEMBER = "member"  # of that team, who is not its captain
    OTHER = "other"  # another team
    JUDGE = "judge"
    ORGANIZER = "organizer"
    OUTSIDER = "outsider"  # an organizer of a competition to which none of these things belongs


EVERYBODY = frozenset(Who)
OF_TEAM = frozenset({Who.OWNER, Who.MEMBER})
AUDIENCES = {
    Audience.EVERYBODY: EVERYBODY,
    Audience.SIGNED_IN: EVERYBODY - {Who.VISITOR},
    Audience.TEAMS: OF_TEAM | {Who.OTHER},
    Audience.SUBMITTERS: OF_TEAM | {Who.OTHER, Who.ORGANIZER},
    Audience.READERS: OF_TEAM | {Who.JUDGE, Who.ORGANIZER},
    Audience.OWNERS: OF_TEAM | {Who.ORGANIZER},
    Audience.CAPTAINS: frozenset({Who.OWNER, Who.ORGANIZER}),
    Audience.JUDGES: frozenset({Who.JUDGE, Who.ORGANIZER, Who.OUTSIDER}),
    Audience.COMPETITION_ORGANIZERS: frozenset({Who.ORGANIZER, Who.OUTSIDER}),
    Audience.ORGANIZERS: frozenset({Who.ORGANIZER}),
}
"""Who is meant by what a route declares, of a thing of the team OWNER; all others get 401, 403 or 404."""
OF_NO_COMPETITION = (
    "{submission_id}",
    "{announcement_id}",
    "{appeal_id}",
    "{rejudgement_id}",
    "/judging/conflicts",
    "/messages",
)
"""Things that belong to no competition here, so that the organizer of one does not see them."""

SUBMISSION = "/api/v1/submissions/{submission_id}"
UPLOAD = "/api/v1/uploads/{upload_id}"
HUMAN_BASELINE = "/api/v1/tracks/{track}/tasks/{task}/human-baseline"
STATION = "/api/v1/stations/{name}"
TEAM = "/api/v1/teams/{team_id}"
APPEAL = "/api/v1/appeals/{appeal_id}"
COMPETITION = "/api/v1/competitions/{competition}"
STAGE = f"{COMPETITION}/tracks/{{track}}/stages/{{stage}}"
REJUDGEMENT = "/api/v1/rejudgements/{rejudgement_id}"
EVALUATION = "/api/v1/evaluations/{evaluation_id}"
MEMBER = f"{TEAM}/members/{{member_id}}"
LAST = ("cancel", "restart-unserved", "restart", "requeue", "{member_id}/token")
"""From then on there is no result, and at last the shared token no longer leads the team."""
BYTES = ("/api/v1/uploads", "/api/v1/submissions", "/api/v1/briefs/own", "/log/cosignatures")
"""Take files, of which there is no dry run, or what anybody may add."""
ENDS_A_TEAM = {
    ("post", f"{TEAM}/merge"),
    ("delete", TEAM),
    ("put", f"{TEAM}/disqualification"),
}
Route = tuple[str, str]


@cache
def described() -> dict[Route, dict[str, Any]]:
    """What the API says of each route."""
    paths = create_app(make_settings()).openapi()["paths"]
    routes = {(method, path): route for path, methods in paths.items() for method, route in methods.items()}
    return {
        place: routes[place]
        for place in sorted(routes, key=lambda place: (place[1].endswith(LAST), "token" in place[1], place))
    }


def audience(place: Route, *, is_public: bool = False) -> frozenset[Who]:
    """Who may call a route, as it declares."""
    declared = [name for needed in described()[place].get("security", []) for name in needed["HTTPBearer"]]
    if not declared:
        return EVERYBODY
    found = AUDIENCES[Audience.EVERYBODY if is_public and Audience.EVERYBODY in declared else Audience(declared[0])]
    if any(name in place[1] for name in OF_NO_COMPETITION) and not is_public:
        return found - {Who.OUTSIDER}
    return found - {Who.MEMBER} if place == ("post", "/api/v1/tokens") else found


REFUSED = {401, 403, 404}
QUICK = {Who.VISITOR, Who.ORGANIZER}  # the roles that every suite tries; the slow tests try all
IDENTITY = re.compile(r"[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}")
UPLOAD_HEADERS = {"Tus-Resumable": "1.0.0"}
KIND = "kind bW9kZWw="  # "model", as the protocol writes it


@dataclass(frozen=True, kw_only=True)
class Setting:
    """A service with a finished submission of the team OWNER, and everybody's token."""

    service: Service
    submission_id: str
    tokens: dict[Who, str | None]
    is_public: bool = False

    def ask(self, method: str, path: str, who: Who) -> int:
        """Status of a request that would succeed for whoever may make it."""
        return self.send(method, self.prepare(method, path, who), who).status_code

    def send(self, method: str, prepared: dict[str, Any], who: Who, **headers: str) -> Response:
        """The answer to a request."""
        token = self.tokens[who]
        of_all = prepared.get("headers", {}) | headers | (bearer(token) if token is not None else {})
        return self.service.client.request(method, **(prepared | {"headers": of_all}))

    def prepare(self, method: str, path: str, who: Who) -> dict[str, Any]:
        """Make what a request is about, and return its address, body and headers."""
        ids = {
            "submission_id": self.submission_id,
            "upload_id": "",
            "token_id": "",
            "track": "track_2" if path.startswith(f"{COMPETITION}/tracks") else "track_1",
            "competition": "cup",
            "stage": "stage2",
            "level": "0",
            "name": "lab" if path == STATION else "000.p/1",
            "quota": "tokens",
        }
        if path == HUMAN_BASELINE:
            ids["task"] = TASK
            self.publish_human_baseline()
        if path.startswith((f"{STAGE}/briefs", f"{STAGE}/results")):
            ids |= {"track": "elsewhere", "stage": "brief" if "briefs" in path else "play"}
        if path == f"{SUBMISSION}/withdrawal" or (method, path) == ("delete", SUBMISSION):
            ids["submission_id"] = self.new_submission()
        if "{announcement_id}" in path:
            ids["announcement_id"] = self.new_announcement()
        if "{question_id}" in path:
            ids["question_id"] = self.new_question()
        if "{appeal_id}" in path:
            ids["appeal_id"] = self.new_appeal()
        if "{evaluation_id}" in path:
            ids["evaluation_id"] = self.evaluation()
        if "{worker_id}" in path:
            ids["worker_id"] = self.new_worker()
        if "{notice_id}" in path:
            ids["notice_id"] = self.new_notice()
        if path == STATION:
            self.new_station()
        if "/trials/{task}" in path:
            ids |= self.new_trial()
        if "{team_id}" in path:
            ids["team_id"] = str(self.service.principal.team_id)
            if (method, path) in ENDS_A_TEAM:
                ids["team_id"] = self.new_team()
            elif "{invitation_id}" in path:
                ids["invitation_id"] = str(self.new_invitation()[0].id)
            elif "{webhook_id}" in path:
                ids["webhook_id"] = self.new_webhook()
            elif "{member_id}" in path:
                # The captain of a team without a token of its own is who has the team's; who leaves is another one.
                ids["member_id"] = self.new_member() if method == "delete" else self.captain()
        if "{rejudgement_id}" in path:
            ids["rejudgement_id"] = self.new_rejudgement()
        if "{upload_id}" in path:
            ids["upload_id"] = self.new_upload()
        if "{token_id}" in path:
            ids["token_id"] = self.new_token()
        headers = dict(UPLOAD_HEADERS) if "/uploads" in path else {}
        options = BODIES[method, path](self, who) if (method, path) in BODIES else {}
        return options | {"url": path.format(**ids), "headers": headers | options.get("headers", {})}

    def evaluation(self) -> str:
        """Id of the evaluation of the submission."""
        with self.service.database.transaction() as session:
            return str(newest_evaluation(session, session.get_one(Submission, UUID(self.submission_id))).id)

    def new_worker(self) -> str:
        """Id of a further worker."""
        with self.service.database.transaction() as session:
            made = Worker(
                host="machine", pid=1, slots=1, state=WorkerState.READY, evaluator_version="1+a", isolation="",
                platform_class="x86_64-linux",
            )  # fmt: skip
            session.add(made)
            session.flush()
            return str(made.id)

    def new_notice(self) -> str:
        """Id of a notice that was given up."""
        with self.service.database.transaction() as session:
            facts = {"page": "/"}
            made = Notice(
                kind=NoticeKind.FINISHED, channel=NoticeChannel.MAIL, target="a@example.org", subject=uuid4().hex,
                team_id=self.service.principal.team_id, facts=facts, given_up_at=datetime.now(UTC),
            )  # fmt: skip
            session.add(made)
            session.flush()
            return str(made.id)

    def new_trial(self) -> dict[str, str]:
        """Task and number of an episode of the submission that a station has played."""
        content = b"frames"
        video = {"code": "0" * 16, "frames": 1, "link": "0" * 64, "sha256": sha256(content).hexdigest(), "n_bytes": 6}
        file = self.service.settings.scratch_dir / "video"
        file.write_bytes(content)
        self.service.services.blobs.put(file, str(video["sha256"]))
        with self.service.database.transaction() as session:
            submission = session.get_one(Submission, UUID(self.submission_id))
            key = EpisodeKey.from_evaluation(newest_evaluation(session, submission), submission)
            episode = session.scalars(select(EpisodeResult).where(*key.conditions()).limit(1)).one()
            no_infos: list[dict[str, Any]] = [{}] * len(episode.record["infos"])
            evidence = {"station": "lab", "video": video}
            episode.record = episode.record | {"evidence": evidence, "infos": no_infos}
            stored = {"submission_id": UUID(self.submission_id), "role": FileRole.VIDEO, "sha256": video["sha256"]}
            if session.get(SubmissionFile, tuple(stored.values())) is None:
                session.add(SubmissionFile(**stored, n_bytes=6, name="trial.mjpeg", facts={}))
            return {"task": episode.task, "episode": str(episode.episode)}

    def new_station(self) -> None:
        """The station `lab`, which may be there already."""
        with self.service.database.transaction() as session:
            if not stations.list_stations(session):
                stations.add_station(session, CONSOLE, "lab")

    def publish_human_baseline(self) -> None:
        """That of the task, in place of what a request before has left."""
        with self.service.database.transaction() as session:
            publish_human_baseline(session, CONSOLE, TRACK, TASK, [("cuboid", True, 4, {})])

    def new_team(self) -> str:
        """Id of a further team."""
        with self.service.database.transaction() as session:
            return str(make_principal(session, f"Team {uuid4().hex[:12]}").team_id)

    def new_invitation(self) -> tuple[Invitation, str]:
        """An invitation to the team OWNER, and its code."""
        with self.service.database.transaction() as session:
            return members.invite(session, CONSOLE, session.get_one(Team, self.service.principal.team_id))

    def new_submission(self) -> str:
        with self.service.database.transaction() as session:
            return str(submit(session, self.service.principal, uuid4().hex).id)

    def new_announcement(self) -> str:
        """Number of an announcement."""
        with self.service.database.transaction() as session:
            return str(messages.publish_announcement(session, CONSOLE, title="News", text="Text", notify=False).id)

    def new_question(self) -> str:
        """Number of a question of the team OWNER."""
        with self.service.database.transaction() as session:
            session.execute(delete(Question))
            return str(messages.ask_question(session, self.service.principal, "Why?", public=True).id)

    def new_appeal(self) -> str:
        """Number of an open appeal of the team OWNER."""
        self.forget_appeals()
        with self.service.database.transaction() as session:
            by, submission_id = self.service.principal, UUID(self.submission_id)
            return str(appeals.open_appeal(session, by, submission_id, "Look again.").id)

    def new_rejudgement(self) -> str:
        """Id of an open rejudgement of nothing."""
        with self.service.database.transaction() as session:
            made = Rejudgement(track="track_3", stage="", reason="Look again.")
            session.add(made)
            session.flush()
            return str(made.id)

    def new_result(self) -> str:
        """Id of a scored model of a further team."""
        with self.service.database.transaction() as session:
            by = make_principal(session, f"Team {uuid4().hex[:12]}")
            return str(submit_scored(session, by, uuid4().hex, {TASK: make_score(50)}).id)

    def forget_appeals(self) -> None:
        """Removes all, so that the submission can be appealed against."""
        with self.service.database.transaction() as session:
            session.execute(delete(Appeal))

    def new_webhook(self) -> str:
        """Id of a webhook of the team OWNER."""
        address = "https://hook.example.org/"
        with self.service.database.transaction() as session:
            made = Webhook(team_id=self.service.principal.team_id, address=address, secret="0" * 64)
            session.add(made)
            session.flush()
            return str(made.id)

    def new_member(self) -> str:
        """Id of a further member of the team OWNER."""
        new = members.JoiningMember(code=self.new_invitation()[1], name=uuid4().hex[:12])
        with self.service.database.transaction() as session:
            return str(members.join(session, new, timedelta(days=1))[0].id)

    def captain(self) -> str:
        """Id of the captain of the team OWNER, who has no token yet."""
        with self.service.database.transaction() as session:
            captain = members.find_captain(session, session.get_one(Team, self.service.principal.team_id))
            session.execute(delete(ApiToken).where(ApiToken.member_id == captain.id))
            captain.password_hash = None
            return str(captain.id)

    def new_upload(self) -> str:
        """A begun upload of the team OWNER."""
        token = self.tokens[Who.OWNER]
        assert token is not None
        headers = UPLOAD_HEADERS | bearer(token) | {"Upload-Length": "7", "Upload-Metadata": KIND}
        made = self.service.client.post("/api/v1/uploads", headers=headers)
        assert made.status_code == 201, made.text
        return made.headers["Location"].rpartition("/")[2]

    def new_token(self) -> str:
        """Id of a further token of the team OWNER."""
        answer = self.service.post("/tokens", json={"label": "further"})
        assert answer.status_code == 201, answer.text
        return str(answer.json()["id"])


def _as_organizer(who: Who) -> dict[str, str]:
    return {"team": "Team A"} if who is Who.ORGANIZER else {}


def _named(who: Who) -> dict[str, str]:
    return {"judge": "Prof. X"} if who is Who.ORGANIZER else {}


Options = Callable[[Setting, Who], dict[str, Any]]
BODIES: dict[tuple[str, str], Options] = {
    ("post", "/api/v1/teams"): lambda *_: {"json": {"name": f"Team {uuid4().hex[:12]}"}},
    ("post", "/api/v1/teams/join"): lambda setting, _: {
        "json": {"code": setting.new_invitation()[1], "name": uuid4().hex[:12]}
    },
    ("put", f"{STAGE}/advancement"): lambda *_: {"json": {}},
    ("put", "/api/v1/briefs/own"): lambda *_: {
        "content": b"%PDF-1.4 1 0 obj << /Type /Page >> endobj",
        "params": {"competition": "cup", "track": "elsewhere_too", "stage": "brief"},
    },
    ("put", f"{STAGE}/briefs/{{team_id}}/decision"): lambda *_: {"json": {"accepted": True, "reason": "good"}},
    ("put", HUMAN_BASELINE): lambda *_: {
        "json": {"episodes": [{"shape": "cuboid", "is_solved": True, "env_steps": 4}]}
    },
    ("put", f"{STAGE}/results"): lambda *_: {"json": {"baseline": "ours", "points": {"tube": 1}, "evidence": "a film"}},
    ("put", f"{COMPETITION}/definition"): lambda *_: {"json": {"definition": make_competition()}},
    ("put", f"{TEAM}/disqualification"): lambda *_: {"json": {"reason": "two accounts"}},
    ("put", f"{TEAM}/quotas/{{quota}}"): lambda *_: {"json": {"limit": 7}},
    ("put", "/api/v1/workers/{worker_id}/order"): lambda *_: {"json": {"order": "drain"}},
    ("post", "/api/v1/stations"): lambda *_: {"json": {"name": uuid4().hex[:12]}},
    ("post", f"{COMPETITION}/finalize"): lambda *_: {"json": {}},
    ("post", f"{COMPETITION}/reopen"): lambda *_: {"json": {"reason": "An appeal was upheld."}},
    ("patch", TEAM): lambda *_: {"json": {"accepted": True}},
    ("post", f"{TEAM}/merge"): lambda setting, _: {"json": {"into": setting.new_team()}},
    ("put", f"{TEAM}/captain"): lambda setting, _: {"json": {"member_id": setting.captain()}},
    ("post", f"{TEAM}/webhooks"): lambda *_: {"json": {"address": "https://hook.example.org/"}},
    ("patch", MEMBER): lambda *_: {"json": {"email": "ann@example.org"}},
    ("put", f"{SUBMISSION}/disqualification"): lambda *_: {"json": {"reason": "copied"}},
    ("put", f"{SUBMISSION}/clearance"): lambda *_: {"json": {"reason": "made apart"}},
    ("put", f"{SUBMISSION}/chosen"): lambda *_: {"json": {"chosen": True}},
    ("put", f"{SUBMISSION}/description"): lambda *_: {"json": {"text": "A network."}},
    ("put", f"{SUBMISSION}/description/removal"): lambda *_: {"json": {"reason": "no"}},
    ("put", f"{SUBMISSION}/public"): lambda setting, _: {"json": {"public": setting.is_public}},
    ("post", "/api/v1/announcements"): lambda *_: {"json": {"title": "News", "text": "Text"}},
    ("post", "/api/v1/questions"): lambda *_: {"json": {"text": "Why?", "public": True}},
    ("put", "/api/v1/questions/{question_id}/answer"): lambda *_: {"json": {"text": "So.", "public": True}},
    ("post", "/api/v1/appeals"): lambda setting, _: {
        "json": {"submission_id": setting.submission_id, "text": "Look again."}
    },
    ("put", f"{APPEAL}/ruling"): lambda *_: {"json": {"upheld": True, "text": "So."}},
    ("put", f"{SUBMISSION}/marks"): lambda _, who: {"json": {"marks": {"clarity": 5.0}, **_named(who)}},
    ("post", f"{TEAM}/messages"): lambda *_: {"json": {"title": "Hello", "text": "Well done."}},
    ("post", "/api/v1/judging/conflicts"): lambda _, who: {
        "json": {"team": "Team A", "reason": "friends", **_named(who)}
    },
    ("post", "/api/v1/rejudgements"): lambda setting, _: {
        "json": {"track": TRACK, "submissions": [setting.new_result()], "reason": "Look again."}
    },
    ("post", f"{REJUDGEMENT}/apply"): lambda *_: {"json": {"shown": compute_revision([])}},
    ("post", "/api/v1/tokens"): lambda *_: {"json": {"label": "new"}},
    ("post", "/api/v1/submissions"): lambda _, who: {
        "content": make_archive(),
        "headers": {"Content-Type": "application/zip"},
        "params": _as_organizer(who),
    },
    ("post", "/api/v1/uploads"): lambda _, who: {
        "headers": {"Upload-Length": "7", "Upload-Metadata": KIND},
        "params": _as_organizer(who),
    },
    ("patch", UPLOAD): lambda *_: {
        "content": b"a",
        "headers": {"Upload-Offset": "0", "Content-Type": "application/offset+octet-stream"},
    },
}


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Setting]:
    """A setting for tests to copy; its service has ended."""
    with fresh_database() as address:
        database = Database(address)
        with running_service(database, tmp_path_factory.mktemp("filled")) as service:
            setting = fill(service)
        database.dispose()
        yield setting


@pytest.fixture
def setting(filled: Setting, tmp_path: Path) -> Iterator[Setting]:
    with copied_service(filled.service, tmp_path) as service:
        yield replace(filled, service=service)


def played_elsewhere(days: float = 0) -> dict[str, Any]:
    """A track with a brief and results that operators enter, the second stage open; so many days later the first."""
    now = datetime.now(UTC) + timedelta(days=days)
    times = [(now + timedelta(days=days)).isoformat() for days in (-2, -1, 1)]
    brief = {"name": "brief", "title": "Brief", "opens": times[0], "closes": times[1], "brief": {}}
    task = {"name": "tube", "title": "Tube", "points": 10}
    play = {"name": "play", "title": "Play", "opens": times[1], "closes": times[2], "entered": [task]}
    return {"title": "Elsewhere", "taken_here": False, "stages": [brief, play]}


def fill(service: Service) -> Setting:
    """Makes everybody and what they ask for."""
    sensor: dict[str, str | bytes] = {
        "Track_3/submission.yaml": "track: track_3\ntasks: [sensor-standard]\nname: flat\n",
        "Track_3/sensor.yaml": "{}",
        "Track_3/gel.stl": drawn_gels.stl_bytes(drawn_gels.flat()),
        "Track_3/design.md": "A flat gel.",
        "Track_3/policy.py": POLICY,
    }
    submission_id = service.upload(make_archive(sensor)).json()["id"]
    check_sensors(service.services)
    with service.services.database.transaction() as session:
        content = make_competition(appeal_days=7)
        content["tracks"] = {"track_2": content["tracks"][TRACK] | {"taken_here": False}}
        content["tracks"] |= {"elsewhere": played_elsewhere(), "elsewhere_too": played_elsewhere(days=1.5)}
        put_in_place(session, content)
        session.add(
            Brief(
                competition="cup",
                track="elsewhere",
                stage="brief",
                team_id=service.principal.team_id,
                content=b"%PDF-",
                sha256="0" * 64,
                pages=1,
            )
        )
        row = session.get_one(CompetitionRow, "cup")
        row.finalized_at, row.winners, row.boards = row.applied_at, [], []
        submission = session.get_one(Submission, UUID(submission_id))
        judge = tokens.issue(session, CONSOLE, role=Role.JUDGE, label="judge", lifetime=None).secret
        outsider = tokens.issue(
            session, CONSOLE, role=Role.ORGANIZER, label="outsider", competition="cup", lifetime=None
        ).secret
    play_all(service.services.database, submission)
    with service.services.database.transaction() as session:
        team = session.get_one(Team, service.principal.team_id)
        code = members.invite(session, CONSOLE, team)[1]
        joined = members.join(session, members.JoiningMember(code=code, name="Ann"), timedelta(days=1))[1]
    return Setting(
        service=service,
        submission_id=submission_id,
        tokens={
            Who.VISITOR: None,
            Who.OWNER: service.token,
            Who.MEMBER: joined.secret,
            Who.OTHER: service.other_token,
            Who.JUDGE: judge,
            Who.ORGANIZER: service.organizer_token,
            Who.OUTSIDER: outsider,
        },
    )


@pytest.mark.parametrize("who", [pytest.param(who, marks=() if who in QUICK else pytest.mark.slow) for who in Who])
def test_a_role_gets_exactly_what_the_routes_declare(setting: Setting, who: Who) -> None:
    assert wrong_answers(setting, described(), who) == []
    if who in {Who.VISITOR, Who.OTHER}:  # who have not changed the submission until here
        public = replace(setting, is_public=True)
        assert public.ask("put", f"{SUBMISSION}/public", Who.OWNER) == 200
        assert wrong_answers(public, [place for place in described() if place[1].startswith(SUBMISSION)], who) == []


def test_what_another_team_has_looks_as_if_it_were_not_there(setting: Setting) -> None:
    told = []
    for method, path in described():
        if path.startswith((SUBMISSION, UPLOAD)) and Who.OTHER not in audience((method, path)):
            there = setting.prepare(method, path, Who.OTHER)
            absent = there | {"url": IDENTITY.sub(str(uuid4()), there["url"], count=1)}
            answers = [setting.send(method, prepared, Who.OTHER) for prepared in (there, absent)]
            if len({(each.status_code, each.content and each.json()["code"]) for each in answers}) > 1:
                told.append(f"{method} {path}: {answers}")
    assert told == []


def wrong_answers(setting: Setting, places: Iterable[Route], who: Who) -> list[str]:
    wrong = []
    for method, path in places:
        status = setting.ask(method, path, who)
        is_refused = status in ({401} if who is Who.VISITOR else REFUSED)
        is_answered = status not in REFUSED and status < 500
        if not (is_answered if who in audience((method, path), is_public=setting.is_public) else is_refused):
            wrong.append(f"{method} {path}: {status}")
    return wrong


def test_every_route_declares_who_may_call_it() -> None:
    free = {path for (_, path), route in described().items() if "security" not in route}
    of_everybody = ("/health", "/ready", "/log/", "/api/v1/tracks", "/api/v1/competition", "/api/v1/receipts")
    others = {path for path in free if not path.startswith(of_everybody)}
    assert others == {"/api/v1/teams/join", "/api/v1/uploads"}
    assert not {path for place, path in described() if place != "get"} & {path for path in free if "comp" in path}


@pytest.mark.slow
def test_a_dry_run_of_every_change_answers_and_changes_nothing(setting: Setting) -> None:
    answered = []
    for (method, path), route in described().items():
        if method in {"get", "head", "options"} or (path.startswith(BYTES) and not path.startswith(SUBMISSION)):
            continue
        assert "dry-run" in {parameter["name"] for parameter in route["parameters"]}, (method, path)
        if Who.ORGANIZER in audience((method, path)):
            prepared = setting.prepare(method, path, Who.ORGANIZER)
            before = kept_rows(setting)
            answer = setting.send(method, prepared, Who.ORGANIZER, **{"Dry-Run": "true"})
            assert answer.status_code < 500, (method, path)
            assert kept_rows(setting) == before, (method, path)
            answered += [path] if answer.is_success else []
    assert len(answered) > 30


def test_a_read_changes_nothing(setting: Setting) -> None:
    reads = [
        setting.prepare(method, path, Who.ORGANIZER)
        for method, path in described()
        if method == "get" and Who.ORGANIZER in audience((method, path)) and not path.endswith("/events")
    ]
    before = kept_rows(setting)
    answers = [setting.send("get", prepared, Who.ORGANIZER).is_success for prepared in reads]
    assert sum(answers) > 40
    assert kept_rows(setting) == before


def kept_rows(setting: Setting) -> dict[str, list[str]]:
    """All rows, but for when a token was used; of notices, which are being sent, the ids."""
    rows = rows_of_every_table(setting.service.database)
    rows["notices"] = [row.partition(",")[0] for row in rows["notices"]]
    return {table: found for table, found in rows.items() if table not in {"api_tokens", "metric_totals"}}


def test_a_judge_reads_all_teams_submissions_and_no_tokens(setting: Setting) -> None:
    judge = bearer(setting.tokens[Who.JUDGE] or "")
    listed = setting.service.client.get("/api/v1/submissions", headers=judge).json()["items"]
    assert [item["id"] for item in listed] == [setting.submission_id]
    tokens_seen = setting.service.client.get("/api/v1/tokens", headers=judge).json()["items"]
    assert [token["role"] for token in tokens_seen] == ["judge"]


def test_a_team_cannot_see_what_another_has(setting: Setting) -> None:
    other = bearer(setting.tokens[Who.OTHER] or "")
    assert setting.service.client.get("/api/v1/submissions", headers=other).json()["items"] == []
