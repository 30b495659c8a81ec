# expect: crashed
# where: episode
class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        with open("/tmp/huge", "wb") as file:
            while True:
                file.write(bytes(1 << 20))
