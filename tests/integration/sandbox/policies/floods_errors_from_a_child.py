# expect: output_flood
# where: episode
import os


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        if os.fork() == 0:
            while True:
                os.write(2, b"x" * 1000)
        os.wait()
