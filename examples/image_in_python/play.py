"""Pushes the peg back against the mean drift of the markers; the same policy as examples/image_in_c."""

import numpy as np
from vitac_policy import serve


class Policy:
    """Answers from inside a container image."""

    def act(self, observation):
        """Return the action for an observation."""
        reference, current = observation["marker_flow"].astype(float).swapaxes(0, 1)
        drift = (current - reference)[..., 1].mean()
        return np.round([0.0, np.clip(-drift, -1, 1), 0.0], 3)


if __name__ == "__main__":
    serve(Policy())
