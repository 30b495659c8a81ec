"""The gradient steps of TD3, with the arithmetic of Stable-Baselines3's and without the work that changes nothing.

A gradient step of the plain form spends nearly all its time in the encoders of the markers. Here their layers go over
parts of a batch that fit into a core's cache, as convolutions of width 1, which torch's build for CPUs computes faster
than products of matrices; actions after the last env step of an episode, which no loss counts, are not computed.
"""

from typing import Any

import numpy as np
import torch
from stable_baselines3 import TD3
from torch import nn
from torch.nn import functional

from ..learning.network import TrainingDiverged
from .policy import PointNet

CLOUDS_AT_ONCE = 32
"""Sets of points whose numbers, at most 512 of each point, fit into a core's cache."""


class CachedPointNet(PointNet):
    """The same encoder with the same weights, computed in parts."""

    def forward(self, points: Any) -> Any:
        """Return numbers of shape [..., outputs] from points of shape [..., n, channels]."""
        *sets, count, channels = points.shape
        pictures = points.reshape(-1, 1, count, channels).permute(0, 3, 1, 2)
        parts = pictures.tensor_split(max(1, -(-len(pictures) // CLOUDS_AT_ONCE)))
        largest = torch.cat([self._largest(part) for part in parts])
        return self.whole(largest).unflatten(0, sets)

    def _largest(self, pictures: Any) -> Any:
        """Return the largest of each number over the points, shape [sets, 512], from shape [sets, channels, 1, n]."""
        *layers, last = self.points
        for layer in layers:
            pictures = _linear(pictures, layer) if isinstance(layer, nn.Linear) else functional.relu_(pictures)
        if torch.is_grad_enabled():
            return _LargestOverPoints.apply(pictures, last.weight, last.bias)
        return _linear(pictures, last).amax(dim=(2, 3))


class _LargestOverPoints(torch.autograd.Function):  # type: ignore[misc]
    """A linear layer and the largest of each number over the points.

    Only the point with the largest number has a gradient: at most 512 of all that the layer computes for a set. So the
    sums of the backward pass run over those, not over products of matrices that are nearly all zero.
    """

    @staticmethod
    def forward(ctx: Any, pictures: Any, weight: Any, bias: Any) -> Any:
        """Return numbers of shape [sets, outputs] from points of shape [sets, inputs, 1, n]."""
        largest, where = _convolved(pictures, weight, bias).flatten(2).max(dim=-1)
        ctx.save_for_backward(pictures, weight, where)
        return largest

    @staticmethod
    def backward(ctx: Any, of_largest: Any) -> Any:
        """Return the gradients of points, weight and bias."""
        pictures, weight, where = ctx.saved_tensors
        sets, inputs, _, count = pictures.shape
        points = pictures.permute(0, 2, 3, 1).reshape(-1, inputs)
        first = torch.arange(0, sets * count, count)[:, None]
        of_weight = _sums((where + first).t(), points, of_largest.t(), torch.arange(0, where.numel(), sets))
        where, outputs = where.sort(dim=1)
        starts = torch.searchsorted((where + first).flatten(), torch.arange(sets * count))
        of_points = _sums(outputs, weight, of_largest.gather(1, outputs), starts)
        of_pictures = of_points.view(sets, 1, count, inputs).permute(0, 3, 1, 2)
        return of_pictures, of_weight, of_largest.sum(dim=0)


def _sums(rows: Any, table: Any, factors: Any, starts: Any) -> Any:
    """Return sums of rows of a table, each times its factor; each sum begins at one of the starts."""
    return functional.embedding_bag(rows.flatten(), table, starts, mode="sum", per_sample_weights=factors.flatten())


def _linear(pictures: Any, layer: Any) -> Any:
    return _convolved(pictures, layer.weight, layer.bias)


def _convolved(pictures: Any, weight: Any, bias: Any) -> Any:
    return functional.conv2d(pictures, weight[:, :, None, None], bias)


class ChallengeTD3(TD3):  # type: ignore[misc] # torch is not there when types are checked
    """TD3 whose gradient steps equal those of Stable-Baselines3 within rounding."""

    def train(self, gradient_steps: int, batch_size: int = 100) -> None:
        """Take gradient steps.

        Raises:
            TrainingDiverged: a loss is no number.
        """
        self.policy.set_training_mode(True)
        self._update_learning_rate([self.actor.optimizer, self.critic.optimizer])
        for _ in range(gradient_steps):
            self._n_updates += 1
            batch = self.replay_buffer.sample(batch_size)
            self._train_critics(batch)
            if self._n_updates % self.policy_delay == 0:
                self._train_actor(batch.observations)
                self._move_targets()
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")

    def _train_critics(self, batch: Any) -> None:
        """Fit the critics to what the target networks expect."""
        wanted = self._wanted(batch)
        told = self.critic(batch.observations, batch.actions)
        self._descend("critic", self.critic, sum(functional.mse_loss(each, wanted) for each in told))

    def _wanted(self, batch: Any) -> Any:
        """Return what the critics should tell, shape [b, 1] (Fujimoto et al. 2018, equations 10 and 14)."""
        with torch.no_grad():
            noise = torch.empty_like(batch.actions).normal_(0, self.target_policy_noise)
            noise.clamp_(-self.target_noise_clip, self.target_noise_clip)
            goes_on = batch.dones[:, 0] < 1
            after = {key: value[goes_on] for key, value in batch.next_observations.items()}
            actions = (self.actor_target(after) + noise[goes_on]).clamp(-1, 1)
            wanted = batch.rewards.clone()
            wanted[goes_on] += self.gamma * torch.cat(self.critic_target(after, actions), dim=1).amin(
                dim=1, keepdim=True
            )
            return wanted

    def _train_actor(self, observations: Any) -> None:
        """Move the actor towards what the first critic values."""
        self.critic.requires_grad_(False)
        value = self.critic.q1_forward(observations, self.actor(observations)).mean()
        self._descend("actor", self.actor, -value)
        self.critic.requires_grad_(True)

    def _descend(self, who: str, network: Any, loss: Any) -> None:
        """Take one step of a network's optimizer, and record the mean of the losses since the last line of the log."""
        value = loss.item()
        if not np.isfinite(value):
            raise TrainingDiverged(
                f"The loss of the {who} is {value} in gradient step {self._n_updates}; expected a finite number."
            )
        network.optimizer.zero_grad()
        loss.backward()
        network.optimizer.step()
        self.logger.record_mean(f"train/{who}_loss", value)

    def _move_targets(self) -> None:
        """Move the target networks a little towards the networks."""
        with torch.no_grad():
            for network, target in ((self.critic, self.critic_target), (self.actor, self.actor_target)):
                for now, followed in zip(target.parameters(), network.parameters(), strict=True):
                    now.lerp_(followed, self.tau)
