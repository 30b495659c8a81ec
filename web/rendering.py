"""The Jinja environment of the pages: escapes, refuses undefined names, formats rates and times.

Called by `site`.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache, partial
from hashlib import sha256
from pathlib import Path

from jinja2 import DictLoader, Environment, StrictUndefined, select_autoescape
from markupsafe import Markup
from starlette.requests import Request
from vitac.evaluator.episodes.records import EpisodeOutcome, counted_env_steps
from vitac.server.cache import Cache
from vitac.server.views.scores import describe_twins

from .headers import size

STATIC = Path(__file__).parent / "static"
FOLDER = Path(__file__).parent / "templates"


def read_templates(folder: Path = FOLDER) -> dict[str, str]:
    """Return the templates below a folder, by their names."""
    return {file.relative_to(folder).as_posix(): file.read_text(encoding="utf-8") for file in folder.rglob("*.html")}


MAX_FRAGMENTS = 5000
"""Number of cached parts of pages, such as rows of boards of 2 to 4 kB."""
_fragments: Cache[Hashable, Markup] = Cache(at_most=MAX_FRAGMENTS)


@dataclass(frozen=True, eq=False)
class Same:
    """An object as part of a key: only the same object is equal, so one that nobody changes says all that is in it."""

    of: object

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and self.of is other.of

    def __hash__(self) -> int:
        return id(self.of)


def kept(key: Hashable, caller: Callable[[], Markup]) -> Markup:
    """Return the part of a page that a template's call encloses, rendered once for each key.

    Args:
        key: all that the part depends on, the name of its template first.
        caller: renders it; Jinja gives it.
    """
    return _fragments.get(key, caller)


TEMPLATES = read_templates()
"""Read together with the code: a checkout that changes while the service runs has templates for other code."""


@cache
def environment() -> Environment:
    """Return the environment of this process; an undefined name in a template is an error."""
    jinja = Environment(
        loader=DictLoader(TEMPLATES),
        autoescape=select_autoescape(default=True, default_for_string=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    jinja.globals["kept"] = kept
    jinja.filters.update(
        percent=percent,
        timestamp=timestamp,
        deadline=partial(timestamp, is_deadline=True),
        steps=steps,
        env_steps=counted_env_steps,
        duration=duration,
        remaining=remaining,
        words=words,
        short=short,
        across=across,
        prose=prose,
        quantity=quantity,
        size=size,
        number=number,
        within=within,
        meaning=meaning,
        describe_twins=describe_twins,
    )
    return jinja


def render(template: str, request: Request, **values: object) -> str:
    """Render a template; `static_url` and `path` are available in all.

    Args:
        template: file name inside `templates/`.
        request: the request being answered.
        values: variables of the template.
    """
    return (
        environment()
        .get_template(template)
        .render(path=request.url.path, static_url=static_url, request=request, **values)
    )


@cache
def static_url(name: str) -> str:
    """Return the address of a static file, with its digest, so that browsers may cache it for ever."""
    return f"/static/{name}?v={static_digest(name)}"


def static_digest(name: str) -> str:
    """Return the beginning of the SHA-256 [hex] of a static file as it is now."""
    return _compute_digest(name, (STATIC / name).stat().st_mtime_ns)


@cache
def _compute_digest(name: str, changed_ns: int) -> str:
    del changed_ns  # a file that changes has another digest
    return sha256((STATIC / name).read_bytes()).hexdigest()[:12]


def percent(fraction: float | None) -> str:
    """Format a fraction in [0, 1] as a percentage with one decimal; None as a dash."""
    return "–" if fraction is None else f"{100 * fraction:.1f} %".replace(" ", "\N{NO-BREAK SPACE}")


def steps(mean: float | None) -> str:
    """Format a mean number of env steps with two decimals; None (no success) as a dash."""
    return "–" if mean is None else f"{mean:.2f}"


def timestamp(moment: datetime | None, *, is_deadline: bool = False) -> Markup:
    """Format an aware time as a `<time>` element in UTC, to the minute; `locale.js` shows the reader's own time.

    A deadline, or another time that something hangs on, keeps its UTC time beside that.
    """
    if moment is None:
        return Markup("–")
    utc = moment.astimezone(UTC)
    kind = "nowrap deadline" if is_deadline else "nowrap"
    return Markup(  # noqa: S704 - digits only
        f'<time class="{kind}" datetime="{utc:%Y-%m-%dT%H:%M:%SZ}">{utc:%Y-%m-%d %H:%M} UTC</time>'
    )


def duration(seconds: float | None) -> str:
    """Format a duration: `42 s`, `3 min 05 s`, `2 h 10 min`."""
    if seconds is None:
        return "–"
    whole = max(0, round(seconds))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def remaining(seconds: float) -> str:
    """Format the time until an instant: `12 days 3 h`, `3 h 05 min`, `5 min`; `locale.js` does the same."""
    minutes = max(0, int(seconds // 60))
    days, hours, minutes = minutes // 1440, minutes // 60 % 24, minutes % 60
    if days:
        return f"{days} {'day' if days == 1 else 'days'} {hours} h"
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min"


def within(seconds: float | None) -> str:
    """Format a bound on times [s]: `within 50 ms`, `within 2 s`; None as a dash, infinite as beyond what is counted."""
    if seconds is None:
        return "–"
    if seconds == float("inf"):
        return "beyond what is counted"
    return f"within {1000 * seconds:g} ms" if seconds < 1 else f"within {duration(seconds)}"


def number(count: int) -> str:
    """Format a number with its thousands apart."""
    return f"{count:,}".replace(",", "\N{NARROW NO-BREAK SPACE}")


def words(name: str) -> str:
    """Format an identifier as words: `peg-insertion` and `not_converged` as `peg insertion` and `not converged`."""
    return name.replace("_", " ").replace("-", " ")


def meaning(outcome: str) -> str:
    """Return what the word for an end of an episode means."""
    return EpisodeOutcome(outcome).sentence


def quantity(value: object) -> str:
    """Format a value of an env step's info: numbers with four digits, lists with commas, None as a dash."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return ", ".join(quantity(item) for item in value)
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def short(digest: str | None) -> str:
    """Shorten a digest to twelve characters; the submission's page shows it in full."""
    return "–" if digest is None else digest[:12]


def prose(text: str) -> Markup:
    """Format a sentence of a track file: text between backticks becomes code."""
    parts = text.split("`")
    return Markup("").join(
        Markup("<code>{}</code>").format(part) if odd % 2 else part for odd, part in enumerate(parts)
    )


def across(fraction: float | None) -> str:
    """Format a fraction in [0, 1] as a horizontal position in an SVG: `41.48%`."""
    return f"{100 * min(1.0, max(0.0, fraction or 0.0)):.2f}%"
