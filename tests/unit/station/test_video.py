"""The video of a trial: what is written, what each manipulation is called, and what a full disk does."""

import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner
from uploaded_logs import log_manifest
from vitac.cli.station import app
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome, EpisodeRecord, TrialEvidence, TrialVideo
from vitac.evaluator.logs.log import LogHeader, write_log
from vitac.station import video
from vitac.station.devices.stage import DeviceFault
from vitac.station.overview import Overview, read_code, write_code
from vitac.station.twin.grasp import Mounted
from vitac.station.twin.overview import OverviewTwin
from vitac.station.verification import verify_video
from vitac.station.video import StoredFrame, VideoRecorder, encode_frame, find_first_link, read_frames

CODE = "0123456789ABCDEF"
FRAMES = 12


class Cameras:
    """A station whose cameras see something new at each look, and a screen with the code."""

    def __init__(self, folder: Path, *, code: str = CODE) -> None:
        write_code(code, folder / "code.png")
        self.reasons: list[str] = []
        self.shown: list[str] = []
        self.guard = SimpleNamespace(stop=self.reasons.append, wrench=lambda: (3.0, 4.0, 0.0, 0, 0, 0))
        self.code = np.pad(video_picture(folder / "code.png"), ((0, 200), (0, 300), (0, 0)), constant_values=90)
        self.overview = SimpleNamespace(show_code=self.shown.append, latest=self.code)
        self.looks, self.generator, self.last = 0, np.random.default_rng(1), ((self.code, self.code), 0)
        self.has_looked = threading.Event()

    @property
    def eyes(self) -> Any:
        self.looks += 1
        if self.looks > FRAMES:
            self.has_looked.set()
            self.looks = FRAMES
            return SimpleNamespace(pictures=self.last)
        noise = self.generator.integers(0, 255, (240, 320, 3), dtype=np.uint8)
        self.last = ((noise, noise), 10**18 + self.looks * 200_000_000)
        return SimpleNamespace(pictures=self.last)


def video_picture(file: Path) -> np.ndarray[Any, Any]:
    import cv2

    return np.asarray(cv2.imread(str(file)))


def record(folder: Path, monkeypatch: pytest.MonkeyPatch, code: str = CODE, shown: str | None = None) -> Any:
    """A video of some frames and its record, with a mark in the middle."""
    monkeypatch.setattr(video, "PERIOD_S", 0.001)
    folder.mkdir(exist_ok=True)
    cameras: Any = Cameras(folder, code=shown or code)
    marks: list[dict[str, Any]] = []
    with VideoRecorder(cameras, folder / "trial.mjpeg", code) as recorder:
        while not cameras.has_looked.wait(0.001):
            if cameras.looks == FRAMES // 2:
                marks[:] = [recorder.mark()]
    assert (cameras.shown, cameras.reasons) == ([code], [])
    assert recorder.video is not None
    return recorder.file, make_record(recorder.video, marks or [recorder.mark()])


def make_record(video: TrialVideo, marks: Sequence[dict[str, Any]]) -> EpisodeRecord:
    return EpisodeRecord(
        episode=1,
        task="peg-insertion",
        shape="cuboid",
        initial_offset=(1.0, 2.0, 3.0),
        outcome=EpisodeOutcome.STEPS,
        env_steps=len(marks),
        total_reward=0.0,
        actions=ActionSequence.from_array(np.zeros((len(marks), 3), np.float32)),
        state_hashes=tuple("0" * 64 for _ in range(len(marks) + 1)),
        infos=tuple({"video": mark} for mark in marks),
        evidence=TrialEvidence(station="lab", video=video),
    )


def test_whole_video_shows_its_code_and_follows_its_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, made = record(tmp_path, monkeypatch)
    found = verify_video(file, made)
    assert (found.problems, found.frames, found.code, found.shows_code) == ([], FRAMES, CODE, True)
    assert found.link == made.evidence.video.link


Frames = list[StoredFrame]


def swap(frames: Frames) -> Frames:
    frames[4], frames[6] = frames[6], frames[4]
    return frames


def delay(frames: Frames) -> Frames:
    late = frames[4].note.model_copy(update={"time_ns": frames[4].note.time_ns + 5 * 10**9})
    return [*frames[:4], frames[4]._replace(note=late), *frames[5:]]


def give_other_picture(frames: Frames) -> Frames:
    return [*frames[:4], frames[4]._replace(jpeg=frames[7].jpeg), *frames[5:]]


def chained_anew(frames: Frames) -> Frames:
    """Numbers and links of what is left, as somebody makes them who knows how."""
    link = find_first_link(CODE)
    for place, frame in enumerate(frames):
        note = frame.note.model_copy(update={"frame": place + 1, "last": place == len(frames) - 1})
        link = note.find_link(link)
        frames[place] = frame._replace(note=note.model_copy(update={"link": link}))
    return frames


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda frames: frames[:3] + frames[5:], "The video was cut: frames 4 to 5 are missing before frame 6."),
        (lambda frames: frames[:-2], "The video was cut: it ends with frame 10, which is not its last one."),
        (lambda frames: frames[2:], "The video was cut: frames 1 to 2 are missing before frame 3."),
        (swap, "Frame 6 is swapped: it stands at place 6, after frame 7."),
        (lambda frames: frames[:5] + frames[4:], "Frame 5 is repeated: it has the picture of frame 5."),
        (delay, "Frame 5 was delayed: 5.2 s after"),
        (give_other_picture, "The picture of frame 5 was changed"),
        (lambda frames: chained_anew(frames[:3] + frames[5:]), "Frames 1 to "),
    ],
    ids=["cut", "cut end", "cut start", "swapped", "repeated", "delayed", "other picture", "chained again"],
)
def test_each_manipulation_has_its_own_sentence(
    change: Callable[[Frames], Frames], sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, made = record(tmp_path, monkeypatch)
    changed = []
    for note, jpeg in change(list(read_frames(file))):
        changed.append(encode_frame(note.model_copy(update={"n_bytes": len(jpeg)}), jpeg))
    file.write_bytes(b"".join(changed))
    found = verify_video(file, made)
    assert any(each.startswith(sentence) for each in found.problems), found.problems


def test_file_that_ends_within_a_frame_and_one_of_another_trial_are_told_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, made = record(tmp_path / "one", monkeypatch)
    other, of_other = record(tmp_path / "other", monkeypatch, code="F" * 16)
    file.write_bytes(file.read_bytes()[:-100])
    assert verify_video(file).problems == [f"The video was cut: it ends within frame {FRAMES}."]
    assert verify_video(other, made).problems == [
        f"The video is of the trial with code {'F' * 16}, the record of that with {CODE}."
    ]
    staged, of_staged = record(tmp_path / "staged", monkeypatch, shown="E" * 16)
    found = verify_video(staged, of_staged)
    assert f"A frame near 1 shows the code {'E' * 16}, expected {CODE}." in found.problems
    no_video = of_other.model_copy(update={"evidence": None})
    assert verify_video(other, no_video).problems == ["The record of episode 1 names no video. Give that of a trial."]
    file.write_bytes(b"GIF89a" * 10)
    assert "Expected frame 1 of a trial's video, got other bytes." in verify_video(file).problems[0]


def test_full_disk_stops_the_station_in_a_sentence_and_leaves_no_video(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(video, "PERIOD_S", 0.001)
    cameras: Any = Cameras(tmp_path)
    with VideoRecorder(cameras, Path("/dev/full"), CODE) as recorder:
        while not cameras.reasons:
            cameras.has_looked.wait(0.001)
    assert cameras.reasons == [
        "The video of the trial cannot be written to /dev: No space left on device. Free space there; the trial is "
        "played again."
    ]
    assert recorder.video is None


@pytest.mark.parametrize("code", ["68DBD700AEDAD707", "120E96624732A7BE"])
def test_code_is_read_that_a_detector_of_opencv_never_finds(tmp_path: Path, code: str) -> None:
    write_code(code, tmp_path / "code.png")
    stage: Any = SimpleNamespace(axes=lambda: (0.0, 0.0, -40.0, 0.0))
    picture = OverviewTwin(stage, stage.axes, Mounted(), tmp_path / "code.png")()
    assert not cv2.QRCodeDetector().detectAndDecode(picture)[0]
    assert read_code(picture) == code


def test_code_that_cannot_be_written_names_the_setting(tmp_path: Path) -> None:
    with pytest.raises(DeviceFault, match="`code_picture` of the station's file"):
        write_code(CODE, tmp_path / "none" / "code.png")


def test_code_is_read_from_a_picture_and_nothing_from_noise(tmp_path: Path) -> None:
    write_code(CODE, tmp_path / "code.png")
    assert read_code(video_picture(tmp_path / "code.png")) == CODE
    assert read_code(np.random.default_rng(0).integers(0, 255, (480, 640, 3), dtype=np.uint8)) is None


def test_command_compares_with_the_trial_of_the_log_that_has_the_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, made = record(tmp_path, monkeypatch)
    with (tmp_path / "log").open("wb") as stream:
        write_log(stream, LogHeader(manifest=log_manifest()), [made])

    def verify(*options: str) -> tuple[int, str]:
        ended = CliRunner().invoke(app, ["verify", str(file), "--log", str(tmp_path / "log"), *options])
        return ended.exit_code, " ".join(ended.output.split())

    code, output = verify()
    assert (code, "Nothing was cut, swapped, repeated, delayed or changed: as the log has it." in output) == (0, True)
    assert verify("--episode", "2")[0] == 1
    file.write_bytes(record(tmp_path / "other", monkeypatch, code="F" * 16)[0].read_bytes())
    assert "The log has no trial with the code FFFFFFFFFFFFFFFF: the video is of another one." in verify()[1]
    code, output = verify("--episode", "1")
    assert (code, "The video is of the trial with code" in output) == (1, True)


def test_a_code_is_waited_for_until_the_camera_sees_it(tmp_path: Path) -> None:
    file, overview = tmp_path / "code.png", Overview.__new__(Overview)  # without a camera
    overview._settings = cast("Any", SimpleNamespace(code_picture=file))
    overview._over, overview.latest = threading.Event(), None

    def look() -> None:
        overview.latest = video_picture(file)

    camera = threading.Timer(0.3, look)
    camera.start()
    overview.show_code(CODE)
    assert overview.latest is not None
    assert read_code(overview.latest) == CODE
    camera.join()
