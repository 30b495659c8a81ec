# expect: harmless
# where: episode
import os
import re
import sys

SECRET = re.compile(rb"^[0-9a-f]{64}\n?$")


def is_secret(path):
    try:
        if not os.path.isfile(path) or os.path.getsize(path) > 65:
            return False
        with open(path, "rb") as file:
            return SECRET.match(file.read()) is not None
    except OSError:
        return False


class Policy:
    def reset(self, task):
        """Read everything that could be a secret: small files wherever it may look, arguments, environment."""
        self.seen = 0
        for folder, folders, files in os.walk("/"):
            folders[:] = [name for name in folders if (folder, name) not in {("/", "usr"), ("/", "proc"), ("/", "sys")}]
            if folder.count("/") > 4:
                folders.clear()
            self.seen += sum(is_secret(os.path.join(folder, name)) for name in files)
        said = [os.fsencode(text) for text in (*sys.argv, *os.environ.values())]
        self.seen += sum(SECRET.match(text) is not None for text in said)

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
