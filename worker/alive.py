"""The file that says a worker's process runs: what supervises containers looks at its age. Called by `main`."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

FILE = "worker.alive"
"""In the state directory."""
TOUCHED_EVERY_S = 5.0


@contextmanager
def sign_of_life(folder: Path) -> Iterator[None]:
    """Touch the file while the block runs, whatever the database does; it is removed at the end."""
    file, over = folder / FILE, threading.Event()

    def touch() -> None:
        while not over.is_set():
            with suppress(OSError):  # a full disk
                file.touch()
            over.wait(TOUCHED_EVERY_S)

    thread = threading.Thread(target=touch, name="alive", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        file.unlink(missing_ok=True)
