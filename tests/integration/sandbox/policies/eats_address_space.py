# expect: out_of_memory
# where: episode
class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        bytearray(1 << 40)
