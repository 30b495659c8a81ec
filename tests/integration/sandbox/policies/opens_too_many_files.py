# expect: crashed
# where: episode
class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        kept = [open("/dev/null") for _ in range(10_000)]
