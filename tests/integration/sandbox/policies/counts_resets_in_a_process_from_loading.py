# expect: harmless
# where: episode
import os

# A helper process answers over a named pipe.
os.mkfifo("/tmp/counter")
if os.fork() == 0:
    os.setsid()
    count = 0
    while True:
        with open("/tmp/counter", "wb", buffering=0) as answers:
            answers.write(bytes([count]))
        count += 1


class Policy:
    def reset(self, task):
        try:
            with open("/tmp/counter", "rb", buffering=0) as answers:
                self.seen = answers.read(1)[0]
        except OSError:
            self.seen = 0

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
