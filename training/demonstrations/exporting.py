"""Makes data sets of demonstrations, with their card; Minari's format stands here, LeRobot's in its folder.

Each demonstration is played again for it, so none is in a data set that does not replay.
"""

import shutil
from collections.abc import Callable, Collection, Iterator, Sequence
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Any

from vitac.envs.observable import Observable
from vitac.errors import VitacError
from vitac.evaluator.scoring.score import rate

from ..files import write_text
from ..pool import map_in_order
from ..streams import FIRST_STREAM, STREAMS_PER_SEED
from .collecting import BY_HAND, FILE, Demonstration, DemonstrationKind, Source, read_demonstrations, read_source
from .frames import (
    Frames,
    Origin,
    StoredEpisode,
    choose_observables,
    make_observed_environment,
    play_again,
    read_origin,
    write_origin,
)
from .lerobot.layout import Version, list_features
from .lerobot.writing import write_lerobot

LICENCE = "Apache-2.0"

_CARD = """---
license: apache-2.0
task_categories: [robotics]
tags: [LeRobot, tactile, vitac-arena]
configs:
- config_name: default
  data_files: data/*/*.parquet
---
# Demonstrations of {title}
{description}

{player}

| kind | episodes | successes | in % with 95 % interval |
|---|---|---|---|
{kinds}
{left_out}
- **Starts**: episode n starts with `reset(options={{"rng_seed": ({stream}, n)}})`, in no official list.
- **Made with**: `{env_id}` as in the task `{task}` of `{track}`, evaluator {evaluator}, solver {solver}, mesh hash
  {mesh}, on {platform}.
- **Made by**: `{command}`, then `vitac data export`.
- **Replay**: `vitac data check FOLDER --replay {episodes}` plays them again and compares every state hash.
- **Licence**: {licence}. No person's data and no recording of others is in it.

| observed | shape | unit | meaning |
|---|---|---|---|
{observed}
"""


_EXPERT = """An expert that knows the truth plays in the deterministic simulation of ViTac Arena. It sees what no
policy sees (`privileged.*`), so its actions are more than a policy can know."""
_POLICY = """A policy plays in the deterministic simulation of ViTac Arena, by what every policy sees
(submission {digest})."""
_PERSON = """A person plays in the deterministic simulation of ViTac Arena: `human` by the marker flow alone, as a
policy does, `human-with-scene` with a look at the scene, which no policy sees."""


def make_card(origin: Origin, observables: Sequence[Observable[Any]]) -> str:
    """Return the card, as Markdown with the header that Hugging Face reads."""
    source, episodes = origin.source, origin.episodes
    task, made = source.task, source.manifest
    is_played = any(each.kind in BY_HAND for each in episodes)
    successes = sum(each.outcome == "success" for each in episodes)
    seed = (source.stream - FIRST_STREAM) // STREAMS_PER_SEED
    by_policy = "" if source.policy is None else " --policy SUBMISSION"
    collected = f"vitac data collect {made.task}{by_policy} --successes {successes} --seed {seed} --out DIR"
    player = _EXPERT if source.policy is None else _POLICY.format(digest=source.policy)
    kinds = [_kind_row(kind, [each for each in episodes if each.kind is kind]) for kind in DemonstrationKind]
    return _CARD.format(
        title=task.title[0].lower() + task.title[1:],
        description=task.description.strip(),
        kinds="\n".join(row for row in kinds if row),
        left_out="" if any(each.outcome != "success" for each in episodes) else "\nFailures are left out.\n",
        stream=source.stream,
        env_id=task.env_id,
        task=made.task,
        track=made.track,
        evaluator=made.evaluator_version,
        solver=made.solver_version,
        mesh=made.mesh_hash,
        platform=made.platform_class,
        player=_PERSON if is_played else player,
        command=f"vitac play {made.task} --seed {seed} --out DIR" if is_played else collected,
        episodes=len(episodes),
        licence=LICENCE,
        observed="\n".join(
            f"| `{entry.name}`{' (privileged)' if entry.privileged else ''} | {entry.shape} | {entry.unit} | "
            f"{entry.meaning} |"
            for entry in observables
        ),
    )


def make_card_of(folder: Path) -> str:
    """Return the card of a folder with demonstrations, or that in a data set.

    Raises:
        CollectionRejected: its demonstrations are not what was written.
        NotOurs: it is neither.
    """
    if not (folder / FILE).exists():
        read_origin(folder)
        return (folder / "README.md").read_text()
    source = read_source(folder / FILE)
    stored = tuple(StoredEpisode.of(each) for each in read_demonstrations(folder / FILE))
    return make_card(Origin(source=source, episodes=stored), choose_observables(source.task, None))


def _kind_row(kind: DemonstrationKind, episodes: Sequence[StoredEpisode]) -> str | None:
    if not episodes:
        return None
    counted = rate(sum(each.outcome == "success" for each in episodes), len(episodes))
    percent = [f"{100 * part:.1f}" for part in (counted.success_rate, counted.interval.low, counted.interval.high)]
    return f"| {kind.value} | {counted.episodes} | {counted.successes} | {percent[0]} [{percent[1]}, {percent[2]}] |"


def write_minari(folder: Path, source: Source, env: Any, frames: Iterator[Frames]) -> None:
    """Write a data set, which `minari.MinariDataset(folder / "data")` reads.

    Coloured pictures are stored as JPEG; all other values exactly. Infos hold the state hashes.
    """
    import minari
    from minari.dataset.minari_storage import MinariStorage

    task = source.manifest.task
    storage = MinariStorage.new(
        (folder / "data").absolute(),
        observation_space=env.observation_space,
        action_space=env.action_space,
        env_spec=env.spec,
    )
    storage.update_metadata(
        {
            "dataset_id": f"vitac/{task}/{'policy' if source.policy else 'expert'}-v0",
            "minari_version": minari.__version__,
            "algorithm_name": f"submission {source.policy}" if source.policy else "expert with privileged state",
            "author": {"ViTac Arena"},
            "description": f"Demonstrations of {task}, licence {LICENCE}; README.md is their card.",
        }
    )
    storage.update_episodes(_buffer(source, number, each) for number, each in enumerate(frames))


def _buffer(source: Source, number: int, frames: Frames) -> Any:
    from minari.data_collector import EpisodeBuffer

    demonstration, length = frames.demonstration, len(frames.actions)
    is_success = demonstration.is_success
    return EpisodeBuffer(
        id=number,
        options={"rng_seed": [source.stream, demonstration.episode]},
        observations=frames.observations,
        actions=frames.actions,
        rewards=frames.rewards.tolist(),
        terminations=[is_success and step == length - 1 for step in range(length)],
        truncations=[not is_success and step == length - 1 for step in range(length)],
        infos={"state_hash": list(demonstration.state_hashes)},
    )


class FolderExists(VitacError):
    """A data set is written into a new folder only; name another one, or delete it."""


class DatasetFormat(StrEnum):
    """A format of data sets."""

    LEROBOT_3_0 = "lerobot-v3.0"
    """LeRobotDataset with many episodes in a file."""
    LEROBOT_2_1 = "lerobot-v2.1"
    """LeRobotDataset with one file for every episode."""
    MINARI = "minari"
    """HDF5, as Minari reads it."""


def export(
    collection: Path,
    folder: Path,
    form: DatasetFormat,
    *,
    keys: Collection[str] | None = None,
    only_successes: bool = False,
    only_vectors: bool = False,
    processes: int = 1,
    report: Callable[[int], None],
) -> None:
    """Write a data set of a file of demonstrations.

    Args:
        collection: the file.
        folder: new folder of the data set; it is there when all is written.
        form: of the data set.
        keys: what is seen; by default coloured pictures and all that have few numbers.
        only_successes: whether failures are left out.
        only_vectors: of what is seen, vectors and pictures alone; for LeRobot.
        processes: that play.
        report: called with the number of episodes so far.

    Raises:
        FolderExists: the folder is there already.
        CollectionRejected: the file is not what was written.
        DemonstrationDiffers: one does not replay.
        NotSaved: a file cannot be written.
        VideoNotWritten: OpenCV cannot write a video.
    """
    if folder.exists():
        raise FolderExists(f"{folder} is there already; expected a new folder. Name another one, or delete it.")
    source = read_source(collection)
    observables = choose_observables(source.task, keys)
    env = make_observed_environment(source.task, observables)
    part = folder.with_name(f".{folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    stored: list[StoredEpisode] = []

    def played() -> Iterator[Frames]:
        chosen = (each for each in read_demonstrations(collection) if each.is_success or not only_successes)
        work: Callable[[Demonstration], Frames] = partial(play_again, env, source)
        for frames in map_in_order(work, chosen, processes):
            stored.append(StoredEpisode.of(frames.demonstration))
            yield frames
            report(len(stored))

    if form is DatasetFormat.MINARI:
        write_minari(part, source, env, played())
    else:
        version = Version.V2_1 if form is DatasetFormat.LEROBOT_2_1 else Version.V3_0
        features = list_features(source.task, observables, only_vectors=only_vectors)
        write_lerobot(part, version, source, features, played(), fps=float(env.metadata["render_fps"]))
    origin = Origin(source=source, episodes=tuple(stored))
    write_origin(part, origin)
    write_text(part / "README.md", make_card(origin, observables))
    part.rename(folder)
