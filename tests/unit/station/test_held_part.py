"""Where a part is held outlives the process that closed the gripper."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from vitac.evaluator.strict_model import DocumentRejected
from vitac.station.arm import Arm
from vitac.station.description import StationTask, read_description
from vitac.station.devices.stage import Pose
from vitac.station.eyes import open_station
from vitac.station.held_part import HeldPart, NotRemembered
from vitac.station.twin.grasp import Mounted
from vitac.station.twin.hidden import HiddenSettings
from vitac.station.twin.laboratory import twin_process

FETCH = """
import sys
from pathlib import Path
from vitac.station.arm import Arm
from vitac.station.description import read_description
from vitac.station.eyes import open_station
from vitac.station.held_part import HeldPart

file = Path(sys.argv[1])
with open_station(read_description(file), HeldPart.of_station(file)) as station:
    Arm(station).fetch(beside_mm=(1.5, -1.0))
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.mark.slow
def test_key_of_a_killed_agent_is_put_back_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, key = tmp_path / "station.yaml", Mounted(StationTask.LOCK, "key1")
    with twin_process(HiddenSettings(latency_s=0.0), mounted=key, period_s=0.2) as twin:
        file.write_text(yaml.safe_dump(twin.description))
        command = [sys.executable, "-c", FETCH, str(file)]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as agent:
            assert agent.stdout is not None
            assert agent.stdout.readline() == "held\n"
            agent.kill()
        with open_station(read_description(file), HeldPart.of_station(file)) as station:
            arm, opened_at = Arm(station), list[Pose]()
            assert arm.holds_peg()
            grip = station.guard.grip

            def note(*position: int, **how: int) -> None:
                opened_at.append(arm.pose())
                grip(*position, **how)

            monkeypatch.setattr(station.guard, "grip", note)
            arm.open_in_garage()
    x_mm, _, z_mm, _ = key.garage
    assert opened_at[0][::2] == pytest.approx((x_mm + 1.5, z_mm - 1.0), abs=0.02)


def test_place_is_written_where_it_changes(tmp_path: Path) -> None:
    file = tmp_path / "station.yaml"
    HeldPart.of_station(file).remember((0.0, 0.0))
    assert not list(tmp_path.iterdir()), "a peg is held in its middle, and needs no file"
    HeldPart.of_station(file).remember((1.5, -1.0))
    assert HeldPart.of_station(file).beside_mm == (1.5, -1.0)
    HeldPart.of_station(file).remember((0.0, 0.0))
    assert HeldPart.of_station(file).beside_mm == (0.0, 0.0)


def test_file_that_cannot_be_written_or_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(NotRemembered, match=r"station\.held\.yaml cannot be written .* Make its folder writable"):
        HeldPart.of_station(tmp_path / "nowhere" / "station.yaml").remember((1.0, 0.0))
    (tmp_path / "station.held.yaml").write_text("x_mm: far\n")
    with pytest.raises(DocumentRejected):
        HeldPart.of_station(tmp_path / "station.yaml")
