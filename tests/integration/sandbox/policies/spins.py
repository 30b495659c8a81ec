# expect: cpu_time
# where: episode
# limits: action_cpu_s=0.3
class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        while True:
            pass
