# expect: crashed
# where: episode
class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        raise SystemExit(0)
