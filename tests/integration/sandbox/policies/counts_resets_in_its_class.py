# expect: harmless
# where: episode
class Policy:
    def reset(self, task):
        self.seen = getattr(Policy, "count", 0)
        Policy.count = self.seen + 1

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
