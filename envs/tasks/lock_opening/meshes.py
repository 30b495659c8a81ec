"""The rigid parts of the lock task, and where they lie among the challenge's own files."""

from ...assets import Meshes
from ...fem.model.mesh import SurfaceMesh
from ...geometry.keys_and_locks import OWN_CLEARANCE, KeyShape, key_surface, lock_surface


def key_mesh(meshes: Meshes, shape: KeyShape) -> SurfaceMesh:
    """Return the key of this shape."""
    return meshes.part(lambda: key_surface(shape), f"key_lock/{shape}.STL")


def lock_mesh(meshes: Meshes, shape: KeyShape, slot_clearance_mm: float = OWN_CLEARANCE) -> SurfaceMesh:
    """Return the lock for this key; the challenge has files of its own clearance only."""
    if slot_clearance_mm != OWN_CLEARANCE:
        return lock_surface(shape, slot_clearance_mm)
    number = list(KeyShape).index(shape) + 1
    return meshes.part(lambda: lock_surface(shape), f"key_lock/lock_core_sim{number}.STL")
