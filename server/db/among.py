"""The condition that a column is one of many ids; called by what reads rows for a page of others."""

from collections.abc import Collection
from uuid import UUID

from sqlalchemy import ColumnElement, Uuid, bindparam, func, literal
from sqlalchemy.dialects.postgresql import ARRAY
from sqlalchemy.orm import InstrumentedAttribute


def among(column: InstrumentedAttribute[UUID], ids: Collection[UUID]) -> ColumnElement[bool]:
    """Return the condition with all ids in one parameter, so that the statement is the same however many there are.

    With a parameter for each (`in_`), driver and database read a statement of many kilobytes each time.
    """
    return column == func.any(literal(list(ids), ARRAY(Uuid)))


def among_parameter(column: InstrumentedAttribute[UUID], name: str) -> ColumnElement[bool]:
    """Return the same for a statement that is put together once: the list of ids is its parameter of that name."""
    return column == func.any(bindparam(name, type_=ARRAY(Uuid)))
