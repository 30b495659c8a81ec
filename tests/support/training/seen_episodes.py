"""Episodes as they were seen, without any physics, and data sets of them for tests."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome, Manifest
from vitac.training.demonstrations.collecting import Demonstration, DemonstrationKind, Source
from vitac.training.demonstrations.frames import Frames, Origin, StoredEpisode, write_origin
from vitac.training.demonstrations.lerobot.layout import Feature, Version, list_features
from vitac.training.demonstrations.lerobot.writing import write_lerobot

FPS = 4.0
CAMERA = "observation.images.view"
SOURCE = Source(
    manifest=Manifest(
        track="track_1",
        task="lock-opening",
        list_seed=0,
        task_hash="t",
        evaluator_version="1+test",
        evaluator_hash="e",
        solver_version="3",
        mesh_hash="m",
        platform_class="test",
    ),
    stream=1_000_000,
)


def features() -> tuple[Feature, ...]:
    """Return columns of one number, of a row, of a matrix, and a small video."""
    return (
        Feature(name=CAMERA, dtype="video", shape=(32, 48, 3), names=("height", "width", "channels"), keys=("view",)),
        Feature(name="observation.state", dtype="float32", shape=(3,), keys=("motion",)),
        Feature(name="observation.flow", dtype="float32", shape=(2, 4), keys=("flow",)),
        Feature(name="privileged.shape", dtype="float32", shape=(1,), keys=("shape",)),
        *list_features(SOURCE.task, ()),
    )


def seen(episode: int, length: int) -> Frames:
    """Return an episode of random numbers."""
    random = np.random.default_rng(episode)
    actions = random.uniform(-1, 1, (length, 2)).astype(np.float32)
    solved = episode % 3 > 0
    return Frames(
        demonstration=Demonstration(
            episode=episode,
            kind=DemonstrationKind.CLEAN if solved else DemonstrationKind.MISLED,
            shape="key1",
            outcome=EpisodeOutcome.SUCCESS if solved else EpisodeOutcome.TACTILE,
            total_reward=float(random.normal()),
            actions=ActionSequence.from_array(actions),
            state_hashes=tuple(f"{number:064x}" for number in range(length + 1)),
        ),
        observations={
            "view": np.full((length + 1, 32, 48, 3), 20 * episode % 200, dtype=np.uint8),
            "motion": random.normal(size=(length + 1, 3)).astype(np.float32),
            "flow": random.normal(size=(length + 1, 2, 4)).astype(np.float32),
            "shape": np.full((length + 1, 1), episode, dtype=np.float32),
            "marker_flow": random.normal(scale=50.0, size=(length + 1, 2, 2, 128, 2)).astype(np.float32),
            "relative_motion": random.normal(size=(length + 1, 3)).astype(np.float32),
        },
        actions=actions,
        rewards=random.normal(size=length).astype(np.float32),
        last_info={},
    )


def write_data_set(
    folder: Path, version: Version, lengths: Sequence[int] = (3, 5, 2), *, with_touch: bool = False
) -> list[Frames]:
    """Write a data set of episodes of these lengths, and return them.

    Args:
        folder: of the data set.
        version: of the format.
        lengths: env steps of each episode.
        with_touch: columns are those of markers and relative motion alone, as `vitac data export` makes them.
    """
    episodes = [seen(number, length) for number, length in enumerate(lengths, start=1)]
    observables = [each for each in SOURCE.task.observables if each.name in ("marker_flow", "relative_motion")]
    columns = list_features(SOURCE.task, observables) if with_touch else features()
    write_lerobot(folder, version, SOURCE, columns, episodes, fps=FPS)
    stored = tuple(StoredEpisode.of(each.demonstration) for each in episodes)
    write_origin(folder, Origin(source=SOURCE, episodes=stored))
    return episodes
