from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from vitac.station.eyes import Finger, SensorReading
from vitac.station.perception.markers import MarkerFlow, cut_picture
from vitac.station.ros.messages import RosVersion, messages, read_flow
from vitac.station.ros.relay import RecordingExists, recording

TIME_NS = 1_700_000_000_123_456_789


def sight(movement_px: float) -> SensorReading:
    """Both sides see different pictures and markers; the left ones have moved."""
    generator = np.random.default_rng(3)
    flows = []
    for markers, moved in ((63, movement_px), (51, 0.0)):
        reference = generator.uniform(0, 240, (markers, 2)).astype(np.float32).astype(float)
        flows.append(MarkerFlow(reference, reference + moved))
    left, right = (generator.integers(0, 256, (338, 448, 3), dtype=np.uint8) for _ in range(2))
    return SensorReading(flows[0], flows[1], (left, right), TIME_NS)


@pytest.mark.parametrize("name", ["trial.bag", "trial"])
def test_what_is_recorded_is_read_back_by_other_programs(tmp_path: Path, name: str) -> None:
    recorded = sight(2.0)
    with recording(tmp_path / name) as record:
        for message in messages(recorded):
            record(message, recorded.time_ns)
    version = RosVersion.ROS_1 if name.endswith(".bag") else RosVersion.ROS_2
    with AnyReader([tmp_path / name], default_typestore=version.types()) as reader:
        read: dict[str, tuple[int, Any]] = {
            connection.topic: (time_ns, reader.deserialize(data, connection.msgtype))
            for connection, time_ns, data in reader.messages()
        }
    assert {topic.removeprefix("/") for topic in read} == set(version.topics())
    for side, touch, taken in zip(Finger, (recorded.left, recorded.right), recorded.pictures, strict=True):
        time_ns, tracking = read[f"/Marker_Tracking_{side.title()}"]
        assert time_ns == TIME_NS == tracking.header.stamp.sec * 10**9 + tracking.header.stamp.nanosec
        flow = read_flow(vars(tracking))
        np.testing.assert_array_equal(flow.reference, touch.reference)
        np.testing.assert_allclose(flow.current, touch.current, atol=1e-4)
        picture = read[f"/Tactile_Image_{side.title()}"][1]
        assert (picture.encoding, picture.step) == ("bgr8", 960)
        np.testing.assert_array_equal(picture.data.reshape(picture.height, picture.width, 3), cut_picture(taken))
    assert read["/Marker_Tracking_Contact"][1].is_contact
    assert not read["/Marker_Tracking_Contact"][1].is_overforced


@pytest.mark.parametrize(("movement_px", "said"), [(0.0, (False, False)), (1.0, (True, False)), (40.0, (True, True))])
def test_contact_and_over_force_are_those_of_either_gel(movement_px: float, said: tuple[bool, bool]) -> None:
    *_, judging = messages(sight(movement_px))
    assert tuple(judging.fields.values()) == said


def test_nothing_is_written_over(tmp_path: Path) -> None:
    with pytest.raises(RecordingExists, match="exists"), recording(tmp_path):
        pass
