# expect: non_finite_action
# where: episode
class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        return [0.0, float("-inf"), 0.0]
