"""The process that forks shards, with short calibrations of sensors; `COMMAND` starts it.

A whole calibration plays 180 episodes, 15 s in each of the two runs of a sensor; tests of its result play fewer anyway.
"""

import sys

from vitac.evaluator import estimator
from vitac.evaluator.shards import host

COMMAND = (sys.executable, "-P", __file__)
STARTS = 6


def shorten() -> None:
    calibrate = estimator.calibrate
    setattr(estimator, "calibrate", lambda *of, **given: calibrate(*of, starts=STARTS, **given))  # noqa: B010


if __name__ == "__main__":
    shorten()
    host.main()
