import json

from cli_service import CliService


def limit_of(service: CliService, quota: str) -> object:
    listed = json.loads(service.run("admin", "quota", "list", "Team A", "--json").stdout)
    return next(entry["limit"] for entry in listed if entry["quota"] == quota)


def test_a_limit_is_shown_set_and_reset(service: CliService) -> None:
    shown = service.run("admin", "quota", "list", "Team A").stdout
    for name in ("scored_runs_per_day", "attempts_per_day", "queued_at_once", "tokens", "event_streams"):
        assert name in shown
    for arguments in [("nothing", "1"), ("tokens", "-1"), ("tokens", "many"), ("tokens", "9" * 10)]:
        assert service.run("admin", "quota", "set", "Team A", "--", *arguments).exit_code == 2
    before = limit_of(service, "tokens")
    for given, limit in (("7", 7), ("unlimited", None)):
        unchanged = limit_of(service, "tokens")
        dry = service.run("admin", "quota", "set", "team a", "tokens", given, "--dry-run")
        assert (dry.exit_code, dry.stdout.strip()) == (0, f"tokens of team a: {given}")
        assert limit_of(service, "tokens") == unchanged
        done = service.run("admin", "quota", "set", "team a", "tokens", given, "--json")
        assert done.exit_code == 0, done.output
        assert json.loads(done.stdout)["limit"] == limit_of(service, "tokens") == limit
    assert service.run("admin", "quota", "reset", "team a", "tokens").exit_code == 0
    assert limit_of(service, "tokens") == before
