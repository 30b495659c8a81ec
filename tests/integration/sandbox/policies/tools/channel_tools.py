"""Lies beside every hostile policy: makes frames of its own and finds the channel to send them over."""

import json
import os
import stat
import struct
import sys


def channel():
    """The descriptor of the channel, found among the open ones."""
    for descriptor in range(3, 256):
        try:
            if stat.S_ISSOCK(os.fstat(descriptor).st_mode):
                return descriptor
        except OSError:
            pass
    raise RuntimeError("no channel")


def frame(seq, kind="action", arrays=None, payload=None, **more):
    payload = struct.pack("<3f", 9, 9, 9) if payload is None else payload
    arrays = [{"name": "action", "dtype": "f4", "shape": [3]}] if arrays is None else arrays
    header = json.dumps({"seq": seq, "kind": kind, "arrays": arrays, **more}).encode()
    return struct.pack("<4sIQ", b"VTC1", len(header), len(payload)) + header + payload


def seq():
    """The number of the question that is being answered, from the runtime's own frame."""
    frames = sys._getframe()
    while frames and "connection" not in frames.f_locals:
        frames = frames.f_back
    return frames.f_locals["connection"]._seq
