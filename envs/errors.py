"""The root of every error that ViTac Arena raises on purpose."""


class VitacError(Exception):
    """Something was asked that cannot be done; the message says what was expected, what was given and what to do."""
