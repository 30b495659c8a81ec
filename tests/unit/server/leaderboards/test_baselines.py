import re
from pathlib import Path

from service_factories import LOCK, TASK, TRACK
from vitac.server.leaderboards.baselines import list_baselines


def test_figures_are_the_measured_ones(repository: Path) -> None:
    measured = re.findall(
        r"^\| ([a-z-]+) \| (\w+) \| [^|]+ \| [^|]+ \| ([0-9.]+) \[([0-9.]+), ([0-9.]+)\] \| ([0-9.]+) \|",
        (repository / "benchmarks" / "baselines.md").read_text(),
        re.MULTILINE,
    )
    shown = [
        (
            task,
            one.name,
            *(f"{100 * part:.1f}" for part in (one.success_rate, *one.success_rate_interval)),
            f"{one.mean_steps:.2f}",
        )
        for task in (TASK, LOCK)
        for one in list_baselines(TRACK, task)
    ]
    assert len(shown) == 4
    assert set(shown) == set(measured)


def test_only_tasks_have_them() -> None:
    assert list_baselines(TRACK, None) == list_baselines("track_2", TASK) == []
