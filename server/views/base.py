"""The base of all answers of the REST API, which the pages show, too; made by the service layer, never changed."""

from typing import Any, Self

from pydantic import BaseModel, ConfigDict


class View(BaseModel):
    """Base of all answers: frozen, nothing beyond the fields."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @classmethod
    def from_row(cls, row: object, **values: Any) -> Self:
        """Return the answer about a row: each field that is not among the values is what the row has of that name."""
        return cls(**{name: getattr(row, name) for name in cls.model_fields.keys() - values.keys()}, **values)
