"""How SAPIEN may render; light to import."""

from enum import StrEnum


class RenderMode(StrEnum):
    """How SAPIEN renders a picture."""

    RAST = "rast"
    """Rasterised with its default shader."""
    RT = "rt"
    """Ray-traced, 4 samples per pixel without a denoiser."""
