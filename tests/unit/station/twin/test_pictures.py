"""The stream of a twin's camera."""

import socket
from threading import Event
from urllib.parse import urlsplit

import numpy as np
from vitac.station.twin.pictures import CameraTwin


def test_reader_that_leaves_in_the_middle_of_a_picture_is_noticed() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (80, 80, 3), dtype=np.uint8)
    with CameraTwin(picture=lambda: noise, period_s=0.001) as camera:
        address = urlsplit(camera.stream)
        with socket.create_connection((address.hostname or "", address.port or 0)) as reader:
            reader.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            reader.sendall(b"GET /stream.mjpg HTTP/1.0\r\n\r\n")
            received = b""
            while b"image/jpeg" not in received:
                received += reader.recv(1024)
            assert camera.streams == 1
            reader.shutdown(socket.SHUT_WR)  # takes no more, while a part of a picture is still on its way
            for _ in range(2000):
                if not camera.streams:
                    return
                Event().wait(0.005)
        raise AssertionError("the stream continues without a reader")
