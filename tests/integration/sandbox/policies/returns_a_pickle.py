# expect: bad_action_type
# where: episode
import os
import pickle


class Evil:
    def __reduce__(self):
        return os.system, ("touch /tmp/unpickled",)


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        return pickle.dumps(Evil())
