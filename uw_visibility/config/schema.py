# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Parameter schema of the pipeline and the node: default, unit, bounds, description.

`config/uw_visibility.yaml` has the same names and defaults; node and command
read files of that form.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from uw_visibility.config.lighting import LightingConfig
from uw_visibility.config.parameters import (
    build,
    check_names,
    describe,
    flatten,
    parameter,
    read_yaml,
    section,
)
from uw_visibility.errors import InputError

# tf2 refuses frame names that begin with a slash.
FRAME_ID = re.compile(r"(?!/)[!-~]{1,200}")


@dataclass(frozen=True)
class CameraConfig:
    """Camera: transfer, spectral response, white reference, vignetting."""

    transfer: str = parameter(
        "linear",
        "Relation of pixel values to light: linear, or encoded with the sRGB curve. If it is not "
        "set, linear is assumed, with a warning for compressed or 8-bit colour images.",
        choices=("linear", "srgb"),
    )
    response: str = parameter(
        "nikon_d5100",
        "Spectral response: the name of a shipped table, or the path of a CSV file "
        "with the columns wavelength_nm, red, green, blue.",
    )
    white_reference: tuple[float, float, float] = parameter(
        (1.0, 1.0, 1.0),
        "The camera's linear R, G, B for white at the surface; the scale is free.",
        minimum=1e-3,
        maximum=1e3,
    )
    vignetting: tuple[float, float, float] = parameter(
        (0.0, 0.0, 0.0),
        "Relative illumination of the images is 1 + a r^2 + b r^4 + c r^6, with r the distance "
        "from the principal point over half of the diagonal: a, b, c. Zeros for no correction.",
        minimum=-10.0,
        maximum=10.0,
    )
    flat_field: str = parameter(
        "",
        "Path of an image of an evenly lit surface, of the size of the rectified images, to be "
        "used instead of vignetting; empty for none.",
    )
    flat_field_right: str = parameter(
        "", "The right camera's flat field; empty for the same as the left one's.",
    )

    def __post_init__(self) -> None:
        a, b, c = self.vignetting
        least = min(1.0 + s * (a + s * (b + s * c)) for s in (i / 64 for i in range(65)))
        if least <= 0.0:
            raise InputError(
                f"parameter camera.vignetting is {list(self.vignetting)}, which leaves no light "
                "somewhere in the image: give a, b and c of 1 + a r^2 + b r^4 + c r^6, above 0 for "
                "all r from 0 to 1"
            )


@dataclass(frozen=True)
class NetworkConfig:
    """Properties of an ONNX network that its file does not state, and its execution."""

    model: str = parameter(
        "", "Path of the network, an ONNX file; for matcher or restorer onnx only.",
    )
    providers: str = parameter(
        "cpu", "Execution providers of the network: a list of tensorrt, cuda, openvino and cpu, "
        "separated by commas. Each operator runs on the first one that supports it.",
    )
    pixel_values: str = parameter(
        "0..1", "Range of the network's pixel values, black to white; imagenet is 0..1, minus "
        "ImageNet's mean, divided by its standard deviation.",
        choices=("0..1", "0..255", "-1..1", "imagenet"),
    )
    size_multiple: int = parameter(
        32, "Images for a network without a fixed size are padded to multiples of this.",
        unit="px", minimum=1, maximum=512,
    )
    large_images: str = parameter(
        "resized", "Images that are larger than a model's fixed size are resized to it, or tiled: "
        "the network runs at full resolution on overlapping parts of that size.",
        choices=("resized", "tiled"),
    )
    time_limit: float = parameter(
        5.0, "Longest run of the network; a longer one is ended, and its frame is lost.",
        unit="s", minimum=0.01, maximum=600.0,
    )
    network_memory: float = parameter(
        0.5, "Limit of the computer's memory, not a device's, for all networks of the process; "
        "a network that needs more fails. It must be the same in both sections.",
        unit="GiB", minimum=0.0625, maximum=256.0, read_only=True,
    )


@dataclass(frozen=True)
class StereoConfig(NetworkConfig):
    """The stereo matcher (Geiger, Roser and Urtasun, ACCV 2010), or a user's network."""

    matcher: str = parameter(
        "elas", "Dense matcher of step 2: elas, or onnx for the network in stereo.model.",
    )
    network_images: str = parameter(
        "raw", "Images that the network matches: raw, or with their contrast restored.",
        choices=("raw", "restored"),
    )
    network_check: bool = parameter(
        True, "The network also matches the mirrored pair, and both views are compared: this "
        "takes twice the time, removes mismatches, and gives the confidence.",
    )
    max_disparity: int = parameter(
        0,
        "Largest disparity searched; 0 for a quarter of the image's width.",
        unit="px", minimum=0, maximum=1024,
    )
    min_disparity: int = parameter(
        0, "Smallest disparity searched.", unit="px", minimum=0, maximum=1000,
    )
    reduction: int = parameter(
        1, "Side of the squares of pixels that are averaged before matching and estimation; "
        "published images and disparity keep their size. 2 is for small computers.",
        unit="px", minimum=1, maximum=4,
    )
    support_step: int = parameter(
        5, "Spacing of the grid of points that may become support points.",
        unit="px", minimum=2, maximum=50,
    )
    support_texture: int = parameter(
        10, "Least sum of gradient responses at a support point.", minimum=0, maximum=2000,
    )
    support_uniqueness: float = parameter(
        0.9, "Largest ratio of a support point's best cost to its second best.",
        minimum=0.1, maximum=1.0,
    )
    consistency_cells: int = parameter(
        5, "Grid points to each side that a support point is compared with.",
        minimum=1, maximum=20,
    )
    consistency_disparity: float = parameter(
        2.0, "Largest difference of two support points that agree.",
        unit="px", minimum=0.0, maximum=100.0,
    )
    consistency_count: int = parameter(
        5, "Least number of neighbours that agree with a support point.", minimum=0, maximum=400,
    )
    plane_radius: int = parameter(
        1, "Largest distance from the mesh's plane of disparities that are tried.",
        unit="px", minimum=0, maximum=20,
    )
    plane_deviation: float = parameter(
        1.0, "Standard deviation of the prior about the mesh's plane.",
        unit="px", minimum=0.1, maximum=20.0,
    )
    prior_outlier: float = parameter(
        3.0, "Weight of disparities off the plane, relative to those on it.",
        minimum=1e-3, maximum=1e3,
    )
    likelihood_weight: float = parameter(
        0.007, "Weight of a unit of descriptor difference, relative to the prior.",
        minimum=1e-4, maximum=1.0,
    )
    left_right_tolerance: int = parameter(
        2, "Largest difference of the two views' disparities.", unit="px", minimum=0, maximum=10,
    )
    noise_ratio: float = parameter(
        0.9, "Largest difference of matched descriptors over their texture, around a pixel; "
        "noise in open water has about 1.1.",
        minimum=0.1, maximum=10.0,
    )
    segment_size: int = parameter(
        100, "Smallest number of pixels that a segment of the disparity map keeps.",
        unit="px", minimum=0, maximum=100000,
    )
    segment_difference: float = parameter(
        1.0, "Difference of neighbouring disparities within a segment.",
        unit="px", minimum=0.0, maximum=10.0,
    )
    min_confidence: float = parameter(
        0.0, "Least probability that a disparity is within 1 px of the truth; others are "
        "unmatched. 0.5 keeps matches that are more likely right than wrong. For noisy images the "
        "limit is at least 0.14 to 0.51, rising with noise.",
        minimum=0.0, maximum=0.99,
    )
    gap_width: int = parameter(
        7, "Largest width of gaps in the disparity map that are interpolated.",
        unit="px", minimum=0, maximum=100,
    )
    gap_difference: float = parameter(
        3.0, "Largest difference of the two sides of a gap that is interpolated.",
        unit="px", minimum=0.0, maximum=100.0,
    )
    smoothing_radius: int = parameter(
        5, "Neighbours to each side in the adaptive mean of the disparity map; 0 for none.",
        unit="px", minimum=0, maximum=30,
    )
    smoothing_difference: float = parameter(
        3.0, "Difference of disparity above which a neighbour is on another surface.",
        unit="px", minimum=0.1, maximum=30.0,
    )


@dataclass(frozen=True)
class WaterConfig:
    """Estimation of attenuation and ambient light (eq. 4-7)."""

    veil: str = parameter(
        "free",
        "Model of the veil (light that the water adds) and of the light on the scene: free "
        "(independent; networks trained on random views infer both and the attenuation), or "
        "paper (one ambient light for both, by a fit; more precise if water and scene have the "
        "same light).",
        choices=("free", "paper"),
    )
    min_range_ratio: float = parameter(
        1.25, "Least ratio of the farthest to the nearest range for an estimate.",
        minimum=1.0, maximum=10.0,
    )
    daylight_tolerance: float = parameter(
        0.15, "Relative standard deviation of the ambient light's colour from that of daylight "
        "below water of assessment.water_type, as seen with camera.white_reference, for "
        "water.veil paper only; 10 for no prior.", minimum=0.01, maximum=10.0,
    )


@dataclass(frozen=True)
class AssessmentConfig:
    """Assessment of visibility and depth (eq. 9-14)."""

    contrast: float = parameter(
        0.05, "Smallest contrast that an observer distinguishes (eq. 11).",
        minimum=1e-3, maximum=0.5,
    )
    water_type: str = parameter(
        "clear",
        "Water above the camera, whose attenuation determines the colour of daylight at a "
        "depth: clear sea water, a Jerlov type, or as estimated from each frame.",
        choices=("clear", "IB", "II", "III", "1C", "3C", "5C", "estimated"),
    )
    max_depth: float = parameter(
        60.0, "Largest depth considered.", unit="m", minimum=1.0, maximum=200.0,
    )


@dataclass(frozen=True)
class TrackingConfig:
    """Kalman filter of the water's state over frames."""

    enabled: bool = parameter(
        True, "Filter the estimates over frames, if these have stamps.",
    )
    turbidity_rate: float = parameter(
        0.02, "Rate of the random walk of attenuation, relative to it.",
        unit="1/s^0.5", minimum=1e-4, maximum=10.0,
    )
    unseen_rate: float = parameter(
        0.06, "Relative rate of change of attenuation while frames do not show it; 0.06 is that "
        "of a vehicle that sinks at 0.25 m/s into water whose turbidity doubles within three "
        "metres.",
        unit="1/s", minimum=0.0, maximum=10.0,
    )
    light_rate: float = parameter(
        0.05, "Rate of the random walk of the ambient light's colour, relative to each channel.",
        unit="1/s^0.5", minimum=1e-4, maximum=10.0,
    )
    exposure_change: float = parameter(
        0.5, "Relative standard deviation of the change of exposure, common to all channels, "
        "between frames; 0 for a fixed exposure.", minimum=0.0, maximum=10.0,
    )
    common_error: float = parameter(
        0.6, "Part of the variance of a frame's estimate that following frames share, since "
        "they show the same scene: filtering does not reduce it.", minimum=0.0, maximum=0.95,
    )
    gate_probability: float = parameter(
        0.999, "Probability that a correct estimate passes the gate (chi squared).",
        minimum=0.5, maximum=0.999999,
    )
    reset_count: int = parameter(
        3, "Number of estimates in a row beyond the gate after which the filter restarts with "
        "the last one; those before it are rejected. Two that agree are enough.",
        minimum=1, maximum=100,
    )
    timeout: float = parameter(
        5.0, "Time without an estimate after which the state is unknown.",
        unit="s", minimum=0.01, maximum=3600.0,
    )


@dataclass(frozen=True)
class SurveyConfig:
    """Joint estimate from several frames, each of which has too little spread of range."""

    enabled: bool = parameter(
        True, "Estimate the water from several frames jointly while single ones do not show it, "
        "as in a survey at constant altitude.",
    )
    window: float = parameter(
        60.0, "Time span of the frames that are used jointly.", unit="s", minimum=1.0,
        maximum=3600.0,
    )
    min_frames: int = parameter(
        20, "Least number of frames.", minimum=8, maximum=10000,
    )
    max_frames: int = parameter(
        240, "Largest number of frames; of more, evenly spaced ones are kept.", minimum=16,
        maximum=10000,
    )

    def __post_init__(self) -> None:
        if self.min_frames > self.max_frames:
            raise InputError(
                f"parameter survey.min_frames is {self.min_frames} and survey.max_frames "
                f"{self.max_frames}: give a max_frames that is not smaller"
            )


@dataclass(frozen=True)
class EnhancementConfig(NetworkConfig):
    """Restoration of the scene's radiance (eq. 8) and the dense range it needs."""

    restorer: str = parameter(
        "radiance", "Restorer of the images: radiance (eq. 8), or onnx for the network in "
        "enhancement.model.",
    )
    max_gain: float = parameter(
        30.0, "Largest gain of contrast; pixels restored by less than half are marked.",
        minimum=1.0, maximum=1e3,
    )
    max_noise: float = parameter(
        0.05, "Largest standard deviation of noise and rounding in an enhanced image, as part "
        "of white: limits the gain further.",
        minimum=1e-3, maximum=10.0,
    )
    matting_radius: int = parameter(
        4, "Reach of the matting filter; larger holes are filled from coarser scales.",
        unit="px", minimum=4, maximum=256,
    )
    matting_smoothness: float = parameter(
        1e-5, "Variance of the image, at a scale of 0..1, below which it counts as flat.",
        minimum=1e-7, maximum=1.0,
    )
    max_gap: int = parameter(
        40, "Largest distance from which gaps in the disparity map are filled; gaps wider than "
        "twice that are inpainted.",
        unit="px", minimum=1, maximum=512,
    )


@dataclass(frozen=True)
class PipelineConfig:
    """Configuration of the pipeline: all of its parameters.

    Use `from_parameters` or `from_yaml` to make one; the fields are the
    sections of the parameter file.
    """

    camera: CameraConfig = section(CameraConfig)
    lighting: LightingConfig = section(LightingConfig)
    stereo: StereoConfig = section(StereoConfig)
    water: WaterConfig = section(WaterConfig)
    assessment: AssessmentConfig = section(AssessmentConfig)
    tracking: TrackingConfig = section(TrackingConfig)
    survey: SurveyConfig = section(SurveyConfig)
    enhancement: EnhancementConfig = section(EnhancementConfig)
    threads: int = parameter(
        0, "Number of threads of the pipeline; 0 for one per processor.",
        minimum=0, maximum=64, read_only=True,
    )

    @classmethod
    def from_parameters(cls, values: Mapping[str, Any]) -> PipelineConfig:
        """Make a configuration from the node's parameter names.

        Parameters
        ----------
        values : mapping of str to object
            Values by dotted name, for example ``{"stereo.max_disparity": 96}``.
            Absent ones keep their defaults; names of `NodeConfig` are
            accepted and ignored.

        Returns
        -------
        PipelineConfig

        Raises
        ------
        InputError
            If a name is unknown (the nearest known one is named) or a value
            is not allowed.
        """
        _check_known(values)
        made: PipelineConfig = build(cls, values)
        return made

    @classmethod
    def from_yaml(cls, path: str | Path) -> PipelineConfig:
        """Make a configuration from a ROS 2 parameter file; see `read_yaml`."""
        return cls.from_parameters(read_yaml(path))

    def to_parameters(self) -> dict[str, Any]:
        """Return every value by its dotted name."""
        return flatten(self)

    def built_in(self) -> PipelineConfig:
        """Return the same configuration without networks or other plug-ins."""
        stereo = replace(self.stereo, matcher=StereoConfig.matcher)
        enhancement = replace(self.enhancement, restorer=EnhancementConfig.restorer)
        return replace(self, stereo=stereo, enhancement=enhancement)


@dataclass(frozen=True)
class SynchronizationConfig:
    """Synchronisation of the four input topics."""

    tolerance: float = parameter(
        0.0, "Largest difference of the two images' stamps; 0 for equal stamps.",
        unit="s", minimum=0.0, maximum=1.0,
    )
    queue_size: int = parameter(
        10, "Largest number of images of each side that wait for their partner.", minimum=1,
        maximum=1000,
    )


@dataclass(frozen=True)
class PlausibilityConfig:
    """Plausibility test of a depth sensor against the depth estimated from colour."""

    sensor_type: str = parameter(
        "PoseWithCovarianceStamped",
        "Type of the messages on depth_sensor; none for no sensor.",
        choices=(
            "PoseWithCovarianceStamped", "Odometry", "FluidPressure", "PointStamped", "Float64",
            "none",
        ),
        read_only=True,
    )
    sensor_sign: str = parameter(
        "auto",
        "Direction in which the sensor's values increase: down, up, or auto, which is down for "
        "Float64 and up for z of a pose or point. A pressure always increases downwards.",
        choices=("auto", "down", "up"),
    )
    sensor_offset: float = parameter(
        0.0, "Depth of the camera below the sensor.", unit="m", minimum=-100.0, maximum=100.0,
    )
    sensor_stddev: float = parameter(
        0.1, "Standard deviation of the sensor's depth if its messages state none.",
        unit="m", minimum=1e-3, maximum=10.0,
    )
    density: float = parameter(
        1025.0, "Density of the water, for FluidPressure.",
        unit="kg/m^3", minimum=900.0, maximum=1300.0,
    )
    surface_pressure: float = parameter(
        101325.0, "Pressure that the sensor measures at the surface; 0 for gauge pressure.",
        unit="Pa", minimum=0.0, maximum=200000.0,
    )
    confidence: float = parameter(
        0.95, "Probability that the difference of a correct sensor passes the gate (chi squared, "
        "one degree of freedom).", minimum=0.5, maximum=0.9999,
    )
    warn_interval: float = parameter(
        10.0, "Least mean time between false warnings with a correct sensor.",
        unit="h", minimum=1e-3, maximum=1e6,
    )
    error_interval: float = parameter(
        100.0, "Least mean time between false errors with a correct sensor.",
        unit="h", minimum=1e-3, maximum=1e6,
    )
    model_stddev: float = parameter(
        0.25, "Scale of errors that the estimate's own standard deviation does not include: "
        "bursts and outliers. Their sizes on this scale are fitted to rendered transects.",
        unit="m", minimum=1e-3, maximum=20.0,
    )
    max_gate: float = parameter(
        1.5, "Largest gate of a conclusive test: a difference within a wider one proves nothing.",
        unit="m", minimum=0.1, maximum=100.0,
    )
    timeout: float = parameter(
        2.0, "Age above which estimate or sensor are stale, and longest gap between the sensor's "
        "messages that is interpolated.", unit="s", minimum=0.1, maximum=60.0,
    )


@dataclass(frozen=True)
class NodeConfig:
    """Configuration of the node, without the pipeline's."""

    autostart: bool = parameter(
        False, "The managed node configures and activates itself once, when its process starts; "
        "it keeps any state that a manager requests later.", read_only=True,
    )
    rectify: bool = parameter(
        False, "Rectify raw images with K, D, R and P of their CameraInfo.", read_only=True,
    )
    image_transport: str = parameter(
        "raw",
        "Input messages: Image (raw), or CompressedImage on the images' topics + /compressed.",
        choices=("raw", "compressed"),
        read_only=True,
    )
    publish_depth_image: bool = parameter(
        False, "Publish depth/image and depth/camera_info: Z of the matched pixels, 32FC1, m "
        "(REP 118).", read_only=True,
    )
    publish_points: bool = parameter(
        False, "Publish points2: the matched pixels in space, with the enhanced image's colours.",
        read_only=True,
    )
    lazy: bool = parameter(
        False, "Subscribe to images only while somebody subscribes to an output other than "
        "/diagnostics.",
    )
    niceness: int = parameter(
        5, "Nice value that is added to the pipeline's threads, so that other threads, such as "
        "those that receive messages, have priority; 0 for none, 19 at most.",
        minimum=0, maximum=19, read_only=True,
    )
    frames_at_once: int = parameter(
        1, "Frames processed at once if they arrive faster than one is processed: 1 has the "
        "shortest latency; 2, advised for four cores or more, has a higher rate and latency, and "
        "takes 200 more bytes per pixel.",
        minimum=1, maximum=4, read_only=True,
    )
    max_megapixels: float = parameter(
        8.0, "Larger images are refused. A pair takes about 220 bytes per pixel.",
        unit="1e6 px", minimum=0.01, maximum=100.0,
    )
    max_range: float = parameter(
        50.0, "Visibility beyond this is published as infinite.",
        unit="m", minimum=0.1, maximum=1000.0,
    )
    depth_frame: str = parameter(
        "map", "Frame of the published depth: fixed to the world, z up, its origin at the surface.",
    )
    distance_frame: str = parameter(
        "", "Frame of visibility/distance, along whose x axis a Range points (REP 103); empty for "
        "the left image's without _optical, as camera_link for camera_link_optical.",
    )
    synchronization: SynchronizationConfig = section(SynchronizationConfig)
    plausibility: PlausibilityConfig = section(PlausibilityConfig)

    @classmethod
    def from_parameters(cls, values: Mapping[str, Any]) -> NodeConfig:
        """Make a configuration from dotted names, ignoring the pipeline's."""
        _check_known(values)
        config: NodeConfig = build(cls, values)
        # distance_frame may be empty.
        for name, frame in (
            ("depth_frame", config.depth_frame), ("distance_frame", config.distance_frame or "map")
        ):
            if not FRAME_ID.fullmatch(frame):
                raise InputError(
                    f"parameter {name} is {frame!r}: give the name of a frame, such as map")
        return config


def _check_known(values: Mapping[str, Any]) -> None:
    """Refuse names that neither the pipeline nor the node has."""
    groups = (PipelineConfig, NodeConfig)
    check_names(values, (info.name for group in groups for info in describe(group)))
