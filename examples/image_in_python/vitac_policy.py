"""Plays ViTac Arena's episodes from inside a container image: `serve(Policy())` in ten lines.

One file, which needs nothing but Python 3.6 or newer. A policy has `act(observation)`, which returns one number for
each action component, and may have `reset(task)`. Observations are NumPy arrays where NumPy can be imported, and else
memory views, of which `tolist()` makes lists. The frames are described in docs/policy-protocol.md.
"""

import array
import itertools
import json
import os
import struct
import sys
import traceback

PREFIX = struct.Struct("<4sIQ")
MAGIC = b"VTC1"
FORMATS = {"u1": "B", "u2": "H", "i2": "h", "i4": "i", "i8": "q", "f4": "f", "f8": "d", "b1": "?"}
MESSAGE_CHARACTERS = 2000


def serve(policy, channel=None):
    """Answer the evaluator's questions until it ends this process.

    Args:
        policy: an object with `act`.
        channel: descriptor of the channel; by default the one that the image's command has inherited.
    """
    use_named_pipes()
    channel = int(os.environ["VITAC_CHANNEL"]) if channel is None else channel
    with open(channel, "rb", closefd=False) as questions:
        while True:
            seq, kind, text, arrays = read_question(questions)
            answer = {"seq": seq, "kind": "failed", "code": "crashed"}
            payload = b""
            try:
                if kind == "load":
                    answer["kind"] = "loaded"
                elif kind == "reset":
                    if hasattr(policy, "reset"):
                        policy.reset(text)
                    answer["kind"] = "ready"
                elif kind == "observe":
                    action = array.array("d", [float(number) for number in policy.act(arrays)])
                    payload = action.tobytes()
                    answer["arrays"] = [{"name": "action", "dtype": "f8", "shape": [len(action)]}]
                    answer["kind"] = "action"
                else:
                    answer["kind"] = "belief"  # of which this says nothing
            except Exception as error:  # noqa: BLE001 - a policy may raise anything
                traceback.print_exc()
                sys.stderr.flush()
                answer["message"] = (type(error).__name__ + ": " + str(error))[:MESSAGE_CHARACTERS]
            send(channel, answer, payload)


def read_question(questions):
    """Return number, kind, text and arrays of the next question."""
    _, header_bytes, payload_bytes = PREFIX.unpack(read_exactly(questions, PREFIX.size))
    header = json.loads(read_exactly(questions, header_bytes).decode("utf-8"))
    payload = memoryview(bytearray(read_exactly(questions, payload_bytes)))
    arrays = {}
    start = 0
    for spec in header["arrays"]:
        size = struct.calcsize(FORMATS[spec["dtype"]])
        for length in spec["shape"]:
            size *= length
        arrays[spec["name"]] = shaped(payload[start : start + size], spec["dtype"], spec["shape"])
        start += size
    return header["seq"], header["kind"], header["text"], arrays


def shaped(data, dtype, shape):
    """Return the bytes of an array as one that the policy may change."""
    try:
        import numpy as np
    except ImportError:
        numbers = data.cast(FORMATS[dtype])
        return data.cast(FORMATS[dtype], shape) if shape and 0 not in shape else numbers
    return np.frombuffer(data, dtype="<" + dtype).reshape(shape)


def read_exactly(questions, n_bytes):
    """Return the next bytes; end quietly where the evaluator has gone."""
    data = questions.read(n_bytes)
    if len(data) < n_bytes:
        os._exit(0)
    return data


def send(channel, answer, payload):
    """Write one frame."""
    header = json.dumps(answer).encode("ascii")
    left = memoryview(PREFIX.pack(MAGIC, len(header), len(payload)) + header + payload)
    while left:
        left = left[os.write(channel, left) :]


def use_named_pipes():
    """Give `os.pipe` back, by which `subprocess` works: the sandbox has no other pipes than those with names."""
    numbers = itertools.count()

    def open_pipe():
        name = "/tmp/.pipe-%d-%d" % (os.getpid(), next(numbers))  # noqa: S108, UP031 - the sandbox's own
        os.mkfifo(name, 0o600)
        read = os.open(name, os.O_RDONLY | os.O_NONBLOCK)
        write = os.open(name, os.O_WRONLY)
        os.unlink(name)  # noqa: PTH108 - as the rest
        os.set_blocking(read, True)
        return read, write

    os.pipe = open_pipe
