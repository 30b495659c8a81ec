"""The contact model of a task's settings, chosen by name."""

from dataclasses import replace
from typing import Any, TypeVar

from ..fem.model.settings import ArenaContactSettings, ContactModel
from .settings import SettingsError

SettingsT = TypeVar("SettingsT")


def with_contact_model(settings: SettingsT, name: str | None) -> SettingsT:
    """Return the settings of a task with the contact model of this name; the same where they have it or none is named.

    Raises:
        SettingsError: there is no such model, or the settings have been given another one.
    """
    if name is None:
        return settings
    if name not in set(ContactModel):
        raise SettingsError(f"Argument 'contact_model' is {name!r}, expected one of {', '.join(ContactModel)}.")
    physics: Any = settings.physics  # type: ignore[attr-defined]
    if physics.contact.model == name:
        return settings
    if name != ContactModel.ARENA_1:
        given = physics.contact.model
        raise SettingsError(
            f"Argument 'contact_model' is {name!r}, but 'physics' was given with {given}; leave one out."
        )
    return replace(settings, physics=replace(physics, contact=ArenaContactSettings()))  # type: ignore[type-var]
