# expect: cpu_time
# where: episode
# limits: action_cpu_s=60 episode_cpu_s=1
import signal


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        signal.signal(signal.SIGXCPU, signal.SIG_IGN)
        while True:
            pass
