# expect: harmless
# where: episode
import os
import resource


def reached(attempt):
    try:
        attempt()
        return 1
    except OSError:
        return 0


class Policy:
    def reset(self, task):
        """Read a file and ask how much of it had to come from the disk: the host's memory of earlier readings."""
        with open(os.__file__, "rb") as file:
            file.read()
        child = os.fork()
        if child == 0:
            os._exit(0)
        self.seen = reached(lambda: resource.getrusage(resource.RUSAGE_SELF))
        self.seen += reached(lambda: os.wait4(child, 0))
        self.seen += reached(lambda: os.wait3(0))
        os.waitpid(child, 0)

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
