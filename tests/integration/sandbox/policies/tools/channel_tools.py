"""Lies beside every hostile policy: what it is to meet, frames of its own, and the channel to send them over."""

import json
import os
import stat
import struct
import sys


def expects(verdict, where="episode", **limits):
    """Say what a policy meets and under which smaller limits; a function is the `act` of a policy."""

    def marked(made):
        policy = made if isinstance(made, type) else type(made.__name__, (), {"reset": lambda self, task: None, "act": made})
        policy.expected = {"verdict": verdict, "where": where, "limits": limits}
        return policy

    return marked


class Counting:
    """A policy whose action says how many episodes it has seen before its own."""

    seen = 0

    def reset(self, task):
        pass

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]


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
