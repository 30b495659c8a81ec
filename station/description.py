"""The file that describes a station: its devices, their addresses and calibrations, its limits, and its track."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Final, Self

from pydantic import Field, PositiveFloat, PositiveInt, model_validator
from vitac.evaluator.strict_model import StrictModel, Word, read_yaml, validate
from vitac.evaluator.tracks import Track, load_track

Interval = Annotated[tuple[float, float], Field(description="[lowest, highest]")]
Byte = Annotated[int, Field(ge=0, le=255)]
Row = tuple[float, float, float, float, float, float]


class StationTask(StrEnum):
    """A simulated task that stations play, by its name."""

    PEG = "peg-insertion"
    LOCK = "lock-opening"
    FUSION = "fusion-insertion"


class Calibration(StrictModel):
    """What was measured on one device, and stays true only for that device."""

    serial_number: Word
    """Serial number of the device that was calibrated."""


class TwinClass(StrEnum):
    """How far a twin is from our simulation."""

    A = "A"
    """The same solver, mesh and contact model with other numbers."""
    B = "B"
    """Another structure, too."""


class TwinMark(StrictModel):
    """What says of a station, its trials and its figures that they are a twin's."""

    twin_class: TwinClass
    without: tuple[Word, ...] = ()
    """Differences of class B that were switched off."""
    identified: bool = False
    """Whether it has the settings that another station was identified with, and so stands for our simulation."""

    def __str__(self) -> str:
        off = f" without {', '.join(self.without)}" if self.without else ""
        source = " of identified settings" if self.identified else ""
        return f"a twin of class {self.twin_class}{source}{off}, no hardware"


class TactileCalibration(Calibration):
    """Calibration of a tactile sensor."""

    markers: PositiveInt
    """Markers that the tracker finds on the gel at rest."""


class TactileCameraSettings(StrictModel):
    """A GelSight Mini."""

    serial_number: Word
    stream: str | None = None
    """Address of a stream of pictures that is read in place of the USB camera, as a twin sends it."""
    calibration: TactileCalibration


class DepthCalibration(Calibration):
    """Intrinsics of the colour camera, to which depth is aligned [pixel]."""

    width: PositiveInt
    height: PositiveInt
    fx: PositiveFloat
    fy: PositiveFloat
    cx: PositiveFloat
    cy: PositiveFloat


class DepthCameraSettings(StrictModel):
    """A RealSense D415."""

    serial_number: Word
    firmware: Word
    stream: str | None = None
    """Address where another program gives its pairs of pictures, as a twin does."""
    calibration: DepthCalibration


class OverviewSettings(StrictModel):
    """A camera that sees the whole platform, and beside it a screen with the code of each trial."""

    serial_number: Word
    stream: str | None = None
    """Address of a stream of pictures in place of the USB camera, as a twin sends it."""
    code_picture: Path | None = None
    """Picture with the trial's code, which the agent writes for the screen."""


class ForceTorqueCalibration(Calibration):
    """Calibration of a force/torque sensor, from its maker's certificate."""

    decoupling: tuple[Row, Row, Row, Row, Row, Row]
    """Matrix from bridge voltages to forces and torques."""


class ForceTorqueSettings(StrictModel):
    """An SRI M3813A at its interface box M8128."""

    host: str
    port: Annotated[int, Field(ge=1, le=65535)] = 4008
    rate_hz: PositiveInt = 1000
    serial_number: Word
    calibration: ForceTorqueCalibration


class StageCalibration(Calibration):
    """Calibration of a stage."""

    steps: tuple[PositiveFloat, PositiveFloat, PositiveFloat, PositiveFloat]
    """Steps of x, y and z per mm, and of the rotary axis per degree."""


class StageSettings(StrictModel):
    """Three linear axes and a rotary axis at a controller that speaks GRBL 1.1."""

    port: str
    """Serial port, best by its name in /dev/serial/by-id."""
    serial_number: Word
    """Text stored in the controller with `$I=`."""
    firmware: Word
    """Version that the controller reports, as 1.1h.20190825."""
    calibration: StageCalibration


class GripperSettings(StrictModel):
    """A Robotiq Hand-E at a serial port. It reports neither serial number nor firmware over Modbus RTU."""

    port: str
    unit: Annotated[int, Field(ge=1, le=247)] = 9


class StageWorkspace(StrictModel):
    """Where the stage may go."""

    x_mm: Interval
    y_mm: Interval
    z_mm: Interval
    rotation_deg: Interval

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        for name, (low, high) in self.intervals().items():
            if low >= high:
                raise ValueError(f"{name}: expected [lowest, highest], got [{low}, {high}]")
        return self

    def intervals(self) -> dict[str, Interval]:
        """Return the interval of each axis, in the order of the stage's axes."""
        return {"x_mm": self.x_mm, "y_mm": self.y_mm, "z_mm": self.z_mm, "rotation_deg": self.rotation_deg}


class GripperLimits(StrictModel):
    """The hardest commands that the gripper gets, as its bytes: 0 to 255."""

    position: Annotated[tuple[Byte, Byte], Field(description="[widest open, closed furthest]")] = (0, 255)
    speed: Byte = 255
    force: Byte


class StationLimits(StrictModel):
    """What no command and no reading may pass. The limit on force and torque is ours: the challenge had none."""

    workspace: StageWorkspace
    speed_mm_s: PositiveFloat
    rotation_deg_s: PositiveFloat
    force_n: PositiveFloat
    torque_nm: PositiveFloat
    marker_movement_px: PositiveFloat = 30.0
    """Over-force of the challenge: its largest movement of a marker."""
    gripper: GripperLimits
    reading_s: PositiveFloat = 0.1
    """The stage stops if the force/torque sensor sent nothing for this long."""
    heartbeat_s: PositiveFloat = 0.5
    """The stage stops if whoever commands it was not heard for this long."""


class StagePose(StrictModel):
    """A pose of the stage."""

    x_mm: float
    y_mm: float
    z_mm: float
    rotation_deg: float = 0.0


class Prompts(StrictModel):
    """Pixels, u and v, of the RGB-D camera's picture at which the segmentation begins."""

    peg: tuple[int, int]
    base: tuple[int, int]


class Release(StrEnum):
    """Who lets a station move again that has stopped."""

    OPERATOR = "operator"
    """A person, after a look at it."""
    AUTOMATIC = "automatic"
    """Nobody: for twins, which break nothing."""


class Procedure(StrictModel):
    """Where trials take place, and how; the defaults are the challenge's."""

    task: StationTask = StationTask.PEG
    """That the mounted parts are for."""
    shape: Word
    """Peg and hole, or key and lock, that are mounted."""
    hole: StagePose
    """Where a peg stands on the plate, centred over its hole and turned with it; where the gripper holds a key at the
    middle of its handle that is as deep in its lock as any trial begins."""
    garage: StagePose
    """Where the gripper closes on the peg, or on the key in front of its lock."""
    safe_z_mm: float
    """Height at which the stage goes from garage to hole."""
    lateral_mm: PositiveFloat = 5.0
    """Height above the plate for motions with the peg beside the hole."""
    start_mm: PositiveFloat = 1.0
    """Height above the plate at which the descent begins."""
    z_step_mm: PositiveFloat = 0.125
    """Descent of every env step, as in simulation."""
    step_mm_s: PositiveFloat = 3.0
    """Speed of env steps; between trials the stage moves at the limit."""
    descent_mm: PositiveFloat = 2.0
    """Length of the descent until a gel must have met the plate."""
    descent_mm_s: PositiveFloat = 0.4
    descent_timeout_s: PositiveFloat = 4.275
    """Without contact after this part of the descent the start counts as not blocked."""
    push_mm: PositiveFloat = 3.0
    """Length of the push test."""
    push_mm_s: PositiveFloat = 1.5
    picture_s: PositiveFloat = 0.04
    """Time between pictures of the tactile cameras; waits are counted in pictures."""
    latency_s: Annotated[float, Field(ge=0)] = 0.12
    """By how much pictures are late; waits are longer by it."""
    open_position: Byte = 100
    """Position of the open gripper; one further closed holds a peg."""
    grip_force: Byte = 50
    prompts: Prompts | None = None
    """Needed where policies read the points of objects."""
    sam_weights: Path | None = None
    """Weights of SAM (ViT-B), which segments in place of colour and depth."""
    zero_n: PositiveFloat = 2.0
    """What the force/torque sensor may show of a peg that hangs in free air; more is an error of its zero."""
    zero_nm: PositiveFloat = 0.1
    release: Release = Release.OPERATOR
    free_gb: PositiveFloat = 1.0
    """Free space on the disk that a trial needs."""


class StationDescription(StrictModel):
    """A station."""

    name: Word
    left: TactileCameraSettings
    right: TactileCameraSettings
    depth_camera: DepthCameraSettings | None = None
    overview: OverviewSettings | None = None
    """Its pictures are in the videos of trials."""
    force_torque: ForceTorqueSettings
    stage: StageSettings
    gripper: GripperSettings
    limits: StationLimits
    procedure: Procedure | None = None
    """How trials are played; without it a station can only be checked."""
    patience: Annotated[float, Field(ge=1)] = 1.0
    """Factor of the times within which devices have to answer: more than 1 for a twin, which shares the cores of its
    computer with the station."""
    twin: TwinMark | None = None
    """Where it is a twin: every result and figure of it says so."""

    @property
    def twin_words(self) -> str | None:
        """What kind of twin it is; None for hardware."""
        return str(self.twin) if self.twin else None

    @model_validator(mode="after")
    def _check_devices(self) -> Self:
        if self.left.serial_number == self.right.serial_number:
            raise ValueError(f"left and right are both {self.left.serial_number}; expected two tactile sensors")
        if self.left.stream is not None and self.left.stream == self.right.stream:
            raise ValueError(f"left and right are both read from {self.left.stream}; expected two streams")
        if self.stage.port == self.gripper.port:
            raise ValueError(f"stage and gripper are both at {self.stage.port}; expected two serial ports")
        return self


def read_description(path: Path) -> StationDescription:
    """Read the file of a station.

    Raises:
        DocumentRejected: with one sentence for each thing that is wrong in it.
    """
    return read_yaml(StationDescription, path)


_NAMES: Final = {
    StationTask.PEG: ("track_1", "station"),
    StationTask.LOCK: ("track_1", "station_lock"),
    StationTask.FUSION: ("track_2", "station_fusion"),
}
"""Of the simulated track, and of that of stations."""
_ENDS: Final = (
    "A marker that moves too far, or the limit of force or torque that stops the policy for the second time, ends a "
    "trial as `tactile`. An action that leads {range} ends it as `error`, and nothing moves. {steps} env steps end it."
)
_SUCCESS_RULES: Final = {
    StationTask.PEG: (
        "The peg is more than 0.35 mm below the height at which a gel felt the plate, the markers of both gels moved "
        "by less than three times what is noise (more after large movements), and a push of 3 mm down moves them by "
        "less than five times as much.",
        "further than 12 mm or 15 degrees from the hole",
    ),
    StationTask.LOCK: (
        "The gripper is more than 4 mm higher than where the key went into its lock, the markers of both gels moved by "
        "less than three times what is noise (more after large movements), and a pull outwards is felt within 5 mm.",
        "beyond -5 to 70 mm along the key from its deepest place, or -3 to 12 mm in height,",
    ),
    StationTask.FUSION: (
        "The peg is more than 1 mm below the rim, within 6 mm in x and y and 10 degrees of its own hole, and the "
        "markers of both gels moved by less than three times what is noise (more after large movements).",
        "further than 12 mm in x, 30 mm in y or 20 degrees from its own hole, or beyond 7.1 mm below to 22.9 mm above "
        "the rim,",
    ),
}
"""When a trial succeeds, and the range of an action; the procedures are `trial`, `lock_trial` and `trials`."""
_PEG_NOTE: Final = "Where a start is not blocked at a station, the next one of the list takes its place."


def make_station_track(
    shape: str, repeats: int, *, starts: int | None = None, task: StationTask = StationTask.PEG
) -> dict[str, Any]:
    """Return the content of a track file: public starts of a shape, each so often, one trial in a shard.

    Args:
        shape: of the peg or key that is mounted.
        repeats: of each start.
        starts: how many of them, the first ones; all if None.
        task: that is played.
    """
    source, name = _NAMES[task]
    simulated = load_track(source)
    played = simulated.tasks[task]
    distinct = dict.fromkeys(
        (start.shape, start.offset) for start in played.episode_list.starts if start.shape == shape
    )
    chosen = list(distinct)[:starts]
    own: dict[str, Any] = played.model_dump(mode="json", exclude_defaults=True, exclude={"name_2025", "profiles"})
    rule, beyond = _SUCCESS_RULES[task]
    own |= {
        "name": f"{task}-station",
        "title": f"{played.title} on a station",
        "station_of": str(task),
        "success_rule": f"{rule} {_ENDS.format(range=beyond, steps=played.max_steps)}",
        "notes": [
            f"{len(chosen)} starts with the {shape}, {repeats} times each. They are not observed.",
            *([_PEG_NOTE] if task is StationTask.PEG else []),
        ],
    }
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
