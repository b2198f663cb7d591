# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Transect as a bag: the vehicle's sensors, and the ground truth.

Stamps begin at a given time and advance by the frames' period. Images are in
the cameras' optical frames (x right, y down, z forward), depth is in a frame
whose z points up from the surface. The true disparity is a
``stereo_msgs/DisparityImage``, 0 for open water, which is below its
``min_disparity``. With lamps, their parameters for the pipeline are in
``lighting.yaml`` in the bag's folder.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.config.parameters import render_values
from uw_visibility.config.schema import AssessmentConfig
from uw_visibility.errors import InputError, check_range
from uw_visibility.images.arrays import DisparityMap
from uw_visibility.messages.estimates import (
    ImageHeader,
    depth_message,
    region_message,
    vector_message,
)
from uw_visibility.messages.images import MessageFactory, write_image
from uw_visibility.optics.light_model import visibility_distance
from uw_visibility.optics.visual_range import BEAM_OVER_SEEN
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.simulation.lamps import Lamp, lighting_parameters
from uw_visibility_lab.simulation.new_bag import new_bag
from uw_visibility_lab.simulation.transect import Transect, TransectFrame
from uw_visibility_lab.simulation.view import MAX_RANGE

TOPICS = {
    "/left/image_rect": "sensor_msgs/msg/Image",
    "/right/image_rect": "sensor_msgs/msg/Image",
    "/left/camera_info": "sensor_msgs/msg/CameraInfo",
    "/right/camera_info": "sensor_msgs/msg/CameraInfo",
    "/depth_sensor": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/transmissometer": "std_msgs/msg/Float64",
    "/ground_truth/attenuation": "geometry_msgs/msg/Vector3Stamped",
    "/ground_truth/ambient_light": "geometry_msgs/msg/Vector3Stamped",
    "/ground_truth/scene_light": "geometry_msgs/msg/Vector3Stamped",
    "/ground_truth/mean_attenuation": "std_msgs/msg/Float64",
    "/ground_truth/visibility": "std_msgs/msg/Float64",
    "/ground_truth/depth": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/ground_truth/disparity": "stereo_msgs/msg/DisparityImage",
}
"""Type of message by topic."""

MOST_DEPTH_NOISE = 1000.0
"""Largest standard deviation of the depth sensor, m."""

LAMP_TOPICS = {
    "/ground_truth/lamps": "std_msgs/msg/Float64MultiArray",
    "/ground_truth/reflectance": "sensor_msgs/msg/Image",
}
"""Additional topics under lamps."""

LAMP_COLUMNS = "x y z, axis x y z, beam angle, power r g b"
LIGHTING = "lighting.yaml"

TRANSMISSOMETER_NOISE = 0.02
"""Standard deviation of the transmissometer, as a part of its value."""

START = 1_700_000_000_000_000_000
"""Time of the first frame unless another is given, ns since 1970 (UTC)."""

END_OF_STAMPS = (1 << 31) * 1_000_000_000
"""Stamps of ROS have 31 bits of seconds; ns since 1970."""

LEFT_FRAME = "stereo_left_optical_frame"
RIGHT_FRAME = "stereo_right_optical_frame"
DEPTH_FRAME = "map"


def write_transect(
    path: str | Path,
    transect: Transect,
    *,
    start: int = START,
    depth_stddev: float = 0.05,
    range_scale: float = 1.0,
    overwrite: bool = False,
    workers: Workers | None = None,
    progress: Callable[[Iterator[TransectFrame]], Any] = iter,
) -> None:
    """Simulate a transect and record it.

    start: time of the first frame, ns since 1970 (UTC).
    depth_stddev: standard deviation of the depth sensor in m.
    range_scale: ratio of the baseline in CameraInfo to the true one, for a wrong calibration.
    """
    check_range(
        "noise of the depth sensor", depth_stddev, 0.0, MOST_DEPTH_NOISE, "m", above=True)
    check_range("range scale", range_scale, 0.0, 100.0, above=True)
    duration = (transect.frames - 1) / transect.rate
    if start + round(duration * 1e9) >= END_OF_STAMPS:
        raise InputError(
            f"{duration:g} s from this start end after the stamps of ROS, in January 2038: give an "
            "earlier start, or fewer frames")
    random = np.random.default_rng([transect.seed, 1])
    # A generator of its own does not change the depth sensor's noise.
    optical = np.random.default_rng([transect.seed, 3])
    lighting = transect.lighting
    topics = TOPICS | (LAMP_TOPICS if lighting.lamps else {})
    with new_bag(Path(path), topics, overwrite=overwrite) as bag:
        if lighting.lamps:
            parameters = lighting_parameters(lighting.lamps, lighting.daylight)
            text = render_values(parameters, "The lamps of this recording, for --params-file.")
            (bag.path / LIGHTING).write_text(text, encoding="utf-8")
        camera = transect.camera
        calibrated = replace(camera, baseline=range_scale * camera.baseline)
        for time, frame in progress(transect.render(workers)):
            stamp = start + round(time * 1e9)
            for side, frame_id, pixels in (
                ("left", LEFT_FRAME, frame.left), ("right", RIGHT_FRAME, frame.right)
            ):
                header = ImageHeader.at(stamp, frame_id).message(bag.make)
                image = write_image(bag.make, pixels, "rgb8", header)
                bag.write(f"/{side}/image_rect", image, stamp)
                info = camera_info_message(bag.make, header, calibrated, right=side == "right")
                bag.write(f"/{side}/camera_info", info, stamp)
            header = ImageHeader.at(stamp, LEFT_FRAME).message(bag.make)
            surface = ImageHeader.at(stamp, DEPTH_FRAME).message(bag.make)
            noisy = frame.depth + depth_stddev * random.standard_normal()
            sensed = depth_message(bag.make, surface, noisy, depth_stddev**2)
            bag.write("/depth_sensor", sensed, stamp)
            # It reads beam attenuation, which is more than what a camera sees.
            beam = BEAM_OVER_SEEN * frame.attenuation[1] * (
                1 + TRANSMISSOMETER_NOISE * optical.standard_normal())
            bag.write("/transmissometer", bag.make("std_msgs/msg/Float64", data=beam), stamp)
            truth = {
                "attenuation": vector_message(bag.make, header, frame.attenuation),
                "ambient_light": vector_message(bag.make, header, frame.ambient_light),
                "scene_light": vector_message(bag.make, header, frame.scene_light),
                "visibility": bag.make(
                    "std_msgs/msg/Float64", data=visibility_distance(
                        float(frame.attenuation.min()), AssessmentConfig().contrast)),
                "mean_attenuation": bag.make("std_msgs/msg/Float64", data=frame.mean_attenuation),
                "depth": depth_message(bag.make, surface, frame.depth, 0.0),
                "disparity": _disparity_message(bag.make, header, camera, frame.disparity_left),
            }
            if lighting.lamps:
                seen = np.isfinite(frame.range_left)[..., np.newaxis]
                reflectance = np.rint(255.0 * np.clip(frame.radiance_left * seen, 0.0, 1.0))
                truth["lamps"] = _lamps_message(bag.make, frame.lamps)
                truth["reflectance"] = write_image(
                    bag.make, reflectance.astype(np.uint8), "rgb8", header)
            for name, message in truth.items():
                bag.write(f"/ground_truth/{name}", message, stamp)


def camera_info_message(
    make: MessageFactory, header: Any, camera: StereoCamera, *, right: bool
) -> Any:
    """Make the CameraInfo of one camera of a pair."""
    projection = np.zeros((3, 4))
    projection[0, 0] = projection[1, 1] = camera.focal_length
    projection[:2, 2], projection[2, 2] = camera.principal_point, 1.0
    if right:
        projection[0, 3] = -camera.focal_length * camera.baseline
    return make(
        "sensor_msgs/msg/CameraInfo",
        header=header,
        height=camera.height,
        width=camera.width,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=projection[:, :3].ravel(),
        r=np.eye(3).ravel(),
        p=projection.ravel(),
        binning_x=0,
        binning_y=0,
        roi=region_message(make, (0, 0, 0, 0)),
    )


def _lamps_message(make: MessageFactory, lamps: tuple[Lamp, ...]) -> Any:
    rows = [[*lamp.position, *lamp.axis, lamp.beam_angle, *lamp.power] for lamp in lamps]
    sizes = (("lamp", len(rows), 10 * len(rows)), (LAMP_COLUMNS, 10, 10))
    dimensions = [
        make("std_msgs/msg/MultiArrayDimension", label=label, size=size, stride=stride)
        for label, size, stride in sizes
    ]
    return make(
        "std_msgs/msg/Float64MultiArray",
        layout=make("std_msgs/msg/MultiArrayLayout", dim=dimensions, data_offset=0),
        data=np.array(rows, dtype=np.float64).ravel(),
    )


def _disparity_message(
    make: MessageFactory, header: Any, camera: StereoCamera, disparity: DisparityMap
) -> Any:
    known = np.nan_to_num(disparity, nan=0.0)
    return make(
        "stereo_msgs/msg/DisparityImage",
        header=header,
        image=write_image(make, known, "32FC1", header),
        f=camera.focal_length,
        t=camera.baseline,
        valid_window=region_message(make, (0, 0, camera.width, camera.height)),
        # A ray is at least as long as the depth along the axis, f b / disparity.
        min_disparity=camera.focal_length * camera.baseline / MAX_RANGE,
        max_disparity=float(max(math.ceil(known.max()), 1)),
        delta_d=float(np.finfo(np.float32).eps * max(known.max(), 1.0)),
    )
