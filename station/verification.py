"""Finds what was done to the video of a trial: a cut, swapped, repeated, delayed or changed frame, or another trial."""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from vitac.evaluator.episodes.records import EpisodeRecord

from .overview import read_code
from .video import PERIOD_S, FrameNote, StoredFrame, VideoUnreadable, find_first_link, find_overview, read_frames

LARGEST_GAP_S: Final = 3.0
"""A camera that sends nothing for 2 s has failed; a longer time between frames is a delay."""
_LOOKS: Final = 5
"""The code is looked for in every such frame: reading it takes as long as a frame lasts."""
_SEEN_PART: Final = 0.5


@dataclass(kw_only=True)
class VideoFindings:
    """What was found in a video.

    Attributes:
        frames: that can be read.
        code: of the trial, as the first frame says; empty without a frame.
        link: of the last frame.
        shows_code: whether cameras saw the code; None where no camera looks at it.
        problems: a sentence for each.
    """

    frames: int = 0
    code: str = ""
    link: str = ""
    shows_code: bool | None = None
    problems: list[str] = field(default_factory=list)


def verify_video(file: Path, record: EpisodeRecord | None = None) -> VideoFindings:
    """Return what is found in a video, compared with its trial's record where there is one."""
    findings = VideoFindings()
    notes: list[FrameNote] = []
    codes: list[str | None] = []
    digests: dict[str, int] = {}
    try:
        for number, frame in enumerate(read_frames(file)):
            findings.problems += _check_frame(frame, notes, digests)
            notes.append(frame.note)
            if number % _LOOKS == 0:
                codes += _look_for_code(frame)
    except VideoUnreadable as error:
        findings.problems.append(str(error))
    else:
        findings.problems += _check_end(notes)
    if notes:
        findings.frames, findings.code, findings.link = len(notes), notes[0].code, notes[-1].link
    findings.shows_code, problems = _check_codes(codes, findings.code)
    findings.problems += problems
    if record is not None:
        findings.problems += _compare(notes, record)
    return findings


def _check_frame(frame: StoredFrame, before: Sequence[FrameNote], digests: dict[str, int]) -> Iterator[str]:
    note, place = frame.note, len(before) + 1
    digest = hashlib.sha256(frame.jpeg).hexdigest()
    if digest != note.picture:
        yield f"The picture of frame {note.frame} was changed: it is not the one that was recorded."
    elif digest in digests:
        yield f"Frame {note.frame} is repeated: it has the picture of frame {digests[digest]}."
    digests.setdefault(digest, note.frame)
    last = before[-1] if before else None
    expected = last.frame + 1 if last else 1
    if note.frame > expected:
        yield f"The video was cut: frames {expected} to {note.frame - 1} are missing before frame {note.frame}."
    elif note.frame < expected and digests[digest] == note.frame:
        yield f"Frame {note.frame} is swapped: it stands at place {place}, after frame {expected - 1}."
    if last and note.code != last.code:
        yield f"Frame {note.frame} is of another trial: its code is {note.code}, that of the frame before {last.code}."
    follows = note.frame == expected
    if follows and note.link != note.find_link(last.link if last else find_first_link(note.code)):
        yield f"Frame {note.frame} does not follow the frame before: its number, time or picture was changed."
    if last and follows and not 0 < note.time_ns - last.time_ns <= LARGEST_GAP_S * 1e9:
        gap_s = (note.time_ns - last.time_ns) / 1e9
        yield f"Frame {note.frame} was delayed: {gap_s:.1f} s after the frame before, expected about {PERIOD_S:g} s."


def _check_end(notes: Sequence[FrameNote]) -> Iterator[str]:
    if not notes:
        yield "The video has no frame."
    elif not notes[-1].last:
        yield f"The video was cut: it ends with frame {notes[-1].frame}, which is not its last one."


def _look_for_code(frame: StoredFrame) -> Iterator[str | None]:
    """Yield the code that the overview shows in a frame, None where it shows none; nothing without an overview."""
    import cv2

    picture = cv2.imdecode(np.frombuffer(frame.jpeg, np.uint8), cv2.IMREAD_COLOR)
    overview = None if picture is None else find_overview(np.asarray(picture, dtype=np.uint8))
    if overview is not None:
        yield read_code(overview)


def _check_codes(codes: Sequence[str | None], expected: str) -> tuple[bool | None, list[str]]:
    if not codes:
        return None, []
    others = [f"A frame near {1 + _LOOKS * place} shows the code {code}, expected {expected}."
              for place, code in enumerate(codes) if code not in (None, expected)]  # fmt: skip
    part = codes.count(expected) / len(codes)
    seen = [] if part >= _SEEN_PART else [f"The code is seen in {part:.0%} of the looks, expected {_SEEN_PART:.0%}."]
    return not (others or seen), [*others, *seen]


def _compare(notes: Sequence[FrameNote], record: EpisodeRecord) -> Iterator[str]:
    """Compare with the marks in the record, which are in the receipt."""
    video = record.video
    if video is None:
        yield f"The record of episode {record.episode} names no video. Give that of a trial."
        return
    if notes and notes[0].code != video.code:
        yield f"The video is of the trial with code {notes[0].code}, the record of that with {video.code}."
        return
    links = {note.frame: note.link for note in notes}
    marks = [*_marks(record), (video.frames, video.link)]
    wrong = next((frame for frame, link in marks if frame and links.get(frame) != link), None)
    if wrong is not None:
        right = max((frame for frame, link in marks if frame < wrong and links.get(frame) == link), default=0)
        yield f"Frames {right + 1} to {wrong} are not those that the record names: the video was written again."


def _marks(record: EpisodeRecord) -> Iterable[tuple[int, str]]:
    for info in record.infos:
        mark = info.get("video")
        if isinstance(mark, dict):
            yield int(str(mark["frame"])), str(mark["link"])
