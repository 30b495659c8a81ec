"""`vitac team webhook`: the addresses to which the team's notices are posted, over the API; for its captain."""

from typing import Annotated
from uuid import UUID

import typer

from ..terminal.options import Server, TokenFile
from ..terminal.output import AsJson, print_json, print_pairs, print_records
from .http import make_client
from .own_team import own_path

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@app.command("list")
def list_webhooks(server: Server = None, token_file: TokenFile = None, as_json: AsJson = False) -> None:
    """List the team's webhooks, oldest first."""
    client = make_client(server, token_file)
    found = client.call("GET", f"{own_path(client)}/webhooks")["items"]
    print_records(found, ("id", "address", "created_at"), none="No webhook.", as_json=as_json)


@app.command()
def add(
    address: Annotated[str, typer.Argument(help="Where notices are posted, e.g. https://team.example.org/hook.")],
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Post the team's notices to an address, and print the secret that signs them."""
    client = make_client(server, token_file)
    made = client.call("POST", f"{own_path(client)}/webhooks", {"address": address})
    if as_json:
        print_json(made)
        return
    print_pairs({name: made[name] for name in ("id", "address", "secret")})
    print("\nThe secret is shown only once; the receiver checks each notice with it.")


@app.command()
def remove(
    webhook: Annotated[UUID, typer.Argument(help="Id of the webhook, as `vitac team webhook list` prints it.")],
    server: Server = None,
    token_file: TokenFile = None,
) -> None:
    """Post no further notices to an address."""
    client = make_client(server, token_file)
    client.call("DELETE", f"{own_path(client)}/webhooks/{webhook}")
    print(f"{webhook} no longer gets notices")
