"""A real S3-speaking server process (moto's) that forgets everything at its end; imported by tests of the storage."""

import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import httpx

BUCKET = "arena"
CREDENTIALS = {"AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test", "AWS_REGION": "us-east-1"}
START_LIMIT_S = 60.0


@dataclass(frozen=True, kw_only=True)
class S3Server:
    """A server with one empty bucket."""

    endpoint: str
    process: "subprocess.Popen[bytes]"

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

    def _texts(self, query: str, tag: str) -> list[str]:
        answer = httpx.get(f"{self.endpoint}/{BUCKET}{query}", timeout=10)
        answer.raise_for_status()
        found = ET.fromstring(answer.text).iter()  # noqa: S314 - of a server that the test has started
        return [element.text or "" for element in found if element.tag.rpartition("}")[2] == tag]


@contextmanager
def s3_server(folder: Path, host: str = "127.0.0.1") -> Iterator[S3Server]:
    """Runs the server on a free port while the block runs; its output goes to a file in the folder."""
    with socket.socket() as free:
        free.bind((host, 0))
        port = free.getsockname()[1]
    endpoint = f"http://{host}:{port}"
    with (folder / "s3.log").open("wb") as log:
        program = [sys.executable, "-m", "moto.server", "-H", host, "-p", str(port)]
        process = subprocess.Popen(program, stdout=log, stderr=log)
    try:
        _make_bucket(endpoint, process)
        yield S3Server(endpoint=endpoint, process=process)
    finally:
        process.kill()
        process.wait()


def _make_bucket(endpoint: str, process: "subprocess.Popen[bytes]") -> None:
    deadline = time.monotonic() + START_LIMIT_S
    while True:
        assert process.poll() is None, "the S3 server did not start"
        assert time.monotonic() < deadline, "the S3 server did not answer in time"
        try:
            httpx.put(f"{endpoint}/{BUCKET}", timeout=10).raise_for_status()
            return
        except httpx.TransportError:
            time.sleep(0.05)
