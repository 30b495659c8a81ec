"""2025 text logs: read, checked against themselves and the published rules, and converted to JSON lines."""

from .checks import WHY_RATES_DIFFER, TextLogSummary, check, summarize, to_json_lines
from .messages import TextLogRejected, is_text_log
from .reader import TextEpisode, TextLog, TextStep, read_text_log
from .scripts import Script, find_script

__all__ = [
    "WHY_RATES_DIFFER",
    "Script",
    "TextEpisode",
    "TextLog",
    "TextLogRejected",
    "TextLogSummary",
    "TextStep",
    "check",
    "find_script",
    "is_text_log",
    "read_text_log",
    "summarize",
    "to_json_lines",
]
