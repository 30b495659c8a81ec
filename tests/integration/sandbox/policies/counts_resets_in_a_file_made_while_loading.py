# expect: harmless
# where: episode
import os


class Policy:
    def __init__(self):
        os.mkdir("/tmp/folder")
        open("/tmp/folder/count", "wb").close()

    def reset(self, task):
        self.seen = 0
        if os.path.exists("/tmp/folder/count"):
            with open("/tmp/folder/count", "ab+") as file:
                file.seek(0)
                self.seen = len(file.read())
                file.write(b"x")

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
