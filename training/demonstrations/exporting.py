"""Makes a data set of demonstrations. Each is played again for it, so none is in a data set that does not replay."""

import shutil
from collections.abc import Callable, Collection, Iterator
from enum import StrEnum
from functools import partial
from pathlib import Path

from vitac.envs.errors import VitacError

from ..files import write_text
from ..pool import map_in_order
from .card import make_card
from .demonstration import Demonstration, read_demonstrations, read_source
from .frames import Frames, choose_observables, make_observed_environment, play_again
from .lerobot.layout import Version, list_features
from .lerobot.writing import write_lerobot
from .minari import write_minari
from .origin import Origin, StoredEpisode, write_origin


class FolderExists(VitacError):
    """A data set is written into a new folder only; name another one, or delete it."""


class Format(StrEnum):
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
    form: Format,
    *,
    keys: Collection[str] | None = None,
    only_successes: bool = False,
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

    if form is Format.MINARI:
        write_minari(part, source, env, played())
    else:
        version = Version.V2_1 if form is Format.LEROBOT_2_1 else Version.V3_0
        features = list_features(source.task, observables)
        write_lerobot(part, version, source, features, played(), fps=float(env.metadata["render_fps"]))
    origin = Origin(source=source, episodes=tuple(stored))
    write_origin(part, origin)
    write_text(part / "README.md", make_card(origin, observables))
    part.rename(folder)
