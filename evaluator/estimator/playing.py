"""The standard estimator as what `episodes` plays: in our own process, because nothing of a team's runs in it."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from time import process_time
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from ..agent.protocol.frames import CloudSpec
from .controller import Controller, Vector
from .features import compute_features
from .regression import Coefficients

if TYPE_CHECKING:
    from ..episodes.reading import Observation


class EstimatorPolicy:
    """The estimator within one episode; attributes as `episodes.episode.Policy` says."""

    channel_s = 0.0
    output = ""

    def __init__(self, controller: Controller, *, is_blind: bool) -> None:
        self.cpu_s = 0.0
        self._controller = controller
        self._is_blind = is_blind

    def act(self, observation: "Observation") -> NDArray[np.float32]:
        """Return the action for an observation."""
        started = process_time()
        features = compute_features(cast(Any, observation["marker_flow"]), at_rest=self._is_blind)
        action = np.array(self._controller.act(features), dtype=np.float32)
        self.cpu_s += process_time() - started
        return action


class EstimatorSession:
    """The estimator, calibrated to a sensor, between episodes.

    Args:
        coefficients: of the sensor.
        action_scale: of the task [mm, mm, deg].
        is_blind: it sees all markers at rest.
    """

    isolation = None

    def __init__(self, coefficients: Coefficients, action_scale: Vector, *, is_blind: bool) -> None:
        self._coefficients = coefficients
        self._action_scale = action_scale
        self._is_blind = is_blind

    def begin_shard(self) -> None:
        """Count nothing: the estimator has no limit on its time."""

    @contextmanager
    def episode(
        self,
        *,
        task: str,  # noqa: ARG002 - as all sessions
        action_shape: tuple[int, ...],  # noqa: ARG002
        clouds: Sequence[CloudSpec] = (),  # noqa: ARG002
    ) -> Iterator[EstimatorPolicy]:
        """Return the estimator for one episode."""
        yield EstimatorPolicy(Controller(self._coefficients, self._action_scale), is_blind=self._is_blind)
