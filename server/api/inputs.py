"""What all inputs of routes have in common."""

from pydantic import BaseModel, ConfigDict


class Input(BaseModel):
    """Base of the inputs: a field that is not declared is refused."""

    model_config = ConfigDict(extra="forbid")
