"""Every limit on a submission in one place: shown in the rules, stored with the result, changed by settings only."""

from dataclasses import dataclass, fields

from vitac.envs.errors import VitacError

KIB = 1024
MIB = 1024 * KIB
GIB = 1024 * MIB


class LimitsInvalid(VitacError):
    """A limit is not a positive number: correct the setting that the message names."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What one submission may use; sizes in bytes, times in seconds."""

    memory_bytes: int = 3 * GIB
    """Memory of the policy and its children together (memory cgroup, else the watchdog)."""
    address_space_bytes: int = 4 * GIB
    """Address space of each process."""
    processes: int = 64
    """Processes and threads together."""
    open_files: int = 256
    file_size_bytes: int = 64 * MIB
    """Size of one written file."""
    tmp_bytes: int = 64 * MIB
    shm_bytes: int = 16 * MIB

    start_cpu_s: float = 60.0
    """Import and constructor."""
    start_wall_s: float = 120.0
    action_cpu_s: float = 2.0
    """One answer: an action, or the end of reset()."""
    action_wall_s: float = 10.0
    episode_cpu_s: float = 30.0
    shard_cpu_s: float = 300.0
    """All episodes of a shard together, with every load."""
    shard_wall_s: float = 900.0
    """Waiting for the policy in all episodes of a shard together, with every load."""

    output_kept_bytes: int = 64 * KIB
    """Length of the end of the policy's output that is stored for its team."""
    output_killed_bytes: int = 4 * MIB
    """Output of one start or one episode at which the policy is stopped."""

    archive_packed_bytes: int = 512 * MIB
    archive_unpacked_bytes: int = 1 * GIB
    archive_files: int = 5_000
    """Files and folders, with the folders that paths imply."""
    archive_depth: int = 16
    archive_ratio: float = 200.0
    """Unpacked over packed size."""

    message_bytes: int = 16 * MIB
    """One message on the channel."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not value > 0:
                raise LimitsInvalid(f"Limit {field.name} is {value!r}, expected a number above 0; correct the setting.")
