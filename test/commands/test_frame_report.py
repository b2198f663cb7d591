# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The report of one frame."""

from __future__ import annotations

import json
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from uw_visibility.commands.enhance import frame_report
from uw_visibility.status import Status
from uw_visibility.water.meaning.derived import DerivedQuantities

NAN = float("nan")
DERIVED = DerivedQuantities(black_disc_visibility=10.0, black_disc_visibility_stddev=1.0)


def water(**changes: Any) -> SimpleNamespace:
    fields: dict[str, Any] = {
        "attenuation": np.array([0.6, 0.2, 0.1]),
        "attenuation_stddev": np.array([0.03, 0.02, 0.01]),
        "ambient_light": np.array([0.1, 0.4, 0.5]),
        "ambient_light_stddev": np.array([0.003, 0.002, 0.001]),
        "iterations": 7,
        "bins": np.int64(40),
    }
    return SimpleNamespace(**{**fields, **changes})


def visibility(**changes: Any) -> SimpleNamespace:
    fields: dict[str, Any] = {
        "status": Status.OK, "depth_status": Status.OK,
        "mean_attenuation": 0.2, "mean_attenuation_stddev": 0.01,
        "distance": 23.5, "distance_stddev": 1.5, "distance_low": 22.0,
        "distance_high": 25.0, "depth": 3.0, "depth_stddev": 0.5,
        "channels": "RGB",
    }
    return SimpleNamespace(**{**fields, **changes})


def frame(**changes: Any) -> Any:
    original = changes.pop("original", 0.25)
    fields: dict[str, Any] = {
        "status": Status.OK, "coarse_water": water(), "water": water(),
        "visibility": visibility(),
        "clear_water_attenuation": np.array([0.228, 0.066, 0.025]),
        "stereo": SimpleNamespace(
            support_points=np.int64(500), coverage=np.float32(0.5), matched_fraction=0.75,
            matched_fraction_original=original,
        ),
        "images": SimpleNamespace(
            scene_light=np.array([0.25, 0.5, np.float32(0.75)]), balanced=0.5
        ),
        "timing_ms": {"matching": 1.23456, "total": 2.0},
    }
    return SimpleNamespace(**{**fields, **changes})


def test_the_report_holds_every_estimate_in_its_place() -> None:
    assert frame_report(frame(), DERIVED) == {
        "status": "ok",
        "step1": {
            "attenuation": [0.6, 0.2, 0.1], "ambient_light": [0.1, 0.4, 0.5],
            "support_points": 500, "coverage": 0.5,
        },
        "step2": {
            "attenuation": [0.6, 0.2, 0.1], "attenuation_stddev": [0.03, 0.02, 0.01],
            "ambient_light": [0.1, 0.4, 0.5], "ambient_light_stddev": [0.003, 0.002, 0.001],
            "iterations": 7, "bins": 40,
        },
        "clear_water_attenuation": [0.228, 0.066, 0.025],
        "mean_attenuation": 0.2, "mean_attenuation_stddev": 0.01,
        "channels": "RGB",
        "visibility_distance": 23.5, "visibility_distance_stddev": 1.5,
        "visibility_distance_low": 22.0, "visibility_distance_high": 25.0,
        "black_disc_visibility_low": pytest.approx(10.0 / math.exp(0.1)),
        "black_disc_visibility": 10.0,
        "black_disc_visibility_high": pytest.approx(10.0 * math.exp(0.1)),
        **{f"{name}{end}": None for name in ("secchi_depth", "diffuse_attenuation_490")
           for end in ("_low", "", "_high")},
        "depth": 3.0, "depth_stddev": 0.5,
        "white": {"scene_light": [0.25, 0.5, 0.75], "from_camera": 0.5},
        "matched_fraction": {"original": 0.25, "enhanced": 0.75},
        "timing_ms": {"matching": 1.235, "total": 2.0},
    }


def test_what_is_not_assessable_is_null() -> None:
    nothing = water(
        attenuation=np.full(3, NAN), attenuation_stddev=np.full(3, NAN),
        ambient_light=np.array([0.1, NAN, 0.5]), ambient_light_stddev=np.full(3, np.inf),
    )
    report = frame_report(
        frame(
            status=Status.NO_COLOUR,
            water=nothing,
            visibility=visibility(status=Status.NO_COLOUR, mean_attenuation=NAN, distance=np.inf),
            original=None,
            images=SimpleNamespace(scene_light=None, balanced=0.0),
        ), DerivedQuantities(),
    )
    assert report["status"] == "no colour"
    assert report["step2"]["attenuation"] is None
    assert report["step2"]["ambient_light"] == [0.1, None, 0.5]
    assert report["step2"]["ambient_light_stddev"] is None
    assert report["mean_attenuation"] is None
    assert report["visibility_distance"] is None
    assert report["matched_fraction"]["original"] is None
    assert report["white"] is None
    json.dumps(report, allow_nan=False)


@pytest.mark.parametrize(
    ("changes", "status"),
    [
        ({}, Status.OK),
        ({"visibility": visibility(depth_status=Status.FIT_FAILED)}, Status.FIT_FAILED),
        ({"visibility": visibility(status=Status.TOO_DARK)}, Status.TOO_DARK),
        (
            {"status": Status.SATURATED, "visibility": visibility(status=Status.TOO_DARK)},
            Status.SATURATED,
        ),
    ],
)
def test_the_status_is_the_first_reason(changes: dict[str, Any], status: Status) -> None:
    assert frame_report(frame(**changes), DERIVED)["status"] == str(status)
