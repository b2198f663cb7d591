# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Estimation of attenuation and ambient light from pixels and ranges (eq. 4-7)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uw_visibility.config.schema import WaterConfig
from uw_visibility.errors import InputError
from uw_visibility.images.noise import ROUNDING_VARIANCE
from uw_visibility.images.view import ColourSamples, View
from uw_visibility.optics.transfer import linear_table
from uw_visibility.status import Status
from uw_visibility.water.contrast import (
    Decay,
    contrast_course,
    decay,
    envelope_decay,
    fuse_decays,
)
from uw_visibility.water.fit import Fit, blank, fit_plain
from uw_visibility.water.lower_envelope import fit_lower_envelope
from uw_visibility.water.observations import Envelopes, observe
from uw_visibility.water.open_water import OpenWater, find_open_water
from uw_visibility.water.position import HalfEnvelopes, compare_halves, observe_halves
from uw_visibility.water.priors import Daylight, fuse
from uw_visibility.water.transfer_check import CERTAIN, other_transfer
from uw_visibility.water.validation import (
    black_attenuation,
    brightest_patch,
    least_ambient_light,
    refuse_channel,
    refuse_frame,
    refute_clearness,
    validate_fit,
)
from uw_visibility.water.veil import (
    CONTRADICTION,
    FitVeil,
    envelope_likelihood,
    fit_free_veil,
)

# Dark envelope: its quantile, and the pixels below it at least. The paper takes
# 1 % (eq. 4). The darkest 5 pixels are a patch rather than a speck; where ranges
# are interpolated, more of them are wrong.
PLAIN_DARK = (0.01, 0.5)
DARK = (0.0002, 5.0)
COARSE_DARK = (0.002, 20.0)
BRIGHT_QUANTILE = 0.99
# What ambient light is off by where the paper's model holds, as a part of it: where water
# is thick, the fit knows of noise alone.
AMBIENT_ERROR = 0.01


@dataclass(frozen=True)
class WaterEstimate:
    """What the water does to light, as one image shows it.

    Attributes
    ----------
    status : Status
        OK when all three channels are assessable, else the first reason why not.
    attenuation : (3,) float64 ndarray
        β for R, G, B, 1/m; NaN where not assessable.
    ambient_light : (3,) float64 ndarray
        I∞ for R, G, B, in units of irradiance; NaN where not assessable. Where veil and
        light are told apart, it is the veil B.
    covariance : (3, 2, 2) float64 ndarray
        Of (attenuation, ambient light), per channel; NaN where not assessable.
    iterations : int
        Iterations of the fit, the largest over the channels.
    bins : int
        Range bins used.
    channel_status : tuple of Status
        For R, G, B.
    envelope : Envelopes or None
        The observations that were fitted.
    joint_covariance : (6, 6) float64 ndarray or None
        Of β_R, I∞_R, β_G, I∞_G, β_B, I∞_B; None where the channels are taken
        as independent.
    light : (3,) float64 ndarray or None
        Light W on the scene; None where it is the veil, as in the paper. See
        `scene_light`.
    light_stddev : (3,) float64 ndarray or None
        Its standard deviation.
    cues : dict of str to tuple of (3,) float64 ndarray
        What each cue alone says of β, and its standard deviation: ``"open water"`` or
        ``"dark envelope"``, and ``"contrast"``. Empty with the paper's model.
    open_water : float
        Part of the image that is open water.
    """

    status: Status
    attenuation: NDArray[np.float64]
    ambient_light: NDArray[np.float64]
    covariance: NDArray[np.float64]
    iterations: int
    bins: int
    channel_status: tuple[Status, Status, Status]
    envelope: Envelopes | None = None
    joint_covariance: NDArray[np.float64] | None = None
    light: NDArray[np.float64] | None = None
    light_stddev: NDArray[np.float64] | None = None
    cues: dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]] = field(
        default_factory=dict)
    open_water: float = 0.0

    @property
    def veil(self) -> NDArray[np.float64]:
        """(3,) float64: veil B, what the water adds at infinity; the same as `ambient_light`."""
        return self.ambient_light

    @property
    def scene_light(self) -> NDArray[np.float64]:
        """(3,) float64: light W on the scene, the irradiance of white with no water between."""
        return self.ambient_light if self.light is None else self.light

    @property
    def scene_light_stddev(self) -> NDArray[np.float64]:
        """(3,) float64: standard deviation of the light on the scene."""
        return self.ambient_light_stddev if self.light_stddev is None else self.light_stddev

    @property
    def attenuation_stddev(self) -> NDArray[np.float64]:
        """(3,) float64: standard deviation of the attenuation, 1/m."""
        return np.sqrt(self.covariance[:, 0, 0])

    @property
    def ambient_light_stddev(self) -> NDArray[np.float64]:
        """(3,) float64: standard deviation of the ambient light."""
        return np.sqrt(self.covariance[:, 1, 1])

    @classmethod
    def not_assessable(cls, reason: Status, envelope: Envelopes | None = None) -> WaterEstimate:
        """Return an estimate that says only why there is none."""
        return cls(
            status=reason,
            attenuation=np.full(3, np.nan),
            ambient_light=np.full(3, np.nan),
            covariance=np.full((3, 2, 2), np.nan),
            iterations=0,
            bins=0 if envelope is None else len(envelope.range),
            channel_status=(reason, reason, reason),
            envelope=envelope,
        )


class Cues(NamedTuple):
    """What tells of the water beside the envelopes of the whole image.

    Attributes
    ----------
    contrast : Decay or None
        Decay of contrast with range.
    open_water : OpenWater or None
        Open water in view.
    halves : HalfEnvelopes or None
        Dark envelopes of halves of the image.
    coarse : bool
        Whether a rough estimate will do.
    """

    contrast: Decay | None = None
    open_water: OpenWater | None = None
    halves: HalfEnvelopes | None = None
    coarse: bool = False


class WaterEstimator:
    """Estimates the water's state; one instance may serve several threads.

    Parameters
    ----------
    config : WaterConfig
    clear_water_attenuation : (3,) array_like
        κ of the camera, 1/m.
    transfer : str
        How code values follow light: ``"linear"`` or ``"srgb"``.
    daylight : Daylight, optional
        What is known of the colour of the ambient light; nothing by default.
    """

    def __init__(
        self,
        config: WaterConfig,
        clear_water_attenuation: ArrayLike,
        transfer: str = "linear",
        daylight: Daylight | None = None,
    ) -> None:
        self._config = config
        self._clear_water = np.array(clear_water_attenuation, dtype=np.float64)
        self._transfer = transfer
        self._daylight = daylight

    def estimate(
        self,
        image: NDArray[Any],
        range_map: NDArray[np.floating],
        valid: NDArray[np.bool_] | None = None,
        start: WaterEstimate | None = None,
        range_error: float = 0.0,
        coarse: bool = False,
    ) -> WaterEstimate:
        """Estimate attenuation and ambient light from plain arrays.

        Parameters
        ----------
        image : (H, W, 3) ndarray of uint8, uint16 or float32
            RGB code values; float32 is linear irradiance 0..1. A (H, W) image
            has no colour and is not assessable.
        range_map : (H, W) ndarray of float
            Range along the line of sight, m; NaN where unknown.
        valid : (H, W) bool ndarray, optional
            Pixels that may count.
        start : WaterEstimate, optional
            An earlier estimate to start from.
        range_error : float
            Standard deviation of range over its square, 1/m: that of the
            disparity over focal length times baseline. 0 stands for exact
            ranges, which hold up to the edges of things.
        coarse : bool
            Whether ranges are interpolated between points, as in a mesh.

        Returns
        -------
        WaterEstimate

        Raises
        ------
        InputError
            If shapes or types do not fit.
        """
        view = self._as_view(image, range_map, valid)
        return self.estimate_view(
            view, range_map, start=start, range_error=range_error, coarse=coarse)

    def estimate_view(
        self,
        view: View,
        range_map: NDArray[np.floating],
        *,
        start: WaterEstimate | None = None,
        range_error: float = 0.0,
        coarse: bool = False,
    ) -> WaterEstimate:
        """Estimate attenuation and ambient light from a view, whose noise is known.

        Parameters
        ----------
        view : View
            A grey one has no colour and is not assessable.
        range_map, start, range_error, coarse
            See `estimate`.

        Returns
        -------
        WaterEstimate
        """
        colour = view.colour
        if colour is None:
            return WaterEstimate.not_assessable(Status.NO_COLOUR)
        envelope = self._observe(colour, range_map, view.valid, range_error, coarse)
        if envelope.pixels == 0 and not colour.pixels.any():
            return WaterEstimate.not_assessable(Status.TOO_DARK, envelope)
        return self._estimate(
            envelope, self._fewest_pixels(colour), start,
            lambda active: self._coarse_cues(envelope, active) if coarse else self._cues(
                colour, np.asarray(range_map, np.float32), view.valid, envelope, active))

    def estimate_envelope(
        self,
        envelope: Envelopes,
        contrast: Decay | None = None,
    ) -> WaterEstimate:
        """Estimate attenuation and ambient light from envelopes alone, as those of many frames.

        Parameters
        ----------
        envelope : Envelopes
        contrast : Decay, optional
            Decay of contrast with range, where veil and light are told apart.

        Returns
        -------
        WaterEstimate
        """
        return self._estimate(
            envelope, self._config.min_bin_pixels, None, lambda active: Cues(contrast))

    def _estimate(
        self,
        envelope: Envelopes,
        fewest_pixels: int,
        start: WaterEstimate | None,
        cues: Callable[[NDArray[np.bool_]], Cues],
    ) -> WaterEstimate:
        """Validate, fit, validate the fit; `cues` gives those beside the envelopes."""
        reason = refuse_frame(envelope, fewest_pixels, self._config.min_range_ratio)
        if reason is not Status.OK:
            return WaterEstimate.not_assessable(reason, envelope)
        if envelope.grey:
            return WaterEstimate.not_assessable(Status.NO_COLOUR, envelope)
        status = [refuse_channel(envelope, channel) for channel in range(3)]
        active = np.array([reason is Status.OK for reason in status])
        if not active.any():
            return WaterEstimate.not_assessable(status[0], envelope)
        if self._config.method != "paper" and self._config.veil == "free":
            return self._estimate_free_veil(
                envelope, status, active, cues(active))
        fit = self._fit(envelope, active, start, envelope.range_error, self._clear_water)
        for channel in np.flatnonzero(active):
            status[channel] = validate_fit(fit, envelope, int(channel))
        if self._config.method != "paper" and all(reason is Status.OK for reason in status):
            ambient_min = np.array([least_ambient_light(envelope, c) for c in range(3)])
            fit = fuse(
                fit, self._clear_water, ambient_min, self._daylight,
                self._config.daylight_tolerance)
            covariance = fit.covariance.copy()
            covariance[1::2, 1::2] += np.diag((AMBIENT_ERROR * fit.parameters[:, 1]) ** 2)
            fit = replace(fit, covariance=covariance)
        # Of few channels, those that were refused do not count.
        attenuation = np.where(
            [reason is Status.OK for reason in status], fit.parameters[:, 0], np.nan)
        clearer = refute_clearness(
            attenuation, np.nan_to_num(fit.covariance[0::2, 0::2]), self._clear_water)
        return _assemble(fit, envelope, _refused(status, clearer))

    @staticmethod
    def _coarse_cues(envelope: Envelopes, active: NDArray[np.bool_]) -> Cues:
        """Return what is quick: a mesh covers open water, and has no outlines."""
        return Cues(envelope_decay(envelope, active), coarse=True)

    def _cues(
        self,
        samples: ColourSamples,
        range_map: NDArray[np.float32],
        valid: NDArray[np.bool_] | None,
        envelope: Envelopes,
        active: NDArray[np.bool_],
    ) -> Cues:
        """Decay of contrast with range, open water in view, and envelopes of halves."""
        codes, irradiance = samples.pixels, linear_table(samples.transfer, samples.pixels.dtype)
        ranges, valid = samples.reduce(range_map, valid)
        mask = np.ones((1, 1), np.bool_) if valid is None else valid
        rounding = np.sqrt(samples.noise**2 + ROUNDING_VARIANCE)
        contrast = fuse_decays(
            decay(*contrast_course(
                codes, ranges, mask, irradiance, envelope.limits, rounding), active),
            envelope_decay(envelope, active))
        return Cues(
            contrast,
            find_open_water(codes, ranges, valid, irradiance, envelope),
            observe_halves(
                codes, ranges, mask, irradiance, envelope.limits,
                rounding * np.nan_to_num(envelope.step).max(axis=1)),
        )

    def _estimate_free_veil(
        self,
        envelope: Envelopes,
        status: list[Status],
        active: NDArray[np.bool_],
        cues: Cues,
    ) -> WaterEstimate:
        """Estimate with the veil apart from the light."""
        brightest = _brightest(envelope, active)
        fit = self._veil_fit(envelope, active)

        def fuse_priors(
            found: Fit, light: NDArray[np.float64], veil: NDArray[np.float64],
            tolerance: NDArray[np.float64],
        ) -> Fit:
            return fuse(
                found, self._clear_water, np.full(3, 1e-6), self._daylight,
                self._config.daylight_tolerance, light, veil, tolerance)

        found = fit_free_veil(
            fit, fuse_priors, envelope, brightest, self._clear_water, cues.contrast,
            cues.open_water, cues.coarse)
        if found is None:
            return WaterEstimate.not_assessable(Status.FIT_FAILED, envelope)
        for channel in np.flatnonzero(active):
            status[channel] = validate_fit(found.fit, envelope, int(channel))
        if found.disagreement > CONTRADICTION:
            status = _refused(status, Status.CUES_DISAGREE)
        covariance = found.fit.covariance.copy()
        if cues.halves is not None:
            attenuation, veil = found.fit.parameters.T
            uneven = compare_halves(cues.halves, attenuation, veil, found.scene_light)
            refuted = uneven.refutes(attenuation)
            status = _refused(status, refuted)
            covariance[0::2, 0::2] += uneven.stddev_of(attenuation) ** 2 * np.outer(
                attenuation, attenuation)
        if not cues.coarse and self._other_transfer_fits(envelope, active, found.likelihood):
            status = _refused(status, Status.OTHER_TRANSFER)
        shown = np.where(active, found.fit.parameters[:, 0], np.nan)
        status = _refused(
            status, refute_clearness(shown, covariance[0::2, 0::2], self._clear_water))
        blanked = replace(found.fit, covariance=blank(covariance, active))
        estimate = _assemble(blanked, envelope, status)
        known = np.isfinite(estimate.attenuation)
        return replace(
            estimate,
            light=np.where(known, found.scene_light, np.nan),
            light_stddev=np.where(known, found.scene_light_stddev, np.nan),
            cues=found.cues,
            open_water=0.0 if cues.open_water is None else cues.open_water.fraction,
        )

    def _veil_fit(
        self, envelope: Envelopes, active: NDArray[np.bool_]
    ) -> FitVeil:
        """Return the fit of the dark envelope for a given veil."""
        patches = _brightest_patches(envelope)

        def fit(
            lower: NDArray[np.float64], upper: NDArray[np.float64], light: NDArray[np.float64]
        ) -> Fit:
            share = np.clip(envelope.dark / lower[:, np.newaxis], 0.0, 0.98)
            black = -np.log1p(-share) / envelope.dark_range
            first = np.stack((self._clear_water, lower), axis=1)
            first[active, 0] = np.nanmedian(black[active], axis=1)
            found = fit_lower_envelope(
                envelope.dark_range, envelope.dark, envelope.deviation, lower, first,
                self._clear_water, active, envelope.range_error, patches, light, upper)
            return _with_all_channels(found, active, self._clear_water, lower)

        return fit

    def _other_transfer_fits(
        self, envelope: Envelopes, active: NDArray[np.bool_], likelihood: float
    ) -> bool:
        """Tell whether the envelope is certainly likelier with the other transfer."""
        other, change = other_transfer(envelope, self._transfer)
        alternative = envelope_likelihood(
            self._veil_fit(other, active), _brightest(other, active),
            self._clear_water)
        return alternative + change > likelihood + CERTAIN

    def estimate_grey(
        self,
        image: NDArray[Any],
        range_map: NDArray[np.floating],
        valid: NDArray[np.bool_] | None = None,
        range_error: float = 0.0,
        coarse: bool = False,
    ) -> tuple[float, float] | None:
        """Estimate attenuation and ambient light of a single channel, to restore its contrast.

        Parameters
        ----------
        image : (H, W) ndarray of uint8, uint16 or float32
            Code values; float32 is linear irradiance 0..1.
        range_map : (H, W) ndarray of float
            Range along the line of sight, m; NaN where unknown.
        valid : (H, W) bool ndarray, optional
            Pixels that may count.
        range_error, coarse
            See `estimate`.

        Returns
        -------
        tuple of float, or None
            Attenuation, 1/m, and ambient light in units of irradiance; None
            where they are not assessable. A grey camera's response is taken
            to reach the least attenuated channel.

        Raises
        ------
        InputError
            If shapes or types do not fit.
        """
        view = self._as_view(image, range_map, valid)
        return self.estimate_grey_view(view, range_map, range_error=range_error, coarse=coarse)

    def estimate_grey_view(
        self,
        view: View,
        range_map: NDArray[np.floating],
        *,
        range_error: float = 0.0,
        coarse: bool = False,
    ) -> tuple[float, float] | None:
        """Estimate attenuation and ambient light of a grey view; see `estimate_grey`."""
        samples = ColourSamples(
            np.dstack((view.pixels,) * 3), view.transfer, np.repeat(view.noise, 3))
        envelope = self._observe(samples, range_map, view.valid, range_error, coarse)
        reason = refuse_frame(
            envelope, self._fewest_pixels(samples), self._config.min_range_ratio)
        if reason is not Status.OK:
            return None
        if refuse_channel(envelope, 0) is not Status.OK:
            return None
        alone = np.array([True, False, False])
        fit = self._fit(envelope, alone, None, range_error, np.full(3, self._clear_water.min()))
        if validate_fit(fit, envelope, 0) is not Status.OK:
            return None
        attenuation, ambient_light = fit.parameters[0]
        return float(attenuation), float(ambient_light)

    def _as_view(
        self,
        image: NDArray[Any],
        range_map: NDArray[np.floating],
        valid: NDArray[np.bool_] | None,
    ) -> View:
        _check(image, range_map, valid)
        image = image[..., 0] if image.shape[2:] == (1,) else image
        codes, transfer = _codes(image, self._transfer)
        return View.of(codes, transfer, valid)

    def _observe(
        self,
        samples: ColourSamples,
        range_map: NDArray[np.floating],
        valid: NDArray[np.bool_] | None,
        range_error: float,
        coarse: bool,
    ) -> Envelopes:
        config = self._config
        plain = config.method == "paper"
        dark_quantile, fewest_dark = PLAIN_DARK if plain else COARSE_DARK if coarse else DARK
        ranges, valid = samples.reduce(np.asarray(range_map, dtype=np.float32), valid)
        return observe(
            samples,
            np.ascontiguousarray(ranges),
            None if valid is None else np.ascontiguousarray(valid),
            bins=config.bins,
            min_pixels=int(samples.count(config.min_bin_pixels)),
            edge_tolerance=config.edge_tolerance,
            dark_quantile=dark_quantile,
            fewest_dark=samples.count(fewest_dark),
            bright_quantile=BRIGHT_QUANTILE,
            range_error=range_error,
            plain=plain,
        )

    def _fewest_pixels(self, samples: ColourSamples) -> int:
        return int(samples.count(self._config.min_bin_pixels))

    def _fit(
        self,
        envelope: Envelopes,
        active: NDArray[np.bool_],
        start: WaterEstimate | None,
        range_error: float,
        clear_water: NDArray[np.float64],
    ) -> Fit:
        """Fit the dark envelope, with one ambient light for veil and scene."""
        ambient_min = np.array(
            [least_ambient_light(envelope, c) if active[c] else 1.0 for c in range(3)])
        plain = self._config.method == "paper"
        first = np.stack((clear_water, ambient_min), axis=1)
        for c in np.flatnonzero(active):
            if plain:
                first[c, 1] = np.nanmax(envelope.bright[c])
            else:
                # From above: what is brighter than the curve of the water holds it less.
                first[c, 0] = np.median(black_attenuation(envelope, int(c), ambient_min[c]))
        if start is not None:
            known = np.isfinite(start.attenuation)
            first[known, 0] = start.attenuation[known]
            first[known, 1] = start.ambient_light[known]
        if plain:
            return fit_plain(envelope.range, envelope.dark, ambient_min, first, active)
        return fit_lower_envelope(
            envelope.dark_range, envelope.dark, envelope.deviation, ambient_min, first,
            clear_water, active, range_error,
            _brightest_patches(envelope),
        )


def _check(
    image: NDArray[Any], range_map: NDArray[np.floating], valid: NDArray[np.bool_] | None
) -> None:
    if image.dtype not in (np.uint8, np.uint16, np.float32):
        raise InputError(f"the image is of type {image.dtype}: give uint8, uint16 or float32")
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (1, 3)):
        raise InputError(f"the image has the shape {image.shape}: give (H, W, 3) or (H, W)")
    if range_map.shape != image.shape[:2]:
        raise InputError(
            f"the range map has the shape {range_map.shape}, the image {image.shape[:2]}: "
            "give one range per pixel"
        )
    if valid is not None and (valid.shape != range_map.shape or valid.dtype != np.bool_):
        raise InputError("the mask of valid pixels must be boolean, of the image's size")


def _codes(image: NDArray[Any], transfer: str) -> tuple[NDArray[Any], str]:
    """Return contiguous code values and their transfer; irradiance becomes 16-bit codes."""
    if image.dtype != np.float32:
        return np.ascontiguousarray(image), transfer
    light = np.nan_to_num(np.clip(image, 0.0, 1.0), nan=0.0)
    return (light * 65535 + 0.5).astype(np.uint16), "linear"


def _refused(status: list[Status], reason: Status) -> list[Status]:
    """Refuse every channel that is not refused yet; none where the reason is OK."""
    return [reason if before is Status.OK else before for before in status]


def _brightest(envelope: Envelopes, active: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(3,): the bright envelope at its brightest; 1 for a channel that is left out."""
    return np.array([least_ambient_light(envelope, c) if active[c] else 1.0 for c in range(3)])


def _brightest_patches(envelope: Envelopes) -> NDArray[np.float64]:
    """(3, 2): irradiance and range of the brightest patch near by, of each channel."""
    return np.array([brightest_patch(envelope, c) for c in range(3)])


def _with_all_channels(
    fit: Fit, active: NDArray[np.bool_], clear_water: NDArray[np.float64],
    veil: NDArray[np.float64],
) -> Fit:
    """Put a guess with a large deviation in the place of channels that were left out."""
    if active.all():
        return fit
    particles = max(float(np.mean(fit.parameters[active, 0] - clear_water[active])), 0.0)
    absent = ~active
    values = fit.parameters.copy()
    values[absent, 0] = clear_water[absent] + particles
    values[absent, 1] = veil[absent]
    covariance = np.nan_to_num(fit.covariance)
    for c in np.flatnonzero(absent):
        covariance[2 * c, 2 * c] = (1.0 + particles) ** 2
        covariance[2 * c + 1, 2 * c + 1] = veil[c] ** 2
    return replace(fit, parameters=values, covariance=covariance)


def _assemble(fit: Fit, envelope: Envelopes, status: list[Status]) -> WaterEstimate:
    refused = np.array([reason is not Status.OK for reason in status])
    parameters = np.where(refused[:, np.newaxis], np.nan, fit.parameters)
    joint = fit.covariance.copy()
    joint[np.repeat(refused, 2), :] = np.nan
    joint[:, np.repeat(refused, 2)] = np.nan
    return WaterEstimate(
        status=next((reason for reason in status if reason is not Status.OK), Status.OK),
        attenuation=parameters[:, 0],
        ambient_light=parameters[:, 1],
        covariance=np.stack([joint[2 * c:2 * c + 2, 2 * c:2 * c + 2] for c in range(3)]),
        iterations=fit.iterations,
        bins=len(envelope.range),
        channel_status=(status[0], status[1], status[2]),
        envelope=envelope,
        joint_covariance=joint,
    )
