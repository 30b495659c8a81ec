# expect: harmless
# where: episode
class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        return [0, 0.0, False]
