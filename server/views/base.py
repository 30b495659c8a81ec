"""The base of all answers of the REST API, which the pages show, too; made by the service layer, never changed."""

from pydantic import BaseModel, ConfigDict


class View(BaseModel):
    """Base of all answers: frozen, nothing beyond the fields."""

    model_config = ConfigDict(frozen=True, extra="forbid")
