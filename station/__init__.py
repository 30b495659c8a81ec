"""The real platform: a laboratory's devices down to the bytes, limits before any motion, perception from pictures."""
