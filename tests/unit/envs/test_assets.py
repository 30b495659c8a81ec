from pathlib import Path

import numpy as np
import pytest
from vitac.envs.assets import AssetsMissing, Meshes, mesh_hash
from vitac.envs.geometry.keys_and_locks import KeyShape
from vitac.envs.geometry.pegs import PegShape
from vitac.envs.geometry.stl import StlError
from vitac.envs.tactile.gel import GelFilesError
from vitac.envs.tasks.lock_opening.env import key_mesh, lock_mesh
from vitac.envs.tasks.peg_insertion.env import PegInsertionSettings, hole_mesh, peg_mesh


def test_meshes_are_generated_by_default() -> None:
    meshes = Meshes()
    assert meshes.gel().name == "generated GelSight Mini gel"
    assert peg_mesh(meshes, PegShape.CUBOID) is peg_mesh(meshes, PegShape.CUBOID)
    assert [len(key_mesh(meshes, shape).vertices_m) for shape in KeyShape] == [32, 32, 32, 38]
    assert [len(lock_mesh(meshes, shape).vertices_m) for shape in KeyShape] == [32, 32, 32, 40]


def test_all_meshes_of_the_challenge_are_read(reference_dir: Path) -> None:
    meshes = Meshes(reference_dir / "assets" / "track1")
    assert meshes.gel().name == "gelsight_mini_e430/tet.msh"
    assert meshes.gel() is Meshes(str(reference_dir / "assets" / "track1")).gel()
    for shape in PegShape:
        assert peg_mesh(meshes, shape).name == f"{shape}_peg.STL"
        assert hole_mesh(meshes, shape).name == f"{shape}_hole_1.5mm.STL"
    for number, key in enumerate(KeyShape, 1):
        assert key_mesh(meshes, key).name == f"key{number}.STL"
        assert lock_mesh(meshes, key).name == f"lock_core_sim{number}.STL"


def test_missing_folder_is_a_named_refusal(tmp_path: Path) -> None:
    with pytest.raises(AssetsMissing, match=r"Expected the challenge's meshes in .*nowhere.*gelsight_mini_e430"):
        Meshes(tmp_path / "nowhere")


def test_missing_files_are_named(tmp_path: Path) -> None:
    (tmp_path / "gelsight_mini_e430").mkdir()
    meshes = Meshes(tmp_path)
    with pytest.raises(GelFilesError, match="meta_file"):
        meshes.gel()
    with pytest.raises(StlError, match=r"cuboid_peg\.STL"):
        peg_mesh(meshes, PegShape.CUBOID)
    with pytest.raises(StlError, match=r"lock_core_sim4\.STL"):
        lock_mesh(meshes, KeyShape.KEY4)


def test_mesh_hash_tells_meshes_and_settings_apart() -> None:
    meshes = Meshes()
    peg, hole = peg_mesh(meshes, PegShape.CUBOID), hole_mesh(meshes, PegShape.CUBOID)
    base = mesh_hash(meshes.gel(), [peg, hole], PegInsertionSettings())
    assert base == mesh_hash(meshes.gel(), [peg, hole], PegInsertionSettings())
    assert base != mesh_hash(meshes.gel(), [hole, peg], PegInsertionSettings())
    assert base != mesh_hash(meshes.gel(), [peg, hole], PegInsertionSettings(peg_friction=9.6))
    assert len(base) == 64
    assert np.array_equal(meshes.gel().rest_position_m, Meshes().gel().rest_position_m)
