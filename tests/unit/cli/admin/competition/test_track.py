import json
from pathlib import Path

from typer.testing import CliRunner, Result
from vitac.cli.main import build_app
from vitac.evaluator.strict_model import DocumentRejected

FILE = """
name: mine
folder: Mine
title: My track
summary: One episode.
accepts: [model]
tasks:
  one-peg:
    name: one-peg
    env_id: ViTac/PegInsertion-v1
    title: Peg
    description: One peg.
    success_rule: As in track 1.
    max_steps: 8
    shard_size: 1
    episode_list:
      list_seed: 7
      offset_option: offset_mm_deg
      blocks: [{starts: [{shape: cuboid, offset: [-3, 2, 5]}]}]
"""


def run(*arguments: str) -> Result:
    """A command without any service."""
    return CliRunner().invoke(build_app(arguments), list(arguments), env={"COLUMNS": "200"})


def test_a_track_file_is_checked_and_its_cost_told(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(FILE)
    shown = run("admin", "track", "check", str(file))
    assert shown.exit_code == 0, shown.exception
    assert "one-peg         1  cuboid  public" in shown.stdout
    assert "VITAC_TRACKS_DIR" in shown.stdout
    (task,) = json.loads(run("admin", "track", "check", str(file), "--json").stdout)["tasks"]
    assert (task["episodes"], task["shards"], task["cpu_s"] > 0) == (1, 1, True)
    file.write_text(FILE.replace("max_steps: 8", "max_steps: 3"))
    refused = run("admin", "track", "check", str(file))
    assert isinstance(refused.exception, DocumentRejected)
