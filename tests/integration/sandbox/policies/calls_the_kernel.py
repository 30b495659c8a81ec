# expect: harmless
# where: episode
import ctypes
import os

SYSCALL = ctypes.CDLL(None, use_errno=True).syscall
# ptrace, mount, unshare(user), unshare(net), setns, bpf, keyctl, add_key, memfd_create, perf_event_open, io_uring_setup,
# process_vm_readv, process_vm_writev, shmget, msgget, semget, chroot, reboot, init_module, userfaultfd, open_tree,
# setuid(0), sethostname, kexec_load, personality, setpriority(other), kcmp, pidfd_getfd, clone3, mq_open, setsockopt
CALLS = [
    (101, 16, 1, 0, 0), (165, b"x", b"/tmp", b"tmpfs", 0), (272, 0x10000000), (272, 0x40000000), (308, 0, 0),
    (321, 5, 0, 0), (250, 0, 0, 0), (248, b"user", b"a", b"b", 1, -3), (319, b"x", 0), (298, 0, 0, -1, -1, 0),
    (425, 8, 0), (310, 1, 0, 0, 0, 0, 0), (311, 1, 0, 0, 0, 0, 0), (29, 1, 4096, 0o1777), (68, 1, 0o1777),
    (64, 1, 1, 0o1777), (161, b"/tmp"), (169, 0, 0, 0, 0), (175, 0, 0, b""), (323, 1), (428, -100, b"/", 1),
    (105, 0), (170, b"x", 1), (246, 0, 0, 0, 0), (135, 0x0040000), (141, 0, 1, 5), (312, 1, 1, 0, 0, 0), (438, 0, 0, 0),
    (435, 0, 0), (240, b"/x", 0o102, 0o600, 0), (54, 1, 1, 2, b"1111", 4),
]


def succeeded(call):
    return SYSCALL(*[ctypes.c_long(part) if isinstance(part, int) else part for part in call]) >= 0


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        found = [call for call in CALLS if succeeded(call)]
        if found:
            print(found)
        return [float(len(found) + (os.getuid() == 0)), 0.0, 0.0]
