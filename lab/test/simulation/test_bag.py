# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A simulated bag, read back field by field, and the command that writes it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from uw_visibility.cli import main
from uw_visibility.messages.images import read_image, stamp_to_nanoseconds
from uw_visibility.optics.visual_range import BEAM_OVER_SEEN
from uw_visibility.stereo.rig import StereoRig
from uw_visibility_lab.simulation.camera import CameraEffects, StereoCamera
from uw_visibility_lab.simulation.transect import Transect

pytest.importorskip("rosbags")

from uw_visibility.replay.bags.reader import BagReader
from uw_visibility_lab.simulation.bag import START, TOPICS, write_transect

TRANSECT = Transect(
    frames=3, rate=4.0, depth=(3.0, 5.0), attenuation=(0.1, 0.2), seed=2,
    camera=StereoCamera(96, 64, 90.0, 0.2),
)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    path = tmp_path_factory.mktemp("bag") / "transect"
    write_transect(path, TRANSECT, depth_stddev=0.1)
    by_topic: dict[str, list[Any]] = {}
    times: dict[str, list[int]] = {}
    with BagReader(path) as reader:
        assert reader.topics == TOPICS
        for recorded in reader.messages():
            by_topic.setdefault(recorded.topic, []).append(reader.deserialize(recorded))
            times.setdefault(recorded.topic, []).append(recorded.time)
    frames = [f for _, f in TRANSECT.render()]
    return SimpleNamespace(path=path, messages=by_topic, times=times, frames=frames)


def test_every_topic_has_every_frame_at_its_time(bag: SimpleNamespace) -> None:
    expected = [START + k * 250_000_000 for k in range(3)]
    assert set(bag.messages) == set(TOPICS)
    for topic, times in bag.times.items():
        assert times == expected
        for message, time in zip(bag.messages[topic], times, strict=True):
            if hasattr(message, "header"):
                assert stamp_to_nanoseconds(message.header.stamp) == time


def test_images_and_calibration(bag: SimpleNamespace) -> None:
    for side in ("left", "right"):
        for message, info, frame in zip(
            bag.messages[f"/{side}/image_rect"], bag.messages[f"/{side}/camera_info"],
            bag.frames, strict=True,
        ):
            assert message.encoding == "rgb8"
            np.testing.assert_array_equal(read_image(message), getattr(frame, side))
            assert message.header.frame_id == f"stereo_{side}_optical_frame"
            assert info.header.frame_id == message.header.frame_id
            assert (info.width, info.height, info.distortion_model) == (96, 64, "plumb_bob")
            np.testing.assert_array_equal(info.k, [90, 0, 47.5, 0, 90, 31.5, 0, 0, 1])
            np.testing.assert_array_equal(info.r, np.eye(3).ravel())
            np.testing.assert_array_equal(info.d, np.zeros(5))
    left, right = (bag.messages[f"/{side}/camera_info"][0] for side in ("left", "right"))
    assert right.p[3] == pytest.approx(-90.0 * 0.2)
    rig = StereoRig.from_camera_info(left, right)
    assert (rig.focal_length, rig.baseline) == pytest.approx((90.0, 0.2))
    assert rig.principal_point == (47.5, 31.5)


def test_depth_points_up_and_its_noise_is_as_stated(bag: SimpleNamespace) -> None:
    for topic, variance in (("/ground_truth/depth", 0.0), ("/depth_sensor", 0.01)):
        for message, frame in zip(bag.messages[topic], bag.frames, strict=True):
            error = -message.pose.pose.position.z - frame.depth
            assert abs(error) <= 4.0 * variance**0.5
            assert (error == 0.0) == (variance == 0.0)
            covariance = message.pose.covariance.reshape(6, 6)
            assert covariance[2, 2] == pytest.approx(variance)
            assert (np.diag(covariance)[[0, 1, 3, 4, 5]] >= 1e6).all()
            assert message.pose.pose.orientation.w == 1.0


def test_the_transmissometer_reads_the_beam_attenuation(bag: SimpleNamespace) -> None:
    """A camera sees light scattered by small angles, which a transmissometer does not."""
    for message, frame in zip(bag.messages["/transmissometer"], bag.frames, strict=True):
        assert message.data == pytest.approx(BEAM_OVER_SEEN * frame.attenuation[1], rel=0.1)


def test_truth_of_the_water(bag: SimpleNamespace) -> None:
    for name in ("attenuation", "ambient_light", "scene_light"):
        for message, frame in zip(bag.messages[f"/ground_truth/{name}"], bag.frames, strict=True):
            vector = (message.vector.x, message.vector.y, message.vector.z)
            np.testing.assert_array_equal(vector, getattr(frame, name))
    alpha = [m.data for m in bag.messages["/ground_truth/mean_attenuation"]]
    assert alpha == [f.mean_attenuation for f in bag.frames]
    # Eq. 12 at a contrast of 0.05.
    distance = [m.data for m in bag.messages["/ground_truth/visibility"]]
    assert distance == pytest.approx([np.log(10.5) / f.attenuation.min() for f in bag.frames])


def test_true_disparity_follows_the_message_definition(bag: SimpleNamespace) -> None:
    for message, frame in zip(bag.messages["/ground_truth/disparity"], bag.frames, strict=True):
        image = message.image
        assert (image.encoding, image.height, image.width) == ("32FC1", 64, 96)
        disparity = np.frombuffer(image.data, np.float32).reshape(64, 96)
        assert np.isfinite(disparity).all()
        known = disparity >= np.float32(message.min_disparity)
        np.testing.assert_array_equal(known, np.isfinite(frame.disparity_left))
        np.testing.assert_array_equal(disparity[known], frame.disparity_left[known])
        assert disparity.max() <= message.max_disparity
        assert (message.f, message.t) == pytest.approx((90.0, 0.2))


def test_the_command_writes_the_same_bag(bag: SimpleNamespace, tmp_path: Path) -> None:
    path = tmp_path / "bag"
    arguments = [
        "simulate", "-o", str(path), "--frames", "3", "--rate", "4", "--width", "96",
        "--height", "64", "--baseline", "0.2", "--depth", "3", "5",
        "--attenuation", "0.1", "0.2", "--seed", "2", "--depth-stddev", "0.1",
    ]
    assert main(arguments) == 0
    with BagReader(path) as one, BagReader(bag.path) as other:
        assert [m.data for m in one.messages()] == [m.data for m in other.messages()]


def test_options_left_out_are_the_defaults_of_the_library(tmp_path: Path) -> None:
    # At full size: last bits of another order of operations change few of the codes.
    assert main(["simulate", "-o", str(tmp_path / "one"), "--frames", "1"]) == 0
    write_transect(tmp_path / "other", Transect(frames=1))
    images = ["/left/image_rect", "/right/image_rect"]
    with BagReader(tmp_path / "one") as one, BagReader(tmp_path / "other") as other:
        assert [m.data for m in one.messages(images)] == [m.data for m in other.messages(images)]


SMALL = ["--frames", "1", "--width", "96", "--height", "72"]


@pytest.mark.parametrize("start, seconds", [
    ("2024-05-01T12:00:00Z", 1714564800), ("2024-05-01T14:00:00+02:00", 1714564800),
    ("2024-05-01", 1714521600)])
def test_the_first_frame_has_the_time_that_is_given(
    tmp_path: Path, start: str, seconds: int
) -> None:
    assert main(["simulate", "-o", str(tmp_path / "bag"), *SMALL, "--start", start]) == 0
    with BagReader(tmp_path / "bag") as reader:
        assert reader.span == (seconds * 10**9, seconds * 10**9)


def test_a_bag_is_replaced_only_when_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bag"
    assert main(["simulate", "-o", str(path), *SMALL]) == 0
    before = {p: p.read_bytes() for p in path.iterdir()}
    assert main(["simulate", "-o", str(path), *SMALL, "--seed", "7"]) == 2
    error = capsys.readouterr().err
    assert str(path) in error
    assert "--force" in error
    assert error.count("\n") == 1
    assert {p: p.read_bytes() for p in path.iterdir()} == before
    assert main(["simulate", "-o", str(path), *SMALL, "--seed", "7", "--force"]) == 0
    assert {p: p.read_bytes() for p in path.iterdir()} != before


def test_force_removes_nothing_but_bags(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    precious = tmp_path / "thesis.tex"
    precious.write_text("years of work", encoding="utf-8")
    assert main(["simulate", "-o", str(tmp_path), *SMALL, "--force"]) == 2
    assert "not a bag" in capsys.readouterr().err
    assert precious.exists()


def first_frame(path: Path) -> SimpleNamespace:
    """Return what a bag says of its first frame."""
    found: dict[str, Any] = {}
    with BagReader(path) as reader:
        for recorded in reader.messages():
            found.setdefault(recorded.topic, reader.deserialize(recorded))
    vectors = {
        name: np.array([v.x, v.y, v.z])
        for name in ("attenuation", "ambient_light", "scene_light")
        for v in [found[f"/ground_truth/{name}"].vector]
    }
    images = {side: read_image(found[f"/{side}/image_rect"]) for side in ("left", "right")}
    return SimpleNamespace(
        **vectors, **images, baseline=-found["/right/camera_info"].p[3] / 90.0,
        alpha=found["/ground_truth/mean_attenuation"].data,
    )


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    path = tmp_path_factory.mktemp("plain") / "bag"
    assert main(["simulate", "-o", str(path), *SMALL]) == 0
    return first_frame(path)


WATER_OPTIONS = {
    "--veil 0.4": lambda one, other: np.allclose(one.ambient_light, 0.4 * one.scene_light),
    "--veil 0.4 0.5 2": lambda one, other: np.allclose(
        one.ambient_light, one.scene_light * [0.4, 0.5, 2.0]),
    "--water-type 5C --attenuation 0 0": lambda one, other: one.alpha > 5.0 * other.alpha,
    "--layer 0.5 3": lambda one, other: (one.attenuation > other.attenuation + 0.4).all(),
    "--plume 0.5 0.3": lambda one, other: (
        (one.attenuation > other.attenuation).all()
        and (one.left[:, :66] == other.left[:, :66]).all()),
}
"""Options that change the truth of the water, and how."""

IMAGE_OPTIONS = (
    "--blur 1", "--veil-gradient 0.5", "--transfer srgb", "--vignetting 0.5", "--bayer",
    "--jpeg 60", "--noise-codes 4", "--marine-snow 0.1", "--marine-snow 0.1 --snow-brightness 3",
)
"""Options that change both images, and no truth."""


@pytest.mark.parametrize("options", [*WATER_OPTIONS, *IMAGE_OPTIONS])
def test_each_option_shows(options: str, plain: SimpleNamespace, tmp_path: Path) -> None:
    assert main(["simulate", "-o", str(tmp_path / "bag"), *SMALL, *options.split()]) == 0
    frame = first_frame(tmp_path / "bag")
    for side in ("left", "right"):
        assert (getattr(frame, side) != getattr(plain, side)).any()
    if options in WATER_OPTIONS:
        assert WATER_OPTIONS[options](frame, plain)
    else:
        for name in ("attenuation", "ambient_light", "scene_light"):
            np.testing.assert_array_equal(getattr(frame, name), getattr(plain, name))


def test_options_of_one_camera_and_of_the_calibration(
    plain: SimpleNamespace, tmp_path: Path
) -> None:
    for index, (option, value) in enumerate((
        ("--range-scale", "1.25"), ("--white-balance", "1.2 1 0.8"))):
        path = tmp_path / str(index)
        assert main(["simulate", "-o", str(path), *SMALL, option, *value.split()]) == 0
    scaled, balanced = (first_frame(tmp_path / str(index)) for index in range(2))
    np.testing.assert_array_equal(scaled.left, plain.left)
    assert scaled.baseline == pytest.approx(1.25 * plain.baseline)
    np.testing.assert_allclose(balanced.ambient_light, plain.ambient_light * [1.2, 1.0, 0.8])


def test_automatic_white_balance_differs_from_frame_to_frame() -> None:
    effects = CameraEffects(automatic_white_balance=True)
    gains = [
        frame.ambient_light / fixed.ambient_light
        for (_, frame), (_, fixed) in zip(
            replace(TRANSECT, camera_effects=effects).render(), TRANSECT.render(), strict=True)
    ]
    assert gains[0][0] > 1.05
    assert not np.allclose(gains[0], gains[2], rtol=0.02)


@pytest.mark.parametrize(("options", "what"), [
    ("--frames 0", "frames"),
    ("--rate -1", "rate"),
    ("--start yesterday", "yesterday is not a time"),
    ("--start 2050-01-01", "from 1970 to 2037"),
    ("--start 2038-01-19T03:14:07Z --frames 3", "give an earlier start"),
    ("--width 95", "--width is 95 px: give at least 96 and at most 8192 px"),
    ("--height 63", "--height is 63 px: give at least 64"),
    ("--baseline 0", "baseline"),
    ("--attenuation -1 0", "attenuation"),
    ("--depth-stddev 0", "depth sensor"),
    ("--depth-stddev 1e200", "depth sensor"),
    ("--marine-snow 2", "marine snow"),
    ("--snow-brightness -1", "marine snow"),
    ("--veil 0.5 0.6", "--veil"),
    ("--water-type 7C", "water type"),
    ("--jpeg 200", "JPEG"),
    ("--noise-codes -1", "noise"),
    ("--range-scale 0", "range scale"),
    ("--lamps 3", "number of lamps"),
    ("--night", "--night"),
    ("--lamps 2 --lamp-positions 0 0 1", "--lamp-positions"),
    ("--lamp-positions 0 1", "--lamp-positions"),
    ("--lamps 2 --lamp-directions 0 0 1", "--lamp-directions"),
    ("--lamps 2 --lamp-power 1 2", "--lamp-power"),
    ("--lamp-positions 0 0 0.001", "within 0.01 m"),
    ("--lamps 2 --plume 0.1 0.5", "leave out the lamps"),
    ("--altitude 1 2 3", "--altitude"),
    ("--lamp-power 2", "--lamp-power"),
    ("--lamp-jitter 0.1", "--lamp-jitter"),
    ("--strobe alternate", "--strobe"),
    ("--no-shading --daylight", "--no-shading"),
])
def test_bad_options_are_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: str, what: str
) -> None:
    assert main(["simulate", "-o", str(tmp_path / "bag"), *SMALL, *options.split()]) == 2
    error = capsys.readouterr().err
    assert what in error
    assert error.count("\n") == 1
    assert not (tmp_path / "bag").exists()


def test_bright_snow_is_as_bright_as_told(tmp_path: Path) -> None:
    """Where a particle covers a pixel, it adds its own light in place of what is behind."""
    frames = []
    for brightness in ("0", "1", "2"):
        path = tmp_path / brightness
        words = ["--marine-snow", "0.3", "--snow-brightness", brightness, "--noiseless",
                 "--exposure", "0.5"]
        assert main(["simulate", "-o", str(path), *SMALL, *words]) == 0
        frames.append(first_frame(path))
    dark, grey, bright = (frame.left.astype(float) for frame in frames)
    # Particles that are darker or brighter than the veil by as much lie as far from it.
    np.testing.assert_allclose(bright - grey, grey - dark, atol=1.5)
    covered = (bright - dark).max(axis=2) > 20
    assert 0.05 < covered.mean() < 0.6
