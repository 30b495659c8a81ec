"""Every block of code in the documents is run, or `NOT_RUN` says why not.

That commands have the verbs and options that documents show is tested in test_commands, without running any.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from textwrap import dedent

import pytest
import yaml
from databases import fresh_database
from shown_documents import FENCE, documents

NOT_RUN = {
    r"vitac demo\b": "tests/acceptance/test_demo.py does",
    r"vitac test\b": "is what runs this",
    r"vitac (serve|worker)\b": "run until they are stopped; a server runs beside this test",
    r"vitac doctor\b": "its exit code is about the machine; tests of the sandbox run all its checks",
    r"vitac scale\b|VITAC_DATABASE_URL": "needs Slurm; benchmarks/slurm.py runs it",
    r"press.a.switch|press-switch": "needs the example's package; tests/integration/own_task has it",
    r"vitac compile\b": "takes half a minute; tests/unit/cli/test_compile.py says what it plays",
    r"vitac login\b": "asks for a token; tests/unit/cli/client does",
    r"vitac --(maniskill|torch)\b": "downloads gigabytes; tests/integration/maniskill and tests/unit/training do",
    r"vitac train\b": "takes minutes; tests/unit/examples/test_train_a_policy.py trains in miniature",
    r"train_a_policy|RUN/|maniskill_cloning|lock_opening_cloned": "needs what training makes, torch, or ManiSkill",
    r"(mkdir|cp -r) .*my_submission|export VITAC": "makes a folder that the reader of another document already has",
    r"vitac station\b": "needs the devices of a laboratory; tests/unit/cli/test_station.py has twins of them",
    r"--station\b": "plays trials on a twin for minutes; tests/unit/station/test_trial.py does",
    r"vitac gap\b": "needs trials; tests/unit/cli/test_gap.py makes some",
    r"--remote\b|remote connect": "needs a policy server or a gate; tests/integration/remote has those of packages",
    r"vitac check examples/track_3_dome": "measures the sensor too; tests/integration/sandbox/test_sensor.py does",
    r"vitac sensor evaluate\b": "plays many episodes; tests/unit/cli/test_sensor.py does",
    r"first/|first$|check first\b|submit first\b": "needs the challenge's STL file; a dome is checked in its place",
    r"--out (episode.webp|frames)": "draws many pictures; tests/unit/cli/show does",
    r"compare A\.json": "needs three evaluations; tests/unit/cli/test_compare.py compares some",
    r"\blerobot-train\b": "needs lerobot; tests/unit/training/demonstrations trains a step where it is",
    r"\bpolicy\.tar\b": "needs an image; tests/integration/sandbox/test_images.py makes some",
    r"\bdocker\b": "tests/containers does, where there is an engine",
    r"\b(pip|pipx|uvx)\b": "installs from an index; .ci/run installs the wheel",
    r"test_(same_bits|golden)": "is in the suite",
    r"log import|--secret|compare run.jsonl|trained.jsonl": "needs a whole list or a log of 2025",
    r"\b(ID|FILE|KEY|HEX|DIGEST|NAME|DIR|PACKAGE|SUBMISSION)\b": "stands for what a finished evaluation has",
    r"vitac (question|appeal|team|publish|receipt|witness)\b":
        "needs a competition that runs; tests/unit/cli/client does",
    r"admin (brief|result) ": "needs a competition that is played elsewhere; tests/unit/server/decisions has one",
    r"admin (advance|results|judging|receipt export|rejudge|appeal|question|restore|team (accept|merge|disqualify))\b":
        "needs a competition with results; tests/unit/cli/admin does",
    r"admin (announcement|competition (apply cup.yaml$|lists|reveal)|quota set)\b":
        "would change what follows; tests/unit/cli/admin does",
    r"admin .*--server": "needs an organizer's token; tests/unit/cli/admin/test_from_elsewhere.py has one",
    r"\bcurl\b": "asks a service at an address that stands for any",
    r"vitac submit run.jsonl|VITAC_TRACKS_DIR": "needs a whole log, or a track file that the server has",
}  # fmt: skip
"""Commands by pattern, and where else they are run or why nowhere."""
NOT_EXECUTED = {"CONTRIBUTING.md": "parts of files of ours", "docs/notices.md": "a function for other programs",
                "docs/demonstrations.md": "needs lerobot; tests/unit/training/demonstrations reads with it where it is",
                "docs/tutorials/press_a_switch.md": "tests/integration/own_task runs it"}  # fmt: skip
"""Documents whose Python is compiled only."""
GENERATED = {"python-reference", "rest", "task", "environments", "settings", "outcomes", "verdicts"}
"""Stand for what the code says of itself (tests/unit/web/documentation)."""
LANGUAGES = {"sh", "dockerfile", "python", "yaml", "json", "bibtex", "", *GENERATED}
REPLACED = {
    "my_folder": "my_submission",
    "my_log.jsonl": "run.jsonl",
    "log show FILE": "log show run.jsonl",
    "log diff FILE OTHER": "log diff run.jsonl run.jsonl",
    "log match FILE SUBMISSION": "log match run.jsonl my_submission",
    "resimulate FILE": "resimulate run.jsonl",
    "--episode 40 --actions": "--episode 2 --actions",
    '"Team Name" --contact': '"Other Team" --contact',
    "--episodes 1:12": "--episodes 1:2",
    "--successes 200": "--successes 4",
    "--successes 290": "--successes 4",
    "--out taught --processes 2": "--out taught",
    "simulation.json": "result.json",
    "examples/track_3_dome/Track_3": "my_sensor",
    "dome.png": "sensor.png",
}
DOCS = Path(__file__).parents[3] / "docs"
MAIN = "from vitac.cli.main import main; main()"
WHOLE_LIST = re.compile(r"(vitac evaluate (?!.*--episodes).*?)(?=\s*$)")


def blocks(markdown: str, language: str) -> list[str]:
    return [block for found, block in FENCE.findall(markdown) if found == language]


def test_every_language_is_known_and_what_can_be_parsed_can(repository: Path) -> None:
    for name, markdown in documents(repository):
        languages = [line.removeprefix("```") for line in re.findall(r"^```.*$", markdown, re.MULTILINE)][::2]
        assert set(languages) <= LANGUAGES, name
        for block in blocks(markdown, "python"):
            compile(dedent(block), name, "exec")
        for block in blocks(markdown, "yaml"):
            assert yaml.safe_load(dedent(block)) is not None, name
        for block in blocks(markdown, "json"):
            json.loads(block)
        shell = "\n".join(blocks(markdown, "sh"))
        parsed = subprocess.run(["bash", "-n"], input=shell, capture_output=True, text=True, check=False)
        assert parsed.returncode == 0, f"{name}: {parsed.stderr}"


def test_examples_that_draw_actions_seed_them_so_that_they_repeat(repository: Path) -> None:
    drawing = [
        block
        for _, markdown in documents(repository)
        for block in blocks(markdown, "python")
        if "space.sample()" in block
    ]
    assert drawing
    assert all("action_space.seed(" in block for block in drawing)


def commands(repository: Path) -> Iterator[str]:
    for _, markdown in documents(repository):
        for block in blocks(markdown, "sh"):
            yield from block.splitlines()


def reason_not_to_run(command: str) -> str | None:
    return next((reason for pattern, reason in NOT_RUN.items() if re.search(pattern, command)), None)


def test_each_reason_not_to_run_is_needed(repository: Path) -> None:
    lines = [re.sub(r"\s+#.*", "", line) for line in commands(repository)]
    assert [pattern for pattern in NOT_RUN if not any(re.search(pattern, line) for line in lines)] == []
    assert len([line for line in lines if line and reason_not_to_run(line) is None]) > 50


WITH_PYTHON = {name: found for name, markdown in documents(DOCS.parent) if (found := blocks(markdown, "python"))}


@pytest.fixture
def workplace(repository: Path, tmp_path: Path) -> Path:
    """A folder in which a reader types: the launcher, the examples, and the files that documents take for granted."""
    launcher = tmp_path / "vitac"
    launcher.write_text(f"#!/bin/sh\nexec {sys.executable} -c '{MAIN}' \"$@\"\n")
    launcher.chmod(0o755)
    for folder in ("examples", "competitions", "evaluator"):
        (tmp_path / folder).symlink_to(repository / folder)
    shutil.copytree(
        repository / "examples" / "peg_insertion_heuristic" / "Track_1", tmp_path / "my_submission" / "Track_1"
    )
    shutil.copytree(repository / "examples" / "track_3_dome" / "Track_3", tmp_path / "my_sensor")
    shutil.copy(repository / "competitions" / "vitac-2025.yaml", tmp_path / "cup.yaml")
    (tmp_path / "tracks").mkdir()
    (own_track,) = blocks((repository / "docs" / "organizing.md").read_text(), "yaml")
    (tmp_path / "tracks" / "mine.yaml").write_text(own_track)
    return tmp_path


@contextmanager
def serving(environment: dict[str, str]) -> Iterator[str]:
    """Run `vitac serve`, and yield its address."""
    command = [sys.executable, "-c", MAIN, "serve", "--port", "0"]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        try:
            yield server.stdout.readline().split()[-1]
        finally:
            server.terminate()
            server.communicate(timeout=60)


def script_of(lines: Iterator[str], address: str) -> str:
    """Return the commands that are run, each once, with the values that a reader would fill in."""
    text = re.sub(r"[ \t]+#.*", "", "\n".join(lines))
    for shown, meant in {**REPLACED, "ADDRESS": address}.items():
        text = text.replace(shown, meant)
    chosen = (line for line in text.splitlines() if reason_not_to_run(line) is None)
    return "\n".join(dict.fromkeys(WHOLE_LIST.sub(r"\1 --episodes 1:2", line) for line in chosen))


@pytest.mark.slow(minutes=4)
def test_the_commands_of_the_documents_work_one_after_the_other(repository: Path, workplace: Path) -> None:
    folders = {"VITAC_STATE_DIR": str(workplace / "state"), "XDG_CONFIG_HOME": str(workplace / "config")}
    with fresh_database() as database:
        environment = os.environ | folders | {"VITAC_DATABASE_URL": database}
        with serving(environment) as address:
            done = subprocess.run(
                ["bash", "-exc", script_of(commands(repository), address)],
                cwd=workplace,
                env=environment,
                input="y\n" * 9,
                timeout=1500,
                capture_output=True,
                text=True,
                check=False,
            )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(WITH_PYTHON.keys() - NOT_EXECUTED.keys()))
def test_the_python_of_a_document_works(workplace: Path, name: str) -> None:
    code = "from pathlib import Path\nimport gymnasium\nimport vitac.envs\n" + "\n".join(map(dedent, WITH_PYTHON[name]))
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=workplace, capture_output=True, text=True, check=False, timeout=600
    )
    assert done.returncode == 0, done.stderr[-2000:]
