"""The 2025 challenge's text logs: read whole, checked for everything that can be checked, converted to JSON lines."""

from .checks import check
from .conversion import to_json_lines
from .kinds import Kind, kind_of
from .messages import TextLogRejected
from .reader import TextEpisode, TextLog, TextStep, read_text_log
from .summary import TextLogSummary, summarize

__all__ = [
    "Kind",
    "TextEpisode",
    "TextLog",
    "TextLogRejected",
    "TextLogSummary",
    "TextStep",
    "check",
    "kind_of",
    "read_text_log",
    "summarize",
    "to_json_lines",
]
