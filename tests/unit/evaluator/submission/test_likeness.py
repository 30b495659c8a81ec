import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from vitac.evaluator.submission.likeness import ArchiveLikeness, ArchiveSketch, compare_sketches, make_sketch

CODE = """
class Policy:
    def reset(self, task):
        self.step = 0

    def act(self, observation):
        self.step += 1
        return self.weights @ observation["relative_motion"] / self.step
"""
OTHER = """
import math
GAIN = 0.5
class Policy:
    def reset(self, task): pass
    def act(self, seen): return [GAIN * math.tanh(value) for value in seen["marker_flow"][0][1].mean(axis=0)]
"""


def archive(path: Path, code: str, weights: np.ndarray, name: str = "weights.npz") -> Path:
    content = io.BytesIO()
    if name.endswith(".npz"):
        np.savez(content, layer=weights)
    elif name.endswith(".json"):
        content.write(json.dumps([round(float(value), 4) for value in weights.ravel()]).encode())
    else:
        content.write(b"head" + weights.astype("<f4").tobytes())
    path.mkdir()
    (path / "policy.py").write_text(code)
    (path / name).write_bytes(content.getvalue())
    return path


def trained(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((40, 30))


def likeness(first: Path, second: Path) -> ArchiveLikeness:
    return compare_sketches(make_sketch(first), make_sketch(second))


@pytest.mark.parametrize("name", ["weights.npz", "weights.json", "weights.bin"])
def test_weights_with_a_little_noise_are_alike_and_those_of_another_seed_are_not(tmp_path: Path, name: str) -> None:
    source = archive(tmp_path / "a", CODE, trained(1), name)
    noisy = archive(tmp_path / "b", CODE, trained(1) + 1e-2 * trained(2), name)
    other = archive(tmp_path / "c", CODE, trained(3), name)
    assert (likeness(source, noisy).weights or 0) > 0.999
    assert abs(likeness(source, other).weights or 0) < 0.2


def test_half_precision_is_read_as_such(tmp_path: Path) -> None:
    first, second = (archive(tmp_path / f"{n}", CODE, trained(1).astype(np.float16) * n) for n in (1, 2))
    assert likeness(first, second).weights == pytest.approx(1, abs=1e-3)


def test_code_is_compared_without_comments_layout_and_names_of_its_own(tmp_path: Path) -> None:
    source = archive(tmp_path / "a", CODE, np.zeros((2, 2)))
    changed = CODE.replace("    ", "  ").replace("self.step = 0", "self.step = 0  # a comment\n")
    renamed = changed.replace("observation", "seen").replace("task", "name").replace("Policy", "Mine")
    found = likeness(source, archive(tmp_path / "b", renamed, np.zeros((2, 2))))
    assert (found.code, found.weights, found.is_copy) == (1, None, True)
    other = likeness(source, archive(tmp_path / "c", OTHER, np.zeros((2, 2))))
    assert (other.code or 0) < 0.3
    assert not other.is_copy


def test_the_same_code_with_weights_of_another_seed_is_no_copy(tmp_path: Path) -> None:
    found = likeness(*(archive(tmp_path / str(seed), CODE, trained(seed)) for seed in (1, 2)))
    assert (found.code, found.is_copy) == (1, False)


def test_policies_of_one_recipe_with_a_few_numbers_each_are_no_copies(tmp_path: Path) -> None:
    few = [np.random.default_rng(seed).standard_normal(20) for seed in (1, 2)]
    found = likeness(*(archive(tmp_path / str(k), CODE, weights) for k, weights in enumerate(few)))
    assert (found.code, found.weights is not None, found.is_copy) == (1, True, False)


def test_weights_that_are_a_small_part_of_an_archive_say_nothing(tmp_path: Path) -> None:
    first, second = (archive(tmp_path / str(seed), CODE, trained(1)) for seed in (1, 2))
    for seed, folder in ((3, first), (4, second)):
        np.save(folder / f"{seed}.npy", np.random.default_rng(seed).standard_normal(3000 + seed))
    assert likeness(first, second).weights == 0


def test_a_stored_sketch_says_the_same(tmp_path: Path) -> None:
    first, second = (make_sketch(archive(tmp_path / str(seed), CODE, trained(seed))) for seed in (1, 2))
    again = ArchiveSketch.from_bytes(first.to_bytes())
    assert compare_sketches(again, second) == compare_sketches(first, second)
    assert len(first.to_bytes()) == 1024 + 8 + 1024


def test_hostile_files_cost_no_more_than_others_and_nothing_is_unpickled(tmp_path: Path) -> None:
    folder = archive(tmp_path / "a", "this is no python (", np.zeros((2, 2)))
    content = io.BytesIO()
    np.save(content, np.array([{}, []], dtype=object), allow_pickle=True)
    (folder / "objects.npy").write_bytes(content.getvalue() * 100)
    (folder / "lies.npy").write_bytes(np.lib.format.magic(1, 0) + b"\x46\x00{'descr': '<f8', 'shape': (99999999999,)}")
    (folder / "broken.pt").write_bytes(b"PK\x03\x04" + bytes(500) + b"PK\x05\x06" + bytes(18))
    with zipfile.ZipFile(folder / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as opened:
        for number in range(4):
            opened.writestr(f"{number}.npy", bytes(2**24))
    (folder / "deep.py").write_text("(" * 10_000 + "\n")
    (folder / "link.py").symlink_to("/etc/passwd")
    assert make_sketch(folder).samples.shape[1] == 512
