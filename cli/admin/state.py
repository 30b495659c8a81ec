"""States of evaluations as options name them; called by the nouns that list by state."""

import typer
from vitac.server.db.states import EvaluationState


def known_state(name: str) -> "EvaluationState":
    """Return the state of that name.

    Raises:
        typer.BadParameter: there is none.
    """
    try:
        return EvaluationState(name)
    except ValueError:
        raise typer.BadParameter(f"{name!r} is no state; they are {', '.join(EvaluationState)}") from None
