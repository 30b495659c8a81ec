"""The verbs are made of the API as it is, and what is asked about is what happens, or nothing."""

import json
from pathlib import Path
from runpy import run_path

import pytest
from cli_service import CliService
from service_factories import TASK, TRACK, make_settings
from vitac.cli.admin import competition, files
from vitac.cli.admin.verbs import NOUNS
from vitac.cli.client.verbs import ConsentMissing, find_operation, require_consent
from vitac.server.api.app import API_PREFIX, create_app
from vitac.server.leaderboards.baselines import HUMAN
from vitac.server.principals import Audience
from vitac.training.demonstrations.frames import DemonstrationDiffers
from vitac.training.demonstrations.hand_play import HandPlay

ORGANIZERS = {Audience.ORGANIZERS, Audience.COMPETITION_ORGANIZERS}
BY_HAND = {
    competition.APPLY,
    files.HUMAN_BASELINE,
    files.STAGE_SUBMISSIONS,
    "GET /competitions/{competition}/results",
    "GET /leaderboards/{track}/receipts",
}


def test_operations_are_those_of_the_api(repository: Path) -> None:
    document = run_path(str(repository / "setup" / "describe_api.py"))["document"]
    text = (repository / "cli" / "client" / "operations.json").read_text()
    assert text == document(), "run .venv/bin/python setup/describe_api.py"


def test_everything_that_only_organizers_may_do_is_a_verb() -> None:
    paths = create_app(make_settings()).openapi()["paths"]
    routes = {
        f"{method.upper()} {path.removeprefix(API_PREFIX)}"
        for path, methods in paths.items()
        for method, route in methods.items()
        for needed in route.get("security", ())
        if path.startswith(API_PREFIX) and ORGANIZERS & set(needed["HTTPBearer"])
    }
    assert len(routes) > 50
    assert routes - {verb.operation for noun in NOUNS.values() for verb in noun.verbs} == BY_HAND


def test_a_table_names_fields_that_there_are() -> None:
    for noun in NOUNS.values():
        for verb in noun.verbs:
            fields = {field.name for field in find_operation(verb.operation).fields}
            named = {
                *verb.fixed,
                *verb.usual,
                *(verb.only or ()),
                *verb.arguments,
                *verb.words,
                *verb.needed,
                *verb.parse,
            }
            assert named <= fields, verb.operation


def test_consent_is_needed_where_nobody_can_be_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    with pytest.raises(ConsentMissing, match="--yes"):
        require_consent("Cancel?", yes=False)
    require_consent("Cancel?", yes=True)


def test_what_people_solve_by_hand_is_played_again_and_published(service: CliService, tmp_path: Path) -> None:
    played = HandPlay(TASK, tmp_path)
    with played.storing() as path:
        for looks in (False, True):
            played.begin()
            if looks:
                played.scene_mm()
            while played.end_reason is None:
                played.step([0.0, 0.0, 0.0])
    (felt, seen), folder = path.read_text().splitlines(keepends=True)[1:], str(path.parent)
    assert service.run("admin", "baseline", "publish", folder, "--dry-run", "--json").exit_code == 0
    published = json.loads(service.run("admin", "baseline", "publish", folder, "--json").stdout)
    assert published["measures"].keys() == {"surface_diff_mm"}
    assert (published["name"], published["episodes"]) == (HUMAN, 1), "who has looked at the scene did not play by touch"
    assert service.run("admin", "baseline", "remove", TRACK, TASK, "--yes").exit_code == 0
    head = path.read_text().splitlines(keepends=True)[0]
    path.write_text(head + seen)
    refused = service.run("admin", "baseline", "publish", folder)
    assert "no episode that was played by marker flow alone" in str(refused.exception)
    hashes = json.loads(felt)["state_hashes"]
    path.write_text(head + felt.replace(hashes[-1], hashes[0]))
    refused = service.run("admin", "baseline", "publish", folder)
    assert isinstance(refused.exception, DemonstrationDiffers)
