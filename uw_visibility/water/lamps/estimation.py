# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Estimation of attenuation and scattering where lamps light the scene."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erfcx

from uw_visibility.config.lighting import LightingConfig
from uw_visibility.config.schema import WaterConfig
from uw_visibility.images.arrays import Array, Mask
from uw_visibility.images.view import View
from uw_visibility.optics.lamps import (
    REFERENCE,
    LampTables,
    Table,
    displaced,
    log_direct,
    nodes_of,
    tabulate,
    trilinear,
)
from uw_visibility.status import Status
from uw_visibility.water.daylight.validation import (
    MAX_CLIPPED_FRACTION,
    refuse_spread,
    refute_clearness,
)
from uw_visibility.water.estimate import (
    LampLight,
    WaterEstimate,
    blank,
    of_channels,
    overall_status,
    refuse,
)
from uw_visibility.water.lamps.cells import Cells
from uw_visibility.water.lamps.fit import FEWEST_CELLS, ContrastFit, fit_contrast, fit_light
from uw_visibility.water.lamps.incidence import (
    Incidence,
    lamp_rows,
    observe_incidence,
    points_along,
    step_of,
)
from uw_visibility.water.lamps.observations import LampObservations, observe
from uw_visibility.water.lamps.track_fit import TrackFit, fit_tracks
from uw_visibility.water.lamps.tracks import GroundView, Sightings

Rays = Callable[[Array, Array], Array]

# Attenuation is not assessable when its standard deviation is beyond this part of it, see
# `refuse_spread`. Ground straight below is at one range; of its frames, those in which noise makes
# attenuation too large look well known, and told three times the true one.
MAX_RELATIVE_STDDEV = 1.0 / 3.0
# What no image can tell, as a part of β: the scale of range, the transfer, a beam's form.
MODEL_ERROR = 0.07
# Square of the distance of tracks from contrast, in standard deviations of the three channels,
# beyond which they are not those of one scene: 0.3 % by chance.
CONTRADICTION = 14.0
# Deviation of the channels' attenuation by particles and dissolved matter: relative to its mean,
# and at least, 1/m.
CHANNEL_TOLERANCE = 0.3
CHANNEL_TOLERANCE_MIN = 0.02
# Attenuation is at least that of clear water (eq. 3), known to about a tenth.
CLEAR_WATER_TOLERANCE = 0.1
# Deviation of β, 1/m, of a channel that is not seen.
UNSEEN = 10.0


@dataclass(frozen=True)
class _Prepared:
    """Tables for one size of image."""

    rays: Array
    tables: LampTables
    row_angle: float
    moved: list[Table]
    # Directions of the points of incidence, by the side of a sample, px.
    point_rays: dict[int, Array]


class CellEstimator:
    """Estimator of the water's state from cells, of one frame or many.

    `clear_water_attenuation` is κ of the camera, (3,), 1/m.
    """

    def __init__(self, lighting: LightingConfig, clear_water_attenuation: ArrayLike) -> None:
        self._lighting = lighting
        self._clear_water = np.array(clear_water_attenuation, dtype=np.float64)

    def fit_tracks(self, frames: Sequence[Sightings]) -> TrackFit | None:
        """Fit attenuation to tracked points; None where that fails, or by daylight too."""
        return fit_tracks(frames, self._lighting) if self._lighting.model == "lamps" else None

    def estimate_cells(
        self, cells: Cells, refused: list[Status] | None = None, tracks: TrackFit | None = None
    ) -> WaterEstimate:
        """Estimate from cells, of one frame or of many, and tracks of ground points over these.

        `refused` says why channels are not assessable; OK by default.
        """
        fit = fit_contrast(cells, self._lighting.model == "both", self._clear_water)
        if tracks is not None:
            fit = _joined(fit, tracks)
        status = list(refused or [Status.OK] * 3)
        for c in range(3):
            if status[c] is Status.OK and fit.cells[c] < FEWEST_CELLS:
                status[c] = Status.TOO_DARK
        seen = np.array([reason is Status.OK for reason in status])
        if not seen.any():
            nothing, no = WaterEstimate.not_assessable(overall_status(status)), np.full(3, np.nan)
            return replace(nothing, lamps=LampLight(no, no, no, no, no, cells))
        beta, covariance = self._join_channels(fit, seen)
        # That water is not clearer than clear water tells nothing of this water.
        deviation = np.sqrt(np.diag(covariance))
        beta, covariance = self._above_clear_water(beta, covariance, seen)
        for c in np.flatnonzero(seen).tolist():
            status[c] = refuse_spread(float(beta[c]), float(deviation[c]), MAX_RELATIVE_STDDEV)
        beta = np.where([reason is Status.OK for reason in status], beta, np.nan)
        status = refuse(status, refute_clearness(beta, covariance, self._clear_water))
        beta = np.where([reason is Status.OK for reason in status], beta, np.nan)
        return self._assembled(cells, fit, beta, covariance, status)

    def _join_channels(self, fit: ContrastFit, seen: Mask) -> tuple[Array, Array]:
        """Fuse β with the prior that channels are alike."""
        clear = self._clear_water
        beta = np.where(seen, fit.attenuation, 0.0)
        covariance = np.where(np.outer(seen, seen), fit.covariance, 0.0)
        covariance = np.nan_to_num(covariance) + np.diag(np.where(seen, 0.0, UNSEEN**2))
        particles = max(float((beta - clear)[seen].mean()), 0.0)
        tolerance = (CHANNEL_TOLERANCE_MIN + CHANNEL_TOLERANCE * particles) ** 2
        for c in range(3):
            row = np.full(3, -1.0 / 3.0)
            row[c] += 1.0
            beta, covariance = _update(beta, covariance, row, float(row @ clear), tolerance)
        return beta, covariance

    def _above_clear_water(self, beta: Array, covariance: Array, seen: Mask) -> tuple[Array, Array]:
        """Raise β to clear water's, and add the model's error."""
        clear = self._clear_water
        for c in np.argsort(beta - clear):
            if seen[c] and beta[c] < clear[c]:
                least = float(clear[c])
                beta, covariance = _raised(
                    beta, covariance, c, least, CLEAR_WATER_TOLERANCE * least)
        return beta, covariance + MODEL_ERROR**2 * np.outer(beta, beta)

    def _assembled(
        self, cells: Cells, fit: ContrastFit, beta: Array, covariance: Array, status: list[Status]
    ) -> WaterEstimate:
        light = fit_light(cells, beta, fit.daylight)
        known = np.isfinite(beta)
        # The lamps' colours are known, so that their power is one number.
        seen = known & (light.power > 0)
        power = float(np.exp(np.log(light.power[seen]).mean())) if seen.any() else math.nan
        veil = light.scattering * cells.far_scattered(beta) + light.veil
        relative = np.hypot(light.scattering_stddev / np.maximum(light.scattering, 1e-12), 0.1)
        joint = np.zeros((6, 6))
        joint[0::2, 0::2] = covariance
        joint[1::2, 1::2] = np.diag((np.minimum(relative, 10.0) * veil) ** 2)
        scene_light = np.where(known, power, np.nan)
        return WaterEstimate(
            **of_channels(
                status, beta, np.where(known, np.maximum(veil, 1e-9), np.nan),
                blank(joint, known)),
            iterations=fit.iterations, bins=len(cells.range), light=scene_light,
            light_stddev=np.where(known, light.power_stddev, np.nan),
            lamps=LampLight(
                beta, scene_light, light.scattering, fit.daylight * power, light.veil, cells))


class LampEstimator(CellEstimator):
    """Estimator of the water's state under lamps; tables are made once for a size of image.

    `rays` gives unit directions, (Y, X, 3), through a grid of columns and rows, px.
    """

    def __init__(
        self, config: WaterConfig, lighting: LightingConfig, clear_water_attenuation: ArrayLike,
        rays: Rays,
    ) -> None:
        super().__init__(lighting, clear_water_attenuation)
        self._config = config
        self._rays = rays
        self._prepared: dict[tuple[int, int], _Prepared] = {}

    def tables(self, shape: tuple[int, int]) -> LampTables:
        """Tables for images of a height and width, px."""
        return self._prepare(shape).tables

    def _prepare(self, shape: tuple[int, int]) -> _Prepared:
        if shape not in self._prepared:
            columns, rows = nodes_of(shape)
            rays = self._rays(columns, rows)
            lamps = list(self._lighting.lamps())
            tables = tabulate(rays, columns, rows, lamps)
            first = log_direct(rays, lamps)
            moved = [
                log_direct(rays, others) - first for others in displaced(
                    lamps, self._lighting.position_stddev, self._lighting.direction_stddev)]
            # Of one size at a time, as buffers are.
            middle = rays[len(rows) // 2 - 1:, len(columns) // 2]
            row_angle = float(np.linalg.norm(middle[1] - middle[0]) / (rows[1] - rows[0]))
            self._prepared = {shape: _Prepared(rays, tables, row_angle, moved, {})}
        return self._prepared[shape]

    def estimate_view(
        self, view: View, range_map: NDArray[np.floating], *, range_error: float = 0.0
    ) -> WaterEstimate:
        """Estimate attenuation and scattering from a view; see `WaterEstimator.estimate`.

        `range_error` changes nothing here.
        `ambient_light` of the result is what the water shows at infinity in the image's middle.
        """
        if view.colour is None:
            return WaterEstimate.not_assessable(Status.NO_COLOUR)
        prepared = self._prepare(view.shape)
        tables = prepared.tables
        direct = tables.log_direct[REFERENCE].mean(axis=0)
        scattered = tables.log_scattered[REFERENCE].mean(axis=0)
        ranges = np.asarray(range_map, np.float32)
        incidence = self._observe_incidence(view, ranges, prepared, direct, scattered)
        seen = observe(
            view.colour, ranges, view.valid, tables, direct, scattered, prepared.row_angle,
            incidence.log_cosine)
        reason = self._refuse(seen, view)
        if reason is not Status.OK:
            return WaterEstimate.not_assessable(reason)
        cells = _cells(seen, prepared, incidence)
        refused = [
            Status.SATURATED if seen.saturated[c] > MAX_CLIPPED_FRACTION else Status.OK
            for c in range(3)]
        low, high = seen.limits
        if high < self._config.min_range_ratio * low:
            # Many such frames may tell together what one does not.
            refused = [Status.RANGE_SPREAD_TOO_SMALL] * 3
        water = self.estimate_cells(cells, refused)
        assert water.lamps is not None
        ground = GroundView.of(view, ranges, prepared.rays)
        return replace(water, lamps=replace(water.lamps, ground=ground))

    def _observe_incidence(
        self, view: View, range_map: NDArray[np.float32], prepared: _Prepared, direct: Table,
        scattered: Table,
    ) -> Incidence:
        colour = view.colour
        assert colour is not None
        ranges, _ = colour.reduce(range_map, view.valid)
        scale, step = colour.scale, step_of(ranges.shape)
        if scale not in prepared.point_rays:
            rows, columns = (
                scale * points_along(size, step) + 0.5 * (scale - 1) for size in ranges.shape)
            prepared.point_rays[scale] = self._rays(columns, rows)
        return observe_incidence(
            colour, np.ascontiguousarray(ranges), prepared.tables, prepared.point_rays[scale],
            lamp_rows(list(self._lighting.lamps())), direct, scattered)

    @staticmethod
    def _refuse(seen: LampObservations, view: View) -> Status:
        """Validate a frame's observations: OK, or why no channel is assessable."""
        assert view.colour is not None
        if not view.colour.pixels.any():
            return Status.TOO_DARK
        if (seen.saturated > MAX_CLIPPED_FRACTION).all():
            return Status.SATURATED
        if (seen.zero > MAX_CLIPPED_FRACTION).all():
            return Status.TOO_DARK
        if len(seen.range) == 0:
            return Status.TOO_FEW_OBSERVATIONS
        return Status.OK


def _joined(fit: ContrastFit, tracks: TrackFit) -> ContrastFit:
    """Weighted mean of contrast and tracks; contrast alone where tracks contradict it."""
    seen = np.isfinite(fit.attenuation)
    covariance = np.where(np.outer(seen, seen), np.nan_to_num(fit.covariance), 0.0)
    covariance += np.diag(np.where(seen, 0.0, UNSEEN**2))
    away = tracks.attenuation - np.where(seen, fit.attenuation, 0.0)
    weight = np.linalg.inv(covariance + tracks.covariance)
    if away @ weight @ away > CONTRADICTION:
        return fit
    gain = covariance @ weight
    found = np.where(seen, fit.attenuation, 0.0) + gain @ away
    return replace(
        fit, attenuation=np.where(seen, found, np.nan), covariance=covariance - gain @ covariance)


def _update(
    mean: Array, covariance: Array, row: Array, value: float, variance: float
) -> tuple[Array, Array]:
    """Kalman's update by one number."""
    gain = covariance @ row / (row @ covariance @ row + variance)
    fresh = covariance - np.outer(gain, row @ covariance)
    return mean + gain * (value - row @ mean), 0.5 * (fresh + fresh.T)


def _raised(
    mean: Array, covariance: Array, c: int, least: float, tolerance: float
) -> tuple[Array, Array]:
    """Truncate one variable of a Gaussian at a least value of a tolerance.

    Its variance is that of the truncated normal distribution; others follow their covariance with
    it.
    """
    stddev = math.sqrt(covariance[c, c] + tolerance**2)
    below = (least - mean[c]) / stddev
    # Inverse Mills ratio φ(a) / (1 − Φ(a)): mean of a normal law that is truncated at a.
    ratio = math.sqrt(2.0 / math.pi) / float(erfcx(below / math.sqrt(2.0)))
    gain = covariance[:, c] / stddev
    fresh = covariance - ratio * (ratio - below) * np.outer(gain, gain)
    return mean + below * gain, 0.5 * (fresh + fresh.T)


def _cells(seen: LampObservations, prepared: _Prepared, incidence: Incidence) -> Cells:
    """Take the tables' light at the cells' places, with the incidence on the ground."""
    tables = prepared.tables
    places = tables.place(seen.column, seen.row, seen.range)
    direct, scattered = (
        trilinear(table, *places) for table in (tables.log_direct, tables.log_scattered))
    reference, unit = direct[REFERENCE].mean(axis=0), scattered[REFERENCE].mean(axis=0)
    moved = np.array([trilinear(table[None, None], *places)[0, 0] for table in prepared.moved])
    # An exponent that is off changes the light as a lamp that is off does.
    moved = np.vstack([moved.reshape(-1, len(seen.range)), incidence.stddev * seen.log_cosine])
    direct = direct + incidence.exponent * seen.log_cosine
    far = tables.log_scattered[:, :, len(tables.rows) // 2, len(tables.columns) // 2, -1]
    return Cells(
        seen.range, seen.count, seen.contrast, seen.noise, seen.mean, seen.dark, seen.bright,
        direct - reference, scattered - reference, reference, unit - reference,
        moved, np.asarray(far, np.float64))
