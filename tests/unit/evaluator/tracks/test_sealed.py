import hashlib
import stat
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vitac.envs.maniskill.definition import is_maniskill
from vitac.envs.tasks.peg_insertion.env import accepts_start
from vitac.evaluator.tracks import ListKind, Task, Track, UnknownTrack, list_tracks, load_track
from vitac.evaluator.tracks.sealed import (
    SecretRejected,
    load_played_track,
    make_commitment,
    new_secret,
    read_secret,
    sealed_track,
    write_secret,
)

SECRET = bytes(range(32))
FIRST_OFFSET = (-3.682, 0.416, 2.794)
LIST_SEED = 5325763755431341239
TRACKS = [load_track(name) for name in list_tracks()]


def box(task: Task, shape: str) -> list[tuple[float, float]]:
    offsets = [start.offset for start in task.episode_list.starts if start.shape == shape]
    return [(min(column), max(column)) for column in zip(*offsets, strict=True)]


@pytest.mark.parametrize("track", TRACKS, ids=lambda track: track.name)
def test_a_sealed_list_has_the_episodes_of_the_public_one_at_other_starts(track: Track) -> None:
    sealed = sealed_track(track, SECRET)
    for name, public in track.tasks.items():
        task = sealed.tasks[name]
        assert (public.episode_list.kind, task.episode_list.kind) == (ListKind.PUBLIC, ListKind.SEALED)
        assert task.episode_list.commitment == make_commitment(SECRET)
        assert [episode.shape for episode in task.episodes] == [episode.shape for episode in public.episodes]
        assert task.episode_list.list_seed not in {public.episode_list.list_seed, 0}
        assert task.digest() != public.digest()
        known = {(start.shape, start.offset) for start in public.episode_list.starts}
        drawn = {(start.shape, start.offset) for start in task.episode_list.starts}
        assert is_maniskill(task.env_id) or not known & drawn  # there the seed alone makes another start
        for shape, offset in drawn:
            assert all(low <= value <= high for value, (low, high) in zip(offset, box(public, shape), strict=True))


def test_the_list_follows_from_the_secret_alone_and_never_changes() -> None:
    """Published secrets must give the list that was played, whatever the version: these values are fixed for ever."""
    one, again = (sealed_track(load_track("track_1"), SECRET).tasks["peg-insertion"] for _ in range(2))
    assert one.episodes == again.episodes
    other = sealed_track(load_track("track_1"), SECRET[::-1]).tasks["peg-insertion"]
    assert {start.offset for start in one.episode_list.starts}.isdisjoint(
        start.offset for start in other.episode_list.starts
    )
    assert one.episodes[0].offset == FIRST_OFFSET
    assert one.episode_list.list_seed == LIST_SEED


def test_tasks_draw_independently() -> None:
    lists = [task.episode_list for track in TRACKS for task in sealed_track(track, SECRET).tasks.values()]
    assert len({listed.list_seed for listed in lists}) == len(lists)


@given(st.binary(min_size=32, max_size=32))
@settings(max_examples=5)
def test_no_drawn_peg_just_falls_into_its_hole(secret: bytes) -> None:
    starts = sealed_track(load_track("track_1"), secret).tasks["peg-insertion"].episode_list.starts
    assert all(accepts_start(start.shape, start.offset) for start in set(starts))  # type: ignore[arg-type]
    assert not accepts_start("cuboid", (0.0, 0.0, 0.0))


def test_the_commitment_can_be_computed_with_any_tool() -> None:
    expected = hashlib.sha256(b"vitac-sealed-list-1\n" + SECRET).hexdigest()
    assert make_commitment(SECRET) == expected


def test_a_new_secret_is_its_owners_only_and_overwrites_nothing(tmp_path: Path) -> None:
    path = tmp_path / "secret"
    secret = new_secret(path)
    assert read_secret(path) == secret
    assert len(secret) == 32
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    with pytest.raises(SecretRejected, match="Name a new file"):
        new_secret(path)
    assert read_secret(path) == secret
    assert new_secret(tmp_path / "another") != secret
    with pytest.raises(FileExistsError):
        write_secret(path, SECRET)
    write_secret(tmp_path / "copy", secret)
    assert (tmp_path / "copy").read_text() == path.read_text()
    assert stat.S_IMODE((tmp_path / "copy").stat().st_mode) == 0o600


def test_a_track_is_played_with_its_public_lists_or_with_those_of_a_secret() -> None:
    public = load_track("track_1")
    assert load_played_track("track_1", None) == public
    sealed = load_played_track("track_1", SECRET)
    assert sealed == sealed_track(public, SECRET) != public
    assert {task.episode_list.commitment for task in sealed.tasks.values()} == {make_commitment(SECRET)}
    with pytest.raises(UnknownTrack):
        load_played_track("track_0", SECRET)


@pytest.mark.parametrize("content", [b"", b"00" * 31, b"00" * 33, b"zz" * 32, b"\xff" * 64, b"00" * 40_000])
def test_what_is_no_secret_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "secret"
    path.write_bytes(content)
    with pytest.raises(SecretRejected, match="expected 64 hexadecimal digits"):
        read_secret(path)
    with pytest.raises(SecretRejected, match="cannot be read"):
        read_secret(tmp_path / "missing")
