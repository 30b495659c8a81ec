"""The untrusted side: how a submitted policy is started, isolated, asked for actions and judged when it fails.

Who starts whom (pids as the sandbox sees them):

    evaluator                      `session`; the environment runs here, outside
      sh                           joins the control groups and becomes bwrap (`isolation.cgroup`)
        bwrap                      namespaces, mounts, seccomp filter (`isolation.bubblewrap`, `isolation.seccomp`)
          1 first                  setpriv and prlimit become Python with `runtime/agent.py`; runs no line of the policy
            2 loader               imports the policy and calls its constructor, forks the loaded copy, ends
            3 loaded copy          child of 1 since its parent ended; frozen by ptrace, never runs again (`loaded_copy`)
            4 episode              cloned in the name of 3 as a child of 1, one at a time; answers `reset` and `act`

What joins them:

    channel   socketpair evaluator <-> 2, 3, 4    questions and answers (`protocol`), the only way in or out for data
    output    pipe       2, 3, 4 -> evaluator     standard output and error, stored for the team (`isolation.output`)
    status    pipe       1 -> evaluator           how each process ended; 0 says that the sandbox works
    info      pipe       bwrap -> evaluator       the pid of 1 outside

In order: make control groups, spawn, wait for info and status 0, ask 2 to load, freeze 3, end all others, empty `/tmp`
and `/dev/shm`, check what 3 holds. For each episode: zero the times of the output, clone 4, ask, kill all but 1 and 3,
put back or compare what they share; on a difference start the whole sandbox again. At last kill 1, which takes
everything with it, wait until no process holds the output, remove the control groups.
"""
