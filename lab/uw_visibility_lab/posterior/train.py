# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Training of the posterior's networks on drawn views (PyTorch)."""

from __future__ import annotations

import io
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from uw_visibility import __version__
from uw_visibility.config.files import write_whole
from uw_visibility_lab.posterior.curves import OF_CURVES
from uw_visibility_lab.posterior.examples import Examples
from uw_visibility_lab.posterior.network import (
    COMPONENTS,
    FACTORS,
    LEAST_LOG_DEVIATION,
    MOST_DEVIATIONS,
    MOST_LOG_DEVIATION,
    OF_COMPONENT,
    OUTPUTS,
    UNKNOWNS,
    features_of,
)
from uw_visibility_lab.posterior.statistics import BINS, COMPARED, OF_BIN, OF_CHANNEL, QUANTILES

HIDDEN = (144, 96, 64)
BATCH = 256
LEARNING_RATE, WEIGHT_DECAY = 2e-3, 3e-2
# Noise on the features, in deviations, and the part of them that is left out in each step.
FEATURE_NOISE, DROPPED = 0.03, 0.1
# Part of the examples that tells when to stop.
HELD_BACK = 0.08


class Net(nn.Module):
    """The network of `uw_visibility_lab.posterior.network`, to be trained."""

    def __init__(self, features: int) -> None:
        super().__init__()
        first, second, third = HIDDEN
        self.parts = nn.ModuleList((
            nn.Linear(features, first), nn.Linear(2 * first, second), nn.Linear(second, third),
            nn.Linear(third, OUTPUTS), nn.Linear(third, COMPONENTS)))
        self.act = nn.GELU(approximate="tanh")

    def forward(self, x: Any) -> tuple[Any, Any]:
        """Outputs (N, 3, OUTPUTS) and logits (N, K)."""
        first, second, third, last, of = self.parts
        hidden = self.act(first(x))
        mixed = torch.cat((hidden, hidden.mean(1, keepdim=True).expand_as(hidden)), -1)
        hidden = self.act(third(self.act(second(mixed))))
        return last(hidden), of(hidden.mean(1))


def negative_log_likelihood(outputs: Any, logits: Any, truth: Any) -> Any:
    """(N,): of truth (N, 3, 3) under the mixture."""
    n = len(truth)
    shaped = outputs.view(n, 3, COMPONENTS, OF_COMPONENT).transpose(1, 2)
    mean = shaped[..., :UNKNOWNS].reshape(n, COMPONENTS, 9)
    deviation = shaped[..., UNKNOWNS:2 * UNKNOWNS].clamp(
        LEAST_LOG_DEVIATION, MOST_LOG_DEVIATION).exp()
    low = shaped[..., 2 * UNKNOWNS:UNKNOWNS + 6]
    zero = torch.zeros_like(low[..., 0])
    lower = torch.stack((
        torch.stack((deviation[..., 0], zero, zero), -1),
        torch.stack((low[..., 0], deviation[..., 1], zero), -1),
        torch.stack((low[..., 1], low[..., 2], deviation[..., 2]), -1)), -2)
    loading = shaped[..., UNKNOWNS + 6:].reshape(n, COMPONENTS, 9, FACTORS)
    # Woodbury: only matrices of FACTORS by FACTORS are inverted.
    off = (truth.reshape(n, 1, 9) - mean).view(n, COMPONENTS, 3, 3, 1)
    white = torch.linalg.solve_triangular(lower, off, upper=False).reshape(n, COMPONENTS, 9)
    loaded = torch.linalg.solve_triangular(
        lower, loading.view(n, COMPONENTS, 3, 3, FACTORS), upper=False).reshape(
            n, COMPONENTS, 9, FACTORS)
    inner = torch.eye(FACTORS) + loaded.transpose(-1, -2) @ loaded
    projected = (loaded.transpose(-1, -2) @ white.unsqueeze(-1))
    root = torch.linalg.cholesky(inner)
    half = torch.linalg.solve_triangular(root, projected, upper=False)
    square = (white**2).sum(-1) - (half**2).sum((-1, -2))
    log_determinant = deviation.log().sum((-1, -2)) + torch.diagonal(
        root, dim1=-2, dim2=-1).log().sum(-1)
    log_density = -0.5 * square - log_determinant - 4.5 * math.log(2 * math.pi)
    return -torch.logsumexp(torch.log_softmax(logits, -1) + log_density, -1)


def _loss(net: Net, x: Any, truth: Any) -> Any:
    outputs, logits = net(x)
    return negative_log_likelihood(outputs, logits, truth)


def mirrored_columns() -> NDArray[np.intp]:
    """Columns of a channel's own features that change sign where left and right change places."""
    first = len(QUANTILES) + 1
    return np.concatenate([
        i * OF_BIN + np.arange(first, first + len(COMPARED)) for i in range(BINS)])


def channel_columns() -> int:
    """Number of a channel's own features."""
    return BINS * OF_BIN + OF_CHANNEL + OF_CURVES


def train(
    examples: Examples, seeds: int = 3, epochs: float = 40.0, say: Any = print
) -> dict[str, NDArray[Any]]:
    """Train networks; return their arrays as `network.load` reads them."""
    x = features_of(examples.of_bins, examples.of_channels, examples.of_image)
    flat = x.reshape(-1, x.shape[2])
    centre, spread = flat.mean(0), flat.std(0) + 1e-3
    x = np.clip((x - centre) / spread, -MOST_DEVIATIONS, MOST_DEVIATIONS)
    held = np.random.default_rng(0).random(len(x)) < HELD_BACK
    columns = mirrored_columns()
    columns = np.concatenate((columns, columns + channel_columns()))
    sign = np.ones(x.shape[2], np.float32)
    sign[columns] = -1.0
    # A mirrored feature is mirrored about its own zero, not about its mean.
    shift = np.where(sign < 0, -2.0 * centre / spread, 0.0).astype(np.float32)
    xs, ys = torch.from_numpy(x[~held]), torch.from_numpy(examples.truth[~held])
    xv, yv = torch.from_numpy(x[held]), torch.from_numpy(examples.truth[held])
    flip, flip_shift = torch.from_numpy(sign), torch.from_numpy(shift)
    steps = int(epochs * len(xs) / BATCH)
    arrays: dict[str, NDArray[Any]] = {
        "networks": np.array(seeds), "centre": centre.astype(np.float32),
        "spread": spread.astype(np.float32)}
    for seed in range(seeds):
        torch.manual_seed(seed)
        net = Net(x.shape[2])
        optimiser = torch.optim.AdamW(
            net.parameters(), lr=LEARNING_RATE, weight_decay=WEIGHT_DECAY)
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimiser, LEARNING_RATE, total_steps=steps + 1, pct_start=0.05)
        best, kept = math.inf, {}
        begun = time.monotonic()
        for step in range(steps + 1):
            if step % 1000 == 0 or step == steps:
                net.eval()
                with torch.no_grad():
                    loss = float(_loss(net, xv, yv).clamp(max=50.0).mean())
                if loss < best:
                    best, kept = loss, {k: v.clone() for k, v in net.state_dict().items()}
                say(f"network {seed}, step {step} of {steps}: {loss:.3f} held back "
                    f"({time.monotonic() - begun:.0f} s)")
                net.train()
            at = torch.randint(len(xs), (BATCH,))
            batch = xs[at]
            mirrored = torch.rand(BATCH, 1, 1) < 0.5
            batch = torch.where(mirrored, batch * flip + flip_shift, batch)
            mask = (torch.rand(batch.shape) > DROPPED).float() / (1.0 - DROPPED)
            batch = batch * mask + FEATURE_NOISE * torch.randn(batch.shape)
            optimiser.zero_grad()
            loss = _loss(net, batch, ys[at]).clamp(max=50.0).mean()
            loss.backward()
            nn.utils.clip_grad_norm_(net.parameters(), 1.0)
            optimiser.step()
            schedule.step()
        net.load_state_dict(kept)
        for i, layer in enumerate(net.parts):
            assert isinstance(layer, nn.Linear)
            arrays[f"{seed}_{2 * i}"] = layer.weight.detach().numpy().T.astype(np.float16)
            arrays[f"{seed}_{2 * i + 1}"] = layer.bias.detach().numpy().astype(np.float16)
    return arrays


def provenance(pool: Path, seed: int, examples: Examples) -> str:
    """What the networks were trained on, to be kept with them."""
    return (
        f"{len(examples.truth)} views of the scenes in {pool.name}, seed {seed}, "
        f"uw_visibility {__version__}, PyTorch {torch.__version__}")


def write(arrays: dict[str, NDArray[Any]], path: Path, provenance: str) -> None:
    """Write networks with where they come from."""
    content = io.BytesIO()
    np.savez_compressed(
        content, provenance=np.array(provenance), **arrays)  # type: ignore[arg-type]
    write_whole(path, content.getvalue())
