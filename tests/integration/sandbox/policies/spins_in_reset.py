# expect: cpu_time
# where: episode
# limits: action_cpu_s=0.3
class Policy:
    def reset(self, task):
        while True:
            pass

    def act(self, observation):
        return [0.0, 0.0, 0.0]
