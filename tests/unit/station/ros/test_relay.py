"""The commands that publish and listen, each in a process of its own: both versions of ROS hold state per process."""

import json
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest
from vitac.station.twin.laboratory import TwinStation

COMMAND = [sys.executable, "-c", "from vitac.cli.main import main; main()", "station"]
Environment = dict[str, str]


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def answers(port: int) -> bool:
    with socket.socket() as caller:
        return caller.connect_ex(("127.0.0.1", port)) == 0


@contextmanager
def core(folder: Path) -> Iterator[Environment]:
    """A running core of ROS 1."""
    rosmaster = shutil.which("rosmaster")
    if rosmaster is None:
        pytest.skip("ROS 1 is not here (Debian: apt-get install python3-rospy python3-rosmaster python3-sensor-msgs)")
    port = free_port()
    environment = {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1", "ROS_HOME": str(folder)}
    process = subprocess.Popen([rosmaster, "--core", "-p", str(port)], env=os.environ | environment)
    try:
        while not answers(port):
            assert process.poll() is None
            time.sleep(0.05)
        yield environment
    finally:
        process.terminate()
        process.wait()


@contextmanager
def domain(_: Path) -> Iterator[Environment]:
    """A DDS domain on the loopback address."""
    interface = "<General><Interfaces><NetworkInterface address='127.0.0.1'/></Interfaces></General>"
    peers = "<Discovery><Peers><Peer address='127.0.0.1'/></Peers></Discovery>"
    configuration = f"<CycloneDDS><Domain>{interface}{peers}</Domain></CycloneDDS>"
    yield {"ROS_DOMAIN_ID": str(os.getpid() % 100), "CYCLONEDDS_URI": configuration}


@pytest.mark.slow
@pytest.mark.parametrize(("ros", "network"), [("1", core), ("2", domain)])
def test_what_one_process_publishes_another_reads(
    ros: str, network: Callable[[Path], AbstractContextManager[Environment]], twins: TwinStation, tmp_path: Path
) -> None:
    twins.write(tmp_path / "station.yaml")
    with network(tmp_path) as environment:
        variables = os.environ | environment
        publisher = subprocess.Popen([*COMMAND, "publish", str(tmp_path / "station.yaml"), "--ros", ros], env=variables)
        try:
            listener = [*COMMAND, "listen", "--ros", ros, "--reset", "left", "--messages", "50", "--json"]
            output = subprocess.run(listener, env=variables, check=True, capture_output=True, text=True, timeout=60)
        finally:
            publisher.terminate()
            publisher.wait()
    received = {each.pop("topic"): each for each in map(json.loads, output.stdout.splitlines())}
    assert received["Marker_Tracking_Left"]["markers"] == received["Marker_Tracking_Right"]["markers"] == 63
    assert received["Tactile_Image_Right"]["encoding"] == "bgr8"
    assert received["Marker_Tracking_Contact"] == {"is_contact": False, "is_overforced": False}


@pytest.mark.slow
def test_missing_core_is_said_in_a_sentence() -> None:
    if shutil.which("rosmaster") is None:
        pytest.skip("ROS 1 is not here")
    environment = os.environ | {"ROS_MASTER_URI": f"http://127.0.0.1:{free_port()}"}
    ended = subprocess.run([*COMMAND, "listen", "--ros", "1"], env=environment, capture_output=True, text=True)
    assert ended.returncode == 1
    assert ended.stderr.count("\n") == 1
    assert "Expected a core of ROS 1 at" in ended.stderr


def test_readings_are_recorded_until_the_wanted_number(twins: TwinStation, tmp_path: Path) -> None:
    twins.write(tmp_path / "station.yaml")
    arguments = ["publish", str(tmp_path / "station.yaml"), "--record", str(tmp_path / "rest.bag"), "--readings", "3"]
    output = subprocess.run([*COMMAND, *arguments], check=True, capture_output=True, text=True, timeout=60)
    assert output.stdout == "3 readings of both gels\n"
    assert (tmp_path / "rest.bag").stat().st_size > 3 * 2 * 230_400
