"""What the info of the fusion task holds beside that of every insertion task."""

from typing import TypedDict


class SeenObjects(TypedDict):
    """What the rig saw, after the challenge's entries; only where `object_point_cloud` is observed.

    Attributes:
        peg_seen: a pixel of the peg has a depth; otherwise its cloud is zeros.
        base_seen: the same of the base.
    """

    peg_seen: bool
    base_seen: bool
