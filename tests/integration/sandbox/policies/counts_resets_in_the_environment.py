# expect: harmless
# where: episode
import os


class Policy:
    def reset(self, task):
        self.seen = int(os.environ.get("COUNT", "0"))
        os.environ["COUNT"] = str(self.seen + 1)

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
