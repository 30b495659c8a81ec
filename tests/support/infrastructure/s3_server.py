"""A real S3-speaking server process (moto's) that forgets everything at its end; imported by tests of the storage."""

import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree as ET

import httpx

BUCKET = "arena"
CREDENTIALS = {"AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test", "AWS_REGION": "us-east-1"}
START_LIMIT_S = 300.0


class S3Server:
    """A server with one bucket, empty after each start; what it prints goes to a file in the folder."""

    def __init__(self, folder: Path, host: str) -> None:
        with socket.socket() as free:
            free.bind((host, 0))
            self._host, self._port = host, free.getsockname()[1]
        self._log = folder / "s3.log"
        self.endpoint = f"http://{host}:{self._port}"
        self.process: subprocess.Popen[bytes]

    def start(self) -> None:
        """Starts it, always on the same port."""
        program = [sys.executable, "-m", "moto.server", "-H", self._host, "-p", str(self._port)]
        with self._log.open("ab") as log:
            self.process = subprocess.Popen(program, stdout=log, stderr=log)
        deadline = time.monotonic() + START_LIMIT_S
        while True:
            assert self.process.poll() is None, "the S3 server did not start"
            assert time.monotonic() < deadline, "the S3 server did not answer in time"
            try:
                self._make_bucket()
                return
            except httpx.TransportError:
                time.sleep(0.05)

    def empty(self) -> None:
        """Forgets everything, as a new start would; starts it where it was killed."""
        if self.process.poll() is not None:
            self.start()
        else:
            httpx.post(f"{self.endpoint}/moto-api/reset", timeout=60).raise_for_status()
            self._make_bucket()

    def kill(self) -> None:
        """Ends it; ending it again changes nothing."""
        self.process.kill()
        self.process.wait()

    @property
    def environment(self) -> dict[str, str]:
        """What a process of ours needs to use it."""
        return CREDENTIALS | {
            "AWS_ENDPOINT_URL": self.endpoint,
            "AWS_ALLOW_HTTP": "true",
            "VITAC_STORAGE_URL": f"s3://{BUCKET}/files",
        }

    def stored_keys(self) -> list[str]:
        """The keys of all objects in the bucket."""
        return self._texts("?list-type=2", "Key")

    def unfinished_uploads(self) -> list[str]:
        """The keys of uploads in parts that were neither completed nor aborted."""
        return self._texts("?uploads", "Key")

    def _make_bucket(self) -> None:
        httpx.put(f"{self.endpoint}/{BUCKET}", timeout=60).raise_for_status()

    def _texts(self, query: str, tag: str) -> list[str]:
        answer = httpx.get(f"{self.endpoint}/{BUCKET}{query}", timeout=60)
        answer.raise_for_status()
        found = ET.fromstring(answer.text).iter()  # noqa: S314 - of a server that the test has started
        return [element.text or "" for element in found if element.tag.rpartition("}")[2] == tag]


@contextmanager
def s3_server(folder: Path, host: str = "127.0.0.1") -> Iterator[S3Server]:
    """Runs the server on a free port while the block runs."""
    server = S3Server(folder, host)
    server.start()
    try:
        yield server
    finally:
        server.kill()
