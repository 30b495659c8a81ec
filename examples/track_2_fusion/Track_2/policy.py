"""Sees which hole it is and where it lies, travels there just above the rim, and searches by touch if it must.

Five things are unknown: the peg's shape, and where it begins: its x and theta, and its y and z above the base. The
first look finds the shape, every look the rest, and the median over all looks counts. Where the peg is now follows from
where it began and from `relative_motion`. What a picture does not show is taken to be in the middle of what it may be.
Needs only NumPy.
"""

import numpy as np
from outline_fit import fit_outline, misfit
from picture import Picture
from solids import HOLES, place_base, place_peg

HOVER = 0.6  # mm above the rim while travelling
BLIND = 0.3  # mm above the rim: below, the rim begins to hide the peg's lower end
EARLY = 1.5  # mm before the hole at which the descent begins: it takes two env steps, in which the gripper goes on
CLOSE = 0.25  # mm
UPRIGHT = 1.0  # degrees
TOUCH = 1.0  # pixels of the markers' mean motion: 0.1 of noise in free air, 5 to 12 after pressing the peg on the rim
LIFT = 0.5  # mm
ANGLES = (-7.0, 0.0, 7.0)  # degrees: the first fit begins with each of them
MIDDLE = np.array([0.0, 22.625, 0.0, 7.0])  # of all starts: where the peg is taken to begin until a look has found it
FARTHEST = np.array([8.0, 8.0, 15.0, 5.0])  # from there; what a look finds beyond is an error


class Policy:
    """Keeps one estimate of the start [x, y, theta, z] per look, in the order of `relative_motion`."""

    def reset(self, task):
        """Begin an episode."""
        self.shape = "cuboid"
        self.starts = []
        self.hover = HOVER
        self.tries = 0

    def act(self, observation):
        """Look, unless the peg is pressed on something or too low; then go on."""
        motion = observation["relative_motion"].astype(np.float64)
        touched = marker_motion(observation["marker_flow"]) > TOUCH
        if not self.starts or (not touched and self.place(motion)[3] > BLIND):
            picture = Picture(observation["rgb_picture"], observation["depth_picture"])
            if picture.shows_peg_and_base():
                self.look(picture, motion)
        place = self.place(motion)
        if touched:
            return self.back_off(place)
        return action(self.way(place), place[2], -1.0 if self.is_over_hole(place) else self.hover - place[3])

    def place(self, motion):
        """Return x and y [mm] in the base's frame, theta [degrees], and the lower end's height above the rim [mm]."""
        return np.median(self.starts or [MIDDLE], axis=0) + motion

    def look(self, picture, motion):
        """Add an estimate of the start: the first from depth and outlines, the others from outlines alone."""
        outline = picture.peg_outline()
        if not self.starts:
            self.shape = picture.peg_shape()
            fits = [fit_outline(outline, self.place_peg, (0.0, angle), rounds=4) for angle in ANGLES]
            x, theta = min(fits, key=lambda fit: misfit(outline, self.place_peg(*fit)))
            y, z = picture.rough_base_place()
            rounds = 4
        else:
            x, y, theta, z = self.place(motion)
            rounds = 1
        x, theta = fit_outline(outline, self.place_peg, (x, theta), rounds)
        y, z = fit_outline(picture.base_outline(), place_base, (y, z), rounds)
        start = np.array([x, y, theta, z]) - motion
        if (np.abs(start - MIDDLE) < FARTHEST).all():
            self.starts.append(start)

    def place_peg(self, x, theta):
        """Return the seen peg's corners."""
        return place_peg(self.shape, x, theta)

    def way(self, place):
        """Return the way [mm] to the hole, or to the next point of the search around it."""
        return HOLES[self.shape] + spiral(self.tries) - place[:2]

    def is_over_hole(self, place):
        """Return whether the peg may go down; during the search only where the spiral wants it."""
        x, y = np.abs(self.way(place))
        return x < CLOSE and y < (CLOSE if self.tries else EARLY) and abs(place[2]) < UPRIGHT

    def back_off(self, place):
        """Return the action after a touch: up, and to the next point of the search.

        A touch on the way means that the rim is higher than it looked; then the peg travels higher from now on.
        """
        if self.is_over_hole(place):
            self.tries += 1
        else:
            self.hover += LIFT
        return action(self.way(place), place[2], max(LIFT, self.hover - place[3]))


def spiral(number):
    """Return a point [mm] of a sunflower spiral: all have about the same distance from each other, 0 is the middle."""
    angle = 2.4 * number
    return 0.6 * np.sqrt(number) * np.array([np.cos(angle), np.sin(angle)])


def marker_motion(marker_flow):
    """Return the mean motion of the markers [pixels], the largest of both sensors and directions.

    The last marker is repeated to fill the array; only its first copy counts.
    """
    means = []
    for reference, current in marker_flow:
        count = 1 + int(np.argmax((reference == reference[-1]).all(axis=1)))
        means.append((current - reference)[:count].mean(axis=0))
    return np.abs(means).max()


def action(way, theta, up):
    """Return the action that goes straight along a way [mm], to the angle 0 [degrees] and up [mm], as far as allowed.

    x and y are the gripper's own axes, which are turned by theta.
    """
    sine, cosine = np.sin(np.radians(theta)), np.cos(np.radians(theta))
    own = np.array([cosine * way[0] + sine * way[1], cosine * way[1] - sine * way[0]])
    own /= max(1.0, np.abs(own).max())
    # Rounded, so that differences in the last bits of another machine do not change the episode.
    return np.clip(np.round([*own, -theta, up], 3), -1.0, 1.0).astype(np.float32)
