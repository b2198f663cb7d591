# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The network that turns statistics into a posterior, run by NumPy.

One network serves the three channels: its inputs are the statistics of a channel and the mean of
those of the other two. So it is equivariant to permutations of the channels. For each channel c it
gives K normal components of t_c = (ln βd̃, ln B/b̂, ln W/b̂), with d̃ the median range and b̂ the
channel's brightest; loadings on R factors that the channels share make the components' covariance

    Σ = blockdiag(L_c L_cᵀ) + U Uᵀ,    L_c lower triangular (3, 3), U (9, R).

The weights are trained by simulation (`uw_visibility train` of the lab; Cranmer, Brehmer and
Louppe 2020, doi:10.1073/pnas.1912789117).
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from uw_visibility import data as package_data
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, Mask
from uw_visibility.water.daylight.curves import OF_CURVES, curves
from uw_visibility.water.daylight.statistics import (
    BETWEEN_HALVES,
    BINS,
    COMPARED,
    OF_BIN,
    OF_CHANNEL,
    OF_IMAGE,
    ZEROS,
    Statistics,
)
from uw_visibility.water.daylight.validation import MAX_CLIPPED_FRACTION

COMPONENTS = 3
FACTORS = 2
# Unknowns of a channel.
UNKNOWNS = 3
OF_COMPONENT = UNKNOWNS + 6 + UNKNOWNS * FACTORS
OUTPUTS = COMPONENTS * OF_COMPONENT
# Features of each channel: its own, the mean of the others', and those of the image.
OWN = OF_CURVES + OF_CHANNEL
FEATURES = 2 * OWN + OF_IMAGE
# Binary outputs beside the mixture: the camera's transfer is not the configured one; lamps light
# the image instead of daylight.
FLAGS = 2
# Features that show whether an image is like those of training: its statistics without the
# residuals of the light model, which cannot be too small.
PLAIN = np.r_[:BINS * OF_BIN, OF_CURVES:OWN, 2 * OWN:FEATURES]
# Differences between left and right, of which the network takes the absolute values: it is
# invariant to mirrored images.
SIDEWAYS = np.add.outer(
    np.arange(BINS) * OF_BIN, BETWEEN_HALVES + np.arange(len(COMPARED))).ravel()
# Standardised features are clipped at so many deviations.
MOST_DEVIATIONS = 6.0
# Bounds of the logarithm of a component's deviation.
LEAST_LOG_DEVIATION, MOST_LOG_DEVIATION = -4.0, 1.5
# Written by `uw_visibility train`.
WEIGHTS = "daylight_posterior.npz"
# Layers of a network.
LAYERS = 6
# Added to a layer's variance before the division by it.
LEAST_VARIANCE = 1e-5


class Mixture(NamedTuple):
    """Mixture of normal distributions of the nine unknowns, channel by channel."""

    weight: Array  # (K,)
    mean: Array  # (K, 9)
    covariance: Array  # (K, 9, 9)
    other_curve: float  # probability that the camera's transfer is not the configured one
    lamps: float  # probability that lamps light the image instead of daylight
    # mean square of the standardised statistics; about 1 for images like those of training
    unlike: float


@dataclass(frozen=True)
class Network:
    """Trained networks whose answers are averaged."""

    centre: Array  # (D,), mean of the features in training
    spread: Array  # (D,), their deviation
    # weights and biases of each network, layer by layer
    layers: tuple[tuple[NDArray[np.float32], ...], ...]
    # limit of `Posterior.unlike`, which nearly all training views keep
    most_unlike: float = math.inf
    most_misfit: float = math.inf  # limit of `Posterior.misfit`, likewise

    def infer(self, statistics: Statistics) -> Mixture:
        """Infer the posterior of an image's statistics."""
        features = standardise(features_of(*statistics[:4]), self.centre, self.spread)
        outputs, logits, flags = _run(self.layers, features)
        other_curve, lamps = expit(flags).mean(axis=0).tolist()
        seen = lit(statistics)
        unlike = float(np.mean(features[np.ix_(seen, PLAIN)]**2)) if seen.any() else 0.0
        return Mixture(*_components(outputs, logits), other_curve, lamps, unlike)


def features_of(
    of_bins: NDArray[np.float32], of_tiles: NDArray[np.float32], of_channels: NDArray[np.float32],
    of_image: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Input of the network for each channel: its statistics, the others' mean, the image's.

    Takes the arrays of `Statistics`, with any axes before; returns (..., 3, D).
    """
    own = np.concatenate((curves(of_bins, of_tiles, of_channels, of_image), of_channels), axis=-1)
    own[..., SIDEWAYS] = np.abs(own[..., SIDEWAYS])
    others = 0.5 * (own.sum(axis=-2, keepdims=True) - own)
    image = np.broadcast_to(of_image[..., np.newaxis, :], (*own.shape[:-1], of_image.shape[-1]))
    return np.concatenate((own, others, image), axis=-1)


def lit(statistics: Statistics) -> Mask:
    """(3,): channels that have light: few pixels have the code 0."""
    return np.asarray(statistics.of_channels[:, ZEROS] < MAX_CLIPPED_FRACTION)


def standardise(features: NDArray[Any], centre: Array, spread: Array) -> Array:
    """Standardise features by mean and deviation of training, and clip them."""
    return np.asarray(np.clip((features - centre) / spread, -MOST_DEVIATIONS, MOST_DEVIATIONS))


def _run(
    networks: tuple[tuple[NDArray[np.float32], ...], ...], features: Array
) -> tuple[Array, Array, Array]:
    """Outputs (N, 3, OUTPUTS) of N networks, logits of the components (N, K) and of the flags."""
    # By einsum, as fast as BLAS by one thread: those of OpenBLAS wait actively, and take a
    # processor from the pipeline for the rest of the frame.
    def layer(number: int, inputs: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.stack([
            np.einsum("...j,jk->...k", each, layers[2 * number]) + layers[2 * number + 1]
            for each, layers in zip(inputs, networks, strict=True)])

    seen = np.broadcast_to(features.astype(np.float32), (len(networks), *features.shape))
    hidden = gelu(normalise(layer(0, seen)))
    others = np.broadcast_to(hidden.mean(axis=1, keepdims=True), hidden.shape)
    hidden = gelu(normalise(layer(1, np.concatenate((hidden, others), axis=2))))
    hidden = gelu(normalise(layer(2, hidden)))
    together = hidden.mean(axis=1)
    return (
        layer(3, hidden).astype(np.float64), layer(4, together).astype(np.float64),
        layer(5, together).astype(np.float64))


def normalise(x: NDArray[np.float32]) -> NDArray[np.float32]:
    """Layer normalisation without gain and bias (Ba, Kiros and Hinton, arXiv:1607.06450)."""
    away = x - x.mean(axis=-1, keepdims=True)
    return np.asarray(
        away / np.sqrt((away**2).mean(axis=-1, keepdims=True) + np.float32(LEAST_VARIANCE)))


def gelu(x: NDArray[np.float32]) -> NDArray[np.float32]:
    """Gaussian error linear unit by its tanh form (Hendrycks and Gimpel, arXiv:1606.08415)."""
    return np.asarray(0.5 * x * (1.0 + np.tanh(0.7978845608 * (x + 0.044715 * x**3))), np.float32)


def _components(outputs: Array, logits: Array) -> tuple[Array, Array, Array]:
    """Weights (K,), means (K, 9) and covariances (K, 9, 9) of the components of all networks."""
    weight = np.exp(logits - logits.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    shaped = outputs.reshape(-1, 3, COMPONENTS, OF_COMPONENT).swapaxes(1, 2).reshape(
        -1, 3, OF_COMPONENT)
    mean = shaped[..., :UNKNOWNS].reshape(len(shaped), -1)
    lower = np.zeros((len(shaped), 3, UNKNOWNS, UNKNOWNS))
    diagonal = np.arange(UNKNOWNS)
    lower[..., diagonal, diagonal] = np.exp(np.clip(
        shaped[..., UNKNOWNS:2 * UNKNOWNS], LEAST_LOG_DEVIATION, MOST_LOG_DEVIATION))
    row, column = np.tril_indices(UNKNOWNS, -1)
    lower[..., row, column] = shaped[..., 2 * UNKNOWNS:UNKNOWNS + 6]
    loading = shaped[..., UNKNOWNS + 6:].reshape(len(shaped), -1, FACTORS)
    covariance = loading @ loading.swapaxes(1, 2)
    for c in range(3):
        block = slice(c * UNKNOWNS, (c + 1) * UNKNOWNS)
        covariance[:, block, block] += lower[:, c] @ lower[:, c].swapaxes(1, 2)
    return weight.ravel() / len(outputs), mean, covariance


def load(path: Path) -> Network:
    """Read networks from an .npz file; nothing in it is run.

    Raises `InputError` if the file is none, or holds no networks of this form.
    """
    try:
        with np.load(path, allow_pickle=False) as data:
            network = of_arrays(data)
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(
            f"{path} holds no trained networks: give what `uw_visibility train` wrote") from error
    for first, *others in network.layers:
        sizes = (first.shape[0], len(network.centre), others[-4].shape[1], others[-2].shape[1])
        if sizes != (FEATURES, FEATURES, COMPONENTS, FLAGS):
            raise InputError(f"{path} is of networks of another form: train anew")
    return network


def of_arrays(data: Mapping[str, NDArray[Any]]) -> Network:
    """Networks from the arrays of training; without limits they are infinite."""
    layers = tuple(
        tuple(array for j in range(LAYERS) for array in (
            data[f"{i}_{j}_weights"] * data[f"{i}_{j}_scale"], data[f"{i}_{j}_bias"]))
        for i in range(int(data["networks"])))
    unlike, misfit = (float(x) for x in data["limits"]) if "limits" in data else (math.inf,) * 2
    return Network(
        data["centre"].astype(np.float64), data["spread"].astype(np.float64), layers, unlike,
        misfit)


@lru_cache(maxsize=1)
def trained() -> Network:
    """Networks that come with the package."""
    with resources.as_file(resources.files(package_data) / WEIGHTS) as path:
        return load(path)
