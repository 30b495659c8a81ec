# expect: harmless
# where: episode
from channel_tools import seq


class Policy:
    def reset(self, task):
        self.seen = seq() - 1

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
