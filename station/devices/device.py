"""What all drivers share: the identity of a device, and how it fails."""

from dataclasses import dataclass

from vitac.envs.errors import VitacError


class DeviceNotFound(VitacError):
    """Nothing answers at the device's address; check cable, power and the address in the station's file."""


class DeviceInUse(DeviceNotFound):
    """Another program talks to the device, perhaps while it moves; end that one first."""


class DeviceFault(VitacError):
    """A device answers wrongly, reports a fault or stopped answering; the message says which and what to do."""


@dataclass(frozen=True, kw_only=True)
class Identity:
    """What a device reports about itself; None for what it does not report."""

    serial_number: str | None = None
    firmware: str | None = None
