"""The track of a service whose episodes are trials on stations."""

from typing import Any, Final

from vitac.evaluator.strict_model import validate
from vitac.evaluator.tracks import Track, load_track

from .description import StationTask

_NAMES: Final = {StationTask.PEG: ("track_1", "station"), StationTask.FUSION: ("track_2", "station_fusion")}
"""Of the simulated track, and of that of stations."""


def make_station_track(
    shape: str, repeats: int, *, starts: int | None = None, task: StationTask = StationTask.PEG
) -> dict[str, Any]:
    """Return the content of a track file: public starts of a shape, each so often, one trial in a shard.

    Args:
        shape: of the peg that is mounted.
        repeats: of each start.
        starts: how many of them, the first ones; all if None.
        task: that is played.
    """
    source, name = _NAMES[task]
    simulated = load_track(source)
    played = simulated.tasks[task]
    found = dict.fromkeys((start.shape, start.offset) for start in played.episode_list.starts if start.shape == shape)
    chosen = list(found)[:starts]
    own: dict[str, Any] = played.model_dump(mode="json", exclude_defaults=True, exclude={"name_2025", "profiles"})
    own |= {"name": f"{task}-station", "title": f"{played.title} on a station", "station_of": str(task)}
    own["shard_size"] = 1
    own["episode_list"] = {
        "list_seed": played.episode_list.list_seed,
        "offset_option": played.episode_list.offset_option,
        "blocks": [
            {"repeats": repeats, "starts": [{"shape": shape, "offset": list(offset)} for shape, offset in chosen]}
        ],
    }
    content = {
        "name": name,
        "folder": simulated.folder,
        "title": f"Station: {played.title}",
        "summary": f"{played.title} on a laboratory's devices, with the {shape}.",
        "accepts": ["model"],
        "tasks": {own["name"]: own},
    }
    validate(Track, content, f"{name}.yaml")
    return content
