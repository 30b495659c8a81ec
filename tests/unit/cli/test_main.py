import subprocess
import sys
from types import SimpleNamespace

import pytest
from vitac.cli import main as cli
from vitac.envs.extras import install_command
from vitac.errors import VitacError
from vitac.evaluator.version import evaluator_version


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of the command line."""
    with pytest.raises(SystemExit) as exit_:
        cli.main(arguments)
    out, err = capsys.readouterr()
    assert isinstance(exit_.value.code, int)
    return exit_.value.code, out, err


@pytest.fixture
def noun(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """A stand-in for the module of the noun `status`."""
    module = SimpleNamespace(command=lambda: None)
    monkeypatch.setattr(cli, "import_module", {"vitac.cli.client.status": module}.__getitem__)
    return module


def test_help_lists_every_noun_in_full(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "--help")
    assert code == 0
    for noun in cli.NOUNS:
        assert noun.name in out
        assert noun.summary in out


def test_nothing_asked_for_shows_the_help_as_wrong_usage(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys)
    assert code == 2
    assert "Commands:" in out + err


def test_unknown_noun_names_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = run(capsys, "evalute")
    assert code == 2
    assert "No such command 'evalute'. Did you mean 'evaluate'?" in err


def test_version_names_package_and_evaluator(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "--version")
    assert code == 0
    assert out.startswith("vitac-arena ")
    assert out.endswith(f"evaluator {evaluator_version()}\n")


def test_refusal_is_one_line_and_exit_code_1(noun: SimpleNamespace, capsys: pytest.CaptureFixture[str]) -> None:
    def refuse() -> None:
        raise VitacError("Expected a, came b; do c.")

    noun.command = refuse
    assert run(capsys, "status") == (1, "", "vitac: Expected a, came b; do c.\n")


def test_wrong_option_is_exit_code_2(noun: SimpleNamespace, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = run(capsys, "status", "--bogus")
    assert code == 2
    assert "No such option: --bogus" in err


def test_interrupt_is_exit_code_130(noun: SimpleNamespace, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    noun.command = interrupt
    assert run(capsys, "status")[0] == 130


def test_fault_of_ours_is_not_hidden(noun: SimpleNamespace) -> None:
    def fail() -> None:
        raise ZeroDivisionError

    noun.command = fail
    with pytest.raises(ZeroDivisionError):
        cli.main(["status"])


def test_help_imports_no_noun_and_nothing_heavy() -> None:
    code = (
        "import sys\nfrom vitac.cli.main import main\n"
        "try: main(['--help'])\nexcept SystemExit: pass\n"
        "heavy = {'gymnasium', 'numpy', 'numba', 'pydantic', 'yaml', 'sqlalchemy', 'fastapi', 'rich', 'httpx'}\n"
        "heavy.add('importlib.metadata')\n"
        "print(sorted(heavy & set(sys.modules)), [m for m in sys.modules if m.startswith('vitac.cli.')])"
    )
    result = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert result.stdout.splitlines()[-1] == "[] ['vitac.cli.main']"


@pytest.mark.parametrize(
    ("noun_name", "module", "extra", "package"),
    [
        ("serve", "service.serve", "server", "fastapi"),
        ("worker", "service.worker", "worker", "sqlalchemy"),
        ("admin", "admin.app", "server", "alembic"),
        ("demo", "demo.command", "server", "uvicorn"),
    ],
)
def test_missing_packages_of_a_command_are_named_with_how_to_install_them(
    noun_name: str,
    module: str,
    extra: str,
    package: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def missing(name: str) -> None:
        assert name == f"vitac.cli.{module}"
        raise ModuleNotFoundError("No module", name="obstore")

    monkeypatch.setattr(cli, "import_module", missing)
    code, out, err = run(capsys, noun_name)
    assert (code, out) == (1, "")
    assert err.startswith(f"vitac: obstore is not installed. This command needs the extra '{extra}'; install it with: ")
    assert install_command(extra) in err
    assert package in err


@pytest.mark.parametrize(("noun_name", "name"), [("status", "httpx"), ("serve", "vitac.server.missing")])
def test_missing_module_of_our_own_is_a_fault(noun_name: str, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(_: str) -> None:
        raise ModuleNotFoundError("No module", name=name)

    monkeypatch.setattr(cli, "import_module", missing)
    with pytest.raises(ModuleNotFoundError):
        cli.main([noun_name])


def test_commands_begin_without_numpy() -> None:
    """Numpy and gymnasium take a quarter of a second; what a command needs of them is imported when it runs."""
    names = ("check", "evaluate", "train", "data", "log", "doctor")
    imports = "; ".join(f"import vitac.cli.{name}" for name in names)
    code = f"import sys; {imports}; print([name for name in ('numpy', 'gymnasium') if name in sys.modules])"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ended.stdout == "[]\n"
