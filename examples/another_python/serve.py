"""Plays an environment for a program in another Python, whose packages do not agree with ours.

python serve.py ADDRESS [ENVIRONMENT]

The other one listens at the address (`multiprocessing.connection`), gives its key in the variable `KEY`, and sends
pairs of a method's name and its arguments; `docs/libraries.md` shows it. Both must trust each other: what they send is
pickled.
"""

import os
import sys
from multiprocessing.connection import Client

import gymnasium
import numpy as np
import vitac.envs  # noqa: F401 - registers the ids
from vitac.envs.tasks.making import NumericInfos


def main() -> None:
    """Answer until the other one closes the connection."""
    env = NumericInfos(gymnasium.make(sys.argv[2] if len(sys.argv) > 2 else "ViTac/PegInsertion-v1"))
    with Client(sys.argv[1], authkey=os.environ["KEY"].encode()) as other:
        try:
            while True:
                name, arguments = other.recv()
                if "action" in arguments:
                    arguments["action"] = np.asarray(arguments["action"], dtype=np.float32)
                other.send(getattr(env, name)(**arguments))
        except EOFError:
            env.close()


if __name__ == "__main__":
    main()
