"""The launcher's set-up, run for real against an interpreter that only pretends to install."""

import os
import shutil
import stat
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from vitac.cli.main import NOUNS, Noun

# Stands in for python3.11: real for `-c`, unless it has an answer for who asks whether it can make an environment, and
# in place of venv and pip it writes what those would leave behind.
FAKE_PYTHON = f"""#!/bin/sh
case "$*" in
  "-I -c "*ensurepip*)
    if [ -n "${{FAKE_ANSWER-}}" ]; then echo "$FAKE_ANSWER"; else exec '{sys.executable}' -S "$@"; fi ;;
  "-I -c "*) exec '{sys.executable}' -S "$@" ;;
  "-I -m venv "*)
    echo "venv" >>"$FAKE_CALLS"
    mkdir -p "$4/bin" && ln -s "$(readlink -f "$0")" "$4/bin/python" ;;
  *"pip "*"--require-hashes"*)
    for last; do :; done
    case $last in *.[1-9]) exit ;; esac # the other parts of the lock
    last=${{last%.0}}
    echo "pip ${{last##*/}}" >>"$FAKE_CALLS"
    if [ -n "${{FAKE_GATE-}}" ]; then read -r opened <"$FAKE_GATE"; fi
    if [ -n "${{FAKE_PIP_ERROR-}}" ]; then echo "$FAKE_PIP_ERROR"; exit 1; fi
    case $last in *maniskill.lock | *torch.lock) exit ;; esac
    for program in vitac pytest; do
      printf '#!/bin/sh\\nfor word; do printf "<%%s>" "$word"; done; pwd\\n' >"${{0%/*}}/$program"
      echo "exit 7" >>"${{0%/*}}/$program"
      chmod +x "${{0%/*}}/$program"
    done ;;
  *"pip "*"torch=="*)
    for last; do :; done
    echo "pip ${{last%%=*}}" >>"$FAKE_CALLS"
    if [ -n "${{FAKE_TORCH_ERROR-}}" ]; then echo "$FAKE_TORCH_ERROR"; exit 1; fi ;;
esac
"""

# Stand in for node and npm: they take what they are told to bundle for bundled.
FAKE_NODE = """#!/bin/sh
if [ "$1" = -p ]; then echo "${FAKE_NODE_VERSION-24}"; exit; fi
echo "esbuild" >>"$FAKE_CALLS.player"
for word; do case $word in --outfile=*) echo "player" >"${word#--outfile=}" ;; esac; done
"""
FAKE_NPM = """#!/bin/sh
echo "npm $1" >>"$FAKE_CALLS.player"
case "${NODE_ENV-} $*" in
  production*--include=dev*--include=optional*) ;;
  production*) echo "esbuild was left out"; exit 1 ;;
esac
if [ -n "${FAKE_NPM_ERROR-}" ]; then echo "$FAKE_NPM_ERROR"; exit 1; fi
"""

TOOLS = (
    *(
        "awk",
        "cat",
        "chmod",
        "cksum",
        "cp",
        "date",
        "df",
        "dirname",
        "find",
        "grep",
        "id",
        "ln",
        "mkdir",
        "mv",
        "readlink",
    ),
    *("rm", "sed", "sh", "sort", "tail", "touch", "tr", "uname", "xargs"),
)

# Stands in for apt-get and dpkg-deb: knows bubblewrap and one library, once the lists have been updated.
FAKE_APT = """#!/bin/sh
for last; do :; done
here=${0%/*}
echo "apt-get" "$@" >>"$FAKE_CALLS"
case " $* " in
  *" update "*) touch "$FAKE_CALLS.lists" ;;
  *) if [ ! -e "$FAKE_CALLS.lists" ]; then echo "E: Unable to locate package $last"; exit 100; fi ;;
esac
case " $* " in
  *" -s install "*) echo "Inst libcap2 (1 stable)"; echo "Inst $last (0.8 stable [amd64])"; echo "Conf $last" ;;
  *" install "*) printf '#!/bin/sh\\n' >"$here/bwrap"; chmod +x "$here/bwrap" ;;
  *" download libcap2 bubblewrap "* | *" download bubblewrap libcap2 "*) touch libcap2_1.deb bubblewrap_2.deb ;;
esac
"""
FAKE_DPKG = """#!/bin/sh
case $2 in
  *bubblewrap*)
    mkdir -p "$3/usr/bin"
    printf '#!/bin/sh\\necho "$LD_LIBRARY_PATH" "$@"\\n' >"$3/usr/bin/bwrap"
    chmod +x "$3/usr/bin/bwrap" ;;
  *) mkdir -p "$3/usr/lib/x86_64-linux-gnu" ;;
esac
"""


@dataclass(frozen=True, kw_only=True)
class Checkout:
    """A repository with the launcher in it, and a PATH on which only the pretended interpreter is a Python."""

    root: Path
    calls_file: Path
    environment: dict[str, str] = field(repr=False)

    def start(self, *command: str, cwd: Path | None = None, **variables: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            command or (str(self.root / "vitac"), "status"),
            cwd=cwd or self.root,
            env=self.environment | variables,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, *command: str, cwd: Path | None = None, **variables: str) -> subprocess.CompletedProcess[str]:
        process = self.start(*command, cwd=cwd, **variables)
        output, errors = process.communicate()
        return subprocess.CompletedProcess(process.args, process.returncode, output, errors)

    @property
    def calls(self) -> list[str]:
        return self.calls_file.read_text().splitlines() if self.calls_file.exists() else []

    @property
    def player_calls(self) -> list[str]:
        """What was called to build the 3D player."""
        file = self.calls_file.with_name("calls.player")
        return file.read_text().splitlines() if file.exists() else []

    @property
    def player(self) -> Path:
        return self.root / "web" / "static" / "playback.js"


def program(path: Path, text: str) -> None:
    path.write_text(text)
    path.chmod(path.stat().st_mode | stat.S_IXUSR | stat.S_IXGRP | stat.S_IXOTH)


@pytest.fixture
def checkout(repository: Path, tmp_path: Path) -> Checkout:
    root = tmp_path / "a checkout"
    shutil.copytree(repository / "setup", root / "setup")
    shutil.copytree(repository / "requirements", root / "requirements")
    shutil.copytree(repository / "viewer", root / "viewer")
    (root / "envs" / "playback_files").mkdir(parents=True)
    for name in ("vitac", "pyproject.toml", "envs/playback_files/stage.json"):
        shutil.copy(repository / name, root / name)
    binaries = tmp_path / "bin"
    binaries.mkdir()
    for tool in TOOLS:
        found = shutil.which(tool)
        assert found is not None, tool
        (binaries / tool).symlink_to(found)
    program(binaries / "python3.11", FAKE_PYTHON)
    program(binaries / "node", FAKE_NODE)
    program(binaries / "npm", FAKE_NPM)
    program(binaries / "bwrap", "#!/bin/sh\n")
    program(binaries / "runsc", "#!/bin/sh\n")
    program(binaries / "chromium", "#!/bin/sh\n")
    environment = {
        "PATH": str(binaries),
        "HOME": str(tmp_path),
        "FAKE_ANSWER": "ready",
        "FAKE_CALLS": str(tmp_path / "calls"),
    }
    return Checkout(root=root, calls_file=tmp_path / "calls", environment=environment)


def test_installs_once_then_runs_the_command(checkout: Checkout) -> None:
    first, second = checkout.run(FAKE_ANSWER=""), checkout.run()
    assert checkout.calls == ["venv", "pip base.lock"]
    assert (first.stdout, first.returncode) == (f"<status>{checkout.root}\n", 7)
    assert (second.stdout, second.returncode) == (first.stdout, first.returncode)
    assert "Python packages are ready" in first.stderr
    assert second.stderr == ""


def test_passes_words_unchanged_and_keeps_the_callers_folder(checkout: Checkout, tmp_path: Path) -> None:
    ran = checkout.run(str(checkout.root / "vitac"), "status", "two words", "", "*", cwd=tmp_path)
    assert ran.stdout == f"<status><two words><><*>{tmp_path}\n"


def test_runs_through_symlinks(checkout: Checkout, tmp_path: Path) -> None:
    (tmp_path / "far").symlink_to(checkout.root / "vitac")
    (tmp_path / "bin" / "arena").symlink_to("../far")
    assert checkout.run("arena", "status", cwd=tmp_path).stdout == f"<status>{tmp_path}\n"
    assert (checkout.root / ".venv" / "vitac-stamp").is_file()


def test_test_command_adds_the_dev_packages_and_runs_in_the_repository(checkout: Checkout, tmp_path: Path) -> None:
    checkout.run()
    ran = checkout.run(str(checkout.root / "vitac"), "test", "-k", "two words", cwd=tmp_path)
    assert checkout.calls == ["venv", "pip base.lock", "pip dev.lock"]
    assert ran.stdout == f"<-k><two words>{checkout.root}\n"


def test_each_command_adds_its_packages_and_later_commands_keep_them(checkout: Checkout) -> None:
    for command in ("status", "show", "status", "test", "show", "worker", "admin"):
        checkout.run(str(checkout.root / "vitac"), command)
    assert checkout.calls == ["venv", "pip base.lock", "pip show.lock", "pip dev.lock"]


@pytest.mark.parametrize(("verb", "locks"), [("export", ["base", "data"]), ("collect", ["base"])])
def test_data_sets_bring_what_writes_them_but_collecting_does_not(
    checkout: Checkout, verb: str, locks: list[str]
) -> None:
    checkout.run(str(checkout.root / "vitac"), "data", verb, "folder")
    assert checkout.calls == ["venv", *(f"pip {lock}.lock" for lock in locks)]


OWN_RULES = {"show", "serve", "demo", "witness"}
NEED_BASE = [
    *(f"{noun.name} word" for noun in NOUNS if noun.extra in {None, "data"} and noun.name not in OWN_RULES),
    *("sensor show --help", "show --help", "station --help", "evaluate folder --station twin --help"),
    *("sensor check folder", "sensor evaluate folder", "sandbox", "witness run address"),
    *("admin --server http://a.test appeal list", "admin appeal list --server=http://a.test"),
]
"""Collecting data sets needs no more."""


def test_commands_of_participants_bring_neither_server_nor_database(checkout: Checkout) -> None:
    for words in NEED_BASE:
        ran = checkout.run(str(checkout.root / "vitac"), *words.split())
        assert ran.stdout.startswith("".join(f"<{word}>" for word in words.split())), words
        assert checkout.calls == ["venv", "pip base.lock"], words


@pytest.mark.parametrize(
    "noun",
    [noun for noun in NOUNS if noun.extra not in {None, "data"} and noun.name not in OWN_RULES],
    ids=lambda noun: noun.name,
)
def test_commands_bring_what_their_extra_needs(checkout: Checkout, noun: Noun) -> None:
    checkout.run(str(checkout.root / "vitac"), noun.name, "word")
    wanted = {
        "server": ["pip server.lock"],
        "station": ["pip base.lock", "pip station.lock"],
        "worker": ["pip server.lock", "pip show.lock"],
    }
    assert noun.extra is not None
    assert checkout.calls == ["venv", *wanted[noun.extra]]


@pytest.mark.parametrize(
    ("words", "lock"),
    [
        ("sensor show folder", "show"),
        ("station run --help", "server"),
        ("admin appeal replay 1", "server"),
        ("admin appeal list", "server"),
        ("witness serve", "server"),
    ],
)
def test_verbs_bring_what_they_need_and_no_more(checkout: Checkout, words: str, lock: str) -> None:
    ran = checkout.run(str(checkout.root / "vitac"), *words.split())
    assert checkout.calls == ["venv", f"pip {lock}.lock"]
    assert ran.stdout.startswith("".join(f"<{word}>" for word in words.split()))


@pytest.mark.parametrize(
    ("words", "locks"),
    [
        ("evaluate folder --station twin --episodes 1", ["base"]),
        ("evaluate folder --station=twin", ["base"]),
        ("demo --station", ["server", "show"]),
        ("station check file", ["base"]),
        ("station run file --key key", ["server"]),
    ],
)
def test_what_plays_on_a_station_brings_its_software(checkout: Checkout, words: str, locks: list[str]) -> None:
    checkout.run(str(checkout.root / "vitac"), *words.split())
    assert checkout.calls == ["venv", *(f"pip {lock}.lock" for lock in [*locks, "station"])]


def test_service_and_drawing_are_added_to_each_other(checkout: Checkout) -> None:
    for command in ("show", "admin", "worker", "show", "admin", "evaluate"):
        checkout.run(str(checkout.root / "vitac"), command)
    both = ["pip server.lock", "pip show.lock"]
    assert checkout.calls == ["venv", "pip show.lock", *both]
    with (checkout.root / "pyproject.toml").open("a") as file:
        file.write("# changed\n")
    checkout.run(str(checkout.root / "vitac"), "evaluate")
    assert checkout.calls[4:] == both


def test_maniskill_is_added_once_after_saying_how_large_it_is(checkout: Checkout) -> None:
    launcher = str(checkout.root / "vitac")
    first, second = (checkout.run(launcher, "--maniskill", "status") for _ in range(2))
    assert checkout.calls == ["venv", "pip base.lock", "pip torch", "pip maniskill.lock"]
    said = ("take 3 GB", "installing torch for CPUs", "installing ManiSkill", "ManiSkill is ready")
    assert sorted(said, key=first.stderr.index) == list(said)
    assert (first.returncode, first.stdout) == (7, f"<status>{checkout.root}\n")
    assert second.stderr == ""
    checkout.run(launcher, "status")
    checkout.run(launcher, "--maniskill", "test")
    assert checkout.calls[4:] == ["pip dev.lock"]
    with (checkout.root / "requirements" / "maniskill.lock").open("a") as file:
        file.write("# changed\n")
    checkout.run(launcher, "--maniskill", "status")
    assert checkout.calls[5:] == ["pip dev.lock", "pip torch", "pip maniskill.lock"]


def test_maniskill_that_was_cut_off_is_added_again_and_too_small_a_disk_refused(
    checkout: Checkout, tmp_path: Path
) -> None:
    launcher = str(checkout.root / "vitac")
    failed = checkout.run(launcher, "--maniskill", "status", FAKE_TORCH_ERROR="Failed to resolve 'a.host'")
    assert (failed.returncode, "the package index cannot be reached" in failed.stderr) == (1, True)
    assert len(checkout.calls) == 3
    (tmp_path / "bin" / "df").unlink()
    program(tmp_path / "bin" / "df", "#!/bin/sh\necho head\necho disk 0 0 2048000 0% /\n")
    full = checkout.run(launcher, "--maniskill", "status")
    assert "the disk has 2000 MiB free" in full.stderr
    assert (full.returncode, len(checkout.calls)) == (1, 3)
    program(tmp_path / "bin" / "df", "#!/bin/sh\necho head\necho disk 0 0 9048000 0% /\n")
    assert checkout.run(launcher, "--maniskill", "status").returncode == 7


def test_torch_is_added_once_as_the_build_for_cpus(checkout: Checkout) -> None:
    launcher = str(checkout.root / "vitac")
    first, second = (checkout.run(launcher, "--torch", "check", "my folder") for _ in range(2))
    assert checkout.calls == ["venv", "pip base.lock", "pip torch", "pip torch.lock"]
    assert "torch for CPUs, Stable-Baselines3 and TensorBoard take 1 GB" in first.stderr
    assert "Stable-Baselines3 is ready" in first.stderr
    assert (first.returncode, first.stdout) == (7, f"<check><my folder>{checkout.root}\n")
    assert second.stderr == ""


@pytest.mark.parametrize(("option", "lock"), [("--torch", "torch.lock"), ("--maniskill", "maniskill.lock")])
def test_where_the_index_has_no_torch_for_cpus_nothing_is_added_and_the_remedy_named(
    checkout: Checkout, option: str, lock: str
) -> None:
    """PyPI has none for x86_64."""
    launcher = str(checkout.root / "vitac")
    error = "ERROR: No matching distribution found for torch==2.13.0+cpu"
    absent = checkout.run(launcher, option, "status", FAKE_TORCH_ERROR=error)
    assert absent.returncode == 1
    assert "is not on the package index that pip is configured for. Nothing was added." in absent.stderr
    assert "Name the index that torch's own pages give for CPUs in PIP_EXTRA_INDEX_URL" in absent.stderr
    assert checkout.calls == ["venv", "pip base.lock", "pip torch"]
    assert checkout.run(launcher, option, "status").returncode == 7
    assert checkout.calls[3:] == ["pip torch", f"pip {lock}"]


@pytest.mark.parametrize("document", ["maniskill", "submissions", "training"])
def test_documents_that_show_an_addition_name_the_index_of_torch(repository: Path, document: str) -> None:
    assert "PIP_EXTRA_INDEX_URL" in (repository / "docs" / f"{document}.md").read_text(encoding="utf-8")


def test_both_additions_stand_beside_each_other(checkout: Checkout) -> None:
    launcher = str(checkout.root / "vitac")
    for words in (("--torch", "--maniskill"), ("--maniskill",), ("--maniskill", "--torch"), ()):
        assert checkout.run(launcher, *words, "status").stdout == f"<status>{checkout.root}\n"
    torch, maniskill = ["pip torch", "pip torch.lock"], ["pip torch", "pip maniskill.lock"]
    assert checkout.calls == ["venv", "pip base.lock", *torch, *maniskill]
    (checkout.root / ".venv" / "vitac-torch").unlink()
    checkout.run(launcher, "--maniskill", "--torch", "status")
    assert checkout.calls[6:] == torch


def test_torch_that_does_not_fit_on_the_disk_is_refused_before_anything_is_added(
    checkout: Checkout, tmp_path: Path
) -> None:
    launcher = str(checkout.root / "vitac")
    checkout.run(launcher, "status")
    (tmp_path / "bin" / "df").unlink()
    program(tmp_path / "bin" / "df", "#!/bin/sh\necho head\necho disk 0 0 1024000 0% /\n")
    refused = checkout.run(launcher, "--torch", "status")
    assert refused.returncode == 1
    assert "the disk has 1000 MiB free" in refused.stderr
    assert "expected 1500" in refused.stderr
    assert checkout.calls == ["venv", "pip base.lock"]


def test_updates_in_place_when_what_is_wanted_changes(checkout: Checkout) -> None:
    checkout.run()
    for changed in ("pyproject.toml", "requirements/base.lock"):
        with (checkout.root / changed).open("a") as file:
            file.write("# changed\n")
        checkout.run()
    assert checkout.calls == ["venv", *["pip base.lock"] * 3]


def test_an_update_keeps_the_dev_packages(checkout: Checkout) -> None:
    checkout.run(str(checkout.root / "vitac"), "test")
    with (checkout.root / "pyproject.toml").open("a") as file:
        file.write("# changed\n")
    checkout.run()
    assert checkout.calls == ["venv", "pip dev.lock", "pip dev.lock"]


def test_remakes_an_environment_that_was_cut_off(checkout: Checkout) -> None:
    checkout.run(FAKE_PIP_ERROR="Killed")
    assert not (checkout.root / ".venv" / "vitac-stamp").exists()
    (checkout.root / ".venv" / "leftover").touch()
    assert checkout.run().returncode == 7
    assert checkout.calls == ["venv", "pip base.lock"] * 2
    assert not (checkout.root / ".venv" / "leftover").exists()


def test_an_addition_that_could_not_be_downloaded_leaves_what_worked(checkout: Checkout) -> None:
    checkout.run()
    stamp = checkout.root / ".venv" / "vitac-stamp"
    before = stamp.read_text()
    for error in ("Failed to resolve 'a.host'", "No space left on device", "HASH"):
        failed = checkout.run(str(checkout.root / "vitac"), "show", FAKE_PIP_ERROR=error)
        assert (failed.returncode, failed.stdout) == (1, "")
        assert stamp.read_text() == before
        after = checkout.run()
        assert (after.returncode, after.stderr) == (7, "")
    assert checkout.calls == ["venv", "pip base.lock", *["pip show.lock"] * 3]


def test_an_update_that_could_not_be_downloaded_is_tried_again_in_place(checkout: Checkout) -> None:
    checkout.run()
    with (checkout.root / "pyproject.toml").open("a") as file:
        file.write("# changed\n")
    kept = checkout.root / ".venv" / "vitac-torch"
    kept.touch()
    for _ in range(2):
        assert "cannot be reached" in checkout.run(FAKE_PIP_ERROR="Failed to resolve 'a.host'").stderr
    assert checkout.run().returncode == 7
    assert checkout.calls == ["venv", *["pip base.lock"] * 4]
    assert kept.exists()


def test_an_addition_that_failed_half_way_is_repaired_in_place(checkout: Checkout) -> None:
    checkout.run(str(checkout.root / "vitac"), "show")
    kept = checkout.root / ".venv" / "vitac-maniskill"
    kept.touch()
    stamp = checkout.root / ".venv" / "vitac-stamp"
    for _ in range(2):
        checkout.run(str(checkout.root / "vitac"), "admin", FAKE_PIP_ERROR="Installing collected packages: numpy")
        assert stamp.read_text().startswith("show unfinished ")
    for _ in range(2):
        assert checkout.run().returncode == 7
    added = ["pip server.lock"] * 2  # which fail before those that draw come
    assert checkout.calls == ["venv", "pip show.lock", *added, "pip show.lock"]
    assert kept.exists()


def test_a_set_up_that_was_killed_in_an_addition_is_repaired_in_place(checkout: Checkout, tmp_path: Path) -> None:
    checkout.run()
    gate = tmp_path / "gate"
    os.mkfifo(gate)
    killed = checkout.start(str(checkout.root / "vitac"), "show", FAKE_GATE=str(gate))
    with gate.open("w") as opened:  # returns when pip waits at the gate
        killed.kill()
        killed.wait()
        opened.write("go\n")
    killed.communicate()
    assert checkout.run().returncode == 7
    assert checkout.calls == ["venv", "pip base.lock", "pip show.lock", "pip base.lock"]


def test_remakes_an_environment_whose_interpreter_is_gone(checkout: Checkout) -> None:
    checkout.run()
    (checkout.root / ".venv" / "bin" / "python").unlink()
    checkout.run()
    assert checkout.calls == ["venv", "pip base.lock"] * 2


def test_remakes_the_environment_after_the_folder_moved(checkout: Checkout) -> None:
    checkout.run()
    moved = checkout.root.rename(checkout.root.with_name("moved"))
    assert checkout.run(str(moved / "vitac"), "status", cwd=moved).returncode == 7
    assert checkout.calls == ["venv", "pip base.lock"] * 2


def test_second_set_up_waits_for_the_first(checkout: Checkout, tmp_path: Path) -> None:
    gate = tmp_path / "gate"
    os.mkfifo(gate)
    first = checkout.start(FAKE_GATE=str(gate))
    with gate.open("w") as opened:  # returns when the first set-up's pip waits at the gate
        second = checkout.start()
        assert second.stderr is not None
        assert "waiting" in second.stderr.readline()
        opened.write("go\n")
    first.communicate()
    second.communicate()
    assert (first.returncode, second.returncode) == (7, 7)
    assert checkout.calls == ["venv", "pip base.lock"]


@pytest.mark.parametrize(
    ("pip_says", "told"),
    [
        ("WARNING: Retrying: Temporary failure in name resolution", "cannot be reached"),
        ("NewConnectionError: Failed to establish a new connection: [Errno 101]", "cannot be reached"),
        ("ERROR: [Errno 28] No space left on device", "disk is full"),
        ("ERROR: THESE PACKAGES DO NOT MATCH THE HASHES FROM THE REQUIREMENTS FILE.", "does not match its hash"),
        ("something never seen before", "something never seen before"),
    ],
)
def test_a_failed_installation_names_cause_and_remedy(checkout: Checkout, pip_says: str, told: str) -> None:
    ran = checkout.run(FAKE_PIP_ERROR=pip_says)
    assert ran.returncode == 1
    assert told in ran.stderr
    assert not (checkout.root / ".venv" / "vitac-stamp").exists()


@pytest.mark.parametrize(
    ("answer", "told"),
    [
        ("venv 3.11", "has no venv module"),
        ("version 3.9", "python3.11 is 3.9."),
        ("version 3.19", "python3.11 is 3.19."),
    ],
)
def test_an_unfit_python_is_named(checkout: Checkout, answer: str, told: str) -> None:
    ran = checkout.run(FAKE_ANSWER=answer)
    assert ran.returncode == 1
    assert told in ran.stderr
    assert "apt-get install" in ran.stderr
    assert not (checkout.root / ".venv").exists()


def test_a_named_python_is_the_only_one_tried(checkout: Checkout, tmp_path: Path) -> None:
    ran = checkout.run(VITAC_PYTHON=str(tmp_path / "absent"))
    assert ran.returncode == 1
    assert f"none among {tmp_path / 'absent'}" in ran.stderr


def test_settings_for_other_installations_do_not_reach_pip(checkout: Checkout, tmp_path: Path) -> None:
    program(tmp_path / "bin" / "python3.11", FAKE_PYTHON.replace("#!/bin/sh", '#!/bin/sh\nenv >>"$FAKE_CALLS.env"', 1))
    (tmp_path / "bin" / "env").symlink_to(shutil.which("env") or "")
    checkout.run(PIP_TARGET="/elsewhere", PIP_USER="1", PYTHONHOME="/elsewhere")
    seen = (tmp_path / "calls.env").read_text()
    assert "/elsewhere" not in seen
    assert "PIP_USER=1" not in seen


def test_exports_the_sandbox_program_it_found(checkout: Checkout, tmp_path: Path) -> None:
    checkout.run(str(checkout.root / "vitac"), "worker")
    program(checkout.root / ".venv" / "bin" / "vitac", '#!/bin/sh\necho "$VITAC_BWRAP"\n')
    assert checkout.run(str(checkout.root / "vitac"), "demo").stdout == f"{tmp_path / 'bin' / 'bwrap'}\n"
    assert checkout.run(str(checkout.root / "vitac"), "demo", VITAC_BWRAP="/own/bwrap").stdout == "/own/bwrap\n"


def test_refuses_to_run_policies_without_a_sandbox(checkout: Checkout, tmp_path: Path) -> None:
    (tmp_path / "bin" / "bwrap").unlink()
    for command in ("demo", "worker", "sandbox"):
        ran = checkout.run(str(checkout.root / "vitac"), command)
        assert ran.returncode == 1
        assert "bubblewrap is missing" in ran.stderr
        assert "apt-get install bubblewrap" in ran.stderr


def test_other_commands_run_without_a_sandbox(checkout: Checkout, tmp_path: Path) -> None:
    (tmp_path / "bin" / "bwrap").unlink()
    own = "status", "log show", "serve", "doctor", "sensor evaluate", "admin appeal replay", ""
    for words in (*own, "evaluate folder", "check folder", "log match"):
        assert checkout.run(str(checkout.root / "vitac"), *words.split()).returncode == 7, words


def test_names_the_package_managers_own_command(checkout: Checkout, tmp_path: Path) -> None:
    (tmp_path / "bin" / "bwrap").unlink()
    program(tmp_path / "bin" / "dnf", "#!/bin/sh\n")
    assert "dnf install bubblewrap" in checkout.run(str(checkout.root / "vitac"), "demo").stderr


@pytest.mark.parametrize("command", ["serve", "demo", "test"])
def test_builds_the_player_once(checkout: Checkout, command: str) -> None:
    first = checkout.run(str(checkout.root / "vitac"), command)
    second = checkout.run(str(checkout.root / "vitac"), command)
    assert checkout.player.read_text() == "player\n"
    assert checkout.player_calls == ["npm ci", "esbuild"]
    assert "the 3D player is ready" in first.stderr
    assert second.stderr == ""


def test_commands_without_pages_build_no_player(checkout: Checkout) -> None:
    for command in ("status", "worker", "evaluate folder", "show"):
        checkout.run(str(checkout.root / "vitac"), *command.split())
    assert checkout.player_calls == []


def test_builds_the_player_again_when_its_sources_change(checkout: Checkout) -> None:
    checkout.run(str(checkout.root / "vitac"), "serve")
    sources = ("viewer/stage.js", "viewer/package-lock.json", "envs/playback_files/stage.json", "setup/build_viewer.sh")
    for built, changed in enumerate(sources, start=2):
        with (checkout.root / changed).open("a") as file:
            file.write("\n")
        checkout.run(str(checkout.root / "vitac"), "serve")
        assert checkout.player_calls == ["npm ci", "esbuild"] * built, changed


def test_goes_on_without_the_player_where_its_packages_cannot_be_fetched(checkout: Checkout) -> None:
    ran = checkout.run(str(checkout.root / "vitac"), "serve", FAKE_NPM_ERROR="npm error network getaddrinfo")
    assert (ran.returncode, ran.stdout.startswith("<serve>")) == (7, True)
    assert "could not be built" in ran.stderr
    assert "pages show still pictures" in ran.stderr
    assert not checkout.player.exists()
    again = checkout.run(str(checkout.root / "vitac"), "serve")
    assert "the player could not be fetched or built less than an hour ago" in again.stderr
    assert checkout.player_calls == ["npm ci"]
    mark = checkout.root / ".system" / "failed-player"
    mark.write_text(f"{int(time.time()) - 3601} {mark.read_text().split()[1]}\n")
    checkout.run(str(checkout.root / "vitac"), "serve")
    assert checkout.player.exists()


@pytest.mark.parametrize("mark", ["", "soon {}", "{}"])
def test_a_mark_of_a_failure_that_says_nothing_is_no_reason_to_wait(checkout: Checkout, mark: str) -> None:
    checkout.run(str(checkout.root / "vitac"), "serve", FAKE_NPM_ERROR="no network")
    (checkout.root / ".system" / "failed-player").write_text(mark)
    checkout.run(str(checkout.root / "vitac"), "serve")
    assert checkout.player.exists()


def test_tests_and_changed_sources_do_not_wait_after_a_failure(checkout: Checkout) -> None:
    serve = (str(checkout.root / "vitac"), "serve")
    checkout.run(*serve, FAKE_NPM_ERROR="no network")
    with (checkout.root / "viewer" / "main.js").open("a") as file:
        file.write("\n")
    checkout.run(*serve, FAKE_NPM_ERROR="no network")
    assert checkout.player_calls == ["npm ci"] * 2
    checkout.run(str(checkout.root / "vitac"), "test")
    assert checkout.player.exists()


def test_builds_the_player_with_its_builder_also_in_production(checkout: Checkout) -> None:
    checkout.run(str(checkout.root / "vitac"), "serve", NODE_ENV="production")
    assert checkout.player.exists()


def test_serves_from_a_folder_that_cannot_be_written_to(checkout: Checkout) -> None:
    serve = (str(checkout.root / "vitac"), "serve")
    checkout.run(*serve)
    shutil.rmtree(checkout.root / ".system")
    (checkout.root / ".system").touch()  # root may write anywhere, but makes no folder in place of a file
    (checkout.root / "viewer" / "main.js").write_text("// changed")
    ran = checkout.run(*serve)
    assert (ran.returncode, ran.stdout.startswith("<serve>")) == (7, True)
    assert ran.stderr.count("no permission to write in") == 1
    assert "Continuing without the 3D player" in ran.stderr


@pytest.mark.parametrize("version", ["18", "", "none"])
def test_an_old_node_is_replaced_by_one_with_a_hash(checkout: Checkout, version: str) -> None:
    checkout.run(str(checkout.root / "vitac"), "serve", FAKE_NODE_VERSION=version)
    assert "pip node.lock" in checkout.calls


def test_a_player_that_was_built_before_stays_where_the_new_one_cannot_be_built(checkout: Checkout) -> None:
    checkout.run(str(checkout.root / "vitac"), "serve")
    with (checkout.root / "viewer" / "main.js").open("a") as file:
        file.write("\n")
    ran = checkout.run(str(checkout.root / "vitac"), "serve", FAKE_NPM_ERROR="no network")
    assert ran.returncode == 7
    assert checkout.player.read_text() == "player\n"


@pytest.fixture
def debian(checkout: Checkout, tmp_path: Path) -> Checkout:
    """The same checkout on a machine with apt-get and without bubblewrap."""
    (tmp_path / "bin" / "bwrap").unlink()
    program(tmp_path / "bin" / "apt-get", FAKE_APT)
    program(tmp_path / "bin" / "dpkg-deb", FAKE_DPKG)
    return checkout


def become(user_id: int, tmp_path: Path) -> None:
    (tmp_path / "bin" / "id").unlink()
    program(tmp_path / "bin" / "id", f"#!/bin/sh\necho {user_id}\n")


def test_root_installs_the_debian_package_with_fresh_lists(debian: Checkout, tmp_path: Path) -> None:
    become(0, tmp_path)
    assert debian.run(str(debian.root / "vitac"), "demo").returncode == 7
    asked = [call.split()[-1] for call in debian.calls if call.startswith("apt-get")]
    assert asked == ["bubblewrap", "update", "bubblewrap"]
    assert debian.run(str(debian.root / "vitac"), "demo").stderr == ""


@pytest.mark.parametrize(
    ("words", "fetches"),
    [
        ("sandbox", True),
        ("sensor evaluate folder --policy other", True),
        ("admin appeal replay 1", True),
        ("sensor show folder", False),
        ("admin appeal list", False),
    ],
)
def test_commands_that_run_policies_fetch_the_sandbox_program(
    debian: Checkout, tmp_path: Path, words: str, fetches: bool
) -> None:
    become(0, tmp_path)
    ran = debian.run(str(debian.root / "vitac"), *words.split())
    assert ran.returncode == 7
    assert ("bubblewrap is ready" in ran.stderr) is fetches
    assert (tmp_path / "bin" / "bwrap").exists() is fetches


def test_a_normal_user_gets_the_package_unpacked_with_its_libraries(debian: Checkout, tmp_path: Path) -> None:
    become(1000, tmp_path)
    debian.run(str(debian.root / "vitac"), "worker")
    program(debian.root / ".venv" / "bin" / "vitac", '#!/bin/sh\necho "$VITAC_BWRAP"\n')
    ran = debian.run(str(debian.root / "vitac"), "demo")
    wrapper = debian.root / ".system" / "bin" / "bwrap"
    assert ran.stdout == f"{wrapper}\n"
    libraries = debian.root / ".system" / "root" / "usr" / "lib" / "x86_64-linux-gnu"
    assert debian.run(str(wrapper), "--ro-bind", "a b").stdout == f"{libraries} --ro-bind a b\n"
    assert not (debian.root / ".system" / "apt").exists()


def test_a_failing_package_manager_is_quoted(debian: Checkout, tmp_path: Path) -> None:
    program(tmp_path / "bin" / "apt-get", "#!/bin/sh\necho 'E: Could not get lock'; exit 100\n")
    ran = debian.run(str(debian.root / "vitac"), "demo")
    assert ran.returncode == 1
    assert "E: Could not get lock" in ran.stderr
    assert "bubblewrap is missing" in ran.stderr
