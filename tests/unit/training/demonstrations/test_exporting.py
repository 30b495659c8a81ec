"""Data sets of real demonstrations: replayed while they are written, and read back."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from vitac.cli.main import main
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.training.demonstrations.collecting import FILE, collect, make_line, read_demonstrations, read_source
from vitac.training.demonstrations.exporting import DatasetFormat, FolderExists, export
from vitac.training.demonstrations.frames import (
    DemonstrationDiffers,
    choose_observables,
    make_observed_environment,
)
from vitac.training.demonstrations.lerobot.layout import INFO, MOTION_NAMES
from vitac.training.demonstrations.replaying import read_folder, replay

pytest.importorskip("pyarrow", reason="needs the extra `data`")

TASK = "lock-opening"
KEYS = ("relative_motion", "marker_flow")


def nothing(_: int) -> None:
    pass


@pytest.fixture(scope="module")
def collection(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return collect(TASK, tmp_path_factory.mktemp("collection"), successes=4)


def run(*arguments: object) -> int | str | None:
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    return ended.value.code


def test_processes_write_the_same_data_set_and_it_gives_the_collection_back(collection: Path, tmp_path: Path) -> None:
    for processes in (1, 2):
        folder = tmp_path / str(processes)
        export(collection, folder, DatasetFormat.LEROBOT_3_0, keys=KEYS, processes=processes, report=nothing)
    data = "data/chunk-000/file-000.parquet"
    assert (tmp_path / "1" / data).read_bytes() == (tmp_path / "2" / data).read_bytes()
    assert run("data", "import", tmp_path / "1", "--to", tmp_path / "back") == 0
    assert (tmp_path / "back" / TASK / FILE).read_bytes() == collection.read_bytes()
    with pytest.raises(FolderExists):
        export(collection, tmp_path / "1", DatasetFormat.LEROBOT_3_0, report=nothing)


def test_minari_reads_what_was_seen_and_makes_the_environment(collection: Path, tmp_path: Path) -> None:
    minari = pytest.importorskip("minari", reason="needs the extra `data`")
    export(collection, tmp_path / "set", DatasetFormat.MINARI, keys=KEYS, report=nothing)
    found = minari.MinariDataset(tmp_path / "set" / "data")
    first = next(read_demonstrations(collection))
    episode = found[0]
    np.testing.assert_array_equal(episode.actions, first.actions.to_array())
    assert [each.decode() for each in episode.infos["state_hash"]] == list(first.state_hashes)
    env = found.recover_environment()
    observation, _ = env.reset(options=dict(first.options(read_source(collection))))
    for key in KEYS:
        np.testing.assert_array_equal(observation[key], episode.observations[key][0])


def test_only_successes_leave_the_episodes_of_failures_out(collection: Path, tmp_path: Path) -> None:
    lines = collection.read_bytes().splitlines(keepends=True)
    failure = next(each for each in read_demonstrations(collection)).model_copy(
        update={"outcome": EpisodeOutcome.STEPS}
    )
    mixed = tmp_path / FILE
    mixed.write_bytes(lines[0] + make_line(failure) + b"".join(lines[2:]))
    export(mixed, tmp_path / "set", DatasetFormat.LEROBOT_2_1, keys=KEYS, only_successes=True, report=nothing)
    _, kept = read_folder(tmp_path / "set")
    assert [each.episode for each in kept] == [each.episode for each in read_demonstrations(mixed) if each.is_success]
    assert "Failures are left out" in (tmp_path / "set" / "README.md").read_text()


def test_another_action_is_found_by_its_state(collection: Path, tmp_path: Path) -> None:
    source, demonstrations = read_folder(collection.parent)
    assert len(replay(source, demonstrations, count=2, report=nothing)) == 2
    first, second = demonstrations[:2]
    changed = first.model_copy(update={"state_hashes": (*first.state_hashes[:-1], second.state_hashes[-1])})
    last = first.actions.shape[0]
    with pytest.raises(DemonstrationDiffers, match=f"Episode 1 of {TASK} has another state after env step {last}"):
        replay(source, [changed], count=1, report=nothing)


@pytest.mark.slow
@pytest.mark.parametrize("task", ["explore", "slip"])
def test_demonstrations_of_tasks_of_arena_2_replay_by_hash_after_a_round_trip(task: str, tmp_path: Path) -> None:
    """Two of the expert's own, and two with noise."""
    collection = collect(task, tmp_path / "collection", successes=4, processes=1)
    export(collection, tmp_path / "set", DatasetFormat.LEROBOT_3_0, processes=1, report=nothing)
    assert run("data", "check", tmp_path / "set", "--replay", 2) == 0
    assert run("data", "import", tmp_path / "set", "--to", tmp_path / "back") == 0
    written = (tmp_path / "back" / task / FILE).read_bytes()
    assert written == collection.read_bytes()


@pytest.mark.slow
def test_random_demonstrations_replay_by_hash_after_a_round_trip(tmp_path: Path) -> None:
    played = 0
    for task, successes in ((TASK, 6), ("peg-insertion", 6), ("fusion-insertion", 2)):
        collection = collect(task, tmp_path / "collection", successes=successes, processes=2)
        keys = ["rgb_picture"] if task == "fusion-insertion" else list(KEYS)
        export(collection, tmp_path / task, DatasetFormat.LEROBOT_3_0, keys=keys, processes=2, report=nothing)
        assert run("data", "check", tmp_path / task, "--replay", 1) == 0
        source, demonstrations = read_folder(tmp_path / task)
        played += len(replay(source, demonstrations, count=25, seed=1, processes=2, report=nothing))
    assert played > 12


def test_card_says_where_it_comes_from(collection: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("data", "card", collection.parent) == 0
    card = capsys.readouterr().out
    assert card.startswith("---\nlicense: apache-2.0\n")
    assert f"`vitac data collect {TASK} --successes 4 --seed 0 --out DIR`" in card
    assert read_source(collection).manifest.mesh_hash in card
    assert "| clean | 2 | 2 | 100.0 [34.2, 100.0] |" in card


def test_touch_is_a_vector_and_both_gels_are_pictures_where_they_are_asked_for(
    collection: Path, tmp_path: Path
) -> None:
    import cv2
    from pyarrow import parquet
    from vitac.training.cloning.policy import fit_motion

    export(
        collection,
        tmp_path / "set",
        DatasetFormat.LEROBOT_3_0,
        keys=(*KEYS, "rgb_images"),
        only_successes=True,
        report=nothing,
    )
    table = parquet.read_table(tmp_path / "set" / "data/chunk-000/file-000.parquet")
    flows = np.array(table["observation.marker_flow"].to_pylist())
    vectors = np.array(table["observation.environment_state"].to_pylist(), dtype=np.float32)
    expected = [np.concatenate([fit_motion(*gel) for gel in flow]) for flow in flows]
    np.testing.assert_allclose(vectors, expected, atol=1e-4)
    info = json.loads((tmp_path / "set" / INFO).read_text())["features"]
    assert info["observation.environment_state"]["shape"] == [12] == [len(MOTION_NAMES)]
    source = read_source(collection)
    first = next(each for each in read_demonstrations(collection) if each.is_success)
    env = make_observed_environment(source.task, choose_observables(source.task, ["rgb_images"]))
    seen, _ = env.reset(options=dict(first.options(source)))
    for gel, side in enumerate(("left", "right")):
        video = cv2.VideoCapture(str(tmp_path / "set" / f"videos/observation.images.{side}/chunk-000/file-000.mp4"))
        _, shown = video.read()
        assert np.abs(shown.astype(int) - seen["rgb_images"][gel]).mean() < 12  # both in blue, green, red
        video.release()


def test_vectors_alone_are_what_policies_of_lerobot_read_and_still_replay(collection: Path, tmp_path: Path) -> None:
    arguments = (
        "data",
        "export",
        collection.parent,
        "--only-vectors",
        "--key",
        "marker_flow",
        "--key",
        "relative_motion",
    )
    assert run(*arguments, "--to", tmp_path / "set") == 0
    features = json.loads((tmp_path / "set" / INFO).read_text())["features"]
    seen = {name: each["shape"] for name, each in features.items() if name.startswith("observation.")}
    assert seen == {"observation.state": [3], "observation.environment_state": [12]}
    assert run("data", "check", tmp_path / "set", "--replay", 1) == 0
    assert run(*arguments, "--to", tmp_path / "other", "--format", "minari") == 2


@pytest.mark.parametrize("form", list(DatasetFormat))
def test_paths_may_be_relative_and_have_spaces_and_accents(
    collection: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: DatasetFormat
) -> None:
    if form is DatasetFormat.MINARI:
        pytest.importorskip("minari", reason="needs the extra `data`")
    monkeypatch.chdir(tmp_path)
    shutil.copytree(collection.parent, "à voir/eine Übung")
    options = ["--format", form.value, *(part for key in KEYS for part in ("--key", key))]
    assert run("data", "export", "à voir/eine Übung", "--to", "été 1/set", *options) == 0
    if form is not DatasetFormat.MINARI:
        assert run("data", "check", "été 1/set", "--replay", 1) == 0
