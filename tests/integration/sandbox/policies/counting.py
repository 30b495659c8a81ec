"""Policies that count resets: what each sees of episodes before its own is the first part of its action."""

import fcntl
import mmap
import multiprocessing
import os
import resource
import socket
import stat
import tempfile
import time

from channel_tools import Counting, expects, seq


class CountingInAFile(Counting):
    def reset(self, task):
        try:
            with open(self.path, "ab+") as file:
                file.seek(0)
                self.seen = len(file.read())
                file.write(b"x")
        except OSError:
            self.seen = 0


@expects("harmless")
class counts_resets_in_a_device_folder(CountingInAFile):
    path = "/dev/count"


@expects("harmless")
class counts_resets_in_a_file_made_while_loading(Counting):
    def __init__(self):
        os.mkdir("/tmp/folder")
        open("/tmp/folder/count", "wb").close()

    def reset(self, task):
        self.seen = 0
        if os.path.exists("/tmp/folder/count"):
            with open("/tmp/folder/count", "ab+") as file:
                file.seek(0)
                self.seen = len(file.read())
                file.write(b"x")


@expects("shared_state", where="load")
class counts_resets_in_a_mapping_that_can_become_writeable(Counting):
    def __init__(self):
        file = os.open("/dev/shm/memory", os.O_RDWR | os.O_CREAT)
        os.ftruncate(file, 4096)
        self.memory = mmap.mmap(file, 4096, flags=mmap.MAP_SHARED, prot=mmap.PROT_READ)
        os.close(file)


@expects("shared_state", where="load")
class counts_resets_in_a_pipe(Counting):
    def __init__(self):
        self.ends = os.pipe()


@expects("shared_state", where="load")
class counts_resets_in_a_removed_temporary_file(Counting):
    def __init__(self):
        self.file = tempfile.TemporaryFile()


@expects("shared_state", where="load")
class counts_resets_in_a_shared_mapping_of_a_file(Counting):
    def __init__(self):
        file = os.open("/tmp/memory", os.O_RDWR | os.O_CREAT)
        os.ftruncate(file, 4096)
        self.memory = mmap.mmap(file, 4096)
        os.close(file)


@expects("shared_state", where="load")
class counts_resets_in_a_shared_mapping_of_zero(Counting):
    def __init__(self):
        self.memory = mmap.mmap(os.open("/dev/zero", os.O_RDWR), 4096)


@expects("harmless")
class counts_resets_in_a_temporary_file(CountingInAFile):
    path = "/tmp/count"


@expects("shared_state", where="load")
class counts_resets_in_an_event_counter(Counting):
    def __init__(self):
        self.counter = os.eventfd(0)


@expects("shared_state", where="load")
class counts_resets_in_an_open_temporary_file(Counting):
    def __init__(self):
        self.file = open("/tmp/count", "w+")


@expects("harmless")
class counts_resets_in_bytes_left_in_the_channel(Counting):
    def reset(self, task):
        # Reads what an earlier episode left unread; none is to be there before the first observation.
        self.seen = 0
        for descriptor in range(3, 64):
            try:
                if stat.S_ISSOCK(os.fstat(descriptor).st_mode):
                    with socket.socket(fileno=os.dup(descriptor)) as channel:
                        self.seen = len(channel.recv(100, socket.MSG_DONTWAIT | socket.MSG_PEEK))
            except OSError:
                pass


@expects("harmless")
class counts_resets_in_flags_of_a_device(Counting):
    def __init__(self):
        self.file = os.open("/dev/urandom", os.O_RDONLY)

    def reset(self, task):
        self.seen = int(bool(fcntl.fcntl(self.file, fcntl.F_GETFL) & os.O_NONBLOCK))
        fcntl.fcntl(self.file, fcntl.F_SETFL, os.O_NONBLOCK)


@expects("harmless")
class counts_resets_in_flags_of_an_open_file(Counting):
    def __init__(self):
        self.file = os.open(__file__, os.O_RDONLY)

    def reset(self, task):
        self.seen = int(bool(fcntl.fcntl(self.file, fcntl.F_GETFL) & os.O_NONBLOCK))
        fcntl.fcntl(self.file, fcntl.F_SETFL, os.O_NONBLOCK)


@expects("harmless")
class counts_resets_in_flags_of_its_output(Counting):
    def reset(self, task):
        self.seen = int(bool(fcntl.fcntl(1, fcntl.F_GETFL) & os.O_NONBLOCK))
        fcntl.fcntl(1, fcntl.F_SETFL, os.O_NONBLOCK | os.O_WRONLY)


@expects("harmless")
class counts_resets_in_inode_numbers(Counting):
    def reset(self, task):
        with open("/tmp/probe", "w") as file:
            number = os.fstat(file.fileno()).st_ino
        os.remove("/tmp/probe")
        self.seen = number - 2


@expects("harmless")
class counts_resets_in_its_class(Counting):
    def reset(self, task):
        self.seen = getattr(Policy, "count", 0)
        Policy.count = self.seen + 1


@expects("harmless")
class counts_resets_in_its_own_folder(CountingInAFile):
    path = "/submission/count"


@expects("harmless")
class counts_resets_in_nameless_files(Counting):
    def reset(self, task):
        try:
            descriptor = os.open("/tmp", os.O_TMPFILE | os.O_RDWR)
            self.seen = os.fstat(descriptor).st_ino - 2
            os.close(descriptor)
        except OSError:
            self.seen = 0


@expects("harmless")
class counts_resets_in_question_numbers(Counting):
    def reset(self, task):
        self.seen = seq() - 1


@expects("shared_state", where="load")
class counts_resets_in_shared_anonymous_memory(Counting):
    def __init__(self):
        self.memory = mmap.mmap(-1, 4096)


@expects("shared_state", where="load")
class counts_resets_in_shared_arrays(Counting):
    def __init__(self):
        self.array = multiprocessing.RawArray("i", 1)


@expects("harmless")
class counts_resets_in_shared_memory_files(CountingInAFile):
    path = "/dev/shm/count"


@expects("harmless")
class counts_resets_in_terminals(Counting):
    def reset(self, task):
        self.seen = 0
        for name in ("/dev/ptmx", "/dev/pts", "/dev/pts/ptmx", "/dev/tty", "/dev/console"):
            try:
                self.seen += int(os.stat(name).st_mtime == 5)
                os.utime(name, (5, 5))
                os.chmod(name, 0o600)
            except OSError:
                pass


@expects("harmless")
class counts_resets_in_the_environment(Counting):
    def reset(self, task):
        self.seen = int(os.environ.get("COUNT", "0"))
        os.environ["COUNT"] = str(self.seen + 1)


@expects("harmless")
class counts_resets_in_the_limits_of_its_parent(Counting):
    def reset(self, task):
        self.seen = int(resource.getrlimit(resource.RLIMIT_CORE)[0] != resource.getrlimit(resource.RLIMIT_CORE)[1])
        self.seen += 200 - resource.getrlimit(resource.RLIMIT_NOFILE)[0] if resource.getrlimit(resource.RLIMIT_NOFILE)[0] < 200 else 0
        for pid in range(1, 10):
            if pid != os.getpid():
                try:
                    resource.prlimit(pid, resource.RLIMIT_NOFILE, (100, 256))
                except OSError:
                    pass


@expects("harmless")
class counts_resets_in_the_mode_of_a_folder(Counting):
    def reset(self, task):
        self.seen = int(os.stat("/tmp").st_mode & 0o001 == 0)
        try:
            os.chmod("/tmp", 0o1770)
        except OSError:
            pass


@expects("harmless")
class counts_resets_in_the_position_of_a_device(Counting):
    def __init__(self):
        self.file = os.open("/dev/zero", os.O_RDONLY)

    def reset(self, task):
        self.seen = os.lseek(self.file, 0, os.SEEK_CUR)
        os.lseek(self.file, 1, os.SEEK_CUR)


@expects("harmless")
class counts_resets_in_the_position_of_an_open_file(Counting):
    def __init__(self):
        self.file = os.open(__file__, os.O_RDONLY)

    def reset(self, task):
        self.seen = os.lseek(self.file, 0, os.SEEK_CUR)
        os.lseek(self.file, 1, os.SEEK_CUR)


@expects("harmless")
class counts_resets_in_the_priority_of_its_parent(Counting):
    def reset(self, task):
        self.seen = os.getpriority(os.PRIO_PROCESS, 0)
        for pid in range(1, 10):
            try:
                os.setpriority(os.PRIO_PROCESS, pid, self.seen + 1)
            except OSError:
                pass


@expects("harmless")
class counts_resets_in_the_size_of_its_output_pipe(Counting):
    def reset(self, task):
        F_SETPIPE_SZ, F_GETPIPE_SZ = 1031, 1032
        self.seen = fcntl.fcntl(1, F_GETPIPE_SZ) // 65536 - 1
        try:
            fcntl.fcntl(1, F_SETPIPE_SZ, 65536 * 2)
        except OSError:
            pass


@expects("harmless")
class counts_resets_in_the_time_of_a_folder(Counting):
    def reset(self, task):
        self.seen = int(os.stat("/tmp").st_mtime == 5)
        try:
            os.utime("/tmp", (5, 5))
        except OSError:
            pass


@expects("harmless")
class counts_resets_in_the_time_of_the_first_process(Counting):
    def reset(self, task):
        try:
            self.seen = time.clock_gettime((~1 << 3) | 2)
        except OSError:
            self.seen = 0


@expects("shared_state", where="load")
class counts_resets_in_too_many_files(Counting):
    def __init__(self):
        for number in range(6000):
            open(f"/tmp/{number}", "w").close()
