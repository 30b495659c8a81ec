# expect: harmless
# where: episode
import ctypes
import os
import struct

BUFFER = ctypes.create_string_buffer(4096)
MOUNT_REQUEST = struct.pack("<IIQQ", 24, 0, 0xFFFFFFFFFFFFFFFF, 2)  # listmount of the root; statmount needs its answer
SYSCALL = ctypes.CDLL(None, use_errno=True).syscall
# ptrace, mount, unshare(user), unshare(net), setns, bpf, keyctl, add_key, memfd_create, perf_event_open, io_uring_setup,
# process_vm_readv, process_vm_writev, shmget, msgget, semget, chroot, reboot, init_module, userfaultfd, open_tree,
# setuid(0), sethostname, kexec_load, personality, setpriority(other), kcmp, pidfd_getfd, clone3, mq_open, setsockopt,
# statmount, listmount, sysinfo, sync, syncfs, landlock_create_ruleset(version), mseal, lsm_list_modules, cachestat,
# map_shadow_stack, setxattrat, listxattrat, open_tree_attr, file_getattr, futex_requeue, a number that no kernel has yet
CALLS = [
    (101, 16, 1, 0, 0), (165, b"x", b"/tmp", b"tmpfs", 0), (272, 0x10000000), (272, 0x40000000), (308, 0, 0),
    (321, 5, 0, 0), (250, 0, 0, 0), (248, b"user", b"a", b"b", 1, -3), (319, b"x", 0), (298, 0, 0, -1, -1, 0),
    (425, 8, 0), (310, 1, 0, 0, 0, 0, 0), (311, 1, 0, 0, 0, 0, 0), (29, 1, 4096, 0o1777), (68, 1, 0o1777),
    (64, 1, 1, 0o1777), (161, b"/tmp"), (169, 0, 0, 0, 0), (175, 0, 0, b""), (323, 1), (428, -100, b"/", 1),
    (105, 0), (170, b"x", 1), (246, 0, 0, 0, 0), (135, 0x0040000), (141, 0, 1, 5), (312, 1, 1, 0, 0, 0), (438, 0, 0, 0),
    (457, MOUNT_REQUEST, BUFFER, 4096, 0), (458, MOUNT_REQUEST, BUFFER, 8, 0), (99, BUFFER), (162,), (306, 1),
    (444, 0, 0, 1), (462, 0, 0, 0), (461, BUFFER, BUFFER, 0), (451, 1, BUFFER, BUFFER, 0), (453, 0, 4096, 1),
    (463, -100, b"/tmp", 0, b"user.a", BUFFER, 16), (465, -100, b"/tmp", 0, BUFFER, 64), (467, -100, b"/", 1, 0, 0),
    (468, -100, b"/tmp", BUFFER, 24, 0), (456, BUFFER, 0, 0, 0), (900,),
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
