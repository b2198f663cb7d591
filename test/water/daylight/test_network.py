# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Networks give a proper distribution, in metres and irradiance, the same for exchanged channels.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtri

from uw_visibility.errors import InputError
from uw_visibility.water.daylight.inference import DRAWS, Posterior, infer
from uw_visibility.water.daylight.network import (
    COMPONENTS,
    FLAGS,
    LAYERS,
    OUTPUTS,
    Network,
    features_of,
    load,
)
from uw_visibility.water.daylight.statistics import (
    BETWEEN_HALVES,
    BINS,
    COMPARED,
    OF_BIN,
    OF_CHANNEL,
    OF_IMAGE,
    TILES,
    Statistics,
)

HIDDEN = (12, 10, 8)


def statistics_of(seed: int = 0) -> Statistics:
    rng = np.random.default_rng(seed)
    of_bins = rng.normal(-1.0, 0.5, (3, BINS, OF_BIN)).astype(np.float32)
    of_bins[..., -1] = 1.0
    of_image = rng.normal(0.0, 0.3, OF_IMAGE).astype(np.float32)
    of_tiles = rng.uniform(0.2, 0.8, (5, TILES, BINS)).astype(np.float32)
    return Statistics(
        of_bins, of_tiles, rng.normal(size=(3, OF_CHANNEL)).astype(np.float32), of_image,
        np.array((0.2, 0.5, 0.8)), 4.0)


def network(seed: int = 0) -> Network:
    rng = np.random.default_rng(seed)
    one = statistics_of()
    features = features_of(*one[:4]).shape[1]
    sizes = [(features, HIDDEN[0]), (2 * HIDDEN[0], HIDDEN[1]), HIDDEN[1:],
             (HIDDEN[2], OUTPUTS), (HIDDEN[2], COMPONENTS), (HIDDEN[2], FLAGS)]
    layers = []
    for size in sizes:
        layers += [each.astype(np.float32) for each in (
            rng.normal(0.0, 0.7 / math.sqrt(size[0]), size), rng.normal(0.0, 0.1, size[1]))]
    return Network(np.zeros(features), np.ones(features), (tuple(layers),))


def test_the_mixture_is_a_distribution() -> None:
    mixture = network().infer(statistics_of())
    assert mixture.weight.sum() == pytest.approx(1.0)
    assert (mixture.weight > 0).all()
    for covariance in mixture.covariance:
        np.testing.assert_array_equal(covariance, covariance.T)
        assert np.linalg.eigvalsh(covariance).min() > 0


def test_exchanged_channels_exchange_the_answer() -> None:
    one, order = statistics_of(), [2, 0, 1]
    other = one._replace(
        of_bins=one.of_bins[order], of_tiles=one.of_tiles[[*order, 3, 4]],
        of_channels=one.of_channels[order], brightest=one.brightest[order])
    first, second = infer(network(), one), infer(network(), other)
    np.testing.assert_allclose(first.mean[order], second.mean, atol=1e-6)
    at = np.concatenate([np.arange(3 * c, 3 * c + 3) for c in order])
    np.testing.assert_allclose(first.covariance[np.ix_(at, at)], second.covariance, atol=1e-6)


def test_units_are_metres_and_irradiance() -> None:
    one = statistics_of()
    other = one._replace(brightest=0.5 * one.brightest, median_range=2.0 * one.median_range)
    first, second = infer(network(), one), infer(network(), other)
    np.testing.assert_allclose(second.mean - first.mean, -math.log(2.0), rtol=1e-9)
    np.testing.assert_allclose(second.draws - first.draws, -math.log(2.0), rtol=1e-9)
    np.testing.assert_allclose(
        np.tensordot(first.weight, first.draws, 1), first.mean, atol=1e-9)


def test_the_clearest_channel_tells_the_distance() -> None:
    rng = np.random.default_rng(1)
    draws = rng.normal((-1.0, -2.0, -5.0), (0.1, 0.2, 0.1), (20 * DRAWS, 3))
    draws = np.stack((draws, draws, draws), axis=2)
    posterior = Posterior(
        np.zeros((3, 3)), np.eye(9), draws, np.full(len(draws), 1.0 / len(draws)))
    seen = np.array((True, True, False))
    low, middle, high = posterior.clearest(seen)
    assert middle == pytest.approx(2.0, abs=0.02)
    assert high - low == pytest.approx(0.2 * 2.0 * ndtri(0.84), rel=0.06)


def save(path: Path, found: Network, **changed: object) -> Path:
    arrays: dict[str, object] = {
        "networks": np.array(len(found.layers)), "centre": found.centre, "spread": found.spread,
        "limits": np.array((9.0, 9.0)), "provenance": np.array("a test")}
    for i, layers in enumerate(found.layers):
        for j in range(LAYERS):
            scale = np.float32(0.5) + np.arange(layers[2 * j].shape[1], dtype=np.float32)
            arrays |= {f"{i}_{j}_weights": layers[2 * j] / scale, f"{i}_{j}_scale": scale,
                       f"{i}_{j}_bias": layers[2 * j + 1]}
    np.savez(path, **(arrays | changed))  # type: ignore[arg-type]
    return path


def test_networks_are_written_and_read(tmp_path: Path) -> None:
    found = load(save(tmp_path / "weights.npz", network()))
    np.testing.assert_allclose(
        infer(found, statistics_of()).mean, infer(network(), statistics_of()).mean, atol=1e-5)


def test_a_mirrored_image_has_the_same_features() -> None:
    one = statistics_of()
    bins = one.of_bins.copy()
    bins[..., BETWEEN_HALVES:BETWEEN_HALVES + len(COMPARED)] *= -1.0
    np.testing.assert_array_equal(
        features_of(*one[:4]), features_of(bins, *one[1:4]))


@pytest.mark.parametrize("kind", ["absent", "text", "other keys", "other form", "objects"])
def test_what_is_no_network_is_one_sentence(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "weights.npz"
    if kind == "text":
        path.write_text("weights")
    elif kind == "other keys":
        np.savez(path, a=np.zeros(3))
    elif kind == "other form":
        save(path, network(), centre=np.zeros(7))
    elif kind == "objects":
        np.savez(path, networks=np.array([print], dtype=object))
    with pytest.raises(InputError, match="train"):
        load(path)
