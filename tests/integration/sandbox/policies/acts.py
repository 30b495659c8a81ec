"""Policies that are hostile in `act`, which each function is."""

import ctypes
import os
import resource
import signal
import socket
import struct
import sys
import threading
import time

import numpy as np
from channel_tools import channel, expects, frame, seq


@expects("crashed")
def aborts(self, observation):
    os.abort()


@expects("protocol_violation")
def announces_a_huge_header(self, observation):
    os.write(channel(), struct.pack("<4sIQ", b"VTC1", 0xFFFFFFFF, 12))
    time.sleep(60)


@expects("protocol_violation")
def announces_a_negative_shape(self, observation):
    os.write(channel(), frame(seq(), arrays=[{"name": "action", "dtype": "f4", "shape": [-3]}]))
    time.sleep(60)


@expects("protocol_violation")
def announces_an_overflowing_shape(self, observation):
    os.write(channel(), frame(seq(), arrays=[{"name": "action", "dtype": "f4", "shape": [2**31] * 8}]))
    time.sleep(60)


@expects("protocol_violation")
def announces_loading_again(self, observation):
    os.write(channel(), frame(seq(), "loaded", [], b""))
    time.sleep(60)


@expects("protocol_violation")
def announces_object_arrays(self, observation):
    os.write(channel(), frame(seq(), arrays=[{"name": "action", "dtype": "O", "shape": [3]}]))
    time.sleep(60)


@expects("protocol_violation")
def announces_other_sizes(self, observation):
    os.write(channel(), frame(seq(), arrays=[{"name": "action", "dtype": "f4", "shape": [4]}]))
    time.sleep(60)


@expects("protocol_violation")
def announces_too_much(self, observation):
    os.write(channel(), struct.pack("<4sIQ", b"VTC1", 100, 1 << 60))
    time.sleep(60)


@expects("protocol_violation")
def answers_another_question(self, observation):
    os.write(channel(), frame(seq() + 1))
    time.sleep(60)


@expects("protocol_violation", action_wall_s=2)
def answers_from_a_child(self, observation):
    if os.fork() == 0:
        os.write(channel(), frame(seq()))
    time.sleep(60)


@expects("protocol_violation")
def answers_twice(self, observation):
    os.write(channel(), frame(seq()))
    return [0.0, 0.0, 0.0]


@expects("protocol_violation")
def answers_with_another_kind(self, observation):
    os.write(channel(), frame(seq(), "ready"))
    time.sleep(60)


@expects("cpu_time", action_cpu_s=0.5, action_wall_s=60.0)
def burns_time_in_short_lived_children(self, observation):
    while True:
        child = os.fork()
        if child == 0:
            start = time.process_time()
            while time.process_time() - start < 0.02:
                pass
            os._exit(0)
        os.waitpid(child, 0)


@expects("harmless")
def closes_its_output(self, observation):
    os.closerange(1, 3)
    return [0.0, 0.0, 0.0]


@expects("crashed")
def closes_the_channel(self, observation):
    os.close(channel())
    return [0.0, 0.0, 0.0]


@expects("wall_time", action_wall_s=0.5)
def closes_the_channel_and_waits(self, observation):
    os.close(channel())
    time.sleep(60)


@expects("out_of_memory")
def eats_address_space(self, observation):
    bytearray(1 << 40)


@expects("out_of_memory", memory_bytes=300_000_000)
def eats_memory(self, observation):
    kept = [bytearray(os.urandom(1 << 20)) * 64 for _ in range(1000)]


@expects("out_of_memory", memory_bytes=300_000_000, action_wall_s=5)
def eats_memory_in_many_processes(self, observation):
    for _ in range(20):
        if os.fork() == 0:
            kept = bytearray(40_000_000)
            for position in range(0, len(kept), 4096):
                kept[position] = 1
            time.sleep(60)
    time.sleep(60)


@expects("crashed")
def ends_its_process(self, observation):
    os._exit(0)


@expects("crashed")
def fills_temporary_folders(self, observation):
    for number in range(1000):
        with open(f"/dev/shm/{number}", "wb") as file:
            file.write(bytes(1 << 20))


@expects("output_flood")
def floods_errors_from_a_child(self, observation):
    if os.fork() == 0:
        while True:
            os.write(2, b"x" * 1000)
    os.wait()


@expects("output_flood")
def floods_output(self, observation):
    while True:
        print("x" * 1000)


@expects("too_many_processes")
def fork_bomb(self, observation):
    while True:
        try:
            os.fork()
        except OSError:
            pass


@expects("too_many_processes")
def forks_until_refused(self, observation):
    while True:
        if os.fork() == 0:
            time.sleep(60)


@expects("harmless")
def honest(self, observation):
    return np.zeros(3, dtype=np.float32)


@expects("crashed")
def huge_exception_message(self, observation):
    raise ValueError("x" * 1_000_000)


@expects("crashed")
def kills_everything(self, observation):
    os.kill(-1, signal.SIGKILL)
    os.kill(os.getpid(), signal.SIGKILL)


@expects("crashed")
def kills_itself(self, observation):
    os.kill(os.getpid(), signal.SIGKILL)


@expects("crashed")
def leaves_a_child_with_the_channel(self, observation):
    if os.fork() == 0:
        time.sleep(60)
    os._exit(0)


@expects("harmless")
def leaves_daemons_behind(self, observation):
    if os.fork() == 0:
        os.setsid()
        if os.fork() == 0:
            while True:
                time.sleep(0.01)
        os._exit(0)
    return [0.0, 0.0, 0.0]


@expects("harmless")
def looks_for_seeds(self, observation):
    found = [key for key in observation if key not in {"marker_flow", "relative_motion"}]
    return [float(len(found)), 0.0, 0.0]


@expects("crashed")
def opens_too_many_files(self, observation):
    kept = [open("/dev/null") for _ in range(10_000)]


@expects("harmless")
def prints_what_is_not_text(self, observation):
    os.write(1, b"\xff\xfe\x00\x1b[31m\r\n\x07")
    return [0.0, 0.0, 0.0]


@expects("crashed")
def raises_in_act(self, observation):
    raise ValueError("cannot decide")


@expects("harmless")
def raises_its_limits(self, observation):
    found = 0
    for kind in (resource.RLIMIT_AS, resource.RLIMIT_NPROC, resource.RLIMIT_FSIZE, resource.RLIMIT_CPU, resource.RLIMIT_NOFILE):
        try:
            resource.setrlimit(kind, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
            found += 1
        except (ValueError, OSError):
            pass
    return [float(found), 0.0, 0.0]


@expects("crashed")
def raises_system_exit(self, observation):
    raise SystemExit(0)


@expects("harmless")
def reads_environment(self, observation):
    allowed = {"HOME", "LANG", "PATH", "PWD", "PYTHONHASHSEED", "TMPDIR", "LD_LIBRARY_PATH"}
    found = [name for name in os.environ if name not in allowed and not name.endswith("_NUM_THREADS")]
    found += [value for value in os.environ.values() if "/home" in value or "/root" in value]
    return [float(len(found)), 0.0, 0.0]


@expects("wall_time", action_wall_s=0.5)
def reads_the_next_question(self, observation):
    os.read(channel(), 1 << 20)
    time.sleep(60)


@expects("crashed")
def recurses(self, observation):
    return self.act(observation)


@expects("protocol_violation")
def replaces_the_runtime(self, observation):
    main = sys.modules["__main__"]
    main.Connection.write = lambda self, kind, **more: self._socket.sendall(b"I am the evaluator")
    return [0.0, 0.0, 0.0]


@expects("bad_action_shape")
def returns_a_batch(self, observation):
    return np.zeros((1, 3), dtype=np.float32)


@expects("bad_action_type")
def returns_a_dictionary(self, observation):
    return {"action": [0, 0, 0]}


@expects("bad_action_shape")
def returns_a_scalar(self, observation):
    return 0.0


@expects("bad_action_shape")
def returns_an_enormous_array(self, observation):
    return np.zeros(10_000_000)


@expects("bad_action_type")
def returns_complex_numbers(self, observation):
    return [1j, 0, 0]


@expects("non_finite_action")
def returns_infinity(self, observation):
    return [0.0, float("-inf"), 0.0]


@expects("harmless")
def returns_list(self, observation):
    return [0, 0.0, False]


@expects("non_finite_action")
def returns_nan(self, observation):
    return [0.0, float("nan"), 0.0]


@expects("bad_action_type")
def returns_nothing(self, observation):
    pass


@expects("bad_action_type")
def returns_objects(self, observation):
    return np.array([object(), None, 1], dtype=object)


@expects("bad_action_type")
def returns_ragged_lists(self, observation):
    return [[0.0], [0.0, 1.0], 3]


@expects("bad_action_type")
def returns_text(self, observation):
    return "up"


@expects("non_finite_action")
def returns_too_large_for_float32(self, observation):
    return [0.0, 1e300, 0.0]


@expects("bad_action_shape")
def returns_wrong_shape(self, observation):
    return [0.0, 0.0]


@expects("crashed")
def segfaults(self, observation):
    ctypes.string_at(8)


@expects("protocol_violation")
def sends_a_foreign_verdict(self, observation):
    os.write(channel(), frame(seq(), "failed", [], b"", code="sandbox_failed", message="not my fault"))
    time.sleep(60)


@expects("protocol_violation")
def sends_descriptors(self, observation):
    sock = socket.socket(fileno=os.dup(channel()))
    descriptor = os.open("/dev/null", os.O_RDONLY)
    socket.send_fds(sock, [frame(seq())], [descriptor])
    time.sleep(60)


@expects("protocol_violation")
def sends_extra_arrays(self, observation):
    two = [{"name": name, "dtype": "f4", "shape": [3]} for name in ("action", "more")]
    os.write(channel(), frame(seq(), arrays=two, payload=bytes(24)))
    time.sleep(60)


@expects("protocol_violation")
def sends_for_ever(self, observation):
    while True:
        os.write(channel(), bytes(65536))


@expects("protocol_violation")
def sends_garbage(self, observation):
    os.write(channel(), os.urandom(4096))
    time.sleep(60)


@expects("crashed")
def sends_half_a_frame_and_ends(self, observation):
    os.write(channel(), frame(seq())[:30])
    os._exit(3)


@expects("wall_time", action_wall_s=0.5)
def sends_half_a_frame_and_waits(self, observation):
    os.write(channel(), frame(seq())[:30])
    time.sleep(60)


@expects("protocol_violation")
def sends_nested_headers(self, observation):
    header = b"[" * 30_000
    os.write(channel(), struct.pack("<4sIQ", b"VTC1", len(header), 0) + header)
    time.sleep(60)


@expects("protocol_violation")
def sends_unknown_header_keys(self, observation):
    os.write(channel(), frame(seq(), success=True))
    time.sleep(60)


@expects("harmless")
def shuts_the_channel_down(self, observation):
    sock = socket.socket(fileno=os.dup(channel()))
    try:
        sock.shutdown(socket.SHUT_RDWR)
    except OSError:
        pass
    return [0.0, 0.0, 0.0]


@expects("harmless")
def signals_the_first_process(self, observation):
    for number in range(1, 32):
        try:
            os.kill(1, number)
        except OSError:
            pass
    return [0.0, 0.0, 0.0]


@expects("wall_time", action_wall_s=0.5)
def sleeps(self, observation):
    time.sleep(60)


@expects("cpu_time", action_cpu_s=0.3)
def spins(self, observation):
    while True:
        pass


@expects("cpu_time", episode_cpu_s=0.4)
def spins_a_little_in_each_act(self, observation):
    end = time.process_time() + 0.2
    while time.process_time() < end:
        pass
    return [0.0, 0.0, 0.0]


@expects("cpu_time", action_cpu_s=0.3)
def spins_in_a_child(self, observation):
    if os.fork() == 0:
        while True:
            pass
    os.wait()


@expects("cpu_time", action_cpu_s=60, episode_cpu_s=1)
def spins_past_its_signal(self, observation):
    signal.signal(signal.SIGXCPU, signal.SIG_IGN)
    while True:
        pass


@expects("crashed")
def stops_itself(self, observation):
    os.kill(os.getpid(), signal.SIGSTOP)  # refused: job control is not for policies


@expects("too_many_processes")
def threads_until_refused(self, observation):
    while True:
        threading.Thread(target=time.sleep, args=(60,)).start()


@expects("crashed")
def writes_a_huge_file(self, observation):
    with open("/tmp/huge", "wb") as file:
        while True:
            file.write(bytes(1 << 20))
