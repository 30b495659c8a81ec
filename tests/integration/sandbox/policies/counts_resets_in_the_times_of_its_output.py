# expect: harmless
# where: episode
import os


def times():
    return [(os.fstat(number).st_atime_ns, os.fstat(number).st_mtime_ns) for number in (1, 2)]


class Policy:
    def reset(self, task):
        """The pipe remembers when something was last printed; between episodes the evaluator sets it to zero."""
        self.seen = int(times() != [(0, 0), (0, 0)])
        print("printed in an earlier episode")

    def act(self, observation):
        print("and again")
        return [float(self.seen), 0.0, 0.0]
