"""The sensor that a training is for: tasks of Track 3 need one, and others are played with the challenge's."""

from pathlib import Path

from vitac.errors import VitacError
from vitac.evaluator.sensors.check import accepted_sensor
from vitac.evaluator.sensors.made import MadeSensor, made_sensor
from vitac.evaluator.tracks import Track


class SensorMismatch(VitacError):
    """A sensor was given for a task that has none, or none for one that needs it; the message says which."""


def make_sensor(track: Track, task: str, folder: Path | None) -> MadeSensor | None:
    """Return the sensor of a folder, meshed, or None for a task that has none.

    Raises:
        SensorMismatch: the task needs a sensor, or plays with the challenge's.
        SensorRejected: the sensor breaks a rule.
    """
    if (folder is None) == track.has_sensor:
        needed = "the folder of a sensor" if folder is None else "no sensor, as all play it with the same one"
        raise SensorMismatch(f"Expected {needed} for {task}.")
    return None if folder is None else made_sensor(accepted_sensor(folder))
