# expect: shared_state
# where: load
class Policy:
    def __init__(self):
        for number in range(6000):
            open(f"/tmp/{number}", "w").close()

    def reset(self, task):
        self.seen = 0

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
