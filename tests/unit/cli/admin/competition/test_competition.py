import json
from pathlib import Path

import pytest
from cli_service import CliService
from service_factories import TRACK
from vitac.cli.client.answers import RequestRefused
from vitac.evaluator.strict_model import DocumentRejected
from vitac.evaluator.tracks.sealed import make_commitment
from vitac.server.competitions.competition import Competition
from vitac.server.competitions.sealing import seal
from vitac.server.errors import ProblemCode
from vitac.server.principals import CONSOLE

from competitions import (
    FIRST,
    PUBLIC_RANKING,
    SECOND,
    make_competition,
    open_now,
    put_in_place,
    sealed_competition,
    stored_stage,
    write_competition,
)


@pytest.fixture
def file(tmp_path: Path) -> str:
    return str(write_competition(tmp_path, make_competition()))


def test_a_file_is_checked_without_a_service(service: CliService, file: str, tmp_path: Path) -> None:
    shown = service.run("admin", "competition", "check", file)
    assert shown.exit_code == 0
    assert "the best team of the stage before" in shown.stdout
    assert json.loads(service.run("admin", "competition", "check", file, "--json").stdout)["name"] == "cup"
    Path(file).write_text("name: cup\ntitel: wrong\n")
    refused = service.run("admin", "competition", "check", file)
    assert isinstance(refused.exception, DocumentRejected)
    assert "did you mean 'title'" in str(refused.exception)


def test_a_file_is_applied_once_and_by_one_of_two_who_change_it(service: CliService, file: str, tmp_path: Path) -> None:
    apply = ("admin", "competition", "apply")
    assert "The cup" in service.run(*apply, file, "--dry-run").stdout
    assert "has no competition" in str(service.run("admin", "competition", "show").exception)
    first = service.run(*apply, file, "--yes", "--confirm", PUBLIC_RANKING)
    lines = first.stdout.splitlines()
    assert (first.exit_code, lines[0], lines[-1]) == (0, "cup: The cup", "applied")
    assert "track_1: stage1 2031-01-01 00:00 to 2031-02-01 00:00 UTC; stage2 " in first.stdout
    again = service.run(*apply, file)  # nothing to consent to
    assert (again.exit_code, again.stdout.strip()) == (0, "Nothing changes.")
    assert json.loads(service.run(*apply, file, "--json").stdout) == []
    assert "track_1/stage1, track_1/stage2" in service.run("admin", "competition", "show").stdout
    (sealed,) = json.loads(service.run("admin", "competition", "lists", "--json").stdout)
    assert (sealed["stage"], sealed["secret"], len(sealed["commitment"])) == (SECOND, None, 64)
    change = str(write_competition(tmp_path, make_competition(title="The first cup")))
    base = service.run(*apply, change, "--dry-run").stderr.rpartition("--base ")[2].split(".")[0]
    assert base in service.run("admin", "competition", "show").stdout
    assert service.run(*apply, change, "--yes", "--base", base).exit_code == 0
    second = str(write_competition(tmp_path, make_competition(summary="By touch.")))
    for options in (("--yes", "--base", base), ("--yes",), ("--dry-run", "--base", base)):
        refused = service.run(*apply, second, *options)
        assert isinstance(refused.exception, RequestRefused)
        assert refused.exception.code == ProblemCode.CHANGED_MEANWHILE
    assert "The first cup" in service.run("admin", "competition", "show").stdout


def test_a_list_is_revealed_after_its_stage_and_fits_its_commitment(service: CliService) -> None:
    with service.database.transaction() as session:
        put_in_place(session, open_now(sealed_competition(), stage=1))
        for stage in (FIRST, SECOND):
            seal(session, CONSOLE, stored_stage(session, TRACK, stage))
    for stage, said in ((SECOND, "closes at"), ("none", "no stage 'none'")):
        refused = service.run("admin", "competition", "reveal", TRACK, stage, "--yes")
        assert isinstance(refused.exception, RequestRefused)
        assert said in str(refused.exception)
    dry = service.run("admin", "competition", "reveal", TRACK, FIRST, "--dry-run")
    listed = json.loads(service.run("admin", "competition", "lists", "--json").stdout)
    assert [each["secret"] for each in listed] == [None, None]
    assert (dry.exit_code, listed[0]["commitment"] in dry.stdout) == (0, True)
    assert dry.stdout.splitlines()[-1].split() == ["secret", "-"]
    revealed = json.loads(service.run("admin", "competition", "reveal", TRACK, FIRST, "--yes", "--json").stdout)
    listed = json.loads(service.run("admin", "competition", "lists", "--json").stdout)
    assert revealed == listed[0]
    assert make_commitment(bytes.fromhex(listed[0]["secret"])) == listed[0]["commitment"]
    assert listed[1]["secret"] is None


def test_a_first_file_is_summed_up_in_ten_lines_and_ends_with_applied(service: CliService, tmp_path: Path) -> None:
    content = make_competition()
    names = ("track_1", "track_1_peg_robust", "track_1_lock_robust", "track_2", "track_2_gt", "track_2_robust")
    for name in (*names, *(f"elsewhere_{number}" for number in range(6))):
        rules = {"accepts": ["model"], "list": "sealed", "qualified": None}
        stages = [stage | rules for stage in content["tracks"][TRACK]["stages"]]
        content["tracks"][name] = {"title": name, "stages": stages, "taken_here": name in names}
    file = str(write_competition(tmp_path, content))
    for option in ("--dry-run", "--yes"):
        done = service.run("admin", "competition", "apply", file, option)
        lines = done.stdout.splitlines()
        assert done.exit_code == 0
        assert (len(lines), lines[-1]) == ((10, "and 5 more tracks") if option == "--dry-run" else (11, "applied"))
        assert "tracks: 12, stages: 24" in lines[1]
    content["title"] = "The new cup"
    with service.database.transaction() as session:
        base = Competition.read(session).revision
    again = service.run(
        "admin", "competition", "apply", str(write_competition(tmp_path, content)), "--yes", "--base", base
    )
    assert again.stdout.splitlines()[1:][-1] == "applied"
    assert "The new cup" in again.stdout


def test_stages_in_the_past_are_warned_of_where_a_file_is_checked_and_where_it_adds_them(
    service: CliService, tmp_path: Path
) -> None:
    content = open_now(sealed_competition(), stage=1)
    warning = "WARNING: Stage stage1 of track_1 closed at"
    file = str(write_competition(tmp_path, content))
    checked = service.run("admin", "competition", "check", file)
    assert (checked.exit_code, checked.stderr.count(warning), checked.stderr.count("WARNING")) == (0, 1, 1)
    assert warning in service.run("admin", "competition", "apply", file, "--yes").stderr
    content["title"] = "Another title"
    again = service.run("admin", "competition", "apply", str(write_competition(tmp_path, content)), "--dry-run")
    assert "WARNING" not in again.stderr


def test_what_a_file_closes_at_once_is_told_before_it_is_applied(service: CliService) -> None:
    example = str(Path(__file__).parents[5] / "competitions" / "vitac-2025.yaml")
    for arguments in (("--dry-run",), ("--yes",)):
        done = service.run("admin", "competition", "apply", example, *arguments, "--json")
        assert done.exit_code == 0
        assert "teams_locked is 2025-02-01 00:00:00 UTC, which is past" in done.stderr
        assert "Stage stage2 of track_1, track_2 closed at 2025-03-21 00:00:00 UTC, which is past" in done.stderr
        assert "public list" not in done.stderr, "each stage ranks on a sealed list"
        assert len(json.loads(done.stdout)) > 10
    assert service.run("admin", "competition", "apply", example).stderr == "", "nothing changes any more"


def test_hiding_and_showing_names_is_warned_of(service: CliService, tmp_path: Path) -> None:
    told = []
    for anonymous in (True, False, True):
        file = str(write_competition(tmp_path, make_competition(anonymous=anonymous)))
        with service.database.transaction() as session:
            base = Competition.read(session).revision
        done = service.run("admin", "competition", "apply", file, "--yes", "--base", base, "--confirm", PUBLIC_RANKING)
        assert done.exit_code == 0
        told.append(done.stderr)
    assert "anonymous" not in told[0], "nothing was shown before"
    assert "WARNING: anonymous is switched off: from now on everybody sees the real names" in told[1]
    assert "WARNING: anonymous is switched on" in told[2]
    assert "still knows them" in told[2]


def test_a_change_of_what_has_happened_is_confirmed_by_name(
    service: CliService, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    apply = ("admin", "competition", "apply")
    content = make_competition()
    service.run(*apply, str(write_competition(tmp_path, content)), "--yes", "--confirm", PUBLIC_RANKING)
    with service.database.transaction() as session:
        base = Competition.read(session).revision
    content["tracks"][TRACK]["stages"][1]["list"] = "public"
    public, name = str(write_competition(tmp_path, content)), f"tracks.{TRACK}.stages.{SECOND}.list"
    assert f"WARNING: {name}: The commitment" in service.run(*apply, public, "--dry-run").stderr
    refused = service.run(*apply, public, "--yes", "--base", base)
    assert isinstance(refused.exception, RequestRefused)
    assert f"--confirm {name}" in str(refused.exception)
    asked: list[str] = []
    monkeypatch.setattr("vitac.cli.client.verbs.require_consent", lambda question, *, yes: asked.append(question))
    assert service.run(*apply, public).exit_code == 0
    assert asked == [f"{name}: do you mean that?", "Apply these 1 changes?"]
    assert service.run(*apply, public, "--yes").stdout.strip() == "Nothing changes."
