"""What schedulers see of workers: durations on the command line, exit codes, and ever longer pauses of the scaler."""

import time
from collections.abc import Iterator

import pytest
import typer
from vitac.cli.main import main
from vitac.cli.service.worker import _scale_until_stopped, parse_duration_s
from vitac.server.database.availability import DatabaseUnreachable
from vitac.worker import main as worker
from vitac.worker.main import Stay, WorkerRefused
from vitac.worker.slurm import Scaling, SlurmError


@pytest.mark.parametrize(("text", "seconds"), [("60", 60), ("1.5m", 90), ("4h", 14400), ("1d", 86400), (" 9s ", 9)])
def test_durations(text: str, seconds: float) -> None:
    assert parse_duration_s(text) == seconds


@pytest.mark.parametrize("text", ["", "h", "-4h", "4 hours", "1e9", "nan"])
def test_what_is_no_duration_is_refused_with_examples(text: str) -> None:
    with pytest.raises(typer.BadParameter, match="such as 60, 90s, 15m, 4h or 1d"):
        parse_duration_s(text)


@pytest.mark.parametrize(
    ("error", "code"), [(None, 0), (WorkerRefused("unfit"), 69), (DatabaseUnreachable("away"), 75)]
)
def test_exit_code_says_whether_to_try_again(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], error: Exception | None, code: int
) -> None:
    stays = []

    def run(_: object, stay: Stay) -> None:
        stays.append(stay)
        if error is not None:
            raise error

    monkeypatch.setattr(worker, "run", run)
    with pytest.raises(SystemExit) as ended:
        main(["worker", "--drain-when-idle", "2m", "--max-lifetime", "4h"])
    assert ended.value.code == code
    assert stays == [Stay(idle_s=120.0, lifetime_s=14400.0)]
    assert (str(error) in capsys.readouterr().err) == (error is not None)


def test_jobs_that_end_at_once_are_submitted_at_ever_longer_intervals(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    empty, works = Scaling(work=9, running=0, pending=0, submitted=2), Scaling(work=9, running=2, pending=0)
    looks: Iterator[Scaling | Exception] = iter([empty, empty, empty, SlurmError("`squeue` failed"), works, works])
    pauses: list[float] = []

    class FakeScaler:
        def scale(self) -> Scaling:
            found = next(looks)
            if isinstance(found, Exception):
                raise found
            return found

    monkeypatch.setattr(time, "sleep", pauses.append)
    with pytest.raises(StopIteration):
        _scale_until_stopped(FakeScaler(), 15.0)  # type: ignore[arg-type]
    assert pauses == [15.0, 30.0, 60.0, 60.0, 15.0, 15.0]
    said = capsys.readouterr().err
    assert "read their output" in said
    assert "`squeue` failed The next check is in 60 s" in said
