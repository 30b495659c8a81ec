import json
from pathlib import Path

from cli_service import CliService, submission_folder
from databases import fresh_database
from vitac.cli.admin.machine import RESTART
from vitac.cli.client.verbs import NOTHING_CHANGED
from vitac.server.operations.backup import ServiceNotEmpty


def test_backup_is_restored_into_an_empty_service(service: CliService, tmp_path: Path) -> None:
    service.run("submit", str(submission_folder(tmp_path / "mine")), "--json")
    (tmp_path / "tracks").mkdir()
    (tmp_path / "tracks" / "pegs-2026.1.yaml").write_text("name: pegs-2026.1")
    service.environment["VITAC_TRACKS_DIR"] = str(tmp_path / "tracks")
    done = service.run("admin", "backup", str(tmp_path / "backup.tar"), "--json")
    assert (done.exit_code, json.loads(done.stdout)["uploads"]) == (0, 1)
    with fresh_database() as address:
        new = tmp_path / "new"
        service.environment.update(VITAC_DATABASE_URL=address, VITAC_STATE_DIR=str(new))
        service.environment["VITAC_TRACKS_DIR"] = str(new / "tracks")
        new.mkdir()
        tried = service.run("admin", "restore", str(tmp_path / "backup.tar"), "--dry-run", "--json")
        assert (tried.exit_code, json.loads(tried.stdout)) == (0, json.loads(done.stdout))
        assert tried.stderr.strip() == NOTHING_CHANGED
        assert "No such team" in service.run("admin", "team", "list").stdout
        restored = service.run("admin", "restore", str(tmp_path / "backup.tar"), "--yes")
        assert restored.exit_code == 0, restored.output
        assert RESTART in restored.stderr
        assert [path.name for path in (new / "tracks").iterdir()] == ["pegs-2026.1.yaml"]
        del service.environment["VITAC_TRACKS_DIR"]
        assert "Team A" in service.run("admin", "team", "list").stdout


def test_restore_asks_first_and_is_refused_over_data(service: CliService, tmp_path: Path) -> None:
    file = tmp_path / "backup.tar"
    service.run("admin", "backup", str(file))
    assert "repeat with --yes" in str(service.run("admin", "restore", str(file)).exception)
    for option in ("--dry-run", "--yes"):
        done = service.run("admin", "restore", str(file), option)
        assert isinstance(done.exception, ServiceNotEmpty)
        assert "restore into a new one" in str(done.exception)
        assert NOTHING_CHANGED not in done.stderr
