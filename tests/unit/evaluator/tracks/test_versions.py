import sys
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from vitac.envs.tasks import registry
from vitac.evaluator.tracks import load_track
from vitac.evaluator.tracks import registry as tracks_registry
from vitac.evaluator.tracks.registry import (
    compute_hash,
    current_versions,
    differing_parts,
    find_evaluator,
    find_version,
    list_parts,
)
from vitac.evaluator.version import evaluator_hash, evaluator_parts, evaluator_version

EXAMPLE = Path(__file__).parents[4] / "examples" / "press_a_switch"


@pytest.fixture(autouse=True)
def _fresh() -> Iterator[None]:
    registry.task_definitions.cache_clear()
    yield
    registry.task_definitions.cache_clear()


@pytest.fixture
def own_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the example's package, installed with its entry point."""
    copied = tmp_path / "copied_switch"
    copied.mkdir()
    for source in (EXAMPLE / "press_switch").glob("*.py"):
        (copied / source.name).write_text(source.read_text().replace("press_switch", copied.name))
    point = EntryPoint(name="press", value="copied_switch.definition:TASK", group=registry.ENTRY_POINT_GROUP)
    for name in [name for name in sys.modules if name.partition(".")[0] == copied.name]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(registry, "entry_points", lambda *, group: [point] if group == point.group else [])
    return copied


@pytest.fixture
def own_tracks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "tracks"
    folder.mkdir()
    (folder / "switch.yaml").write_text((EXAMPLE / "tracks" / "switch.yaml").read_text())
    monkeypatch.setenv("VITAC_TRACKS_DIR", str(folder))
    return folder


def test_our_own_tracks_have_the_evaluators_version() -> None:
    assert find_version("track_1") == evaluator_version()
    assert compute_hash("track_1") == evaluator_hash()
    assert list_parts("track_1") == evaluator_parts()
    assert find_version("gone") == evaluator_version()
    assert current_versions() == {evaluator_version()}


def test_a_package_and_a_track_file_beside_them_change_only_their_own_track(
    own_package: Path, own_tracks: Path
) -> None:
    assert find_version("track_1") == evaluator_version()
    assert compute_hash("track_1") == evaluator_hash()
    found = find_version("switch")
    assert found != evaluator_version()
    assert len(found) == len(evaluator_version())  # the queue's name has no room for more
    assert find_evaluator(found) == evaluator_version()
    assert find_evaluator("1+000000000000") == "1+000000000000"
    assert current_versions() == {evaluator_version(), found}
    assert list_parts("switch").keys() - evaluator_parts().keys() == {"switch.yaml", own_package.name}


@pytest.mark.parametrize("changed", ["package", "track file"])
def test_a_track_changes_with_its_file_and_with_the_package_of_its_task(
    own_package: Path, own_tracks: Path, changed: str
) -> None:
    before, parts = find_version("switch"), list_parts("switch")
    file = own_package / "__init__.py" if changed == "package" else own_tracks / "switch.yaml"
    file.write_text(file.read_text() + "\n# another\n")
    tracks_registry._parts_of_file.cache_clear()
    assert load_track("switch").name == "switch"
    assert find_version("switch") != before
    expected = own_package.name if changed == "package" else "switch.yaml"
    assert differing_parts(parts, list_parts("switch")) == (expected,)
    assert find_version("track_1") == evaluator_version()
