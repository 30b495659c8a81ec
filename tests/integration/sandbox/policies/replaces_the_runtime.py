# expect: protocol_violation
# where: episode
import sys


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        main = sys.modules["__main__"]
        main.Connection.write = lambda self, kind, **more: self._socket.sendall(b"I am the evaluator")
        return [0.0, 0.0, 0.0]
