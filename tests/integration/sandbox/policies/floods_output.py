# expect: output_flood
# where: episode
class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        while True:
            print("x" * 1000)
