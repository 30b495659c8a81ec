"""Refusals, as RFC 9457 has them."""

from typing import Any

from pydantic import BaseModel, ConfigDict


class ProblemView(BaseModel):
    """RFC 9457 problem; `code` is stable, further members depend on it."""

    model_config = ConfigDict(extra="allow")

    type: str
    title: str
    status: int
    detail: str
    code: str
    instance: str
    errors: list[dict[str, Any]] | None = None
