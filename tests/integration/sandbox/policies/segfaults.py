# expect: crashed
# where: episode
import ctypes


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        ctypes.string_at(8)
