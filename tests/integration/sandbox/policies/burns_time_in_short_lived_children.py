# expect: cpu_time
# where: episode
# limits: action_cpu_s=0.5 action_wall_s=60.0
import os
import time


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        while True:
            child = os.fork()
            if child == 0:
                start = time.process_time()
                while time.process_time() - start < 0.02:
                    pass
                os._exit(0)
            os.waitpid(child, 0)
