"""How the stereo camera measures, as numbers; light to import, because they are part of a track's digest."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class StereoMethod:
    """Projector, exposure, noise and matching of an active stereo camera.

    Attributes:
        pattern_seed: of the projector's dots.
        albedo: share of the light that every surface gives back.
        ambient: even light besides the dots, as a share of the brightest dot.
        speckle_shape: shape of the gamma distribution of mean 1 whose factor every pixel gets.
        thermal_sd_grey: standard deviation of what is added to every pixel [grey levels].
        census_radius_px: pixels around each one that its census code compares.
        block_radius_px: pixels around each one whose costs are summed.
        smallest_disparity_px: that is looked for.
        largest_disparity_px: that is looked for.
        small_jump: cost of a disparity that changes by 1 between neighbours, per pixel of a block.
        large_jump: cost of one that changes by more.
        paths: directions from which costs are summed.
        uniqueness_percent: how much more every other match must cost.
        largest_left_right_difference_px: between the matches of a pixel and of its partner.
        median_width_px: of the filter after matching.
        largest_gap_difference_m: between the depths on both sides of a gap that is filled.
    """

    pattern_seed: int = 415
    albedo: float = 0.5
    ambient: float = 0.02
    speckle_shape: float = 1333.33
    thermal_sd_grey: float = 0.25
    census_radius_px: int = 3
    block_radius_px: int = 3
    smallest_disparity_px: int = 48
    largest_disparity_px: int = 95
    small_jump: int = 8
    large_jump: int = 32
    paths: int = 8
    uniqueness_percent: int = 15
    largest_left_right_difference_px: int = 1
    median_width_px: int = 3
    largest_gap_difference_m: float = 0.01


# Disparities of the official scene are 62.7 to 82.8 px; 48 to 95 reach from 0.345 to 0.683 m.
METHOD = StereoMethod()
