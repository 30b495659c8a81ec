"""Root of the tables, and the kinds of columns that several of them have."""

from datetime import datetime
from enum import StrEnum
from typing import Any
from uuid import UUID

from sqlalchemy import CheckConstraint, DateTime, Enum, Integer, MetaData, Text, Uuid
from sqlalchemy.dialects.postgresql import ARRAY, JSONB
from sqlalchemy.orm import DeclarativeBase

NAMING = {
    "ix": "ix_%(table_name)s_%(column_0_N_name)s",
    "uq": "uq_%(table_name)s_%(column_0_N_name)s",
    "ck": "ck_%(table_name)s_%(constraint_name)s",
    "fk": "fk_%(table_name)s_%(column_0_name)s",
    "pk": "pk_%(table_name)s",
}

SHA256_PATTERN = "^[0-9a-f]{64}$"


class Base(DeclarativeBase):
    """Root of the tables; maps Python types to columns."""

    metadata = MetaData(naming_convention=NAMING)
    type_annotation_map = {  # noqa: RUF012 - SQLAlchemy reads it from the class
        datetime: DateTime(timezone=True),
        dict[str, Any]: JSONB,
        list[dict[str, Any]]: JSONB,
        list[str]: ARRAY(Text),
        list[int]: ARRAY(Integer),
        str: Text,
        UUID: Uuid,
    }


def closed_set(members: type[StrEnum], name: str, length: int = 16) -> Enum:
    """Return the text column that takes the members of an enum only."""
    return Enum(
        members,
        name=name,
        native_enum=False,
        create_constraint=True,
        length=length,
        values_callable=lambda all_of: [member.value for member in all_of],
    )


def sha256_check(column: str) -> CheckConstraint:
    """Return the constraint that a column holds a SHA-256 [hex]."""
    return CheckConstraint(f"{column} ~ '{SHA256_PATTERN}'", name=f"{column}_is_sha256")
