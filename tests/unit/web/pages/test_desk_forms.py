"""The desk of an organizer of forty teams: what was only in a shell before, each with what the command does."""

import io
import json
import re
import zipfile
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cli_service import CliService, cli_service
from httpx import Client
from served_pages import PageVisitor, team_visitor, visitor, visitor_of_role
from service_client import bearer
from service_factories import TASK, TRACK, complete_scored, make_principal, make_score, submit
from sqlalchemy import select
from vitac.server.accounts import teams
from vitac.server.audit import newest_entries
from vitac.server.competitions.sealing import seal
from vitac.server.database.models import Notice, Team
from vitac.server.database.states import Role
from vitac.server.principals import CONSOLE

from competitions import FIRST, SECOND, make_competition, open_now, put_in_place, stored_stage

HEADER = "\N{ZERO WIDTH NO-BREAK SPACE}Team name;E-Mail;Lab"
CSV = "\r\n".join((HEADER, "Tactile Bears;bears@example.org;Zürich", "", '"Gel; bots";;'))


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CliService]:
    with cli_service(tmp_path_factory.mktemp("service") / "state") as service:
        yield service


@pytest.fixture
def organizer(service: CliService) -> PageVisitor:
    return visitor_of_role(service, Role.ORGANIZER)


def names(service: CliService) -> set[str]:
    with service.database.transaction() as session:
        return set(session.scalars(select(Team.name)))


def test_teams_of_a_file_come_with_an_invitation_that_makes_a_captain(
    service: CliService, organizer: PageVisitor, tmp_path: Path
) -> None:
    file = tmp_path / "teams.csv"
    file.write_bytes(CSV.encode())
    tried = service.run("admin", "team", "import", str(file), "--dry-run", "--json")
    assert [(one["name"], one["code"]) for one in json.loads(tried.stdout)] == [
        ("Tactile Bears", None),
        ("Gel; bots", None),
    ]
    assert "Tactile Bears" not in names(service)
    shown = organizer.send("/desk/teams", "/desk/teams/import", csv=CSV)
    codes = re.findall(r"<code>(vitac-join-[\w-]+)</code>", shown.text)
    assert (shown.status_code, len(set(codes)), shown.headers["cache-control"]) == (201, 2, "no-store")
    with Client(base_url=service.address, trust_env=False) as client:
        captain = client.post("/api/v1/teams/join", json={"code": codes[0], "name": "Ann"}).json()
        code = client.post(
            f"/api/v1/teams/{captain['team']['id']}/invitations", headers=bearer(captain["token"]["secret"])
        ).json()["code"]
        client.post("/api/v1/teams/join", json={"code": code, "name": "Bob"})
        own = client.get(f"/api/v1/teams/{captain['team']['id']}", headers=bearer(captain["token"]["secret"])).json()
    assert [(one["name"], one["role"]) for one in own["members"]] == [("Ann", "captain"), ("Bob", "member")]
    assert own["contact"] == "bears@example.org"
    assert "note" not in own, "only organizers read notes"
    listed = json.loads(service.run("admin", "team", "list", "--search", "zürich", "--json").stdout)
    assert [(one["name"], one["note"], one["members"]) for one in listed] == [("Tactile Bears", "Lab: Zürich", 2)]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("team,contact\nNew One,\nTactile Bears,\nnew one,x@example.org\n", "Line 3: There is a team named 'Tactile"),
        ("team,contact\nNew One,\nnew one,x@example.org\n", "Line 3: There is a team named 'new one' already"),
        ("contact,lab\na@example.org,b\n", "Expected a first line with one column `name`, got contact, lab."),
        ("name,team\na,b\n", "Expected a first line with one column `name`, got name, team."),
        ("", "Expected a first line with one column `name`, got an empty file."),
        ("name\n\n", "Expected 1 to 1000 lines with teams, got 0."),
        ("name,lab\nNew One,a\x07b\n", "Line 2: A note has 2 to 4000 printable characters"),
    ],
)
def test_a_wrong_file_imports_no_team_and_says_in_which_line_why(
    service: CliService, content: str, said: str, tmp_path: Path
) -> None:
    with service.database.transaction() as session:
        if "Tactile Bears" not in names(service):
            teams.register(session, CONSOLE, name="Tactile Bears")
    file = tmp_path / "teams.csv"
    file.write_text(content)
    refused = service.run("admin", "team", "import", str(file))
    assert said in str(refused.exception)
    assert "New One" not in names(service)


def test_several_teams_are_changed_together_or_not_at_all(service: CliService, organizer: PageVisitor) -> None:
    with service.database.transaction() as session:
        waiting = [teams.register(session, CONSOLE, name=name, waits=True) for name in ("Bees", "Cats")]
        ids = [str(team.id) for team in waiting]
    chosen = {f"team-{one}": "yes" for one in ids}
    page = organizer.get("/desk/teams?state=waiting").text
    assert all(f'name="team-{one}"' in page for one in ids)
    assert organizer.send("/desk/teams", "/desk/teams/bulk", action="accept", **chosen).status_code == 303
    assert "Bees" not in organizer.get("/desk/teams?state=waiting").text
    refused = organizer.send("/desk/teams", "/desk/teams/bulk", action="disqualify", reason="x", **chosen)
    assert refused.status_code == 422
    assert "No team was changed. " in refused.text
    done = service.run("admin", "team", "bulk", "disqualify", "Bees", "Cats", "--reason", "one person", "--yes")
    assert done.exit_code == 0, done.exception
    assert organizer.get("/desk/teams?state=disqualified").text.count("one person") == 2
    again = service.run("admin", "team", "bulk", "disqualify", "Team A", "Bees", "--reason", "too", "--yes")
    assert "Bees is disqualified" in str(again.exception)
    assert "Team A" not in organizer.get("/desk/teams?state=disqualified").text
    assert team_visitor(service).get("/desk/teams").status_code == 403
    assert organizer.send("/desk/teams", "/desk/teams/note", id=ids[0], note="Asked <twice>.").status_code == 303
    assert "Asked &lt;twice&gt;." in organizer.get("/desk/teams?q=twice").text
    with service.database.transaction() as session:
        assert newest_entries(session, 1)[0].action == "note.change"
    organizer.send("/desk/teams", "/desk/teams/note", id=ids[0], note="")
    assert "Bees" not in organizer.get("/desk/teams?q=twice").text


def test_a_message_to_one_team_is_read_by_nobody_else(service: CliService) -> None:
    with service.database.transaction() as session:
        dogs, own = make_principal(session, "Dogs"), teams.find(session, "Team A")
        assert dogs.team_name == "Dogs"
    sent = service.run("admin", "team", "message", "Team A", "Your <upload>", "Please look at its licence.")
    assert sent.exit_code == 0, sent.exception
    assert "Your &lt;upload&gt;" in team_visitor(service).get("/announcements").text
    assert "Your" not in visitor(service).get("/announcements").text.partition("<main")[2]
    assert "Your" not in team_visitor(service, "Dogs").get("/announcements").text.partition("<main")[2]
    assert "Your" not in visitor(service).get("/api/v1/announcements").text
    assert "Your &lt;upload&gt;" not in visitor(service).get("/").text
    with service.database.transaction() as session:
        assert {notice.team_id for notice in session.scalars(select(Notice))} <= {own.id}


@pytest.fixture(scope="module")
def contest(service: CliService) -> str:
    """A competition whose first stage is over, with results of two teams; its first list is sealed."""
    with service.database.transaction() as session:
        content = make_competition(prizes=[{"place": "first", "amount": 5}])
        first = content["tracks"][TRACK]["stages"][0]
        first |= {"list": "sealed", "sealed": "at_once", "accepts": ["model"]}
        put_in_place(session, open_now(content, stage=1))
        seal(session, CONSOLE, stored_stage(session, TRACK, FIRST))
        for name, successes in (("Ants", 80), ("Elks", 60)):
            in_time = datetime.now(UTC) - timedelta(days=10)
            made = submit(session, make_principal(session, name), name, at=in_time)
            complete_scored(session, made, {TASK: make_score(successes)})
    return f"/desk/competitions/cup/tracks/{TRACK}/stages"


def test_a_stage_is_settled_on_its_page(
    service: CliService, organizer: PageVisitor, contest: str, tmp_path: Path
) -> None:
    assert f'href="{contest}/{SECOND}"' in organizer.get("/desk").text
    final, first = f"{contest}/{SECOND}", f"{contest}/{FIRST}"
    page = organizer.get(final).text
    assert 'name="proposed-Ants"' in page
    assert 'name="proposed-Elks"' not in page
    fields = {"proposed-Ants": "yes", "take-Elks": "yes", "revision": ""}
    assert organizer.send(final, f"{final}/advance", **fields).headers["location"] == final
    assert "Confirmed: <bdi>Elks</bdi>" in organizer.get(final).text
    late = fields | {"take-Ants": "yes"}
    assert organizer.send(final, f"{final}/advance", **late).status_code == 409, "somebody has confirmed meanwhile"
    assert organizer.send(first, f"{first}/reveal").headers["location"] == first
    assert "its secret has been public since" in organizer.get(first).text
    assert organizer.get(first).text.count('<a href="/submissions/') == 2
    saved = organizer.get(f"{first}/submissions.zip")
    with zipfile.ZipFile(io.BytesIO(saved.content)) as archive:
        assert archive.testzip() is None
        index = archive.read("submissions.csv").decode().splitlines()
        lost = archive.read("missing.txt").decode().splitlines()
    assert [row.split(",")[0] for row in index] == ["team", "Ants", "Elks"]
    assert len(lost) == 2, "these were never uploaded as files"
    to = tmp_path / "all.zip"
    assert service.run("admin", "submission", "download", TRACK, FIRST, str(to)).exit_code == 0
    assert to.read_bytes() == saved.content
    for path in (first, f"{first}/submissions.zip", "/desk/competitions/cup", "/desk/competitions/cup/results.zip"):
        assert team_visitor(service).get(path).status_code == 403
        assert visitor(service).get(path).headers["location"].startswith("/sign-in")


def test_a_competition_is_ended_published_and_reopened_on_its_page(
    service: CliService, organizer: PageVisitor, contest: str
) -> None:
    assert contest
    page = "/desk/competitions/cup"
    assert "is over" in organizer.get(page).text or "closes at" in organizer.get(page).text
    with service.database.transaction() as session:
        content = make_competition(prizes=[{"place": "first", "amount": 5}])
        content["tracks"][TRACK]["stages"] = content["tracks"][TRACK]["stages"][:1]
        content["tracks"][TRACK]["stages"][0] |= {
            "opens": "2024-01-01T00:00:00Z", "closes": "2024-02-01T00:00:00Z", "list": "sealed", "sealed": "at_once",
            "accepts": ["model"],
        }  # fmt: skip
        put_in_place(session, content)
    shown = organizer.get(page).text
    assert "Who would win now" in shown
    assert "<bdi>Ants</bdi>" in shown
    fields = {"shown": re.findall(r'name="shown" value="(\w+)"', shown)[0]}
    concerns = re.findall(r'name="(confirm-[^"]+)"', shown)
    assert organizer.send(page, f"{page}/finalize", shown="0" * 16, **dict.fromkeys(concerns, "yes")).status_code == 409
    done = organizer.send(page, f"{page}/finalize", **fields, **dict.fromkeys(concerns, "yes"))
    assert (done.status_code, done.headers.get("location")) == (303, page), done.text
    assert "Final since" in organizer.get(page).text
    with zipfile.ZipFile(io.BytesIO(organizer.get(f"{page}/results.zip").content)) as archive:
        assert "certificates.html" in archive.namelist()
    assert organizer.send(page, f"{page}/reopen", reason="A mistake.").status_code == 303
    assert "A mistake." in visitor(service).get("/competition").text


def test_the_status_of_the_service_is_a_page(service: CliService) -> None:
    shown = visitor(service).get("/status")
    assert shown.status_code == 200
    for part in ("The service can do its work.", "Database", "File store", "wait until a worker starts"):
        assert part in shown.text
    footer = shown.text.partition("<footer")[2]
    assert '<a href="/status">Status</a>' in footer
    assert '<a href="/docs/reference/rest">API</a>' in footer
    assert visitor(service).get("/docs/reference/rest").status_code == 200
