# expect: harmless
# where: episode
import os

COUNT = [0]


def hook():
    COUNT[0] += 1


os.register_at_fork(before=hook, after_in_parent=hook, after_in_child=hook)


class Policy:
    def reset(self, task):
        self.seen = COUNT[0]

    def act(self, observation):
        # Two: before and after the one fork that ends loading.
        return [float(self.seen - 2), 0.0, 0.0]
