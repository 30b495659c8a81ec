"""`vitac whoami`: whose token the commands use, and what the team may have."""

from ..terminal.options import Server, TokenFile
from ..terminal.output import AsJson, print_json, print_pairs, print_records
from .http import Json, make_client


def command(
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Show team, token and quotas."""
    client = make_client(server, token_file)
    me = client.me()
    if as_json:
        print_json(me)
        return
    token = me["token"]
    print_pairs(
        {
            "server": client.server,
            "as": format_owner(me),
            **({"shown as": me["team"]["shown_as"]} if me["team"] is not None else {}),
            "token": token["label"],
            "expires": token["expires_at"] or "never",
        }
    )
    if me["quotas"]:
        print()
        print_records(me["quotas"], ("quota", "limit", "used", "opens_at"), none="", as_json=False)
    if me.get("stage_quotas"):
        print()
        has_several = len({use["competition"] for use in me["stage_quotas"]}) > 1
        columns = ("track", "stage", "quota", "limit", "used", "closes")
        shown = ("competition", *columns) if has_several else columns
        print_records(me["stage_quotas"], shown, none="", as_json=False)


def format_owner(me: Json) -> str:
    """Return the team's name, or that it is an organizer."""
    if me["team"] is not None:
        return str(me["team"]["name"])
    competition = (me["token"] or {}).get("competition")
    return f"organizer of {competition}" if competition else "organizer"
