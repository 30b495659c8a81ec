import re
import subprocess
import sys
from pathlib import Path

import httpx
from made_logs import LOG_KEY, make_entries
from made_receipts import KEY
from typer.testing import CliRunner
from vitac.cli.witness import app
from vitac.server.transparency.merkle import make_tree
from vitac.server.transparency.notes import NoteRejected, sign_checkpoint

PROGRAM = "from vitac.cli.witness import app; app()"


def test_a_log_asks_a_witness_that_listens(tmp_path: Path) -> None:
    folder = ("--folder", str(tmp_path), "--name", "ants.example/v")
    command = [sys.executable, "-c", PROGRAM, "serve", "--log", str(LOG_KEY), "--port", "0", *folder]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            key, address = (process.stdout.readline() for _ in range(2))
            asked = re.search(r"http://\S+", address)
            assert asked is not None
            signed = sign_checkpoint(KEY, size=9, root=make_tree([one.leaf_hash for one in make_entries(9)]).root())
            answer = httpx.post(asked[0], content=f"old 0\n\n{signed}".encode(), timeout=60)
        finally:
            process.terminate()
    assert (answer.status_code, answer.text.split()[1]) == (200, "ants.example/v")
    assert key.split()[1].startswith("ants.example/v+")


def test_what_is_no_key_of_a_log_is_refused_before_anything_is_made(tmp_path: Path) -> None:
    refused = CliRunner().invoke(app, ["serve", "--log", "a+b", "--folder", str(tmp_path / "new"), "--name", "a.b/c"])
    assert isinstance(refused.exception, NoteRejected)
    assert not (tmp_path / "new").exists()
