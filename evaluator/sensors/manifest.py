"""sensor.yaml: camera and markers of a team's own sensor, and nothing else."""

from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from pydantic import Field, model_validator
from vitac.envs.untrusted_file import find_spelling, read_start
from vitac.errors import VitacError

from ..strict_model import DocumentRejected, StrictModel, parse_untrusted_yaml
from .findings import sensor_limits

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from vitac.envs.tactile.camera import CameraIntrinsics

SENSOR_NAME: Final = "sensor.yaml"
_MAX_BYTES: Final = 16 * 1024

Focal = Annotated[float, Field(ge=50, le=2000)]
Coordinate = Annotated[float, Field(ge=-15, le=15)]


class SensorRejected(VitacError):
    """sensor.yaml is missing or wrong: correct the key that the message names."""


class Camera(StrictModel):
    """Intrinsics of the camera; its picture has 320 x 240 pixels, its optical centre is 18 mm behind the gel."""

    focal_px: Annotated[tuple[Focal, Focal], Field(description="Focal lengths along u and v.")] = (340.0, 325.0)
    centre_px: Annotated[
        tuple[Annotated[float, Field(ge=0, le=320)], Annotated[float, Field(ge=0, le=240)]],
        Field(description="Where the camera's axis meets the picture."),
    ] = (160.0, 125.0)

    def intrinsics(self) -> "CameraIntrinsics":
        """Return the camera of the simulation."""
        from vitac.envs.tactile.camera import CameraIntrinsics

        (focal_u, focal_v), (centre_u, centre_v) = self.focal_px, self.centre_px
        return CameraIntrinsics(focal_u_px=focal_u, focal_v_px=focal_v, centre_u_px=centre_u, centre_v_px=centre_v)


class Grid(StrictModel):
    """Markers in rows and columns around a centre."""

    columns: Annotated[int, Field(ge=1, le=128, description="Markers along x, the longer side.")] = 9
    rows: Annotated[int, Field(ge=1, le=128, description="Markers along y.")] = 7
    spacing_mm: Annotated[
        tuple[Annotated[float, Field(gt=0, le=15)], Annotated[float, Field(gt=0, le=15)]],
        Field(description="Between neighbours along x and y."),
    ] = (2.05, 2.05)
    centre_mm: Annotated[tuple[Coordinate, Coordinate], Field(description="Middle of the grid.")] = (0.0, 0.0)
    rotation_deg: Annotated[float, Field(ge=-180, le=180, description="About the middle.")] = 0.0


class Markers(StrictModel):
    """Where markers are drawn, in the frame of the gel: origin in the middle of the base, x along its longer side."""

    grid: Annotated[Grid | None, Field(description="Rows and columns.")] = None
    points_mm: Annotated[
        tuple[tuple[Coordinate, Coordinate], ...] | None, Field(description="Single markers, x and y.")
    ] = None

    @model_validator(mode="after")
    def _expect_one_layout(self) -> "Markers":
        if (self.grid is None) == (self.points_mm is None):
            raise ValueError("expected either 'grid' or 'points_mm'")
        count = len(self.points_mm) if self.points_mm is not None else self.grid.columns * self.grid.rows  # type: ignore[union-attr]
        most = sensor_limits().max_markers
        if not 1 <= count <= most:
            raise ValueError(f"expected 1 to {most} markers, got {count}")
        return self

    def drawn_mm(self) -> "NDArray[np.float64]":
        """Return x and y of all markers [mm], shape [m, 2]; of a grid row by row, x fastest."""
        import numpy as np
        from vitac.envs.deterministic_math import sine_cosine

        if self.grid is None:
            return np.array(self.points_mm, dtype=np.float64)
        grid = self.grid
        x = (np.arange(grid.columns) - 0.5 * (grid.columns - 1)) * grid.spacing_mm[0]
        y = (np.arange(grid.rows) - 0.5 * (grid.rows - 1)) * grid.spacing_mm[1]
        x, y = np.tile(x, grid.rows), np.repeat(y, grid.columns)
        sine, cosine = sine_cosine(radians(grid.rotation_deg))
        return np.column_stack([cosine * x - sine * y + grid.centre_mm[0], sine * x + cosine * y + grid.centre_mm[1]])


class SensorManifest(StrictModel):
    """sensor.yaml; material, friction, noise and what senses are the organizers' and have no key here."""

    camera: Annotated[Camera, Field(description="Intrinsics; the challenge's by default.")] = Camera()
    markers: Annotated[Markers, Field(description="A grid of 9 x 7 at 2.05 mm by default.")] = Markers(grid=Grid())


def read_sensor(folder: Path) -> SensorManifest:
    """Return the sensor.yaml of a folder.

    Raises:
        SensorRejected: it is missing, too large, not YAML, or a key or value is wrong.
    """
    try:
        data = read_start(find_spelling(folder, SENSOR_NAME), _MAX_BYTES)
    except OSError as error:
        raise SensorRejected(f"Expected {SENSOR_NAME} in {folder}, but it cannot be read: {error.strerror}.") from error
    if len(data) > _MAX_BYTES:
        raise SensorRejected(f"{SENSOR_NAME} is larger than {_MAX_BYTES} bytes; make it smaller.")
    try:
        return parse_untrusted_yaml(SensorManifest, data.decode("utf-8"), SENSOR_NAME)
    except UnicodeDecodeError as error:
        raise SensorRejected(f"{SENSOR_NAME} is not UTF-8 ({error}); save it as UTF-8.") from error
    except DocumentRejected as error:
        raise SensorRejected(str(error)) from error
