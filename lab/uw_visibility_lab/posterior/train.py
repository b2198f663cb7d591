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
from scipy.special import logit
from torch import nn

from uw_visibility import __version__
from uw_visibility.config.files import write_whole
from uw_visibility.water.daylight.inference import infer
from uw_visibility.water.daylight.network import (
    COMPONENTS,
    FACTORS,
    FLAGS,
    LEAST_LOG_DEVIATION,
    LEAST_VARIANCE,
    MOST_LOG_DEVIATION,
    OF_COMPONENT,
    OUTPUTS,
    UNKNOWNS,
    Network,
    features_of,
    of_arrays,
    standardise,
)
from uw_visibility.water.daylight.statistics import Statistics
from uw_visibility_lab.posterior.examples import Examples
from uw_visibility_lab.worlds.beliefs import bounds

# Numbers of views: for features that are calculated at a time, and for their mean and deviation.
BLOCK, STANDARD = 1024, 20_480
HIDDEN = (192, 128, 64)
BATCH = 256
LEARNING_RATE, WEIGHT_DECAY, LARGEST_GRADIENT = 1e-2, 1e-1, 1.0
# Part of the features that is dropped in each step.
DROPPED = 0.2
# Largest loss of a view, which limits the effect of outliers.
MOST_LOSS = 50.0
# Part of the examples for validation: the networks of the step with their least loss are kept.
HELD_BACK = 0.08
# Quantile over them that is the limit of `unlike` and `misfit`, beyond which images are refused.
USUAL = 0.997
MOST_OF_LIMITS = 6000


class Net(nn.Module):
    """The network of `uw_visibility.water.daylight.network`, for training."""

    def __init__(self, features: int) -> None:
        super().__init__()
        first, second, third = HIDDEN
        self.parts = nn.ModuleList((
            nn.Linear(features, first), nn.Linear(2 * first, second), nn.Linear(second, third),
            nn.Linear(third, OUTPUTS), nn.Linear(third, COMPONENTS), nn.Linear(third, FLAGS)))
        self.act = nn.GELU(approximate="tanh")

    def forward(self, x: Any) -> tuple[Any, Any, Any]:
        """Outputs (N, 3, OUTPUTS), and logits (N, K) of components and (N, 2) of flags."""
        first, second, third, last, of, flags = self.parts
        hidden = self.act(_normalised(first(x)))
        mixed = torch.cat((hidden, hidden.mean(1, keepdim=True).expand_as(hidden)), -1)
        hidden = self.act(_normalised(second(mixed)))
        hidden = self.act(_normalised(third(hidden)))
        together = hidden.mean(1)
        return last(hidden), of(together), flags(together)


def _normalised(x: Any) -> Any:
    return nn.functional.layer_norm(x, x.shape[-1:], eps=LEAST_VARIANCE)


def negative_log_likelihood(outputs: Any, logits: Any, truth: Any) -> Any:
    """Negative log likelihood, (N,), of truth (N, 3, 3) under the mixture."""
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
    # In 64 bit: in 32 bit, large and nearly equal loadings have no positive determinant.
    loaded, white = loaded.double(), white.double()
    inner = torch.eye(FACTORS, dtype=torch.float64) + loaded.transpose(-1, -2) @ loaded
    projected = loaded.transpose(-1, -2) @ white.unsqueeze(-1)
    root = torch.linalg.cholesky(inner)
    half = torch.linalg.solve_triangular(root, projected, upper=False)
    square = (white**2).sum(-1) - (half**2).sum((-1, -2))
    log_determinant = deviation.log().sum((-1, -2)) + torch.diagonal(
        root, dim1=-2, dim2=-1).log().sum(-1)
    log_density = -0.5 * square - log_determinant - 4.5 * math.log(2 * math.pi)
    return -torch.logsumexp(torch.log_softmax(logits, -1) + log_density, -1)


def _loss(net: Net, x: Any, truth: Any, flags: Any) -> Any:
    """Loss, (N,), of truth (views in daylight only) and of flags (N, 2)."""
    outputs, logits, shown = net(x)
    loss = negative_log_likelihood(outputs, logits, truth).clamp(max=MOST_LOSS)
    return loss * (1.0 - flags[:, 1]) + nn.functional.binary_cross_entropy_with_logits(
        shown, flags, reduction="none").sum(-1)


def train(
    examples: Examples, seeds: int = 3, epochs: float = 40.0, say: Any = print
) -> dict[str, NDArray[Any]]:
    """Train networks; return their arrays in the format of `network.load`."""
    x, centre, spread = standardised_features(examples)
    held = held_back(len(x))
    flags = np.stack((examples.other_curve, examples.lamps), axis=1).astype(np.float32)
    xs, *rest = (torch.from_numpy(each[~held]) for each in (x, examples.truth, flags))
    aside = [torch.from_numpy(each[held]).float() for each in (x, examples.truth, flags)]
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
                    loss = float(_loss(net, *aside).mean())
                if loss < best:
                    best, kept = loss, {k: v.clone() for k, v in net.state_dict().items()}
                say(f"network {seed}, step {step} of {steps}: {loss:.3f} held back "
                    f"({time.monotonic() - begun:.0f} s)")
                net.train()
            at = torch.randint(len(xs), (BATCH,))
            batch = xs[at].float()
            # The same features are dropped in all channels.
            batch *= (torch.rand(BATCH, 1, batch.shape[2]) > DROPPED).float() / (1.0 - DROPPED)
            optimiser.zero_grad()
            loss = _loss(net, batch, *(each[at] for each in rest)).mean()
            loss.backward()
            nn.utils.clip_grad_norm_(net.parameters(), LARGEST_GRADIENT)
            optimiser.step()
            schedule.step()
        net.load_state_dict(kept)
        for i, layer in enumerate(net.parts):
            assert isinstance(layer, nn.Linear)
            weights, scale = quantised(layer.weight.detach().numpy().T)
            arrays |= {
                f"{seed}_{i}_weights": weights, f"{seed}_{i}_scale": scale,
                f"{seed}_{i}_bias": layer.bias.detach().numpy().copy()}
        # Prior of lamps: that of the beliefs, not the share of views under lamps in the examples.
        arrays[f"{seed}_{len(net.parts) - 1}_bias"][1] += (
            logit(bounds("lamps.share")[0]) - logit(flags[~held, 1].mean()))
    return arrays | {"limits": limits(of_arrays(arrays), examples)}


def quantised(weights: NDArray[np.float32]) -> tuple[NDArray[np.int8], NDArray[np.float32]]:
    """Weights (N, M) in 8 bit, with the scale (M,) of each output."""
    scale = np.maximum(np.abs(weights).max(axis=0), 1e-12) / np.float32(127.0)
    return np.rint(weights / scale).astype(np.int8), scale.astype(np.float32)


def standardised_features(
    examples: Examples,
) -> tuple[NDArray[np.float16], NDArray[np.float32], NDArray[np.float32]]:
    """Standardised features (N, 3, D), and their mean and deviation (D,) over the first views.

    They are in 16 bit, since 200,000 views take 1.5 GB.
    """
    def block(at: int) -> NDArray[np.float32]:
        return features_of(*(each[at:at + BLOCK] for each in examples[:4]))

    number = len(examples.truth)
    first = np.concatenate([block(at) for at in range(0, min(number, STANDARD), BLOCK)])
    flat = first.reshape(-1, first.shape[2])
    centre, spread = flat.mean(0), flat.std(0) + 1e-3
    x = np.empty((number, *first.shape[1:]), np.float16)
    for at in range(0, number, BLOCK):
        x[at:at + BLOCK] = standardise(block(at), centre, spread)
    return x, centre, spread


def limits(network: Network, examples: Examples) -> NDArray[np.float64]:
    """`Network.most_unlike` and `Network.most_misfit` from validation views in daylight, (2,)."""
    held = np.flatnonzero(held_back(len(examples.truth)) & ~examples.lamps)[:MOST_OF_LIMITS]
    found = []
    for i in held:
        posterior = infer(network, Statistics(
            examples.of_bins[i], examples.of_tiles[i], examples.of_channels[i],
            examples.of_image[i], np.ones(3), 1.0))
        found.append((posterior.unlike, posterior.misfit))
    return np.quantile(found, USUAL, axis=0)


def held_back(number: int) -> NDArray[np.bool_]:
    """Mask (N,) of the examples for validation; it depends on their number only."""
    return np.random.default_rng(0).random(number) < HELD_BACK


def provenance(pool: Path, seed: int, examples: Examples) -> str:
    """Description of the training data, to be stored with the networks."""
    return (
        f"{len(examples.truth)} views of the scenes in {pool.name}, seed {seed}, "
        f"uw_visibility {__version__}, PyTorch {torch.__version__}")


def write(arrays: dict[str, NDArray[Any]], path: Path, provenance: str) -> None:
    """Write networks with their provenance."""
    content = io.BytesIO()
    np.savez_compressed(
        content, provenance=np.array(provenance), **arrays)  # type: ignore[arg-type]
    write_whole(path, content.getvalue())
