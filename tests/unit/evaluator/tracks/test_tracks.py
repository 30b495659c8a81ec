import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import fields, replace
from math import inf, nan
from pathlib import Path
from typing import Any

import pytest
import yaml
from cubes_track import FILE
from visible_scenes import STARTS
from vitac.envs.vision.stereo.method import StereoMethod
from vitac.evaluator.strict_model import DocumentRejected, parse_yaml
from vitac.evaluator.tracks import (
    Episode,
    Player,
    Task,
    Track,
    UnknownTask,
    UnknownTrack,
    archive_folders,
    find_task,
    list_tracks,
    load_track,
)

TRACK_1 = Path(__file__).parents[4] / "evaluator" / "tracks" / "track_1.yaml"

OFFSETS = [
    (-4, -4, -8), (-4, -2, 2), (-4, 1, -6), (-4, 3, 6), (-3, -3, -2), (-3, -1, 8), (-3, 2, 2), (-2, -4, -6),
    (-2, -2, 4), (-2, 1, -2), (-2, 3, 8), (-1, -3, 0), (-1, 0, 6), (-1, 3, 4), (0, -3, -4), (0, 0, 6),
    (0, 3, 4), (1, -3, -4), (1, 0, -4), (1, 3, 0), (2, -3, -8), (2, -1, 4), (2, 2, -4), (2, 4, 6),
    (3, -2, 0), (3, 1, -8), (3, 3, 2), (4, -3, -4), (4, -1, 6), (4, 2, -2),
]  # fmt: skip


@pytest.fixture
def content() -> dict[str, object]:
    loaded = yaml.safe_load(TRACK_1.read_text(encoding="utf-8"))
    assert isinstance(loaded, dict)
    return loaded


def parse(content: object) -> Track:
    return parse_yaml(Track, yaml.safe_dump(content), "track_1.yaml")


def test_peg_list_has_three_repeats_of_thirty_offsets_of_three_shapes() -> None:
    episodes = load_track("track_1").tasks["peg-insertion"].episodes
    assert [episode.number for episode in episodes] == list(range(1, 271))
    assert [episode.shape for episode in episodes] == ["cuboid", "trapezoid", "concave1"] * 90
    assert [episode.offset for episode in episodes[::3]] == OFFSETS * 3


def test_lock_list_has_four_keys_with_two_repeats_of_twenty_offsets() -> None:
    episodes = load_track("track_1").tasks["lock-opening"].episodes
    assert [episode.number for episode in episodes] == list(range(1, 161))
    assert [episode.shape for episode in episodes] == [
        key for key in ("key1", "key2", "key3", "key4") for _ in range(40)
    ]
    assert [episode.offset for episode in episodes] == [(0.25 * step, 0, 0) for step in range(20)] * 8


def test_every_episode_has_its_own_random_seed() -> None:
    episodes = load_track("track_1").tasks["peg-insertion"].episodes
    assert len({episode.options["rng_seed"] for episode in episodes}) == 270
    assert episodes[41].options == {"shape": "concave1", "offset_mm_deg": (-1.0, 3.0, 4.0), "rng_seed": (0, 42)}
    lock = load_track("track_1").tasks["lock-opening"].episodes
    assert lock[41].options == {"shape": "key2", "offset_mm": (0.25, 0.0, 0.0), "rng_seed": (0, 42)}


@pytest.mark.parametrize(("task", "log"), [("peg-insertion", "peg_insertion"), ("lock-opening", "open_lock")])
def test_list_order_matches_the_organizers_log(task: str, log: str, reference_dir: Path) -> None:
    lines = (reference_dir / "logs" / f"track1_{log}.repeat0.jsonl").read_text().splitlines()
    logged = [json.loads(line) for line in lines]
    episodes = load_track("track_1").tasks[task].episodes
    listed = [episodes[e["episode"] - 1] for e in logged]
    assert [(e["shape"], tuple(e["initial_offset"])) for e in logged] == [(e.shape, e.offset) for e in listed]


def fusion_episodes() -> tuple[Episode, ...]:
    return load_track("track_2").tasks["fusion-insertion"].episodes


def test_fusion_list_has_three_repeats_of_fifty_starts_that_carry_their_own_side() -> None:
    episodes = fusion_episodes()
    assert len(episodes) == 150
    assert [e.offset for e in episodes[:50]] == [e.offset for e in episodes[100:]]
    assert tuple(e.offset for e in episodes[:50]) == STARTS
    assert [e.shape == "hexagon" for e in episodes] == [e.offset[4] == 1 for e in episodes]
    assert sum(e.shape == "hexagon" for e in episodes) == 90
    assert episodes[60].options == {"shape": "cuboid", "start": (1.2, 0.2, -3.2, 6.8, 0), "rng_seed": (0, 61)}


def test_fusion_list_matches_the_organizers_log(reference_dir: Path) -> None:
    """It writes the offset from the hole in the books of its era, 13.0 mm more than z."""
    lines = (reference_dir / "logs" / "track2_peg_insertion_v2.jsonl").read_text().splitlines()
    logged = [json.loads(line)["initial_offset"] for line in lines]
    listed = [episode.offset for episode in fusion_episodes()]
    assert len(logged) == len(listed)
    for got, (x, y, theta, z, left) in zip(logged, listed, strict=True):
        assert got == pytest.approx([x, y + 22.625 - 45.25 * left, theta, z + 13.0])


def test_practice_with_exact_depth_plays_the_same_starts_with_another_digest_on_another_board() -> None:
    scored, practice = load_track("track_2"), load_track("track_2_gt")
    (task,), (practised,) = scored.tasks.values(), practice.tasks.values()
    assert task.episode_list == practised.episode_list
    assert (task.settings, practised.settings) == ({"depth_mode": "stereo"}, {"depth_mode": "gt"})
    assert task.digest() != practised.digest()
    assert set(scored.tasks).isdisjoint(practice.tasks)


@pytest.mark.parametrize("number", [field.name for field in fields(StereoMethod)])
def test_every_number_of_the_stereo_method_is_in_the_digest(number: str, monkeypatch: pytest.MonkeyPatch) -> None:
    task = load_track("track_2").tasks["fusion-insertion"]
    before = task.digest()
    (method,) = task.definition.methods
    other = replace(task.definition, methods=(replace(method, **{number: getattr(method, number) + 1}),))
    monkeypatch.setattr(Task, "definition", other)
    assert task.digest() != before


@pytest.mark.parametrize("name", ["peg-insertion", "lock-opening"])
def test_a_task_without_settings_methods_and_commitment_keeps_the_digest_from_before_there_were_any(name: str) -> None:
    task = load_track("track_1").tasks[name]
    observed = [(row.name, row.shape, row.dtype, row.unit, row.meaning) for row in task.observables]
    done = [(row.name, row.scale, row.unit, row.meaning) for row in task.actions]
    content = task.model_dump_json(
        exclude={
            "settings": True,
            "ranking": True,
            "draws": True,
            "optional_observables": True,
            "force_limit_n": True,
            "delay_steps": True,
            "delay_ms": True,
            "control_period_ms": True,
            "while_thinking": True,
            "player": True,
            "station_of": True,
            "profiles": True,
            "episode_list": {"commitment"},
        }
    )
    content += json.dumps([observed, done])
    assert task.digest() == hashlib.sha256(content.encode()).hexdigest()


def under_delays(content: dict[str, Any], **changes: Any) -> Track:
    del content["tasks"]["lock-opening"]
    content["tasks"]["peg-insertion"] |= {"control_period_ms": 50, "while_thinking": "hold"} | changes
    return parse(content)


def test_a_task_of_several_delays_is_one_for_each_in_env_steps_rounded_up(content: dict[str, Any]) -> None:
    track = under_delays(content, delays_ms=[0, 20, 50, 100, 200])
    assert {name: task.delay_steps for name, task in track.tasks.items()} == {
        "peg-insertion": 0, "peg-insertion-20ms": 1, "peg-insertion-50ms": 1, "peg-insertion-100ms": 2,
        "peg-insertion-200ms": 4,
    }  # fmt: skip
    assert track.tasks["peg-insertion-20ms"].title == "Peg insertion, 20 ms"
    assert [[task.delay_ms for task in tasks] for tasks in track.list_delays()] == [[0, 20, 50, 100, 200]]
    assert Track.model_validate_json(track.model_dump_json()) == track


def test_a_task_without_delay_keeps_its_digest_whatever_an_env_step_takes(content: dict[str, Any]) -> None:
    before = parse(content).tasks["peg-insertion"].digest()
    assert under_delays(content, delays_ms=[0, 60]).tasks["peg-insertion"].digest() == before


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"delays_ms": [0, 50, 50]}, r"delays_ms is \[0, 50, 50\], expected different whole numbers"),
        ({"delays_ms": "50"}, "delays_ms is '50', expected different whole numbers"),
        ({"delay_ms": 50, "control_period_ms": None}, "delay_ms is 50, but control_period_ms is missing"),
        ({"delay_ms": 50, "delay_steps": 2}, "delay_steps is 2, but delay_ms gives 1; leave one of them out"),
        ({"delay_ms": 851}, "delay_ms is 851, which is 18 env steps, expected at most 16"),
        ({"delay_ms": -1}, "delay_ms"),
    ],
)
def test_a_delay_that_is_none_is_refused(content: dict[str, Any], changes: dict[str, Any], part: str) -> None:
    with pytest.raises(DocumentRejected, match=part):
        under_delays(content, **changes)


def test_blocks_are_played_one_after_the_other_each_as_often_as_it_says(content: dict[str, object]) -> None:
    left, right = ({"shape": side, "offset": [0, 0, 0, 3.5]} for side in ("left", "right"))
    blocks = [{"repeats": 2, "starts": [left, right]}, {"starts": [right]}]
    content["tasks"]["peg-insertion"]["episode_list"]["blocks"] = blocks  # type: ignore[index]
    task = parse(content).tasks["peg-insertion"]
    assert [episode.shape for episode in task.episodes] == ["left", "right", "left", "right", "right"]
    assert task.episode_list.shapes == ("left", "right")
    assert {episode.offset for episode in task.episodes} == {(0.0, 0.0, 0.0, 3.5)}


def test_unknown_track_names_the_tracks_and_where_others_are_read_from() -> None:
    with pytest.raises(UnknownTrack, match=r"'track_9'.*track_1.* the folder that VITAC_TRACKS_DIR names"):
        load_track("track_9")


def test_unknown_task_names_the_tasks() -> None:
    with pytest.raises(UnknownTask, match=r"'xyz'; the tasks are .*peg-insertion"):
        find_task("xyz")
    with pytest.raises(UnknownTask, match=r"''; the tasks are "):
        find_task("")
    with pytest.raises(UnknownTask, match=r"'peg'; did you mean .*peg-insertion.*\? The tasks are .*lock-opening"):
        find_task("peg")


def test_a_track_names_its_tasks_where_one_is_missing() -> None:
    track = load_track("track_1")
    assert track.task("peg-insertion") is track.tasks["peg-insertion"]
    with pytest.raises(UnknownTask, match=r"^Track 'track_1' has no task 'peg'; its tasks are peg-insertion, lock-"):
        track.task("peg")


def test_every_packaged_track_is_valid() -> None:
    assert [load_track(name).name for name in list_tracks()] == list(list_tracks())


@pytest.mark.parametrize(("key", "value"), [("player", "blind"), ("force_limit_n", 20), ("list_seed", 7)])
def test_digest_changes_with_the_list_the_player_and_the_limit_of_force(
    content: dict[str, Any], key: str, value: object
) -> None:
    task = content["tasks"]["peg-insertion"]
    (task["episode_list"] if key == "list_seed" else task)[key] = value
    changed = parse(content).tasks["peg-insertion"]
    assert changed.digest() != load_track("track_1").tasks["peg-insertion"].digest()


TASK = ("tasks", "peg-insertion")
BLOCK = (*TASK, "episode_list", "blocks", 0)


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (("rankings",), 1, "track_1.yaml: Unknown key 'rankings'; did you mean 'ranking'"),
        ((*TASK, "shardsize"), 1, "Unknown key 'tasks.peg-insertion.shardsize'; did you mean 'shard_size'"),
        ((*TASK, "episode_list", "block"), 1, "'tasks.peg-insertion.episode_list.block'; did you mean 'blocks'"),
        ((*BLOCK, "repeat"), 1, "'tasks.peg-insertion.episode_list.blocks.0.repeat'; did you mean 'repeats'"),
        *(((*BLOCK, "starts", 3, "offset", 1), x, "blocks.0.starts.3.offset.1") for x in (nan, inf, "many", None)),
        ((*BLOCK, "starts", 3, "offset"), [0, 0], "expected offsets of one length, got 2 and 3 numbers"),
        ((*TASK, "name"), "peg", "tasks.peg-insertion.name is 'peg'"),
        (
            (*TASK, "env_id"), "ViTac/Peg-v1",
            "'ViTac/Peg-v1', expected one of ViTac/Assembly-v1, ViTac/CableEnd-v1, ViTac/Explore-v1",
        ),
        (("combined_tasks",), ["peg"], "combined_tasks has 'peg'; the tasks are lock-opening, peg-insertion"),
        (
            (*TASK, "draws"), {"clearence_mm": [0.5, 2]},
            "no quantity 'clearence_mm' to draw; did you mean 'clearance_mm'?",
        ),
        (
            (*TASK, "draws"), {"clearance_mm": [2, 0.5]},
            "Draw 'clearance_mm' is [2.0, 0.5], expected two numbers from 0.1 to 3 mm, rising.",
        ),
        ((*TASK, "draws"), {"clearance_mm": [0.5, 9]}, "expected two numbers from 0.1 to 3 mm, rising."),
    ],
)  # fmt: skip
def test_what_a_track_file_cannot_say_is_refused_by_name(
    content: dict[str, Any], place: Sequence[str | int], value: object, message: str
) -> None:
    *way, last = place
    target: Any = content
    for part in way:
        target = target[part]
    target[last] = value
    with pytest.raises(DocumentRejected, match=re.escape(message)):
        parse(content)


def test_several_tasks_need_a_combination_rule_and_one_has_none(content: dict[str, object]) -> None:
    rule = content.pop("combination_rule")
    with pytest.raises(DocumentRejected, match="combination_rule must be given where there are several tasks"):
        parse(content)
    del content["tasks"]["lock-opening"]  # type: ignore[attr-defined]
    assert parse(content).combination_rule is None
    with pytest.raises(DocumentRejected, match="and only there"):
        parse(content | {"combination_rule": rule})


@pytest.fixture
def further(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("VITAC_TRACKS_DIR", str(tmp_path))
    return tmp_path


def one_task(content: dict[str, object], *, task: str) -> str:
    tasks = content["tasks"]
    assert isinstance(tasks, dict)
    del content["combination_rule"]
    return yaml.safe_dump(
        content | {"name": "mine", "folder": "Mine", "tasks": {task: tasks["peg-insertion"] | {"name": task}}}
    )


def test_tracks_of_a_folder_stand_beside_ours(further: Path, content: dict[str, object]) -> None:
    (further / "mine.yaml").write_text(one_task(content, task="my-peg"))
    *names, last = list_tracks()
    assert (names, last) == (sorted({*names, "mine"}), "maniskill")
    assert find_task("my-peg")[0].name == "mine"
    assert archive_folders() == (
        "Assembly",
        "CableEnd",
        "Explore",
        "InHandTurn",
        "Mine",
        "MovingHole",
        "Slip",
        "SoftPlug",
        "Track_1",
        "Track_2",
        "Track_3",
        "ViTac2024",
        "ManiSkill",
    )


def test_tracks_of_ours_are_not_replaced(further: Path) -> None:
    (further / "track_1.yaml").write_text(TRACK_1.read_text())
    with pytest.raises(DocumentRejected, match=r"track_1\.yaml has the name of a track that is there already"):
        list_tracks()


def test_a_task_of_two_tracks_is_refused(further: Path, content: dict[str, object]) -> None:
    (further / "mine.yaml").write_text(one_task(content, task="peg-insertion"))
    with pytest.raises(DocumentRejected, match="mine and track_1 both have a task 'peg-insertion'"):
        find_task("lock-opening")


def test_a_folder_without_tracks_is_refused(further: Path) -> None:
    with pytest.raises(DocumentRejected, match=r"VITAC_TRACKS_DIR is .*, expected a folder with track files"):
        load_track("track_1")


def test_name_and_file_name_agree(further: Path, content: dict[str, object]) -> None:
    (further / "other.yaml").write_text(one_task(content, task="my-peg"))
    with pytest.raises(DocumentRejected, match=r"other\.yaml says name 'mine'"):
        load_track("other")


def test_sensors_play_the_starts_and_settings_of_track_1() -> None:
    published = load_track("track_1").tasks["peg-insertion"]
    for task in load_track("track_3").tasks.values():
        assert task.episode_list == published.episode_list
        assert (task.env_id, task.settings, task.max_steps) == (
            published.env_id,
            published.settings,
            published.max_steps,
        )


def test_boards_of_sensors_are_those_of_policies_and_of_the_estimator() -> None:
    track = load_track("track_3")
    assert track.has_sensor
    assert track.tasks_that_count == ("sensor-design",)
    assert {name: task.player for name, task in track.tasks.items()} == {
        "sensor-design": Player.POLICY,
        "sensor-standard": Player.ESTIMATOR,
        "sensor-blind": Player.BLIND,
    }
    assert len({task.digest() for task in track.tasks.values()}) == 3
    assert [name for name, task in track.tasks.items() if task.measures_figures] == ["sensor-blind"]
    assert not any(task.measures_figures for task in load_track("track_1").tasks.values())


def test_estimator_plays_for_every_submission() -> None:
    track = load_track("track_3")
    assert track.list_played_tasks(["sensor-standard"]) == ("sensor-standard", "sensor-blind")
    assert track.list_played_tasks(["sensor-design"]) == tuple(track.tasks)
    assert load_track("track_1").list_played_tasks(["lock-opening"]) == ("lock-opening",)


def test_all_tasks_count_where_none_are_named() -> None:
    assert load_track("track_1").tasks_that_count == ("peg-insertion", "lock-opening")


def test_no_board_mixes_physics_on_a_cpu_and_on_a_gpu() -> None:
    content = yaml.safe_load(FILE) | {"combination_rule": "Mean."}
    on_cpu = content["tasks"]["pick-cube"]
    on_gpu = on_cpu | {"name": "on-gpu", "settings": on_cpu["settings"] | {"sim_backend": "physx_cuda"}}
    both = content | {"tasks": {"pick-cube": on_cpu, "on-gpu": on_gpu}}
    with pytest.raises(
        DocumentRejected, match="would mix physics on a CPU and on a GPU; name the tasks of one of them"
    ):
        parse(both)
    for counts in ("pick-cube", "on-gpu"):
        assert parse(both | {"combined_tasks": [counts]}).tasks_that_count == (counts,)
    also_on_gpu = on_gpu | {"name": "also-on-gpu"}
    assert len(parse(content | {"tasks": {"on-gpu": on_gpu, "also-on-gpu": also_on_gpu}}).tasks_that_count) == 2


def block(content: dict[str, object]) -> dict[str, object]:
    tasks = content["tasks"]
    assert isinstance(tasks, dict)
    return tasks["peg-insertion"]["episode_list"]["blocks"][0]  # type: ignore[no-any-return]


def test_shapes_and_offsets_stand_for_every_shape_at_every_offset(content: dict[str, object]) -> None:
    whole = parse(content).tasks["peg-insertion"]
    del block(content)["starts"]
    block(content).update(shapes=["cuboid", "trapezoid", "concave1"], offsets=[list(offset) for offset in OFFSETS])
    short = parse(content).tasks["peg-insertion"]
    assert short.episodes == whole.episodes
    assert short.digest() == whole.digest()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"shapes": "cuboid", "offsets": [[0, 0, 0]]}, "expected lists of shapes and offsets"),
        ({"shapes": [], "offsets": [[0, 0, 0]]}, "at least 1 item"),
        ({"shapes": ["cuboid"]}, "starts"),
        ({"shapes": ["cuboid"], "offsets": [[0, 0], [0]]}, "offsets of one length"),
    ],
)
def test_unusable_product_of_starts_is_refused(
    content: dict[str, object], changes: dict[str, object], message: str
) -> None:
    del block(content)["starts"]
    block(content).update(changes)
    with pytest.raises(DocumentRejected, match=message):
        parse(content)


def test_profiles_are_no_part_of_the_digest(content: dict[str, object]) -> None:
    before = parse(content).tasks["peg-insertion"].digest()
    tasks = content["tasks"]
    assert isinstance(tasks, dict)
    tasks["peg-insertion"]["profiles"] = {"other": {"reason": "Because.", "settings": {"z_step_mm": 0.1}}}
    changed = parse(content).tasks["peg-insertion"]
    assert changed.digest() == before
    assert changed.profiles["other"].settings == {"z_step_mm": 0.1}


ROBUST = {
    "peg-insertion-robust": ("clearance_mm", 0.5, 2.0),
    "lock-opening-robust": ("slot_clearance_mm", 0.5, 2.0),
    "fusion-robust": ("clearance_mm", 0.5, 1.5),
    "moving-hole-robust": ("clearance_mm", 0.8, 2.0),
    "explore-robust": ("gel_friction", 0.7, 1.5),
    "slip-robust": ("gel_friction", 0.4, 1.2),
    "in-hand-turn-robust": ("gel_friction", 0.2, 0.45),
    "soft-plug-robust": ("interference_mm", 0.05, 0.15),
    "cable-end-robust": ("interference_mm", -0.25, -0.15),
    "assembly-robust": ("gel_friction", 0.6, 1.2),
}
NEW = {
    "peg-insertion-robust": ("peg_bulge", "peg_slant_mm"),
    "lock-opening-robust": (),
    "moving-hole-robust": ("plate_speed_mm_s", "peg_taper"),
    "explore-robust": (),
    "slip-robust": ("part_mass_kg", "load_n"),
    "in-hand-turn-robust": ("held_mm",),
    "soft-plug-robust": ("plug_modulus_mpa",),
    "cable-end-robust": ("plug_modulus_mpa",),
    "assembly-robust": (),
    "fusion-robust": ("picture_delay", "camera_x_mm", "camera_z_mm", "camera_turn_deg"),
}
"""What else makes them hard: outlines of pegs, what is seen of them, motion and loads."""


@pytest.mark.parametrize("name", ROBUST)
def test_robust_tasks_draw_what_makes_them_hard_under_the_contact_model_that_sticks(name: str) -> None:
    _, task = find_task(name)
    quantity, low, high = ROBUST[name]
    assert task.draws[quantity] == (low, high)
    assert {"gel_modulus_kpa", "part_friction", "marker_noise_px", "marker_loss", "drift_u_px_s", "touch_delay"} <= set(
        task.draws
    )
    assert set(NEW[name]) <= set(task.draws)
    assert task.settings["contact_model"] == "arena-2"


def test_draws_are_part_of_the_digest() -> None:
    _, task = find_task("peg-insertion-robust")
    other = task.model_copy(update={"draws": task.draws | {"clearance_mm": (0.5, 1.9)}})
    assert other.digest() != task.digest()


def test_a_limit_of_force_is_an_argument(content: dict[str, Any]) -> None:
    plain = parse(content).tasks["peg-insertion"]
    content["tasks"]["peg-insertion"]["force_limit_n"] = 20
    limited = parse(content).tasks["peg-insertion"]
    assert limited.environment_arguments == {**plain.environment_arguments, "force_limit_n": 20}
    assert all(
        task.force_limit_n is None for name in ("track_1", "track_2") for task in load_track(name).tasks.values()
    )


def test_refuses_a_limit_of_force_that_cannot_be_kept(content: dict[str, Any]) -> None:
    content["tasks"]["peg-insertion"]["force_limit_n"] = 0
    with pytest.raises(DocumentRejected, match=r"force_limit_n: .*greater than 0"):
        parse(content)
    cubes = next(iter(load_track("maniskill").tasks.values())).model_dump() | {"force_limit_n": 20}
    with pytest.raises(ValueError, match=r"force_limit_n is 20, but \S+ measures no contact force; leave it out"):
        Task(**cubes)
