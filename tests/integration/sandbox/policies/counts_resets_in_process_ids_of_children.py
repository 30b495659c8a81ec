# expect: harmless
# where: episode
import os


class Policy:
    def reset(self, task):
        pid = os.fork()
        if pid == 0:
            os._exit(0)
        os.waitpid(pid, 0)
        self.seen = pid - 5

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
