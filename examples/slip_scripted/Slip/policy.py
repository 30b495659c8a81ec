"""Lifts ever harder until the part hangs, and from then on grips as hard as its weight, its load and the friction need.

While the part slides between the jaws it pulls at the gels with twice the friction times the grip, and once it hangs
with its weight. So pull and grip of the first env steps say how likely each friction and each weight is. Pull is felt
as shear of the gels, grip follows from the gripper's width. Needs only NumPy.
"""

import numpy as np

HEIGHT_MM, WIDTH_MM = 1.0, 0.2  # of an action of 1
TOUCHING_MM = 30.16
PULL_N_PX, PULL_N = -1.34, 0.5  # pull at both gels by the shift of the markers in the middle of the picture along u
GRIPS_N = (1.0, 1.4, 2.0, 2.8, 3.9, 5.2)  # of the lifts in which the part may slide
FRICTION, WEIGHT_N = np.meshgrid(np.linspace(0.4, 1.2, 33), np.linspace(1.5, 3.9, 25))
PULL_NOISE_N, GRIP_NOISE = 0.2, 0.08  # of what is felt, and part of the grip
SURE = 0.9
MARGIN = 1.22  # grip over what friction needs; the part is crushed at 1.5
FIRST_LOADED, LOADED = 8, 16  # env steps
FASTEST_N, SLOWEST_N = 1.3, 0.3  # growth of the load in an env step
LIFT_MM, CLEAR_MM = 0.6, 2.5


def pull_n(marker_flow):
    """Return the force that shears both gels downwards."""
    shifts = []
    for before, after in marker_flow:
        seen = np.append((before[1:] != before[:-1]).any(axis=1), True)  # the last marker is repeated
        places = np.column_stack([np.ones(seen.sum()), before[seen] - (160.0, 120.0)])
        shifts.append(np.linalg.lstsq(places, (after - before)[seen, 0], rcond=None)[0][0])
    return PULL_N_PX * np.mean(shifts) + PULL_N


def grip_n(width_mm):
    """Return the force of a jaw at a width of the gripper."""
    closed_mm = TOUCHING_MM - width_mm
    return max(0.2, 1.1 + 43.0 * closed_mm + 16.0 * max(0.0, closed_mm) ** 2)


def width_mm(force_n):
    """Return the width of the gripper at a force of a jaw."""
    more_n = force_n - 1.1
    return (
        TOUCHING_MM - (np.sqrt(43.0**2 + 64.0 * more_n) - 43.0) / 32.0 if more_n > 0.0 else TOUCHING_MM - more_n / 43.0
    )


class Policy:
    """Remembers how likely each friction and weight is, and the pulls of the env steps in which the load grows."""

    def reset(self, task):
        """Begin an episode."""
        self.env_step = 0
        self.unlikely = np.zeros_like(FRICTION)
        self.hung_mm, self.pulls, self.stands = None, [], False

    def act(self, observation):
        """Return what to do in the next env step."""
        width, height = float(observation["gripper_width"][0]), float(observation["relative_motion"][0])
        pull = pull_n(observation["marker_flow"])
        if self.env_step >= LOADED:
            return self.set_down(pull, height)
        if 0 < self.env_step < FIRST_LOADED:
            self.learn(pull, grip_n(width))
        if self.env_step >= FIRST_LOADED - 1:
            self.pulls.append(pull)
        if self.hung_mm is None and (self.hangs(grip_n(width)) > SURE or self.env_step >= len(GRIPS_N)):
            self.hung_mm = height - LIFT_MM
        if self.hung_mm is None:
            up, force = LIFT_MM, GRIPS_N[self.env_step]
        else:
            up, force = min(1.0, max(0.0, CLEAR_MM - height + self.hung_mm)), self.needed_n()
        self.env_step += 1
        return np.clip([up / HEIGHT_MM, (width_mm(force) - width) / WIDTH_MM], -1.0, 1.0).astype(np.float32)

    def learn(self, pull, grip):
        """Weigh each friction and weight by how far a pull is from what it would give."""
        slides = 2.0 * FRICTION * grip
        expected = np.minimum(WEIGHT_N, slides)
        spread = PULL_NOISE_N + np.where(slides < WEIGHT_N, GRIP_NOISE * slides, 0.0)
        self.unlikely += 0.5 * ((pull - expected) / spread) ** 2 + np.log(spread)

    def chances(self):
        """Return the probability of each friction and weight."""
        chances = np.exp(self.unlikely.min() - self.unlikely)
        return chances / chances.sum()

    def hangs(self, grip):
        """Return the probability that the part hangs in this grip."""
        return self.chances()[2.0 * FRICTION * grip > WEIGHT_N].sum() if self.env_step else 0.0

    def needed_n(self):
        """Return the grip for the pull at the end of the next env step."""
        chances = self.chances()
        friction, pull = (chances * FRICTION).sum(), (chances * WEIGHT_N).sum()
        if self.env_step >= FIRST_LOADED - 1:
            steps = np.arange(len(self.pulls)) - len(self.pulls) + 1
            growth, pull = FASTEST_N, self.pulls[-1]
            if len(steps) > 2:
                growth, pull = np.polyfit(steps, self.pulls, 1)
            pull += np.clip(growth, SLOWEST_N, FASTEST_N)
        return MARGIN * pull / (2.0 * friction)

    def set_down(self, pull, height):
        """Lower the part until the table carries it, then open."""
        self.env_step += 1
        self.stands = self.stands or pull < 0.6 * self.pulls[-1]
        if self.stands:
            return np.array([0.0, 1.0], dtype=np.float32)
        return np.array([-np.clip(height - self.hung_mm, 0.25, 1.0) / HEIGHT_MM, 0.0], dtype=np.float32)
