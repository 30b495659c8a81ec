"""Logs to upload: whole and plausible, with made-up states; and a 2025 text log of the same list."""

import gzip
import io
from collections.abc import Iterable
from functools import cache
from typing import Any

from httpx import Response
from service_client import Service
from service_factories import TASK, TRACK, make_manifest, make_record
from text_log_writer import text_log
from vitac.evaluator.episodes.records import EpisodeRecord, Manifest
from vitac.evaluator.logs.log import LogHeader, write_log
from vitac.evaluator.logs.text_2025.scripts import all_scripts
from vitac.evaluator.tracks import load_track

EPISODES = tuple(range(1, 271))
CONTENT_TYPES = {"log": "application/x-ndjson", "text_log": "text/plain"}


def log_manifest(**changes: Any) -> Manifest:
    """What a log of this evaluator says that it was made with."""
    digest = load_track(TRACK).tasks[TASK].digest()
    return make_manifest().model_copy(update={"task_hash": digest, **changes})


def some_records() -> list[EpisodeRecord]:
    """All episodes of the list, as `service_factories.play_all` plays them."""
    return [make_record(episode) for episode in EPISODES]


def a_log(records: Iterable[EpisodeRecord] | None = None, team: str | None = "Team A", **manifest: Any) -> bytes:
    """A whole log; of other records, another team or manifest where they are given."""
    stream = io.BytesIO()
    header = LogHeader(team=team, manifest=log_manifest(**manifest))
    write_log(stream, header, some_records() if records is None else records)
    return stream.getvalue()


def a_text_log(team: str = "Team A", **changes: Any) -> bytes:
    """A 2025 text log of the peg task, every test with two actions; 13 of 270 succeed."""
    return _changed_text_log(team, **changes) if changes else _text_log(team)


@cache
def _text_log(team: str) -> bytes:
    return _changed_text_log(team)


def _changed_text_log(team: str, **changes: Any) -> bytes:
    script = next(script for script in all_scripts() if script.name == "track 1 peg insertion")
    episodes = [_test(number, start.offset) for number, start in enumerate(script.starts(), start=1)]
    values: dict[str, Any] = {
        "episodes": episodes,
        "environment": script.environment,
        "md5": script.md5[0],
        "totals": ("#SUCCESS_RATE: 4.81%", "#AVG_STEP: 2.00"),
        "team": team,
    }
    return text_log(**(values | changes)).encode()


def _test(number: int, offset: tuple[float, ...]) -> dict[str, Any]:
    steps = [_step(n, offset, number <= 13 and n == 2) for n in (1, 2)]
    return {
        "episode": number,
        "initial_offset": offset,
        "steps": steps,
        "result": "SUCCESS" if number <= 13 else "FAIL",
    }


def _step(n: int, offset: tuple[float, ...], success: bool) -> dict[str, Any]:
    return {
        "n": n,
        "action": (0.25, 0.0, -0.5),
        "offset_obs": offset,
        "info_steps": n,
        "surface_diff_m": (0.0005, 0.0005),
        "tactile_movement_too_large": False,
        "too_many_steps": False,
        "error_too_large": False,
        "peg_relative_z_mm": (0.5, 0.5, 0.5, 0.5),
        "is_success": success,
        "relative_motion_mm_deg": (0.0, 0.0, 0.0, 0.0),
        "gt_offset_mm_deg": offset,
        "reward": -1.0,
    }


def packed(log: bytes) -> bytes:
    """The same, as gzip."""
    return gzip.compress(log, mtime=0)


def upload_log(service: Service, log: Any, kind: str = "log", token: str | None = None, **options: Any) -> Response:
    """Uploads a log; a packed one is announced as such."""
    is_packed = isinstance(log, bytes) and log.startswith(b"\x1f\x8b")
    content_type = "application/gzip" if is_packed else CONTENT_TYPES[kind]
    query = f"?kind={kind}{options.pop('query', '')}"
    return service.upload(log, token, query, Content_Type=content_type, **options)
