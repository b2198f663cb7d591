# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Views under water and their truth."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from uw_visibility.errors import InputError
from uw_visibility.optics.transfer import to_linear
from uw_visibility_lab.simulation.formation import fit_attenuation
from uw_visibility_lab.worlds import draw as module
from uw_visibility_lab.worlds.draw import EFFECTS, View, draw
from uw_visibility_lab.worlds.scenes import Scene

SHAPE = (120, 160)
EXACT = ("16 bit",)


def scene(level: float | None = None, *, horizon: bool = True) -> Scene:
    """Floor that recedes, under open water; of one reflectance, or of patches and lines."""
    rng = np.random.default_rng(5)
    if level is None:
        reflectance = rng.uniform(0.0, 0.8, (*SHAPE, 3)).astype(np.float32)
        reflectance[::7] = 0.02
    else:
        reflectance = np.full((*SHAPE, 3), level, np.float32)
    ranges = np.broadcast_to(
        (3.0 / np.linspace(0.5, 3.0, SHAPE[0]))[:, np.newaxis], SHAPE).astype(np.float32)
    if horizon:
        ranges = ranges.copy()
        ranges[:30] = np.inf
    return Scene("floor", "test", reflectance, ranges, pitch=0.4, focal_length=1.0)


@pytest.fixture
def as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave scenes uncropped, with their own reflectance."""
    def vary(rng: np.random.Generator, scene: Scene) -> tuple:
        shape = scene.range.shape
        down = module.downward(shape, scene.focal_length * shape[1], scene.pitch, 0.0)
        return scene.reflectance.copy(), scene.range.copy(), down
    monkeypatch.setattr(module, "vary", vary)


def view(seed: int, effects: tuple[str, ...] = (), of: Scene | None = None) -> View:
    return draw(np.random.default_rng(seed), of or scene(), effects=(*EXACT, *effects))


def linear(seen: View) -> np.ndarray:
    return to_linear(seen.image, seen.transfer).astype(np.float64)


def modelled(seen: View, reflectance: np.ndarray) -> np.ndarray:
    """Return W ρ e^(−βd) + B (1 − e^(−βd)) of a view's truth."""
    with np.errstate(over="ignore"):
        d = np.where(seen.open_water, np.inf, np.nan_to_num(seen.ranges, nan=np.inf))
    t = np.exp(-seen.attenuation * d[..., np.newaxis])
    return seen.light * reflectance * t + seen.veil * (1.0 - t)


@pytest.mark.usefixtures("as_it_is")
@pytest.mark.parametrize("seed", range(8))
def test_a_plain_view_is_the_light_model(seed: int) -> None:
    original = scene()
    seen = view(seed, of=original)
    assert seen.range_error == 0.0 and seen.curve == seen.transfer == "linear"
    expected = modelled(seen, original.reflectance)
    unclipped = expected < 0.999
    assert np.abs(linear(seen) - expected)[unclipped].max() < 2e-5
    np.testing.assert_array_equal(seen.open_water, np.isinf(original.range))


@pytest.mark.usefixtures("as_it_is")
@pytest.mark.parametrize("names", [("srgb",), ("white balance",), ("grey world",)])
def test_truth_is_in_units_of_the_image(names: tuple[str, ...]) -> None:
    original = scene()
    for seed in range(4):
        seen = view(seed, names, original)
        expected = modelled(seen, original.reflectance)
        unclipped = (expected < 0.99) & (expected > 0.01)
        np.testing.assert_allclose(linear(seen)[unclipped], expected[unclipped], rtol=2e-3)


@pytest.mark.usefixtures("as_it_is")
def test_truth_of_a_foreign_curve_is_what_the_told_one_makes_of_it() -> None:
    seen = [view(seed, ("foreign curve",), scene(0.0)) for seed in range(12)]
    assert len({one.curve.split()[0] for one in seen}) >= 3
    for one in seen:
        open_water = linear(one)[one.open_water]
        inside = one.veil < 0.999
        assert open_water.mean(axis=0)[inside] == pytest.approx(one.veil[inside], rel=5e-3)


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_changes_the_view(name: str) -> None:
    of = scene(horizon=name != "open water")
    changed = 0
    for seed in range(6):
        without, with_it = view(seed, of=of), view(seed, (name,), of)
        assert name in with_it.effects and (name in EXACT or name not in without.effects)
        changed += any(
            not np.array_equal(
                getattr(without, field.name), getattr(with_it, field.name), equal_nan=True)
            for field in fields(View) if field.name in ("image", "ranges"))
    assert changed >= 2 or name in EXACT


def ratio(seed: int, name: str, level: float | None = None) -> np.ndarray:
    """Image with an effect over that without, of mean 1, (H, W, 3)."""
    with_it, without = (linear(view(seed, names, scene(level))) for names in ((name,), ()))
    quotient = with_it / np.maximum(without, 1e-4)
    return quotient / quotient.mean()


def test_effects_change_what_they_name() -> None:
    for seed in range(5):
        corner = ratio(seed, "vignetting", 0.5)
        assert corner[0, 0].mean() < corner[60, 80].mean()
        grey = linear(view(seed, ("grey",)))
        assert np.ptp(grey, axis=-1).max() < 1e-6
        assert (view(seed, ("red gone",)).image[..., 0] == 0).all()
        bright, plain = (view(seed, names).image for names in (("over-exposure",), ()))
        assert (bright == 65535).mean() > (plain == 65535).mean()
        assert view(seed, ("low light",)).image.max() < 0.7 * 65535
        snow, plain = (linear(view(seed, names)) for names in (("snow",), ()))
        assert snow.max() / np.median(snow) > plain.max() / np.median(plain)
        assert set(np.unique(view(seed, ("16 bit",)).image % 257)) != {0}
        fish = view(seed, ("fish",))
        assert (fish.ranges < view(seed).ranges - 1e-4).any()
        assert view(seed, ("open water",), scene(horizon=False)).open_water.any()
    shares = []
    for seed in range(6):
        plain, board = view(seed).ranges, view(seed, ("board",)).ranges
        on_board = board < plain - 1e-4
        shares.append(on_board.mean())
        # All of it is about as far, and before what it hides.
        low, high = np.quantile(board[on_board], (0.05, 0.95))
        assert high < 1.4 * low and high < 0.9 * np.median(plain[np.isfinite(plain)])
    assert min(shares) > 0.01 and max(shares) < 0.5


def contrast(image: np.ndarray) -> float:
    return float(np.abs(np.diff(image[30:, :, 1], axis=1)).mean() / image[30:, :, 1].mean())


def test_blur_takes_contrast_and_caustics_add_some() -> None:
    for seed in range(5):
        plain = contrast(linear(view(seed)))
        assert contrast(linear(view(seed, ("defocus",)))) < 0.98 * plain
        assert contrast(linear(view(seed, ("forward scatter",)))) <= plain
        even = contrast(linear(view(seed, of=scene(0.5))))
        assert contrast(linear(view(seed, ("caustics",), scene(0.5)))) > 2.0 * even


def test_a_halo_takes_contrast_and_keeps_light() -> None:
    for seed in range(6):
        plain, hazy = view(seed), view(seed, ("halo",))
        near = plain.ranges < np.nanmedian(plain.ranges)
        level = linear(hazy)[near].mean() / linear(plain)[near].mean()
        assert level == pytest.approx(1.0, abs=0.15)
        spread = [linear(seen)[near].std() / linear(seen)[near].mean() for seen in (plain, hazy)]
        assert spread[1] < spread[0]
        assert hazy.attenuation == pytest.approx(plain.attenuation, rel=0.25)


def test_the_same_state_shows_the_same_water_nearer() -> None:
    far, near = (
        draw(np.random.default_rng(3), scene(), effects=EXACT, nearer=factor)
        for factor in (1.0, 0.5))
    np.testing.assert_allclose(near.ranges, 0.5 * far.ranges, rtol=1e-5)
    np.testing.assert_array_equal(near.attenuation, far.attenuation)


def test_thicker_water_has_a_larger_effective_attenuation() -> None:
    for seed in range(6):
        plain = view(seed).attenuation
        assert (view(seed, ("plume",)).attenuation > plain).all()
        layer = view(seed, ("layer",)).attenuation
        assert (layer >= plain * (1 - 1e-6)).all()
        # Band averages: light of colours that water takes little is what is left.
        assert view(seed, ("spectrum",)).attenuation[0] > 0.0


def test_effective_attenuation_of_one_rate_is_that_rate() -> None:
    d = np.linspace(0.5, 9.0, 300)
    beta = np.array([0.05, 0.4, 2.0])
    assert fit_attenuation(d, np.exp(-beta * d[:, np.newaxis])) == pytest.approx(
        beta, rel=1e-6)
    mixed = 0.5 * (np.exp(-0.1 * d) + np.exp(-0.5 * d))
    trials = np.linspace(0.1, 0.5, 4001)
    loss = ((mixed - np.exp(-trials[:, np.newaxis] * d)) ** 2).sum(axis=1)
    assert fit_attenuation(d, mixed[:, np.newaxis])[0] == pytest.approx(
        trials[loss.argmin()], abs=2e-4)


def test_the_same_seed_is_the_same_view() -> None:
    first, again, other = (
        draw(np.random.default_rng(seed), scene()) for seed in (3, 3, 4))
    for field in fields(View):
        one, two = getattr(first, field.name), getattr(again, field.name)
        assert np.array_equal(one, two, equal_nan=True) if isinstance(
            one, np.ndarray) else one == two
    assert first.attenuation[0] != other.attenuation[0]


def test_an_effect_left_out_leaves_the_others() -> None:
    seen = 0
    for seed in range(60):
        full = draw(np.random.default_rng(seed), scene())
        others = tuple(n for n in full.effects if n not in ("vignetting", "snow"))
        bare = draw(np.random.default_rng(seed), scene(), effects=others)
        assert bare.effects == others
        assert full.depth == bare.depth
        seen += full.effects != bare.effects
    assert seen > 5


def test_random_views_are_plain_in_a_third_and_finite() -> None:
    harmless = {name.partition(".")[2] for name in module.believed.beliefs()
                if name.startswith("always.")}
    plain, known = 0, []
    for seed in range(150):
        seen = draw(np.random.default_rng([9, seed]), scene())
        plain += set(seen.effects) <= harmless
        assert seen.image.shape == (*SHAPE, 3)
        assert seen.image.dtype == (np.uint16 if "16 bit" in seen.effects else np.uint8)
        assert seen.ranges.dtype == np.float32 and seen.open_water.dtype == bool
        assert (seen.ranges[np.isfinite(seen.ranges)] > 0.0).all()
        for value in (seen.attenuation, seen.clear_water):
            assert value.shape == (3,) and (value > 0.0).all() and np.isfinite(value).all()
        for value in (seen.veil, seen.light):
            assert value.shape == (3,) and (value >= 0.0).all() and np.isfinite(value).all()
        assert seen.range_error >= 0.0 and np.isfinite(seen.range_error)
        known.append(np.isfinite(seen.ranges).mean())
    assert 0.25 < plain / 150 < 0.48
    assert np.median(known) > 0.4


def test_bad_calls_are_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="no effect 'fog'"):
        draw(rng, scene(), effects=("fog",))
    empty = replace(scene(), range=np.full(SHAPE, np.inf, np.float32))
    with pytest.raises(InputError, match="no surface"):
        draw(rng, empty)
