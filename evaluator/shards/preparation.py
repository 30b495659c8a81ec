"""What one shard leaves for the next one of the same submission: environment and loaded policy; used by `execution`."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Self

from ..agent.limits import Limits
from ..episodes.episode import Environment, MakeEnvironment, Session
from ..tracks import Task
from .order import ShardOrder

if TYPE_CHECKING:
    from .policy import LoadPolicy


class Preparation:
    """Environment and loaded policy, made when a shard first asks for them and used until an order needs others.

    Every episode runs in a fresh copy of the loaded policy and in a fresh scene, whichever shard it belongs to, so
    that shards have no more in common than the episodes of one shard.
    """

    def __init__(self) -> None:
        self._exits = ExitStack()
        self._of: dict[str, object] | None = None
        self._environment: Environment | None = None
        self._session: Session | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.forget()

    def begin(self, order: ShardOrder) -> None:
        """Begin a shard: forget what was prepared for another order, and count its time from zero."""
        if self._of != order.preparation():
            self.forget()
        self._of = order.preparation()
        if self._session is not None:
            self._session.begin_shard()

    def environment(
        self, make: MakeEnvironment, task: Task, assets_dir: Path | None, observation_keys: Sequence[str] | None
    ) -> Environment:
        """Return the environment, which `make` makes the first time."""
        if self._environment is None:
            self._environment = make(task, assets_dir, observation_keys)
        return self._environment

    @contextmanager
    def policy(self, load: "LoadPolicy", submission_dir: Path, limits: Limits) -> Iterator[Session]:
        """Give the loaded policy, which `load` loads the first time; it stays loaded when the block is left.

        Raises:
            PolicyFailed: it cannot be loaded.
            SandboxFailed: the isolation could not be set up.
        """
        if self._session is None:
            self._session = self._exits.enter_context(load(submission_dir, limits))
        yield self._session

    def forget(self) -> None:
        """Give up environment and policy, and end its sandbox."""
        self._environment = self._session = None
        self._exits.close()
