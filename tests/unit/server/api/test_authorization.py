"""Who may call which route: one table over all routes of the API's description, tried whole."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import timedelta
from enum import StrEnum
from pathlib import Path
from typing import Any
from uuid import UUID, uuid4

import drawn_gels
import pytest
from databases import fresh_database
from service_client import POLICY, Service, bearer, copied_service, make_archive, running_service
from service_factories import TASK, TRACK, make_principal, make_score, play_all, submit_scored
from sqlalchemy import delete
from vitac.server import tokens
from vitac.server.appeals import appeals
from vitac.server.db.engine import Database
from vitac.server.db.models import (
    ApiToken,
    Appeal,
    CompetitionRow,
    Invitation,
    Question,
    Rejudgement,
    Submission,
    Team,
    Webhook,
)
from vitac.server.db.states import Role
from vitac.server.members import members
from vitac.server.messages import announcements, questions
from vitac.server.principals import CONSOLE
from vitac.server.rejudging.comparison import compute_revision

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
SIGNED_IN = EVERYBODY - {Who.VISITOR}
READERS = frozenset({Who.OWNER, Who.MEMBER, Who.JUDGE, Who.ORGANIZER})
CHANGERS = frozenset({Who.OWNER, Who.MEMBER, Who.ORGANIZER})
LEADERS = CHANGERS - {Who.MEMBER}
JUDGES = frozenset({Who.JUDGE, Who.ORGANIZER})
ORGANIZERS = frozenset({Who.ORGANIZER, Who.OUTSIDER})  # each of the own competition
TEAMS = frozenset({Who.OWNER, Who.MEMBER, Who.OTHER})

COMPETITION = "/api/v1/competitions/{competition}"
SUBMISSION = "/api/v1/submissions/{submission_id}"
UPLOAD = "/api/v1/uploads/{upload_id}"
TEAM = "/api/v1/teams/{team_id}"
APPEAL = "/api/v1/appeals/{appeal_id}"
REJUDGEMENT = "/api/v1/rejudgements/{rejudgement_id}"
MEMBER = f"{TEAM}/members/{{member_id}}"
MATRIX: dict[tuple[str, str], frozenset[Who]] = {
    ("get", "/health"): EVERYBODY,
    ("get", "/ready"): EVERYBODY,
    ("get", "/metrics"): frozenset({Who.ORGANIZER}),
    ("get", "/log/checkpoint"): EVERYBODY,
    ("get", "/log/key"): EVERYBODY,
    ("get", "/log/witnessed.json"): EVERYBODY,
    ("get", "/log/tile/entries/{name}"): EVERYBODY,
    ("get", "/log/tile/{level}/{name}"): EVERYBODY,
    ("post", "/log/cosignatures"): EVERYBODY,
    ("get", "/api/v1/tracks"): EVERYBODY,
    ("get", "/api/v1/tracks/{track}"): EVERYBODY,
    ("get", "/api/v1/tracks/{track}/file"): EVERYBODY,
    ("get", "/api/v1/competition"): EVERYBODY,
    ("get", "/api/v1/competition/archive"): EVERYBODY,
    ("get", "/api/v1/competitions"): EVERYBODY,
    ("get", f"{COMPETITION}"): EVERYBODY,
    ("get", f"{COMPETITION}/archive"): EVERYBODY,
    ("get", f"{COMPETITION}/leaderboards/{{track}}"): EVERYBODY,
    ("get", f"{COMPETITION}/leaderboards/{{track}}/logs"): EVERYBODY,
    ("get", f"{COMPETITION}/leaderboards/{{track}}/ranks"): EVERYBODY,
    ("get", f"{COMPETITION}/appeals"): SIGNED_IN,
    ("get", f"{COMPETITION}/receipts"): EVERYBODY,
    ("get", f"{COMPETITION}/tracks/{{track}}/stages/{{stage}}/advancement"): ORGANIZERS,
    ("put", f"{COMPETITION}/tracks/{{track}}/stages/{{stage}}/advancement"): ORGANIZERS,
    ("post", f"{COMPETITION}/freeze"): ORGANIZERS,
    ("post", f"{COMPETITION}/unfreeze"): ORGANIZERS,
    ("post", f"{COMPETITION}/finalize"): ORGANIZERS,
    ("post", f"{COMPETITION}/reopen"): ORGANIZERS,
    ("get", "/api/v1/receipts"): EVERYBODY,
    ("get", "/api/v1/leaderboards/{track}"): EVERYBODY,
    ("get", "/api/v1/leaderboards/{track}/logs"): EVERYBODY,
    ("get", "/api/v1/leaderboards/{track}/ranks"): EVERYBODY,
    ("post", "/api/v1/teams"): EVERYBODY,
    ("post", "/api/v1/teams/join"): EVERYBODY,
    ("get", TEAM): CHANGERS,
    ("patch", TEAM): frozenset({Who.ORGANIZER}),
    ("post", f"{TEAM}/merge"): frozenset({Who.ORGANIZER}),
    ("get", f"{TEAM}/data"): CHANGERS,
    ("delete", TEAM): frozenset({Who.ORGANIZER}),
    ("post", f"{TEAM}/invitations"): LEADERS,
    ("delete", f"{TEAM}/invitations/{{invitation_id}}"): LEADERS,
    ("get", f"{TEAM}/webhooks"): LEADERS,
    ("post", f"{TEAM}/webhooks"): LEADERS,
    ("delete", f"{TEAM}/webhooks/{{webhook_id}}"): LEADERS,
    ("put", f"{TEAM}/captain"): LEADERS,
    ("patch", MEMBER): LEADERS,
    ("delete", MEMBER): LEADERS,
    ("get", "/api/v1/announcements"): EVERYBODY,
    ("post", "/api/v1/announcements"): frozenset({Who.ORGANIZER}),
    ("delete", "/api/v1/announcements/{announcement_id}"): frozenset({Who.ORGANIZER}),
    ("get", "/api/v1/questions"): EVERYBODY,
    ("post", "/api/v1/questions"): TEAMS,
    ("put", "/api/v1/questions/{question_id}/answer"): frozenset({Who.ORGANIZER}),
    ("delete", "/api/v1/questions/{question_id}"): frozenset({Who.ORGANIZER}),
    ("get", "/api/v1/appeals"): SIGNED_IN,
    ("post", "/api/v1/appeals"): CHANGERS,
    ("get", APPEAL): READERS,
    ("post", f"{APPEAL}/withdraw"): CHANGERS,
    ("put", f"{APPEAL}/ruling"): frozenset({Who.ORGANIZER}),
    ("get", "/api/v1/me"): SIGNED_IN,
    ("get", "/api/v1/tokens"): SIGNED_IN,
    ("post", "/api/v1/tokens"): (TEAMS - {Who.MEMBER}) | {Who.ORGANIZER},
    ("delete", "/api/v1/tokens/{token_id}"): LEADERS,
    ("get", "/api/v1/submissions"): SIGNED_IN,
    ("post", "/api/v1/submissions"): TEAMS | {Who.ORGANIZER},
    ("get", "/api/v1/comparisons"): EVERYBODY,
    ("get", SUBMISSION): READERS,
    ("get", f"{SUBMISSION}/episodes"): READERS,
    ("get", f"{SUBMISSION}/action-matches"): READERS,
    ("get", f"{SUBMISSION}/output"): READERS,
    ("get", f"{SUBMISSION}/sensor"): READERS,
    ("get", f"{SUBMISSION}/document"): READERS,
    ("get", f"{SUBMISSION}/log"): READERS,
    ("get", f"{SUBMISSION}/receipts"): READERS,
    ("get", f"{SUBMISSION}/arrival"): READERS,
    ("get", f"{SUBMISSION}/events"): READERS,
    ("put", f"{SUBMISSION}/public"): CHANGERS,
    ("get", f"{SUBMISSION}/card"): READERS,
    ("get", f"{SUBMISSION}/description"): READERS,
    ("put", f"{SUBMISSION}/description"): CHANGERS,
    ("put", f"{SUBMISSION}/description/removal"): frozenset({Who.ORGANIZER}),
    ("delete", f"{SUBMISSION}/description/removal"): frozenset({Who.ORGANIZER}),
    ("put", f"{SUBMISSION}/disqualification"): frozenset({Who.ORGANIZER}),
    ("delete", f"{SUBMISSION}/disqualification"): frozenset({Who.ORGANIZER}),
    ("put", f"{SUBMISSION}/clearance"): frozenset({Who.ORGANIZER}),
    ("delete", f"{SUBMISSION}/clearance"): frozenset({Who.ORGANIZER}),
    ("put", f"{SUBMISSION}/marks"): JUDGES,
    ("post", "/api/v1/judging/conflicts"): JUDGES,
    ("get", "/api/v1/rejudgements"): ORGANIZERS,
    ("post", "/api/v1/rejudgements"): ORGANIZERS,
    ("get", REJUDGEMENT): frozenset({Who.ORGANIZER}),
    ("post", f"{REJUDGEMENT}/apply"): frozenset({Who.ORGANIZER}),
    ("post", f"{REJUDGEMENT}/discard"): frozenset({Who.ORGANIZER}),
    ("get", "/api/v1/judging/{track}"): ORGANIZERS,
    ("post", f"{SUBMISSION}/cancel"): CHANGERS,
    ("post", f"{SUBMISSION}/requeue"): frozenset({Who.ORGANIZER}),
    ("options", "/api/v1/uploads"): EVERYBODY,
    ("post", "/api/v1/uploads"): TEAMS | {Who.ORGANIZER},
    ("head", UPLOAD): CHANGERS,
    ("patch", UPLOAD): CHANGERS,
    ("delete", UPLOAD): CHANGERS,
    ("post", f"{UPLOAD}/submission"): CHANGERS,
    ("post", f"{MEMBER}/token"): LEADERS,  # last: from then on the shared token no longer leads the team
}
"""Who gets an answer of the route about a thing of the team OWNER. All others: 401 without a token, else 403 or 404."""

FOR_EVERYBODY_IF_PUBLIC = {("get", SUBMISSION + part) for part in ("", "/episodes", "/card", "/description")}
OF_A_PUBLIC_SUBMISSION = {
    (method, path): EVERYBODY if (method, path) in FOR_EVERYBODY_IF_PUBLIC else allowed
    for (method, path), allowed in MATRIX.items()
    if path.startswith(SUBMISSION)
}
"""The same of the routes of one submission when it is public."""

REFUSED = {401, 403, 404}
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
        headers: dict[str, str] = dict(UPLOAD_HEADERS) if "/uploads" in path else {}
        token = self.tokens[who]
        if token is not None:
            headers |= bearer(token)
        options = BODIES[method, path](self, who) if (method, path) in BODIES else {}
        headers |= options.pop("headers", {})
        ids = {
            "submission_id": self.submission_id,
            "upload_id": "",
            "token_id": "",
            "track": "track_1",
            "competition": "cup",
            "stage": "stage2",
            "level": "0",
            "name": "000.p/1",
        }
        if path.endswith("/advancement"):
            ids["track"] = "track_2"
        if "{announcement_id}" in path:
            ids["announcement_id"] = self.new_announcement()
        if "{question_id}" in path:
            ids["question_id"] = self.new_question()
        if "{appeal_id}" in path:
            ids["appeal_id"] = self.new_appeal()
        if "{team_id}" in path:
            ids["team_id"] = str(self.service.principal.team_id)
            if path.endswith("/merge") or (method, path) == ("delete", TEAM):
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
        return self.service.client.request(method, path.format(**ids), headers=headers, **options).status_code

    def new_team(self) -> str:
        """Id of a further team."""
        with self.service.database.transaction() as session:
            return str(make_principal(session, f"Team {uuid4().hex[:12]}").team_id)

    def new_invitation(self) -> tuple[Invitation, str]:
        """An invitation to the team OWNER, and its code."""
        with self.service.database.transaction() as session:
            return members.invite(session, CONSOLE, session.get_one(Team, self.service.principal.team_id))

    def new_announcement(self) -> str:
        """Number of an announcement."""
        with self.service.database.transaction() as session:
            return str(announcements.publish(session, CONSOLE, title="News", text="Text", notify=False).id)

    def new_question(self) -> str:
        """Number of a question of the team OWNER."""
        with self.service.database.transaction() as session:
            session.execute(delete(Question))
            return str(questions.ask(session, self.service.principal, "Why?", public=True).id)

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
        new = members.NewMember(code=self.new_invitation()[1], name=uuid4().hex[:12])
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
    ("put", f"{COMPETITION}/tracks/{{track}}/stages/{{stage}}/advancement"): lambda *_: {"json": {}},
    ("post", f"{COMPETITION}/finalize"): lambda *_: {"json": {}},
    ("post", f"{COMPETITION}/reopen"): lambda *_: {"json": {"reason": "An appeal was upheld."}},
    ("patch", TEAM): lambda *_: {"json": {"accepted": True}},
    ("post", f"{TEAM}/merge"): lambda setting, _: {"json": {"into": setting.new_team()}},
    ("put", f"{TEAM}/captain"): lambda setting, _: {"json": {"member_id": setting.captain()}},
    ("post", f"{TEAM}/webhooks"): lambda *_: {"json": {"address": "https://hook.example.org/"}},
    ("patch", MEMBER): lambda *_: {"json": {"email": "ann@example.org"}},
    ("put", f"{SUBMISSION}/disqualification"): lambda *_: {"json": {"reason": "copied"}},
    ("put", f"{SUBMISSION}/clearance"): lambda *_: {"json": {"reason": "made apart"}},
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
    with service.services.database.transaction() as session:
        content = make_competition(appeal_days=7)
        content["tracks"] = {"track_2": content["tracks"][TRACK] | {"taken_here": False}}
        put_in_place(session, content)
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
        joined = members.join(session, members.NewMember(code=code, name="Ann"), timedelta(days=1))[1]
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


def test_every_route_has_an_entry_and_every_entry_a_route(service: Service) -> None:
    document = service.client.get("/openapi.json").json()
    routes = {(method, path) for path, methods in document["paths"].items() for method in methods}
    assert routes == set(MATRIX), "say in MATRIX who may call a new route"


@pytest.mark.parametrize("who", Who)
def test_a_role_gets_exactly_what_the_matrix_gives_it(setting: Setting, who: Who) -> None:
    assert wrong_answers(setting, MATRIX, who) == []
    if who in {Who.VISITOR, Who.OTHER}:  # who have not changed the submission until here
        public = replace(setting, is_public=True)
        assert public.ask("put", f"{SUBMISSION}/public", Who.OWNER) == 200
        assert wrong_answers(public, OF_A_PUBLIC_SUBMISSION, who) == []


def wrong_answers(setting: Setting, matrix: dict[tuple[str, str], frozenset[Who]], who: Who) -> list[str]:
    wrong = []
    for (method, path), allowed in matrix.items():
        status = setting.ask(method, path, who)
        is_refused = status in ({401} if who is Who.VISITOR else REFUSED)
        is_answered = status not in REFUSED and status < 500
        if not (is_answered if who in allowed else is_refused):
            wrong.append(f"{method} {path}: {status}")
    return wrong


def test_a_judge_reads_all_teams_submissions_and_no_tokens(setting: Setting) -> None:
    judge = bearer(setting.tokens[Who.JUDGE] or "")
    listed = setting.service.client.get("/api/v1/submissions", headers=judge).json()["items"]
    assert [item["id"] for item in listed] == [setting.submission_id]
    tokens_seen = setting.service.client.get("/api/v1/tokens", headers=judge).json()["items"]
    assert [token["role"] for token in tokens_seen] == ["judge"]


def test_a_team_cannot_see_what_another_has(setting: Setting) -> None:
    other = bearer(setting.tokens[Who.OTHER] or "")
    assert setting.service.client.get("/api/v1/submissions", headers=other).json()["items"] == []
