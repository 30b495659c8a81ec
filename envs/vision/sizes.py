"""Sizes of what the rig's cameras give; light to import, for lists of observables."""

HEIGHT_PX = 480
WIDTH_PX = 640
POINTS_PER_OBJECT = 128
