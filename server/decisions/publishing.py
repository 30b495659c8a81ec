"""The results of a competition as files: JSON and CSV for programs, pages to print, a certificate for each winner."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC

from jinja2 import Environment
from sqlalchemy.orm import Session
from vitac.errors import VitacError

from ..competitions.competition import Competition
from ..competitions.definition import CompetitionDefinition
from ..competitions.view import competition_view, disqualified_since_the_end
from ..csv_text import csv_text
from ..errors import ProblemCode, ServiceError
from ..transparency.log import ensure_key
from ..views.competition import ArchiveView
from ..views.leaderboards import LeaderboardEntryView, LeaderboardView
from ..views.scores import describe_twins
from .finishing import Winner, find_last_decision, make_boards, winners

_COLUMNS = (
    "track",
    "stage",
    "rank",
    "first_possible_rank",
    "last_possible_rank",
    "team",
    "success_rate",
    "low",
    "high",
)
_MORE = ("mean_steps", "submission", "submitted_at", "list_kind", "result_hash", "evaluator_version", "twin_trials")
"""A spreadsheet runs a cell that begins with one of these as a formula, and a team's name may begin so."""
_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{{ title }}</title>
<style>
body { font: 11pt/1.5 sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em; }
table { border-collapse: collapse; width: 100%; }
th, td { border-bottom: 1px solid #999; padding: .3em .6em; text-align: left; }
tr { break-inside: avoid; }
.certificate { text-align: center; padding: 6em 2em; border: 2px solid; margin: 3em 0; overflow-wrap: anywhere; }
.certificate h2 { font-size: 2.5em; margin: .3em; }
@media print {
body { margin: 0; max-width: none; padding: 0; }
.on-screen { display: none; }
.certificate { box-sizing: border-box; min-height: 178mm; margin: 0; border-width: 4px; display: flex;
flex-direction: column; justify-content: center; break-inside: avoid; }
.certificate + .certificate { break-before: page; }
{% if certificates %}@page { size: A4 landscape; margin: 15mm; }{% endif %}
}
</style></head><body>
{% if certificates %}
<h1 class="on-screen">{{ title }}: certificates</h1>
{% for winner in winners %}
<section class="certificate">
<p>{{ title }}</p>
{% if not final_on %}<p><strong>Not final: results may still change.</strong></p>{% endif %}
<h2>{{ winner.team }}</h2>
<p>{{ winner.place|capitalize }} prize, {{ names[winner.track] }}</p>
<p>{% if winner.points is not none %}{{ "%g"|format(winner.points) }} points{% else %}{{ winner.won_by
}}{% endif %}{% if winner.total is not none %}; total {{
"%.1f"|format(100 * winner.total) }} %{% endif %}{% if winner.note %}; {{ winner.note }}{% endif %}</p>
{% if final_on %}<p>final since {{ final_on }}</p>{% endif %}
{% if winner.submission in twins %}<p><strong>{{ twins[winner.submission] }}</strong></p>{% endif %}
<p><small>{% if winner.result_hash %}result hash {{ winner.result_hash }}{% else %}evidence {{ winner.evidence
}}{% endif %}</small></p>
</section>
{% endfor %}
{% else %}
<h1>{{ title }}</h1>
<p>{{ "Final results of " + final_on + "." if final_on else "Not final: results may still change." }}</p>
<h2>Winners</h2>
<table><thead><tr><th>Track</th><th>Prize</th><th>Team</th><th>Amount</th></tr></thead><tbody>
{% for winner in winners %}
<tr><td>{{ names[winner.track] }}</td><td>{{ winner.place }}{% if winner.total is not none %}, by a total of {{
"%.1f"|format(100 * winner.total) }} %{% elif winner.points is not none %}, by {{ "%g"|format(winner.points)
}} points{% endif %}</td><td>{{ winner.team }}</td>
<td>{{ winner.amount }} {{ winner.currency }}</td></tr>
{% endfor %}
</tbody></table>
{% for board in boards %}
<h2>{{ names[board.track] }}, {{ stages[board.track, board.stage] }}</h2>
<p>{{ board.ranking_rule }}</p>
{% for entry in board.entries if entry.submission_id|string in twins %}
<p><strong>{{ entry.team }}: {{ twins[entry.submission_id|string] }}</strong></p>
{% endfor %}
<table><thead><tr><th>Rank</th><th>Team</th><th>Success rate</th>
<th>95 % interval</th><th>Mean env steps</th>
{% for key in board.ranking.measures %}<th>{{ key.title }}</th>{% endfor %}</tr></thead>
<tbody>
{% for entry in board.entries %}
<tr><td>{{ entry.rank or "-" }}</td><td>{{ entry.team }}</td><td>{{ "%.1f"|format(100 * entry.success_rate) }} %</td>
<td>{{ "%.1f"|format(100 * entry.success_rate_interval[0]) }} to
{{ "%.1f"|format(100 * entry.success_rate_interval[1]) }} %</td>
<td>{{ "%.2f"|format(entry.mean_steps) if entry.mean_steps is not none else "-" }}</td>
{% for key in board.ranking.measures %}
<td>{{ "%.3g"|format(entry.measures[key.name]) if key.name in entry.measures else "-" }}</td>
{% endfor %}</tr>
{% endfor %}
</tbody></table>
{% endfor %}
{% endif %}
</body></html>
"""


class ResultsNotWritten(VitacError):
    """The results cannot be written where they were asked for."""


def result_files(session: Session, name: str | None = None) -> Mapping[str, str]:
    """Return the content of each file by its name.

    Raises:
        ServiceError: there is no competition, a board has results of another evaluator version, or a winner was
            disqualified after the end.
    """
    competition, winning = Competition.find(session, name), winners(session, name)
    boards, final_since = make_boards(session, competition), competition.row.finalized_at
    _require_qualified(competition, winning)
    final_on = None if final_since is None else f"{final_since.astimezone(UTC):%F}"
    return {
        "results.json": _json(competition.definition, boards, winning, is_final=final_on is not None),
        "results.csv": _csv(boards),
        "results.html": _page(competition, boards, winning, final_on=final_on, certificates=False),
        "certificates.html": _page(competition, boards, winning, final_on=final_on, certificates=True),
    }


def _require_qualified(competition: Competition, winning: Sequence[Winner]) -> None:
    """Refuse to give a certificate to a team that was disqualified after the end."""
    out = {team.team for team in disqualified_since_the_end(competition)} & {winner.team for winner in winning}
    if out:
        raise ServiceError(
            ProblemCode.TEAM_DISQUALIFIED,
            f"Expected winners that take part, got {', '.join(sorted(out))}, disqualified after the end; "
            "`vitac admin results finalize --again` decides the winners without them.",
        )


def _json(
    definition: CompetitionDefinition, boards: Sequence[LeaderboardView], winning: Sequence[Winner], *, is_final: bool
) -> str:
    content = {
        "competition": definition.model_dump(mode="json"),
        "is_final": is_final,
        "winners": [asdict(winner) for winner in winning],
        "boards": [board.model_dump(mode="json") for board in boards],
    }
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


def _csv(boards: Sequence[LeaderboardView]) -> str:
    measures = dict.fromkeys(key.name for board in boards for key in board.ranking.measures)
    rows = [(*_row(board, entry), *map(entry.measures.get, measures)) for board in boards for entry in board.entries]
    return csv_text([(*_COLUMNS, *_MORE, *measures), *rows])


def _row(board: LeaderboardView, entry: LeaderboardEntryView) -> list[object]:
    return [
        *(board.track, board.stage, entry.rank, *(entry.rank_range or (None, None)), entry.team, entry.success_rate),
        *(*entry.success_rate_interval, entry.mean_steps, str(entry.submission_id), entry.submitted_at.isoformat()),
        *(entry.list_kind, entry.result_hash, entry.evaluator_version),
        sum(sum(score.twins.values()) for score in entry.scores),
    ]


def _page(
    competition: Competition,
    boards: Sequence[LeaderboardView],
    winning: Sequence[Winner],
    *,
    final_on: str | None,
    certificates: bool,
) -> str:
    page = Environment(autoescape=True).from_string(_PAGE)
    return page.render(
        title=competition.definition.title,
        names={name: track.title for name, track in competition.definition.tracks.items()},
        winners=winning,
        boards=boards,
        final_on=final_on,
        stages=competition.stage_titles,
        twins={
            str(entry.submission_id): said
            for board in boards
            for entry in board.entries
            if (said := describe_twins(entry.scores))
        },
        certificates=certificates,
    )


def archive_view(session: Session, name: str | None = None) -> ArchiveView:
    """Return the archive of a competition; `name` None: of the one that opened last.

    Raises:
        ServiceError: this service runs none, or it is not final.
    """
    view, competition = competition_view(session, name), Competition.read(session, name)
    if view.finalized_at is None:
        raise ServiceError(
            ProblemCode.NOT_FOUND,
            f"{view.title} is still running; its archive appears here once the organizers have made it final.",
        )
    return ArchiveView(
        competition=view,
        boards=[LeaderboardView.model_validate(board) for board in competition.row.boards or []],
        public_key=ensure_key(session).public_key,
        decided_again_at=find_last_decision(session, competition),
        citation=_citation(view.name, view.title, view.finalized_at.year, view.website),
    )


def _citation(name: str, title: str, year: int, website: str | None) -> str:
    """Return an entry for BibTeX; what would end a field or begin a command in it is left out."""
    plain = "".join(character for character in title if character not in "{}\\%#$&~^_")
    lines = [f"  title = {{{{{plain}}}}}", f"  year  = {{{year}}}", "  note  = {Final results with result hashes}"]
    lines += [f"  url   = {{{website}}}"] if website else []
    return f"@misc{{{name},\n" + ",\n".join(lines) + "\n}"
