"""`vitac play` as a process: it says where the page is, and on Ctrl-C what was solved."""

import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import httpx
import pytest


@pytest.mark.slow
def test_ctrl_c_prints_the_rate_of_what_was_played_by_touch(tmp_path: Path) -> None:
    arguments = ["play", "peg-insertion", "--out", str(tmp_path), "--no-browser", "--json"]
    with subprocess.Popen(
        [sys.executable, "-c", "from vitac.cli.main import main; main()", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stderr is not None
        found = next(filter(None, (re.search(r"http://\S+", line) for line in process.stderr)))
        with httpx.Client(base_url=found[0], timeout=60) as page:
            while page.post("step", json={"action": [0, 0, 0]}).raise_for_status().json()["end"] is None:
                pass
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    printed = json.loads(out)
    assert (printed["task"], printed["episodes"]) == ("peg-insertion", 1)
    assert printed["interval"][0] < printed["interval"][1]
    assert Path(printed["file"]).is_file()
