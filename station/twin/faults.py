"""Scripts of faults: what breaks at a twin, and when."""

from enum import StrEnum
from pathlib import Path

from pydantic import PositiveFloat, PositiveInt
from vitac.evaluator.strict_model import StrictModel, read_yaml


class Fault(StrEnum):
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

    fault: Fault
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
