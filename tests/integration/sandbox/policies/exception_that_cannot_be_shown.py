# expect: crashed
# where: episode
class Odd(Exception):
    def __str__(self):
        raise RuntimeError("not even this")


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        raise Odd
