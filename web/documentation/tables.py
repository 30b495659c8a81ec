"""Writes tables of tasks, settings, outcomes and verdicts, as Markdown, from the code that they describe."""

from collections.abc import Iterable
from enum import Enum

from pydantic.fields import FieldInfo
from vitac.evaluator.agent.verdicts import VerdictCode
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.tracks import find_task
from vitac.server.settings import Settings


def settings() -> str:
    """Return a row for each setting of server and worker."""
    fields = Settings.model_fields.items()
    rows = ((f"VITAC_{name.upper()}", field.description or "", _default(field)) for name, field in fields)
    return _table(("variable", "meaning", "default"), rows)


def task(name: str) -> str:
    """Return the observations and the actions of a task."""
    _, found = find_task(name)
    seen = ((row.name, f"{tuple(row.shape)} {row.dtype}", row.unit, row.meaning) for row in found.observables)
    done = ((row.name, f"{row.scale:g} {row.unit}", row.meaning) for row in found.actions)
    observations = _table(("observation", "shape, type", "unit", "meaning"), seen)
    return f"{observations}\n{_table(('action', 'at 1', 'meaning'), done)}"


def outcomes() -> str:
    """Return a row for each way in which an episode ends."""
    return _table(("outcome", "meaning"), ((str(outcome), outcome.sentence) for outcome in EpisodeOutcome))


def verdicts() -> str:
    """Return a row for each reason why a policy has no score."""
    return _table(("verdict", "what to do"), ((str(code), code.sentence) for code in VerdictCode))


def _default(field: FieldInfo) -> str:
    """Return a default as it is written in the environment; a description names one that is computed."""
    value = field.default.value if isinstance(field.default, Enum) else field.default
    if field.default_factory is not None:
        return "as described"
    if value in (None, ""):
        return "none"
    return f"{value:g}" if isinstance(value, float) else str(value).lower() if isinstance(value, bool) else f"{value}"


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [" | ".join(head), " | ".join(["---"] * len(head))]
    lines += [" | ".join((f"`{name}`", *cells)) for name, *cells in rows]
    return "".join(f"| {line} |\n" for line in lines)
