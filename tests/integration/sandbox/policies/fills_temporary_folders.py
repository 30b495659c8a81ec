# expect: crashed
# where: episode
class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        for number in range(1000):
            with open(f"/dev/shm/{number}", "wb") as file:
                file.write(bytes(1 << 20))
