"""Opens all devices of a station, as trials and the agent need them."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from vitac.envs.errors import VitacError

from .description import Procedure, StationDescription
from .devices.depth_camera import AnyDepthCamera, open_depth_camera
from .devices.force_torque import ForceTorqueSensor
from .devices.gripper import Gripper
from .devices.stage import Stage, StageState
from .eyes import Eyes, open_cameras
from .guard import Guard


class NoProcedure(VitacError):
    """The station's file says nothing of trials; add `procedure` to it."""


@dataclass(kw_only=True)
class OpenStation:
    """A station whose guard and eyes are at work.

    Attributes:
        procedure: how trials are played on it.
        thresholds_px: movement of both gels that is more than noise, since the last grasp; None before it.
    """

    description: StationDescription
    procedure: Procedure
    stage: Stage
    gripper: Gripper
    guard: Guard
    eyes: Eyes
    depth_camera: AnyDepthCamera | None = None
    thresholds_px: tuple[float, float] | None = None


@contextmanager
def open_station(description: StationDescription) -> Iterator[OpenStation]:
    """Open the devices and watch them until the context ends.

    A stage in alarm is homed, one that was held gives up its motion, and the force/torque sensor is zeroed if the
    gripper holds nothing: whoever calls this has made the station safe.

    Raises:
        DeviceNotFound: nothing answers at a device's address.
        DeviceFault: a device does not do what it is asked for.
        NoProcedure: the file has none.
    """
    if description.procedure is None:
        raise NoProcedure(f"The file of {description.name} has no `procedure`: add where hole and garage are.")
    with ExitStack() as stack:
        stage = stack.enter_context(Stage(description.stage.port))
        gripper = stack.enter_context(Gripper(description.gripper.port, unit=description.gripper.unit))
        box = stack.enter_context(ForceTorqueSensor(description.force_torque.host, description.force_torque.port))
        left, right = open_cameras(description, stack)
        described = description.depth_camera
        depth_camera: AnyDepthCamera | None = open_depth_camera(described) if described else None
        if depth_camera is not None:
            stack.enter_context(depth_camera)
        _make_ready(stage, gripper, box, description)
        guard = stack.enter_context(Guard(limits=description.limits, stage=stage, gripper=gripper, force_torque=box))
        eyes = stack.enter_context(Eyes(left=left, right=right, guard=guard))
        yield OpenStation(
            description=description,
            procedure=description.procedure,
            stage=stage,
            gripper=gripper,
            guard=guard,
            eyes=eyes,
            depth_camera=depth_camera,
        )


def _make_ready(stage: Stage, gripper: Gripper, box: ForceTorqueSensor, description: StationDescription) -> None:
    state = stage.status().state
    if state is StageState.ALARM:
        stage.home()
    elif state is StageState.HOLD:
        stage.forget_motion()
    gripper.activate()
    procedure = description.procedure
    if procedure is not None and gripper.status().position <= procedure.open_position:
        box.stop()
        box.zero()
    box.start(description.force_torque.rate_hz)
