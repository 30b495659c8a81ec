"""The track that a service needs so that its queue has trials for stations."""

from typing import Any

from vitac.envs.geometry.pegs import PegShape
from vitac.evaluator.strict_model import validate
from vitac.evaluator.tracks import Track, load_track

TASK = "peg-insertion"


def make_station_track(shape: PegShape, repeats: int, *, starts: int | None = None) -> dict[str, Any]:
    """Return the content of a track file: public starts of a shape, each so often, one trial in a shard.

    Args:
        shape: that is mounted.
        repeats: of each start.
        starts: how many of them, the first ones; all if None.
    """
    simulated = load_track("track_1")
    task = simulated.tasks[TASK]
    found = dict.fromkeys((start.shape, start.offset) for start in task.episode_list.starts if start.shape == shape)
    chosen = list(found)[:starts]
    own: dict[str, Any] = task.model_dump(mode="json", exclude_defaults=True, exclude={"name_2025", "profiles"})
    own |= {"name": f"{TASK}-station", "title": "Peg insertion on a station", "station_of": TASK, "shard_size": 1}
    own["episode_list"] = {
        "list_seed": task.episode_list.list_seed,
        "offset_option": task.episode_list.offset_option,
        "blocks": [
            {"repeats": repeats, "starts": [{"shape": shape, "offset": list(offset)} for shape, offset in chosen]}
        ],
    }
    content = {
        "name": "station",
        "folder": simulated.folder,
        "title": "Station",
        "summary": f"Insert the {shape} on a laboratory's devices, by touch alone.",
        "ranking_rule": simulated.ranking_rule,
        "accepts": ["model"],
        "tasks": {own["name"]: own},
    }
    validate(Track, content, "station.yaml")
    return content
