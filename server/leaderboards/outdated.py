"""Says why results have no rank after an upgrade of the evaluator; called by boards and submissions."""

from collections.abc import Collection

from vitac.evaluator.submission_kinds import SubmissionKind

from ..competition.stages import CountedResults


def explain_unranked(
    made_by: Collection[str], counted: CountedResults, track: str, *, kind: SubmissionKind, of: int
) -> str | None:
    """Return why entries of a board have no rank, and what brings it back; None where all were made by its evaluator.

    Args:
        made_by: the evaluator version of each entry without a rank that another one made.
        counted: which results the board ranks.
        track: of the board.
        kind: of the entries.
        of: how many entries there are.
    """
    if not made_by:
        return None
    count = f"{len(made_by)} of {of} entries {'has' if len(made_by) == 1 else 'have'} no rank"
    made = f"evaluator {' or '.join(sorted(set(made_by)))} made {'it' if len(made_by) == 1 else 'them'}"
    return (
        f"{count}: {made}, and this board ranks results of evaluator {counted.evaluator_version}, as results of two "
        f"evaluators are not comparable. {_remedy(counted, track, kind)}"
    )


def explain_unranked_submission(made_by: str, counted: CountedResults, track: str) -> str | None:
    """Return why a scored model has no rank, and what brings it back; None where its board ranks it."""
    if made_by == counted.evaluator_version or counted.final_since is not None:
        return None
    return (
        f"It has no rank: evaluator {made_by} made its result, and the board ranks results of evaluator "
        f"{counted.evaluator_version}, as results of two evaluators are not comparable. "
        f"{_remedy(counted, track, SubmissionKind.MODEL)}"
    )


def _remedy(counted: CountedResults, track: str, kind: SubmissionKind) -> str:
    if counted.final_since is not None:
        return "The results are final, and stay as they are."
    again = "A submission gets a rank once it is evaluated again"
    if not kind.form.runs_policy:
        return f"{again}: upload a log of the present evaluator."
    return f"{again}: organizers do so with `vitac admin rejudge start --track {track} --reason REASON`, then `apply`."
