"""A connection to a service that is cut again and again: a TCP proxy that closes after a number of bytes."""

import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field

CHUNK_BYTES = 1 << 16
RESET = struct.pack("ii", 1, 0)
"""SO_LINGER that closes with a reset, as a lost line does."""


@dataclass(kw_only=True)
class CuttingProxy:
    """Passes connections on to `target`, and cuts each after as many sent bytes as the next of `cuts` says.

    `on_cut` is called when the service has got all that there is before a cut and the client does not know of it yet.
    """

    target: tuple[str, int]
    cuts: list[int]
    on_cut: Callable[[], None] = lambda: None
    n_cut: int = 0
    address: tuple[str, int] = ("", 0)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @contextmanager
    def running(self) -> Iterator["CuttingProxy"]:
        """Listens while the block runs."""
        listener = socket.create_server(("127.0.0.1", 0))
        self.address = listener.getsockname()
        thread = threading.Thread(target=self._accept, args=[listener])
        thread.start()
        try:
            yield self
        finally:
            listener.shutdown(socket.SHUT_RDWR)
            listener.close()
            thread.join()

    def _accept(self, listener: socket.socket) -> None:
        threads = []
        with suppress(OSError):
            while True:
                client, _ = listener.accept()
                threads.append(threading.Thread(target=self._pass_on, args=[client]))
                threads[-1].start()
        for thread in threads:
            thread.join()

    def _pass_on(self, client: socket.socket) -> None:
        try:
            server = socket.create_connection(self.target, timeout=60.0)
        except OSError:
            client.close()
            return
        server.settimeout(None)  # that was for connecting; how long an answer takes, the client decides
        back = threading.Thread(target=_copy, args=[server, client])
        back.start()
        with suppress(OSError):
            self._forward(client, server)
        for end in (server, client):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
        back.join()
        client.close()
        server.close()

    def _forward(self, client: socket.socket, server: socket.socket) -> None:
        with self._lock:
            left = self.cuts[0] if self.cuts else None
        while chunk := client.recv(CHUNK_BYTES):
            if left is not None and len(chunk) >= left:
                server.sendall(chunk[:left])
                server.shutdown(socket.SHUT_RDWR)
                with self._lock:
                    self.cuts.pop(0)
                    self.n_cut += 1
                self.on_cut()
                client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
                client.close()
                return
            left = None if left is None else left - len(chunk)
            server.sendall(chunk)


def _copy(source: socket.socket, destination: socket.socket) -> None:
    with suppress(OSError):
        while chunk := source.recv(CHUNK_BYTES):
            destination.sendall(chunk)
