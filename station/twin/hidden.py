"""What a twin hides from what plays on it: its true numbers and structure, and the script of its faults."""

import hashlib
from enum import StrEnum
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import yaml
from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt
from vitac.envs.tasks.settings import SILICONE_POISSON_RATIO
from vitac.evaluator.strict_model import StrictModel, read_yaml, validate

from ..description import TwinClass, TwinMark
from .structure import Difference, HiddenStructure, draw_structure

Pair = tuple[float, float]


class HiddenSensor(StrictModel):
    """One tactile sensor: how its camera is mounted, and the state of its gel."""

    shift_px: Pair = (0.0, 0.0)
    """Of the whole picture, as the camera is mounted."""
    turn_deg: float = 0.0
    """Of the picture about its middle."""
    distortion: float = 0.0
    """Relative distance from the middle that the lens adds at the corner of the cut picture."""
    light: PositiveFloat = 1.0
    """Factor of the brightness."""
    noise: NonNegativeFloat = 2.0
    """Standard deviation of a colour's value."""
    defocus_px: PositiveFloat = 1.0
    misprint_px: NonNegativeFloat = 1.0
    """Largest distance of a printed marker from its grid."""
    worn: NonNegativeInt = 0
    """Number of pale markers."""
    seed: NonNegativeInt = 0
    """Of the places of markers and the noise."""


class HiddenSettings(StrictModel):
    """A twin in numbers; the defaults are public, those of rehearsals."""

    gel_friction: PositiveFloat = 1.0
    """Coefficient of a gel against the peg."""
    plate_friction: NonNegativeFloat = 0.3
    """Coefficient of the peg against the plate."""
    youngs_modulus_pa: PositiveFloat = 3e5
    poisson_ratio: float = Field(default=SILICONE_POISSON_RATIO, ge=0, le=0.499)
    indentation_mm: float = Field(default=0.875, gt=0, le=1.5)
    """How far the closed gripper presses each gel into the peg."""
    grasp_x_mm: float = 0.0
    """Where the gripper grasps the peg, beside its middle."""
    grasp_z_mm: float = 0.0
    """Where it grasps the peg, above the place that the station expects."""
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where the hole really is, from the place in the station's file: x [mm], y [mm], angle [deg]."""
    plate_mm: float = 0.0
    """How much higher the plate is than the station expects."""
    backlash_mm: NonNegativeFloat = 0.0
    """Play of each linear axis when it turns round."""
    lost_steps: NonNegativeFloat = 0.0
    """Part of each way along x and y that is lost though it is counted."""
    latency_s: NonNegativeFloat = 0.04
    """Time by which the pictures of both cameras are late."""
    drift_px_h: NonNegativeFloat = 0.0
    """Speed at which markers leave their places as the sensors warm up."""
    force_drift_n_h: float = 0.0
    """Speed at which the zero of the force/torque sensor drifts along z."""
    rig: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """How the RGB-D camera is mounted off its place: x and z [mm], turn [deg]."""
    left: HiddenSensor = HiddenSensor(seed=1)
    right: HiddenSensor = HiddenSensor(seed=2)
    structure: HiddenStructure = HiddenStructure()


PUBLIC_SETTINGS: Final = HiddenSettings()
"""A twin without surprises, for rehearsals."""


def draw_hidden(secret: bytes) -> HiddenSettings:
    """Draw a twin from a secret; the same secret gives the same twin."""
    generator = _generator(secret)

    def between(low: float, high: float) -> float:
        return float(generator.uniform(low, high))

    return HiddenSettings(
        gel_friction=between(0.8, 1.2),
        plate_friction=between(0.15, 0.45),
        youngs_modulus_pa=between(2.4e5, 3.8e5),
        indentation_mm=between(0.7, 1.0),
        grasp_x_mm=between(-0.8, 0.8),
        grasp_z_mm=between(-0.3, 0.3),
        origin=(between(-0.2, 0.2), between(-0.2, 0.2), between(-0.3, 0.3)),
        plate_mm=between(-0.2, 0.2),
        backlash_mm=between(0.0, 0.04),
        lost_steps=between(0.0, 5e-4),
        latency_s=between(0.02, 0.12),
        drift_px_h=between(0.0, 1.0),
        left=_draw_sensor(generator),
        right=_draw_sensor(generator),
        force_drift_n_h=between(-2.0, 2.0),
        rig=(between(-0.5, 0.5), between(-0.5, 0.5), between(-0.1, 0.1)),
        poisson_ratio=between(0.45, 0.49),
    )


class TwinSecret(StrictModel):
    """Secret file of a twin whose class is chosen."""

    secret: str
    """From which everything is drawn."""
    twin: TwinClass = TwinClass.A
    without: tuple[Difference, ...] = ()
    """Differences of class B that are switched off; nothing else changes."""


class Twin(NamedTuple):
    """A twin, and what its station's file says of it."""

    hidden: HiddenSettings
    mark: TwinMark


PUBLIC_TWIN: Final = Twin(PUBLIC_SETTINGS, TwinMark(twin_class=TwinClass.A))


def read_secret(path: Path) -> Twin:
    """Return the twin of a secret file: what `TwinSecret` says in YAML, or any other content for one of class A.

    Raises:
        DocumentRejected: with one sentence for each thing that is wrong in it.
    """
    content = path.read_bytes()
    try:
        document = yaml.safe_load(content)
    except (yaml.YAMLError, UnicodeDecodeError):
        document = None
    if not isinstance(document, dict):
        return Twin(draw_hidden(content), TwinMark(twin_class=TwinClass.A))
    return make_twin(validate(TwinSecret, document, str(path)))


def make_twin(chosen: TwinSecret) -> Twin:
    """Return the twin that a secret says."""
    hidden = draw_hidden(chosen.secret.encode())
    if chosen.twin is TwinClass.B:
        structure = draw_structure(_generator(f"structure {chosen.secret}".encode())).without(chosen.without)
        hidden = hidden.model_copy(update={"structure": structure})
    return Twin(hidden, TwinMark(twin_class=chosen.twin, without=chosen.without))


def _generator(secret: bytes) -> np.random.Generator:
    return np.random.default_rng(int.from_bytes(hashlib.sha256(secret).digest()))


def _draw_sensor(generator: np.random.Generator) -> HiddenSensor:
    shift_u, shift_v, turn, lens, light, noise, defocus = generator.uniform(-1.0, 1.0, 7).tolist()
    return HiddenSensor(
        shift_px=(4.0 * shift_u, 4.0 * shift_v),
        turn_deg=1.5 * turn,
        distortion=0.03 * lens,
        light=1.0 + 0.15 * light,
        noise=2.5 + 1.5 * noise,
        defocus_px=1.2 + 0.4 * defocus,
        worn=int(generator.integers(0, 6)),
        seed=int(generator.integers(1, 2**31)),
    )


class TwinFault(StrEnum):
    """What can break."""

    UNPLUGGED_CAMERA = "unplugged-camera"
    FROZEN_STREAM = "frozen-stream"
    STUCK_GRIPPER = "stuck-gripper"
    """Its fingers stay where they are, and it reports that they move."""
    DROPPED_PEG = "dropped-peg"
    TORN_GEL = "torn-gel"
    """A part of the left gel is gone, with its markers."""
    FORCE_SPIKE = "force-spike"
    """One frame of the force/torque sensor is far too large."""
    STAGE_ALARM = "stage-alarm"
    """The next motion meets a limit switch."""
    NETWORK_CUT = "network-cut"
    """The box of the force/torque sensor cannot be reached."""


class ScriptedFault(StrictModel):
    """One fault of a script."""

    fault: TwinFault
    contact: PositiveInt
    """It begins when the peg has touched the plate this often."""
    for_s: PositiveFloat = 2.0
    """Time after which it is mended, by the twin's clock."""


class FaultScript(StrictModel):
    """All faults of a run."""

    faults: tuple[ScriptedFault, ...] = ()


def read_faults(path: Path) -> FaultScript:
    """Read a script of faults.

    Raises:
        DocumentRejected: with one sentence for each thing that is wrong in it.
    """
    return read_yaml(FaultScript, path)
