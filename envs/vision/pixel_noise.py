"""Noise of pixels that follows from a key and the number of the pixel alone; called where pictures are exposed."""

from math import sqrt

import numpy as np

from ..compilation import kernel

# Mean and standard deviation of the sum of eight random bytes.
_BYTES_MEAN = 8 * 127.5
_BYTES_SD = sqrt(8 * (256.0**2 - 1.0) / 12.0)
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
# Every second byte, and what a product adds four numbers of two bytes with.
_EVEN_BYTES = np.uint64(0x00FF00FF00FF00FF)
_ADD_FOUR = np.uint64(0x0001000100010001)


@kernel
def draw_noise(key: np.uint64, counter: np.uint64) -> float:
    """Return a number that is nearly standard normal: the sum of the eight bytes of a mixed counter, scaled.

    The mixer is splitmix64 (Steele, Lea & Flood 2014). A counter rather than a stream, so that the noise of a pixel
    does not depend on how many others show something.
    """
    z = key + (counter + np.uint64(1)) * _GOLDEN
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    pairs = (z & _EVEN_BYTES) + ((z >> np.uint64(8)) & _EVEN_BYTES)
    total = (pairs * _ADD_FOUR) >> np.uint64(48)
    return (float(total) - _BYTES_MEAN) / _BYTES_SD
