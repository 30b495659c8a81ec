"""Makes `Track_1/weights.npz`: behaviour cloning of the demonstrations of an expert, by action chunking.

vitac data collect lock-opening --successes 290 --out collected
vitac data export collected/lock-opening --to demonstrations --only-successes --key marker_flow --key relative_motion
python examples/lock_opening_cloned/train.py demonstrations [--seed 1] [--out Track_1]

Needs torch and pyarrow. It takes a few minutes on one core.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
import torch
from pyarrow import parquet
from torch import nn

sys.path.insert(0, str(Path(__file__).parent / "Track_1"))
from policy import CHUNK, HEADS, LAYERS, WINDOW, features

WIDTH = 64
EPOCHS = 150
BATCH = 128
HELD_OUT = 0.1  # of the episodes
DROPOUT = 0.1


def main() -> None:
    """Read, fit, and write the weights."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("demonstrations", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "Track_1")
    chosen = parser.parse_args()
    torch.manual_seed(chosen.seed)
    torch.set_num_threads(1)
    episodes = read(chosen.demonstrations)
    seen = np.concatenate([tokens for tokens, _ in episodes])
    mean, scale = seen.mean(axis=0), seen.std(axis=0) + 1e-2
    held_out = int(len(episodes) * HELD_OUT)
    normal = [((tokens - mean) / scale, actions) for tokens, actions in episodes]
    fitted = fit(make_samples(normal[held_out:]), make_samples(normal[:held_out]))
    stored = {name: value.numpy().astype(np.float16) for name, value in fitted.state_dict().items()}
    np.savez_compressed(chosen.out / "weights.npz", mean=mean, scale=scale, **stored)


def read(folder: Path) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return what was felt and done in every episode, shapes [n, f] and [n, a]."""
    episodes: dict[int, list[tuple[np.ndarray, np.ndarray]]] = {}
    columns = ["episode_index", "observation.marker_flow", "observation.state", "action"]
    for path in sorted(folder.glob("data/*/*.parquet")):
        for row in parquet.read_table(path, columns=columns).to_pylist():
            felt = features(np.array(row["observation.marker_flow"]), np.array(row["observation.state"]))
            episodes.setdefault(row["episode_index"], []).append((felt, np.array(row["action"])))
    return [tuple(np.array(part) for part in zip(*rows, strict=True)) for rows in episodes.values()]


def make_samples(episodes: list[tuple[np.ndarray, np.ndarray]]) -> tuple[torch.Tensor, ...]:
    """Return windows [n, WINDOW, f] with the newest first, what is there of them, chunks [n, CHUNK, a], and what is."""
    samples = []
    for tokens, actions in episodes:
        for step in range(len(actions)):
            window, chunk = tokens[max(0, step + 1 - WINDOW) : step + 1][::-1], actions[step : step + CHUNK]
            samples.append((*padded(window, WINDOW), *padded(chunk, CHUNK)))
    windows, there, chunks, counted = (np.array(part) for part in zip(*samples, strict=True))
    return tuple(torch.from_numpy(part) for part in (windows, there, chunks, counted))


def padded(rows: np.ndarray, length: int) -> tuple[np.ndarray, np.ndarray]:
    """Return rows followed by zeros, and which are rows."""
    found = np.zeros((length, rows.shape[1]), dtype=np.float32)
    found[: len(rows)] = rows
    return found, np.arange(length) < len(rows)


class Attention(nn.Module):
    """An attention and the two layers after it, as `policy.attention` and `policy.feed` compute them."""

    def __init__(self) -> None:
        super().__init__()
        self.q, self.k, self.v, self.out = (nn.Linear(WIDTH, WIDTH) for _ in range(4))
        self.up, self.down = nn.Linear(WIDTH, 2 * WIDTH), nn.Linear(2 * WIDTH, WIDTH)
        self.norm, self.norm2, self.drop = nn.LayerNorm(WIDTH), nn.LayerNorm(WIDTH), nn.Dropout(DROPOUT)

    def forward(self, asking: torch.Tensor, asked: torch.Tensor | None, there: torch.Tensor) -> torch.Tensor:
        """Return the rows that ask with what they found; None is asked: they ask each other."""
        near = self.norm(asking)
        parts = (self.q(near), *((layer(near if asked is None else asked)) for layer in (self.k, self.v)))
        query, key, value = (part.unflatten(-1, (HEADS, -1)).transpose(1, 2) for part in parts)
        found = nn.functional.scaled_dot_product_attention(query, key, value, attn_mask=there[:, None, None, :])
        asking = asking + self.drop(self.out(found.transpose(1, 2).flatten(2)))
        return asking + self.drop(self.down(torch.relu(self.up(self.norm2(asking)))))


class Network(nn.Module):
    """The network of `policy.chunk`."""

    def __init__(self, inputs: int, actions: int) -> None:
        super().__init__()
        self.embed, self.action = nn.Linear(inputs, WIDTH), nn.Linear(WIDTH, actions)
        self.age = nn.Parameter(0.1 * torch.randn(WINDOW, WIDTH))
        self.query = nn.Parameter(0.1 * torch.randn(CHUNK, WIDTH))
        self.encoder = nn.ModuleList(Attention() for _ in range(LAYERS))
        self.decoder, self.last = Attention(), nn.LayerNorm(WIDTH)

    def forward(self, windows: torch.Tensor, there: torch.Tensor) -> torch.Tensor:
        """Return chunks of actions for windows whose newest row is the first."""
        state = self.embed(windows) + self.age
        for layer in self.encoder:
            state = layer(state, None, there)
        return self.action(self.last(self.decoder(self.query.expand(len(windows), -1, -1), state, there)))


def fit(learned: tuple[torch.Tensor, ...], held_out: tuple[torch.Tensor, ...]) -> Network:
    """Return the network that comes nearest to the actions, in the mean of absolute differences."""
    model = Network(learned[0].shape[-1], learned[2].shape[-1])
    optimizer = torch.optim.AdamW(model.parameters(), lr=1e-3, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, EPOCHS)
    for epoch in range(EPOCHS):
        model.train()
        for batch in torch.randperm(len(learned[0])).split(BATCH):
            optimizer.zero_grad()
            compute_loss(model, [part[batch] for part in learned]).backward()
            optimizer.step()
        schedule.step()
        if epoch % 10 == 9:
            model.eval()
            with torch.no_grad():
                losses = [compute_loss(model, part).item() for part in (learned, held_out)]
            print(f"epoch {epoch + 1}: {losses[0]:.4f}, in held-out episodes {losses[1]:.4f}", file=sys.stderr)
    return model.eval()


def compute_loss(model: Network, samples: list[torch.Tensor] | tuple[torch.Tensor, ...]) -> torch.Tensor:
    """Return the mean absolute difference of the actions that there are."""
    windows, there, chunks, counted = samples
    return ((model(windows, there) - chunks).abs().mean(dim=-1) * counted).sum() / counted.sum()


if __name__ == "__main__":
    main()
