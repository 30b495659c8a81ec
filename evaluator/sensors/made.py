"""A sensor as it is scored: the mesh that was made of it at its upload, with camera and markers, in one file."""

import base64
import hashlib
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, ValidationError
from vitac.errors import VitacError

from ..strict_model import StrictModel
from .check import CheckedSensor, accepted_sensor
from .findings import sensor_limits

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from vitac.envs.sensor_design.tetrahedra import Tetrahedra
    from vitac.envs.tactile.design import SensorDesign

MAX_BYTES = 4 * 1024 * 1024


class MadeSensorDamaged(VitacError):
    """A stored sensor cannot be read; upload the submission again."""


class SensorFacts(StrictModel):
    """What is shown of a sensor besides its pictures."""

    nodes: int
    tetrahedra: int
    is_own_mesh: bool
    thickness_mm: float
    volume_mm3: float
    volume_error: float
    distance_mm: float
    worst_quality: float
    markers: int


class MadeSensor(StrictModel):
    """All that a simulation needs of a sensor; arrays are little-endian, row by row, in base64."""

    format: Literal[1] = 1
    mesh_digest: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    nodes_mm: str
    corners: str
    camera: tuple[float, float, float, float]
    markers_mm: tuple[tuple[float, float], ...]
    facts: SensorFacts

    def as_bytes(self) -> bytes:
        """Return what is stored; its digest names the sensor."""
        return self.model_dump_json().encode() + b"\n"

    @property
    def digest(self) -> str:
        """SHA-256 [hex] of what is stored."""
        return hashlib.sha256(self.as_bytes()).hexdigest()

    def mesh(self) -> "Tetrahedra":
        """Return the tetrahedra, with the base at z = 0.

        Raises:
            MadeSensorDamaged: they are not those of their digest.
        """
        from vitac.envs.sensor_design.tetrahedra import Tetrahedra

        mesh = Tetrahedra(
            nodes_mm=_array(self.nodes_mm, "<f8", 3).astype("f8"), corners=_array(self.corners, "<i8", 4).astype("i8")
        )
        if hashlib.sha256(mesh.as_bytes()).hexdigest() != self.mesh_digest:
            raise MadeSensorDamaged(f"The mesh of a stored sensor is not that of its digest {self.mesh_digest}.")
        return mesh

    def design(self) -> "SensorDesign":
        """Return what is simulated.

        Raises:
            MadeSensorDamaged: the mesh is not the one of its digest.
        """
        from vitac.envs.sensor_design.tetrahedra import make_gel
        from vitac.envs.tactile.camera import CameraIntrinsics
        from vitac.envs.tactile.design import SensorDesign

        gel, sensing = make_gel(self.mesh(), name="the gel")
        return SensorDesign(
            gel=gel,
            sensing_triangles=sensing,
            camera=CameraIntrinsics(*self.camera),
            markers_mm=_markers(self.markers_mm),
        )


def made_sensor(checked: CheckedSensor) -> MadeSensor:
    """Return the sensor of a check without problems."""
    meshed, design = checked.meshed, checked.design
    if meshed is None or design is None:
        raise ValueError("expected a sensor that keeps to every rule")
    mesh, camera = meshed.mesh, design.camera
    return MadeSensor(
        mesh_digest=meshed.digest,
        nodes_mm=base64.b64encode(mesh.nodes_mm.astype("<f8").tobytes()).decode("ascii"),
        corners=base64.b64encode(mesh.corners.astype("<i8").tobytes()).decode("ascii"),
        camera=(camera.focal_u_px, camera.focal_v_px, camera.centre_u_px, camera.centre_v_px),
        markers_mm=tuple((float(x), float(y)) for x, y in design.markers_mm.tolist()),
        facts=SensorFacts(
            nodes=len(mesh.nodes_mm),
            tetrahedra=len(mesh.corners),
            is_own_mesh=meshed.is_own,
            thickness_mm=round(float(mesh.nodes_mm[:, 2].max()), 6),
            volume_mm3=round(mesh.volume_mm3, 3),
            volume_error=round(meshed.volume_error, 6),
            distance_mm=round(meshed.distance_mm, 4),
            worst_quality=round(float(mesh.qualities.min()), 4),
            markers=len(design.markers_mm),
        ),
    )


def read_made_sensor(content: bytes) -> MadeSensor:
    """Return a stored sensor.

    Raises:
        MadeSensorDamaged: it is none, or has more nodes or markers than any sensor may have.
    """
    limits = sensor_limits()
    try:
        made = MadeSensor.model_validate_json(content)
    except ValidationError as error:
        raise MadeSensorDamaged(f"A stored sensor cannot be read ({error.errors()[0]['msg']}).") from error
    if len(content) > MAX_BYTES or made.facts.nodes > limits.max_nodes or len(made.markers_mm) > limits.max_markers:
        raise MadeSensorDamaged("A stored sensor is larger than any may be.")
    return made


def load_made_sensor(path: Path) -> MadeSensor:
    """Return the sensor in a file.

    Raises:
        MadeSensorDamaged: as `read_made_sensor`.
    """
    return read_made_sensor(path.read_bytes())


@cache
def read_design(path: Path) -> "SensorDesign":
    """Return the design of a folder or of a made sensor's file, which is read once in a process and its copies.

    Raises:
        SensorRefused: it breaks a rule.
        SensorRejected: sensor.yaml cannot be used.
        MadeSensorDamaged: the file is no made sensor.
    """
    if path.is_file():
        return load_made_sensor(path).design()
    design = accepted_sensor(path).design
    assert design is not None  # noqa: S101 - of every accepted sensor
    return design


def _array(text: str, dtype: str, columns: int) -> "NDArray[np.generic]":
    import numpy as np

    try:
        return np.frombuffer(base64.b64decode(text, validate=True), dtype=dtype).reshape(-1, columns)
    except ValueError as error:
        raise MadeSensorDamaged(f"An array of a stored sensor cannot be read ({error}).") from error


def _markers(markers_mm: tuple[tuple[float, float], ...]) -> "NDArray[np.float64]":
    import numpy as np

    return np.array(markers_mm, dtype=np.float64).reshape(-1, 2)
