# expect: crashed
# where: episode
import os
import resource

# The loaded copy, which is the child of the one fork that ends loading, can then not be copied for an episode.
os.register_at_fork(after_in_child=lambda: resource.setrlimit(resource.RLIMIT_NPROC, (1, 1)))


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        return [0.0, 0.0, 0.0]
