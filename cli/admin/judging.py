"""`vitac admin judging`: judges' marks by the rubric of a track, conflicts of interest, and what follows from them."""

from typing import Annotated
from uuid import UUID

import typer
from vitac.server.accounts.tokens import is_judge
from vitac.server.competitions.competition import Competition
from vitac.server.decisions.judging import declare_conflict, find_rubric, give_marks, judged
from vitac.server.principals import CONSOLE
from vitac.server.views.judging import JudgedTeamView

from ..service.database import transaction
from ..terminal.output import AsJson, percent, print_done, print_json, print_table, warn
from .competition.competition import CompetitionName
from .consent import DryRun, change_transaction

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

Judge = Annotated[str, typer.Option(help="Name of the judge.")]


@app.command()
def rubric(
    track: Annotated[str, typer.Argument(help="Name of the track.")],
    competition: CompetitionName = None,
    as_json: AsJson = False,
) -> None:
    """Show the criteria and weights of a track."""
    with transaction() as session:
        found = find_rubric(Competition.find(session, competition, track=track), track)
    if as_json:
        print_json(found.model_dump(mode="json"))
        return
    print_table(("criterion", "marks from 0 to 10 for"), [[each.name, each.title] for each in found.criteria], none="")
    weights = ", ".join(f"{name} {weight:g}" for name, weight in found.weights)
    print(f"weights: {weights}; at least {found.judges_at_least} judges")


@app.command()
def mark(
    submission: Annotated[UUID, typer.Argument(help="Id of the submission.")],
    marks: Annotated[list[str], typer.Argument(help="CRITERION=MARK for every criterion.")],
    judge: Judge,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Store the marks of a judge, replacing earlier ones."""
    given = _parsed(marks)
    with change_transaction(dry_run=dry_run) as session:
        give_marks(session, CONSOLE, submission, given, judge=judge)
        known = is_judge(session, judge)
    content = {"submission": submission, "judge": judge, "marks": given}
    print_done(f"marks of {judge} for {submission}", content, as_json=as_json)
    _warn_of_stranger(judge, known=known)


@app.command()
def conflict(
    team: Annotated[str, typer.Argument(help="Name or id of the team.")],
    judge: Judge,
    reason: Annotated[str, typer.Option(help="Why there is a conflict, in words.")],
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Record a conflict of interest: removes the judge's marks of that team and accepts no new ones."""
    with change_transaction(dry_run=dry_run) as session:
        declare_conflict(session, CONSOLE, team, reason, judge=judge)
        known = is_judge(session, judge)
    print_done(f"{judge} does not judge {team}", {"team": team, "judge": judge, "reason": reason}, as_json=as_json)
    _warn_of_stranger(judge, known=known)


@app.command()
def show(
    track: Annotated[str, typer.Argument(help="Name of the track.")],
    stage: Annotated[str | None, typer.Option(help="Name of the stage; by default the one that opened last.")] = None,
    competition: CompetitionName = None,
    as_json: AsJson = False,
) -> None:
    """Show each team's marks with their spread, its figures and its total."""
    with transaction() as session:
        found = judged(session, CONSOLE, Competition.find(session, competition, track=track).shown_stage(track, stage))
    if as_json:
        print_json([team.model_dump() for team in found])
        return
    columns = ("team", "submission", "success", "judges", "mark", "spread", "figures", "total", "conflicts")
    print_table(columns, [_row(team) for team in found], none="The board is empty.")


def _warn_of_stranger(judge: str, *, known: bool) -> None:
    """Warn of a judge without a token: a name that is written in another way counts as one judge more."""
    if not known:
        warn(f"no judge with a token is named {judge!r}; check the spelling: another name is another judge.")


def _row(team: JudgedTeamView) -> list[object]:
    return [
        team.team,
        team.submission,
        percent(team.success_rate),
        len(team.judges),
        team.mark,
        team.spread,
        percent(team.figures),
        percent(team.total),
        ", ".join(f"{name} (marks set aside)" if name in team.set_aside else name for name in team.conflicts),
    ]


def _parsed(texts: list[str]) -> dict[str, float]:
    found: dict[str, float] = {}
    for text in texts:
        name, _, mark = text.partition("=")
        try:
            found[name] = float(mark)
        except ValueError:
            raise typer.BadParameter(f"expected CRITERION=MARK such as structure=7.5, got {text!r}") from None
    return found
