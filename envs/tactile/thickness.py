"""How far a gel reaches from the origin of its frame; gripper and camera follow from it."""

from ..fem.model.mesh import GelMesh

# From the camera's optical centre to the back face of the gel, for every sensor (challenge-facts 9).
EYE_TO_BACK_MM = 18.0
# Heights are rounded to this many decimals of a millimetre, since meshes in files are.
_DECIMALS = 6


def highest_mm(gel: GelMesh) -> float:
    """Return the height of the gel's highest point above the origin of its frame [mm]."""
    return round(float(gel.rest_position_m[:, 2].max()) * 1e3, _DECIMALS)


def eye_distance_m(gel: GelMesh) -> float:
    """Return the distance of the camera behind the origin of the gel's frame [m]: 20 mm for the challenge's gel."""
    back_mm = round(float(gel.rest_position_m[gel.driven_nodes, 2].min()) * 1e3, _DECIMALS)
    return (EYE_TO_BACK_MM - back_mm) * 1e-3
