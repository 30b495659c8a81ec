"""Every admin command that changes something writes the audit log, but not in a dry run, and prints JSON.

A new command has to be listed here.
"""

import json
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from uuid import uuid4

import pytest
import typer
from cli_service import CliService, submission_folder
from service_factories import TASK, play_all, submit
from sqlalchemy import func, select, update
from sqlalchemy.orm import Session
from typer.core import TyperCommand, TyperGroup
from vitac.cli.admin.app import app
from vitac.cli.client.verbs import NOTHING_CHANGED, ConsentMissing
from vitac.server.accounts import members, messages, teams
from vitac.server.accounts.outbox import announce
from vitac.server.accounts.stations import add_station
from vitac.server.accounts.tokens import list_tokens
from vitac.server.audit import newest_entries
from vitac.server.competitions.applying import freeze_boards
from vitac.server.competitions.sealing import seal
from vitac.server.database.models import Evaluation, Notice, Team, Work, Worker
from vitac.server.database.states import NoticeKind, Role, WorkerState, WorkKind
from vitac.server.decisions.finishing import finalize
from vitac.server.leaderboards.baselines import publish_human_baseline
from vitac.server.principals import CONSOLE, Principal
from vitac.server.submissions import appeal_replays, appeals
from vitac.server.views.correspondence import AppealReplayView
from vitac.training.demonstrations.hand_play import HandPlay

from competitions import (
    PUBLIC_RANKING,
    make_competition,
    moved,
    open_now,
    put_in_place,
    sealed_competition,
    stored_stage,
    write_competition,
)

CHANGES = {
    "backup": (["FILE"], "service.backup"),
    "baseline publish": (["PLAYED"], "baseline.publish"),
    "baseline remove": (["track_1", TASK, "--yes"], "baseline.remove"),
    "competition apply": (["COMPETITION", "--yes", "--confirm", PUBLIC_RANKING], "competition.apply"),
    "competition begin-trials": (["track_1", "stage1", "--yes"], "stage.plan_trials"),
    "competition play-final": (["track_1", "stage1", "--yes"], "stage.play_final"),
    "competition reveal": (["track_1", "stage1", "--yes"], "list.reveal"),
    "advance confirm": (["track_1", "stage2", "--yes"], "stage.qualify"),
    "results freeze": ([], "competition.freeze"),
    "results unfreeze": (["--yes"], "competition.unfreeze"),
    "results finalize": (["--yes"], "competition.finalize"),
    "results reopen": (["--reason", "an appeal was upheld", "--yes"], "competition.reopen"),
    "team disqualify": (["Team A", "--reason", "two accounts", "--yes"], "team.disqualify"),
    "team reinstate": (["Team A", "--yes"], "team.reinstate"),
    "team accept": (["Waiting"], "team.accept"),
    "team refuse": (["Waiting", "--reason", "two accounts"], "team.refuse"),
    "team rename": (["Team A", "Ants"], "team.rename"),
    "team captain": (["Team A", "Ann"], "team.captain"),
    "team remove-member": (["Team A", "Ann", "--yes"], "member.remove"),
    "team delete": (["Waiting", "--yes"], "team.delete"),
    "team merge": (["Waiting", "Team A", "--yes"], "team.merge"),
    "team add": (["Bears"], "token.issue"),
    "team import": (["CSV"], "team.register"),
    "team bulk": (["accept", "Waiting", "--yes"], "team.accept"),
    "team message": (["Team A", "News", "All is well."], "announcement.publish"),
    "team note": (["Team A", "Asked twice."], "note.change"),
    "team invite": (["Team A"], "member.invite"),
    "token add": (["--judge", "--label", "Prof. X"], "token.issue"),
    "token revoke": (["TOKEN", "--yes"], "token.revoke"),
    "notice retry": (["NOTICE"], "notice.retry"),
    "announcement publish": (["News", "All is well.", "--notify"], "announcement.publish"),
    "announcement withdraw": (["ANNOUNCEMENT"], "announcement.withdraw"),
    "question answer": (["QUESTION", "So.", "--public"], "question.answer"),
    "question hide": (["QUESTION"], "question.hide"),
    "appeal rule": (["APPEAL", "So.", "--reject"], "appeal.rule"),
    "appeal replay": (["APPEAL", TASK, "3"], "appeal.replay"),
    "quota set": (["Team A", "tokens", "7"], "team.quota"),
    "quota reset": (["LIMITED", "tokens"], "team.quota"),
    "submission cancel": (["SUBMISSION", "--yes"], "submission.cancel"),
    "submission requeue": (["CANCELLED", "--yes"], "submission.requeue"),
    "submission disqualify": (["SUBMISSION", "--reason", "trained on the list", "--yes"], "submission.disqualify"),
    "submission reinstate": (["DISQUALIFIED", "--yes"], "submission.reinstate"),
    "submission remove-description": (["SUBMISSION", "--reason", "no", "--yes"], "submission.remove-description"),
    "submission restore-description": (["UNDESCRIBED", "--yes"], "submission.restore-description"),
    "evaluation cancel": (["EVALUATION", "--yes"], "submission.cancel"),
    "evaluation requeue": (["CANCELLED_EVALUATION", "--yes"], "submission.requeue"),
    "evaluation restart": (["OUTDATED_EVALUATION", "--yes"], "evaluation.restart"),
    "evaluation restart-unserved": (["--yes"], "evaluation.restart"),
    "station add": (["lab"], "station.add"),
    "station remove": (["STATION", "--yes"], "station.remove"),
    "worker cordon": (["WORKER"], "worker.order"),
    "worker uncordon": (["WORKER"], "worker.order"),
    "worker drain": (["WORKER"], "worker.order"),
}
"""Arguments of a command, capitals standing for what there is, and the action of its line."""
TRIED_ELSEWHERE = {
    "brief decide",
    "result enter",
    "judging conflict",
    "judging mark",
    "restore",
    "rejudge start",
    "rejudge apply",
    "rejudge discard",
    "submission clear",
    "submission withdraw-clearance",
}
"""They need an empty service (tests/unit/server/operations/test_backup.py), results of another evaluator version
(tests/unit/cli/admin/test_rejudging.py), a judged track (tests/unit/server/decisions/test_judging.py), a stage played
elsewhere (tests/unit/server/decisions/test_edition_2026.py), or a copy
(tests/unit/server/evaluations/test_near_copies.py)."""


MAKES_SOMETHING = {"team add", "team import", "team message", "team invite"}
"""Verbs whose line has nothing before."""
ONLY_READ = {
    *("check", "copies", "data", "digests", "key", "list", "lists", "propose", "rubric", "show", "trials", "unserved"),
    *("winners", "witnesses"),
}
WRITE_A_FILE = {"receipt export", "results publish", "submission download"}
"""A new one; in the service nothing changes."""
WITHOUT_DRY_RUN = {"backup"}
"""It writes a file, and of the service only the line in the audit log that says so."""


def commands(group: TyperGroup, path: str = "") -> Iterator[tuple[str, TyperCommand, str]]:
    """Yield the words of each command, the command, and the help of its noun."""
    for name, command in group.commands.items():
        if isinstance(command, TyperGroup):
            yield from commands(command, f"{path}{name} ")
        else:
            assert isinstance(command, TyperCommand)
            yield f"{path}{name}", command, group.help or ""


def test_every_command_that_changes_something_is_tried_and_each_has_the_options_of_its_kind() -> None:
    group = typer.main.get_command(app)
    assert isinstance(group, TyperGroup)
    changes = set()
    for name, command, of_noun in commands(group):
        options = {text for given in command.params for text in given.opts}
        verb = name.split()[-1]
        assert "--json" in options, name
        is_change = verb not in ONLY_READ and name not in WRITE_A_FILE | WITHOUT_DRY_RUN
        assert ("--dry-run" in options, "--yes" in options) == (is_change, is_change), f"{name}: scripts give both"
        changes |= {name} if is_change else set()
        assert (command.help or "").rstrip().endswith("."), f"{name} says what it does"
        assert " " not in name or verb in of_noun, f"the help of the noun lists {name}"
    assert changes | WITHOUT_DRY_RUN == set(CHANGES) | TRIED_ELSEWHERE


def there_is(service: CliService, name: str, tmp_path: Path) -> str:
    """What a placeholder stands for."""
    if name == "FILE":
        return str(tmp_path / "file.tar")
    if name == "PLAYED":
        played = HandPlay(TASK, tmp_path)
        with played.storing() as path:
            while played.end_reason is None:
                played.step([0.0, 0.0, 0.0])
        return str(path.parent)
    if name == "CSV":
        file = tmp_path / "teams.csv"
        file.write_text("name\nBears\n")
        return str(file)
    if name == "COMPETITION":
        return str(write_competition(tmp_path, make_competition()))
    if name in {"ANNOUNCEMENT", "QUESTION", "APPEAL"}:
        return said(service, name)
    if name == "NOTICE":
        with service.database.transaction() as session:
            own = teams.find(session, "Team A")
            members.set_email(session, CONSOLE, members.find_captain(session, own), "a@example.org")
            announce(session, NoticeKind.FINISHED, own.id, "evaluation:1", {"page": "/"})
            session.execute(update(Notice).values(given_up_at=func.now()))
            return str(session.scalars(select(Notice.id)).one())
    if name == "WORKER":
        with service.database.transaction() as session:
            worker = Worker(
                id=uuid4(), host="machine", pid=1, slots=1, state=WorkerState.READY, evaluator_version="1+a",
                isolation="", platform_class="x86_64-linux",
            )  # fmt: skip
            session.add(worker)
            return str(worker.id)
    if name == "STATION":
        with service.database.transaction() as session:
            add_station(session, CONSOLE, "lab")
            return "lab"
    if name == "LIMITED":
        service.run("admin", "quota", "set", "Team A", "tokens", "7")
        return "Team A"
    if name == "TOKEN":
        with service.database.transaction() as session:
            return str(list_tokens(session, CONSOLE)[0].id)
    submission = json.loads(service.run("submit", str(submission_folder(tmp_path / "mine")), "--json").stdout)["id"]
    if name == "DISQUALIFIED":
        service.run("admin", "submission", "disqualify", submission, "--reason", "copied", "--yes")
    if name == "UNDESCRIBED":
        service.run("admin", "submission", "remove-description", submission, "--reason", "no", "--yes")
    if name.startswith("CANCELLED"):
        service.run("admin", "submission", "cancel", submission, "--yes")
    if name == "OUTDATED_EVALUATION":
        with service.database.transaction() as session:
            session.execute(update(Evaluation).values(evaluator_version="1+yesterday"))
    if name.endswith("EVALUATION"):
        return str(json.loads(service.run("admin", "evaluation", "list", "--json").stdout)[0]["id"])
    return str(submission)


def said(service: CliService, name: str) -> str:
    """Number of something that somebody has said."""
    with service.database.transaction() as session:
        own = teams.find(session, "Team A")
        by = Principal(role=Role.TEAM, team_id=own.id, team_name=own.name)
        if name == "ANNOUNCEMENT":
            return str(messages.publish_announcement(session, CONSOLE, title="News", text="Text", notify=False).id)
        if name == "QUESTION":
            return str(messages.ask_question(session, by, "Why?", public=True).id)
        content = make_competition(appeal_days=7)
        content["tracks"] = {"mail": content["tracks"]["track_1"] | {"taken_here": False}}
        put_in_place(session, content)
        submission = submit(session, by)
    play_all(service.database, submission)
    with service.database.transaction() as session:
        return str(appeals.open_appeal(session, by, submission.id, "Look again.").id)


def prepare(service: CliService, command: str) -> None:
    """Brings a competition to where the command has something to do."""
    with service.database.transaction() as session:
        if command.startswith("team"):
            make_team_to_change(session, waits=command != "team merge")
            if command == "team reinstate":
                teams.disqualify(session, CONSOLE, teams.find(session, "Team A"), "two accounts")
        elif command == "competition reveal":
            put_in_place(session, open_now(sealed_competition(), stage=1))
            seal(session, CONSOLE, stored_stage(session, "track_1", "stage1"))
        elif command == "competition begin-trials":
            content = open_now(sealed_competition())
            content["tracks"]["track_1"]["stages"][0] |= {"sealed": "at_once", "plan": {"stations": ["lab"]}}
            put_in_place(session, content)
            seal(session, CONSOLE, stored_stage(session, "track_1", "stage1"))
            add_station(session, CONSOLE, "lab")
            own = teams.find(session, "Team A")
            submit(session, Principal(role=Role.TEAM, team_id=own.id, team_name=own.name))
            session.execute(update(Work).values(kind=WorkKind.TRIAL))
            put_in_place(session, moved(content, days=-300))
        elif command == "baseline remove":
            publish_human_baseline(session, CONSOLE, "track_1", TASK, [("cuboid", True, 4, {})])
        elif command == "competition play-final":
            content = open_now(sealed_competition(), stage=1)
            content["tracks"]["track_1"]["stages"][0]["sealed"] = "live_and_final"
            put_in_place(session, content)
            seal(session, CONSOLE, stored_stage(session, "track_1", "stage1.final"))
        elif command == "evaluation restart-unserved":
            own = teams.find(session, "Team A")
            submit(session, Principal(role=Role.TEAM, team_id=own.id, team_name=own.name))
            session.execute(update(Evaluation).values(evaluator_version="1+yesterday"))
        elif command == "advance confirm":
            put_in_place(session, open_now(make_competition(), stage=1))
        elif command.startswith("results"):
            put_in_place(session, moved(make_competition(), days=-2000))
            if command == "results unfreeze":
                freeze_boards(session, CONSOLE)
            elif command == "results reopen":
                finalize(session, CONSOLE)


def make_team_to_change(session: Session, *, waits: bool) -> None:
    """A second member of Team A, and another team."""
    _, code = members.invite(session, CONSOLE, teams.find(session, "Team A"))
    members.join(session, members.JoiningMember(code=code, name="Ann"), timedelta(days=1))
    teams.register(session, CONSOLE, name="Waiting", waits=waits)


def newest_line(service: CliService) -> int:
    """Number of the last line of the audit log."""
    with service.database.transaction() as session:
        return newest_entries(session, 1)[0].id


def dry_run(service: CliService, command: str, given: list[str]) -> object:
    """What a command says that it would do, without asking; no line is written.

    That it leaves every row as it was is tested of every route (tests/unit/server/api/test_authorization).
    """
    last = newest_line(service)
    done = service.run("admin", *command.split(), *(text for text in given if text != "--yes"), "--dry-run", "--json")
    assert done.exit_code == 0, (done.output, done.exception)
    assert NOTHING_CHANGED in done.stderr.splitlines()
    assert newest_line(service) == last
    assert "vitac_" not in done.stdout, "a token that is not kept is not shown"
    return json.loads(done.stdout)


PLAYED = AppealReplayView(
    task=TASK, episode=3, policy_sha256="0" * 64, corrected=False, outcome="success", env_steps=3, same_states=True,
    failure=None, old_outcome="success", old_env_steps=3, played_at=datetime.now(UTC),
)  # fmt: skip


def shape(content: object) -> object:
    """Names of fields, or how many there are."""
    return set(content) if isinstance(content, dict) else len(content) if isinstance(content, list) else None


@pytest.mark.parametrize("command", CHANGES)
def test_a_change_is_written_to_the_audit_log(
    service: CliService, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments, action = CHANGES[command]
    monkeypatch.setattr(appeal_replays, "wait", lambda *_: PLAYED)  # the episode itself takes a worker and seconds
    prepare(service, command)
    given = [there_is(service, name, tmp_path) if name.isupper() else name for name in arguments]
    last = newest_line(service)
    tried = None if command in WITHOUT_DRY_RUN else dry_run(service, command, given)
    if "--yes" in given:
        unasked = service.run("admin", *command.split(), *(text for text in given if text != "--yes"))
        assert isinstance(unasked.exception, ConsentMissing), "nobody can be asked here"
    done = service.run("admin", *command.split(), *given, "--json")
    assert done.exit_code == 0, (done.output, done.exception)
    made = json.loads(done.stdout)
    assert tried is None or shape(tried) == shape(made)
    assert NOTHING_CHANGED not in done.stderr
    with service.database.transaction() as session:
        written = [entry for entry in newest_entries(session, 5) if entry.id > last]
    assert action in {entry.action for entry in written}
    assert {entry.actor for entry in written} == {"organizer:console"}
    by_action = {entry.action: entry for entry in written}
    if command.startswith("team ") and command not in MAKES_SOMETHING:
        assert by_action[action].before is not None
        assert by_action[action].before != by_action[action].after


def test_lists_who_when_what_before_and_after(service: CliService) -> None:
    for limit in ("7", "unlimited"):
        service.run("admin", "quota", "set", "Team A", "tokens", limit)
    listed = json.loads(service.run("admin", "audit", "list", "--action", "team.quota", "--json").stdout)
    assert [(line["before"]["limit"], line["after"]["limit"]) for line in listed] == [(7, None), ("default", 7)]
    assert all(line["actor"] == "organizer:console" and line["at"] for line in listed)
    shown = service.run("admin", "audit", "list", "--action", "team.quota", "--limit", "1").stdout
    assert "who" in shown.splitlines()[0]
    assert '"limit": 7' in shown
    assert "No such change." in service.run("admin", "audit", "list", "--subject", "team:none").stdout


def test_a_long_change_is_cut_in_the_table_only(service: CliService) -> None:
    name = "x" * 64
    service.run("admin", "team", "add", name, "--contact", "y" * 200)
    with service.database.transaction() as session:
        team = session.query(Team).filter_by(name=name).one()
    subject = f"team:{team.id}"
    shown = service.run("admin", "audit", "list", "--subject", subject).stdout
    assert name in shown
    (line,) = json.loads(service.run("admin", "audit", "list", "--subject", subject, "--json").stdout)
    assert line["after"]["name"] == name
