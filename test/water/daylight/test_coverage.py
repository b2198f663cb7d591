# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Standard deviations against errors over many seeded draws of scenes and water."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from scenes import codes

from uw_visibility.config.schema import PipelineConfig, WaterConfig
from uw_visibility.images.view import View
from uw_visibility.status import Status
from uw_visibility.water.blocks import reduce_to_blocks
from uw_visibility.water.daylight.estimation import WaterEstimator
from uw_visibility.water.daylight.inference import infer
from uw_visibility.water.daylight.network import Mixture, trained
from uw_visibility.water.daylight.statistics import (
    QUANTILES,
    Statistics,
    summarise,
)
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.assessment import Assessor

KAPPA = np.array([0.228, 0.066, 0.025])
SHAPE = (192, 256)
DRAWS = 40
ASSESSOR = Assessor(PipelineConfig())


@dataclass(frozen=True)
class Draw:
    """An image of a random scene, its ranges, and the truth."""

    image: np.ndarray
    range: np.ndarray
    attenuation: np.ndarray
    veil: np.ndarray
    light: np.ndarray


def draw(seed: int, ratio: float | None = 1.0, open_water: bool = False) -> Draw:
    """See tilted patches at random ranges; veil over light is `ratio`, random where None."""
    rng = np.random.default_rng(seed)
    rows, columns = SHAPE
    near, far = rng.uniform(1.5, 3.0), rng.uniform(5.0, 9.0)
    tiles = rng.uniform(0.0, 1.0, (6, 8))
    place = cv2.resize(tiles, (columns, rows), interpolation=cv2.INTER_CUBIC).clip(0.0, 1.0)
    distance = (near + (far - near) * place).astype(np.float32)
    grey = sum(
        cv2.resize(rng.random((rows // scale, columns // scale)), (columns, rows)) / 3
        for scale in (3, 8, 24))
    grey = (grey - grey.min()) / (grey.max() - grey.min())
    contrast = rng.uniform(1.5, 2.5)
    tint = 0.9 + 0.1 * rng.random((rows // 16, columns // 16, 3))
    rho = grey[..., np.newaxis] ** contrast * cv2.resize(tint, (columns, rows))
    rho = rng.uniform(0.0, 0.04) + rng.uniform(0.85, 0.95) * rho
    particles = rng.uniform(0.05, 0.4)
    beta = KAPPA + particles * np.exp(rng.normal(0.0, 0.1, 3))
    light = 0.9 * np.exp(-0.8 * beta * rng.uniform(1.0, 4.0))
    light *= 0.85 / light.max()
    share = np.exp(rng.uniform(np.log(0.25), np.log(1.1))) if ratio is None else ratio
    veil = share * light
    path = distance[..., np.newaxis].copy()
    if open_water:
        path[: rows // 5] = np.inf
        distance[: rows // 5] = np.nan
    left = np.exp(-beta * path)
    irradiance = light * rho * left + veil * (1.0 - left)
    codes = 255.0 * irradiance + rng.normal(0.0, 0.5, irradiance.shape)
    image = np.clip(np.round(codes), 0, 255).astype(np.uint8)
    return Draw(image, distance, beta, veil, light)


@functools.cache
def estimates(
    model: str, ratio: float | None, open_water: bool = False
) -> list[tuple[Draw, WaterEstimate]]:
    """Estimate the water of each draw."""
    estimator = WaterEstimator(WaterConfig(veil=model), KAPPA, daylight=ASSESSOR.daylight)
    draws = [draw(seed, ratio, open_water) for seed in range(DRAWS)]
    return [
        (one, estimator.estimate_view(View.of(one.image), one.range, range_error=0.0))
        for one in draws]


def scores(found: list[tuple[Draw, WaterEstimate]]) -> np.ndarray:
    """Errors of attenuation over their standard deviation, of what was published."""
    return np.array([
        (estimate.attenuation - one.attenuation) / estimate.attenuation_stddev
        for one, estimate in found if estimate.status is Status.OK])


def within(score: np.ndarray, deviations: float, least: float) -> None:
    """Assert a share of scores within so many deviations, but for three binomial deviations.

    The channels of a frame are one sample.
    """
    share = (np.abs(score) < deviations).mean()
    assert share > least - 3.0 * np.sqrt(least * (1.0 - least) / len(score))


class TestPaperModel:
    """Veil and light are one, and the estimator knows it."""

    @pytest.fixture
    def found(self) -> list[tuple[Draw, WaterEstimate]]:
        return estimates("paper", 1.0)

    def test_coverage(self, found):
        score = scores(found)
        assert len(score) > 0.9 * DRAWS
        within(score, 1.0, 0.68)
        within(score, 2.0, 0.95)

    def test_standard_deviations_are_not_idle(self, found):
        assert np.sqrt((scores(found) ** 2).mean()) > 0.35


@pytest.mark.parametrize(("ratio", "open_water"), [(1.0, False), (0.4, True), (None, False)])
class TestFreeVeil:
    """Veil and light may differ: the trained posterior, which has not seen these scenes."""

    def test_coverage(self, ratio, open_water):
        told = [(one, e) for one, e in estimates("free", ratio, open_water)
                if e.status is Status.OK]
        assert len(told) > 0.85 * DRAWS
        log_error = np.array([np.log(e.attenuation / one.attenuation) for one, e in told])
        stddev = np.array([e.attenuation_stddev / e.attenuation for _, e in told])
        within(log_error / stddev, 1.0, 0.68)
        within(log_error / stddev, 2.0, 0.95)
        within(log_error / stddev, 3.0, 0.99)
        assert np.sqrt(((log_error / stddev) ** 2).mean()) > 0.3
        assert np.median(np.abs(log_error)) < 0.15
        # The veil, too: far dark patches show it but for noise. With 0.4 of the light and open
        # water it is 3 % too bright, one to two of its standard deviations.
        log_veil = np.array([np.log(e.veil / one.veil) for one, e in told])
        within(log_veil / np.array([e.ambient_light_stddev / e.veil for _, e in told]), 3.0, 0.99)
        if open_water:
            assert np.median(np.abs(log_veil)) < 0.05
        # Distances are in their intervals as often as these say.
        seen = [(one, ASSESSOR.assess(e)) for one, e in told]
        inside = [
            v.distance_low < 2.351 / one.attenuation.min() < v.distance_high
            for one, v in seen if v.status is Status.OK]
        assert len(inside) > 0.75 * DRAWS
        assert np.mean(inside) > 0.68 - 3.0 * np.sqrt(0.68 * 0.32 / len(inside))


class TestRefusalsOfThePosterior:
    """It goes through the same door, and two doors of its own."""

    def estimator(self, **limits: float) -> WaterEstimator:
        return WaterEstimator(
            WaterConfig(), KAPPA, network=replace(trained(), **limits))

    @pytest.mark.parametrize(("limit", "reason"), [
        ("most_unlike", Status.UNLIKE_TRAINING), ("most_misfit", Status.NOT_ONE_WATER)])
    def test_beyond_its_limits_it_tells_nothing(self, limit, reason):
        one = draw(1)
        ok = self.estimator().estimate_view(View.of(one.image), one.range, range_error=0.0)
        assert ok.status is Status.OK
        refused = self.estimator(**{limit: 0.0}).estimate_view(
            View.of(one.image), one.range, range_error=0.0)
        assert refused.status is reason
        assert np.isnan(refused.attenuation).all()

    def test_surfaces_darker_than_their_veil_are_a_misfit(self):
        """A shadow that swallows the veil too: no water does."""
        one = draw(1)
        dark = one.image.copy()
        dark[:, one.range.shape[1] // 2:] //= 12
        even, uneven = (
            infer(trained(), summarise(reduce_to_blocks(
                View.of(image).colour, one.range, None), 0.0, KAPPA)).misfit
            for image in (one.image, dark))
        # Of the dark half, ln² of up to 12.
        assert even < 0.01 and uneven > 1.0

    def test_surfaces_brighter_than_white_are_a_misfit(self):
        one = draw(1)
        seen = summarise(reduce_to_blocks(
            View.of(one.image).colour, one.range, None), 0.0, KAPPA)
        # The brightest of each bin, e² times as bright.
        bright = seen.of_bins.copy()
        bright[..., len(QUANTILES) - 1] += 2.0
        even, uneven = (
            infer(trained(), each).misfit for each in (seen, seen._replace(of_bins=bright)))
        assert even < 0.01 and uneven > 1.0

    def test_what_no_estimator_tells_it_does_not_tell(self):
        one = draw(1)
        for image, ranges, reason in (
            (np.zeros_like(one.image), one.range, Status.TOO_DARK),
            (np.repeat(one.image[..., :1], 3, axis=2), one.range, Status.NO_COLOUR),
            (one.image, np.full_like(one.range, 3.0), Status.RANGE_SPREAD_TOO_SMALL),
            (one.image, np.full_like(one.range, np.nan), Status.TOO_FEW_OBSERVATIONS),
        ):
            found = self.estimator().estimate_view(View.of(image), ranges, range_error=0.0)
            assert found.status is reason

    def test_water_without_red_is_told_by_green_and_blue(self):
        one = draw(1)
        image = one.image.copy()
        image[..., 0] = 0
        found = self.estimator().estimate_view(View.of(image), one.range, range_error=0.0)
        assert found.status is Status.OK and np.isnan(found.attenuation[0])
        error = np.log(found.attenuation / one.attenuation)[1:]
        assert (np.abs(error) < 3.0 * (found.attenuation_stddev / found.attenuation)[1:]).all()
        seen = ASSESSOR.assess(found)
        assert seen.channels == "GB"
        assert seen.distance_low < seen.distance < seen.distance_high

    def test_light_does_not_depend_on_a_channel_without_light(self):
        """However it is correlated with the others."""
        one = draw(1)
        image = one.image.copy()
        image[..., 0] = 0
        found = []
        for correlation in (0.0, 0.8):
            alike = 0.25 * np.eye(3)
            alike[1, 2] = alike[2, 1] = 0.2
            alike[0, 1:] = alike[1:, 0] = 0.25 * correlation
            covariance = 0.01 * np.eye(9)
            covariance[2::3, 2::3] = alike
            mean = np.tile([0.0, -0.5, -0.5], 3)
            estimator = WaterEstimator(
                WaterConfig(), KAPPA, network=SaysAlways(mean, covariance))
            found.append(estimator.estimate_view(View.of(image), one.range, range_error=0.0))
        np.testing.assert_allclose(found[1].light[1:], found[0].light[1:])
        np.testing.assert_allclose(
            found[1].light_covariance[1:, 1:], found[0].light_covariance[1:, 1:])


@dataclass
class SaysAlways:
    """A network whose posterior is one normal distribution, whatever the image."""

    mean: np.ndarray
    covariance: np.ndarray
    most_unlike = most_misfit = np.inf

    def infer(self, statistics: Statistics) -> Mixture:
        return Mixture(np.ones(1), self.mean[np.newaxis], self.covariance[np.newaxis], 0.1, 0.01, 1)


def estimate(image: np.ndarray, distance: np.ndarray, transfer: str = "linear") -> WaterEstimate:
    """Estimate as the node does."""
    estimator = WaterEstimator(WaterConfig(), KAPPA, ASSESSOR.daylight)
    return estimator.estimate_view(View.of(image, transfer), distance, range_error=0.0)


def log_score(found: WaterEstimate, truth: np.ndarray) -> np.ndarray:
    """Errors of ln attenuation over their standard deviation."""
    return np.log(found.attenuation / truth) / (found.attenuation_stddev / found.attenuation)


def encoded(one: Draw) -> np.ndarray:
    """Encode as sRGB."""
    return codes(one.image / 255, transfer="srgb")


class TestPhysicalSense:
    """What no water explains is refused, or the standard deviation covers it."""

    SEEDS = range(12)

    def test_a_wrong_transfer_is_told(self):
        """By frames together; see `Vote` of the filter."""
        draws = [draw(seed) for seed in self.SEEDS]
        wrong = [estimate(encoded(one), one.range).transfer_log_odds for one in draws]
        reverse = [estimate(one.image, one.range, "srgb").transfer_log_odds for one in draws]
        right = [estimate(one.image, one.range).transfer_log_odds for one in draws]
        right += [estimate(encoded(one), one.range, "srgb").transfer_log_odds for one in draws]
        assert np.mean(wrong) > np.mean(right) + 1.0
        assert np.mean(reverse) > np.mean(right)
        assert np.mean(right) < -3.0

    @pytest.mark.parametrize("effect", ["vignetting", "plume"])
    def test_uneven_images_are_refused_or_in_the_deviation(self, effect):
        rows, columns = np.mgrid[-1:1:SHAPE[0] * 1j, -1:1:SHAPE[1] * 1j]
        beyond = []
        for seed in self.SEEDS:
            one = draw(seed)
            if effect == "vignetting":
                # Half of the light is left in the corners.
                image = one.image * (1.0 - 0.25 * (rows**2 + columns**2))[..., np.newaxis]
                truth = one.attenuation, one.attenuation
            else:
                # Right half: 0.3 1/m more.
                left = np.exp(-0.3 * one.range * (columns > 0))[..., np.newaxis]
                image = one.image * left + 255 * one.veil * (1.0 - left)
                truth = one.attenuation, one.attenuation + 0.3
            found = estimate(np.round(image).astype(np.uint8), one.range)
            if found.status is Status.OK:
                low, high = (log_score(found, each) for each in truth)
                beyond.append((low < -3.0) | (high > 3.0))
        assert not beyond or np.mean(beyond) < 0.1

    def test_attenuation_is_above_clear_waters_rather_than_at_it(self):
        """Clear water, and a scene whose contrast grows with range by as much as it takes."""
        for seed in self.SEEDS:
            one = draw(seed, 0.5)
            distance = one.range[..., np.newaxis]
            left = np.exp(-one.attenuation * distance)
            radiance = (one.image / 255 - one.veil * (1.0 - left)) / left
            radiance *= np.exp(0.12 * (distance - distance.max()))
            left = np.exp(-KAPPA * distance)
            seen = radiance * left + one.veil * (1.0 - left)
            found = estimate(np.clip(np.round(255 * seen), 0, 255).astype(np.uint8), one.range)
            assert found.status is Status.OK
            assert (np.abs(log_score(found, KAPPA)) < 3.0).all()

    def test_a_jpeg_that_was_not_told_of_is_in_the_deviation(self):
        """It rounds red, of which little is left, to the light of blue."""
        blue = np.array([0.3, 0.75, 1.0])
        scores = []
        for seed in self.SEEDS:
            one = draw(seed)
            image = np.round(one.image * blue).astype(np.uint8)
            data = cv2.imencode(
                ".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 75])[1]
            pixels = np.ascontiguousarray(cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1])
            found = estimate(pixels, one.range)
            if found.status is Status.OK:
                scores.append(log_score(found, one.attenuation))
        assert len(scores) >= 6
        assert (np.abs(scores) < 3.0).mean() > 0.9

    @pytest.mark.parametrize(("particles", "fall", "wall"), [
        (0.5, 0.0, False), (0.5, 0.4, False), (0.3, 0.5, False), (0.05, 0.0, True),
        (0.2, 0.0, True), (0.1, 0.4, True),
    ])
    def test_a_scene_may_fade_into_open_water_or_end_at_a_wall(self, particles, fall, wall):
        """Matched up to where nothing is left of it, and as smooth as the water beyond.

        The veil may fall by a part of it from above to below.
        """
        rng = np.random.default_rng(0)
        rows = np.linspace(0.0, 1.0, SHAPE[0])[:, np.newaxis] * np.ones((1, SHAPE[1]))
        ranges = (2.0 / np.maximum(rows - 0.2, 0.1)).astype(np.float32)
        grey = cv2.resize(rng.random((SHAPE[0] // 3, SHAPE[1] // 3)), SHAPE[::-1])
        rho = 0.9 * (grey[..., np.newaxis] - grey.min()) ** 2
        if wall:
            rho[rows < 0.55] = 0.6
        beta = KAPPA + particles
        left = np.exp(-beta * ranges[..., np.newaxis])
        if not wall:
            left[rows < 0.3] = 0.0
        veil = 0.6 * (1.0 + fall * (0.5 - rows[..., np.newaxis]))
        codes = 255.0 * (0.8 * rho * left + veil * (1.0 - left)) + rng.normal(0, 0.4, rho.shape)
        ranges[rows < 0.3] = np.nan
        found = estimate(np.clip(np.round(codes), 0, 255).astype(np.uint8), ranges)
        assert found.status is not Status.OK or (np.abs(log_score(found, beta)) < 3.0).all()

    @pytest.mark.parametrize("far", [6.0, 9.0])
    def test_a_brighter_veil_above_that_the_whole_scene_has_faded_into(self, far):
        """Nothing tells the water above from a smooth wall but that all follows from it."""
        scores, ratios = [], []
        for seed in self.SEEDS:
            rng = np.random.default_rng(seed)
            beta = KAPPA + rng.uniform(0.35, 0.6)
            rows = np.linspace(0.0, 1.0, SHAPE[0], dtype=np.float32)[:, np.newaxis]
            heights = cv2.resize(
                rng.uniform(0.8, 1.2, (6, 8)).astype(np.float32), SHAPE[::-1])
            ranges = np.minimum(far, 2.4 * heights / np.maximum(rows - 0.2, 0.05))
            gradient = (1.0 + rng.uniform(0.3, 0.6) * (0.5 - rows))[..., np.newaxis]
            grey = cv2.resize(rng.random((SHAPE[0] // 3, SHAPE[1] // 3)), SHAPE[::-1])
            rho = 0.9 * (grey[..., np.newaxis] - grey.min()) ** 2
            left = np.exp(-beta * np.where(rows < 0.45, np.inf, ranges)[..., np.newaxis])
            codes = 255.0 * 0.6 * (rho * left + gradient * (1.0 - left))
            codes += rng.normal(0.0, 0.5, codes.shape)
            ranges[: int(0.45 * SHAPE[0])] = np.nan
            found = estimate(np.clip(np.round(codes), 0, 255).astype(np.uint8), ranges)
            scores.append(log_score(found, beta))
            ratios.append(beta.min() / found.attenuation.min())
        assert np.isfinite(scores).all(axis=1).mean() > 0.8
        # Without that water visibility is 1.7 and 1.2 times the true one.
        assert (np.abs(scores) > 3.0).any(axis=1).mean() < 0.1
        assert abs(np.nanmedian(ratios) - 1.0) < 0.25

    @pytest.mark.parametrize(("change", "most"), [(0.0, 1.0), (1.4, 4.0)])
    def test_a_veil_that_doubles_without_open_water_in_view_is_hardly_told(self, change, most):
        """Brighter above, where far things are. Where the estimator ends: not by more than this."""
        scores = []
        for seed in self.SEEDS:
            rng = np.random.default_rng(seed)
            rows = np.linspace(0.0, 1.0, SHAPE[0], dtype=np.float32)[:, np.newaxis]
            ranges = np.broadcast_to(2.0 + 6.0 * (1.0 - rows), SHAPE).copy()
            grey = cv2.resize(rng.random((SHAPE[0] // 3, SHAPE[1] // 3)), SHAPE[::-1])
            rho = 0.9 * (grey[..., np.newaxis] - grey.min()) ** 2
            left = np.exp(-(KAPPA + 0.3) * ranges[..., np.newaxis])
            veil = (1.0 + change * (0.5 - rows))[..., np.newaxis]
            codes = 255.0 * 0.5 * (rho * left + veil * (1.0 - left))
            codes += rng.normal(0.0, 0.5, codes.shape)
            found = estimate(np.clip(np.round(codes), 0, 255).astype(np.uint8), ranges)
            assert found.status is Status.OK
            scores.append(log_score(found, KAPPA + 0.3))
        assert np.abs(scores).max() < most

    def test_brighter_light_than_veil_is_told_apart(self):
        one = draw(5, 0.3, open_water=True)
        found = estimate(one.image, one.range)
        # As bright as its brightest patches, and of its colour.
        assert (found.scene_light > 1.5 * found.veil).all()
        np.testing.assert_allclose(
            found.scene_light / found.scene_light.sum(), one.light / one.light.sum(), rtol=0.1)

    def test_depth_in_green_water_is_not_sure(self):
        one = draw(2)
        green = np.array([0.6, 1.0, 0.35])
        image = np.round(one.image * green).astype(np.uint8)
        seen = ASSESSOR.assess(estimate(image, one.range))
        assert seen.depth_status is not Status.OK or seen.depth_stddev > 1.0
        assert not seen.depth_precision > seen.depth_stddev


def test_the_scale_of_range_is_unknown_to_all_channels_alike():
    shown = draw(2)
    found = estimate(shown.image, shown.range)
    samples = View.of(shown.image).colour
    statistics = summarise(reduce_to_blocks(samples, shown.range, None), 0.0, KAPPA)
    alone = infer(trained(), statistics).covariance[0::3, 0::3]
    relative = found.covariance[0::2, 0::2] / np.outer(found.attenuation, found.attenuation)
    np.testing.assert_allclose(relative - alone, np.full((3, 3), 0.046**2), rtol=1e-3)
    # Ranges that are wrong by as much change attenuation by as much.
    longer = estimate(shown.image, shown.range * np.float32(1.046))
    np.testing.assert_allclose(longer.attenuation, found.attenuation / 1.046, rtol=0.01)
