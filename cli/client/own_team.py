"""The team of a token, for the commands that change it."""

from vitac.envs.errors import VitacError

from .http import Client


class NoTeam(VitacError):
    """The token belongs to no team, or the team has no such member: `vitac whoami` and `vitac team show` say which."""


def own_path(client: Client) -> str:
    """Return the path of the API under which the team is.

    Raises:
        NoTeam: the token is an organizer's or a judge's.
    """
    team = client.me()["team"]
    if team is None:
        raise NoTeam("This token belongs to no team; `vitac whoami` shows whose it is.")
    return f"/api/v1/teams/{team['id']}"
