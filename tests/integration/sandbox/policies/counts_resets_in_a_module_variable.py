# expect: harmless
# where: episode
COUNT = 0


class Policy:
    def reset(self, task):
        global COUNT
        self.seen = COUNT
        COUNT += 1

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
