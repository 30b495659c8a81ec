# expect: harmless
# where: episode
import os


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        allowed = {"HOME", "LANG", "PATH", "PWD", "PYTHONHASHSEED", "TMPDIR", "LD_LIBRARY_PATH"}
        found = [name for name in os.environ if name not in allowed and not name.endswith("_NUM_THREADS")]
        found += [value for value in os.environ.values() if "/home" in value or "/root" in value]
        return [float(len(found)), 0.0, 0.0]
