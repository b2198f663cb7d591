# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Every parameter of the pipeline and of the node: default, unit, bounds, meaning.

`config/uw_visibility.yaml` holds the same names and defaults; the node and the
command read that form.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from uw_visibility.errors import InputError
from uw_visibility.parameters import (
    build,
    check_names,
    describe,
    flatten,
    parameter,
    section,
)


@dataclass(frozen=True)
class CameraConfig:
    """What the camera does to light."""

    transfer: str = parameter(
        "linear",
        "How pixel values follow light: linear, or encoded with the sRGB curve.",
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


@dataclass(frozen=True)
class StereoConfig:
    """The stereo matcher (Geiger, Roser and Urtasun, ACCV 2010)."""

    max_disparity: int = parameter(
        0,
        "Largest disparity searched; 0 takes a quarter of the image's width.",
        unit="px", minimum=0, maximum=1024,
    )


@dataclass(frozen=True)
class WaterConfig:
    """Estimation of attenuation and ambient light (eq. 4-7)."""

    bins: int = parameter(
        40, "Number of range bins.", minimum=4, maximum=256,
    )


@dataclass(frozen=True)
class AssessmentConfig:
    """What visibility and depth mean (eq. 9-14)."""

    contrast: float = parameter(
        0.05, "Smallest contrast that an observer distinguishes (eq. 11).",
        minimum=1e-3, maximum=0.5,
    )
    max_depth: float = parameter(
        60.0, "Largest depth considered.", unit="m", minimum=1.0, maximum=200.0,
    )


@dataclass(frozen=True)
class EnhancementConfig:
    """Restoration of the scene's radiance (eq. 8) and the dense range it needs."""

    max_gain: float = parameter(
        30.0, "Largest gain exp(attenuation x range); pixels beyond it are marked.",
        minimum=1.0, maximum=1e3,
    )


@dataclass(frozen=True)
class PipelineConfig:
    """Everything that the pipeline can be told.

    Use `from_parameters` or `from_yaml` to make one; the fields are the
    sections of the parameter file.
    """

    camera: CameraConfig = section(CameraConfig)
    stereo: StereoConfig = section(StereoConfig)
    water: WaterConfig = section(WaterConfig)
    assessment: AssessmentConfig = section(AssessmentConfig)
    enhancement: EnhancementConfig = section(EnhancementConfig)
    threads: int = parameter(
        0, "Threads that the pipeline uses; 0 takes one per processor.",
        minimum=0, maximum=64, read_only=True,
    )

    @classmethod
    def from_parameters(cls, values: Mapping[str, Any]) -> PipelineConfig:
        """Make a configuration from the node's parameter names.

        Parameters
        ----------
        values : mapping of str to object
            Values by dotted name, for example ``{"stereo.max_disparity": 96}``.
            What is absent keeps its default; names of `NodeConfig` are
            accepted and do nothing here.

        Returns
        -------
        PipelineConfig

        Raises
        ------
        InputError
            If a name is unknown (the nearest known one is named) or a value
            is not allowed.
        """
        mine, _ = split_parameters(values)
        return build(cls, mine)

    @classmethod
    def from_yaml(cls, path: str | Path) -> PipelineConfig:
        """Make a configuration from a ROS 2 parameter file; see `read_yaml`."""
        return cls.from_parameters(read_yaml(path))

    def to_parameters(self) -> dict[str, Any]:
        """Return every value by its dotted name."""
        return flatten(self)


@dataclass(frozen=True)
class SynchronizationConfig:
    """How the four input topics become stereo frames."""

    tolerance: float = parameter(
        0.0, "Largest difference of the two images' stamps; 0 asks for equal stamps.",
        unit="s", minimum=0.0, maximum=1.0,
    )
    queue_size: int = parameter(
        10, "Images of each side that wait for their partner.", minimum=1, maximum=1000,
    )


@dataclass(frozen=True)
class NodeConfig:
    """What the node needs beyond the pipeline."""

    rectify: bool = parameter(
        False, "Rectify raw images with K, D, R and P of their CameraInfo.", read_only=True,
    )
    max_range: float = parameter(
        50.0, "Visibility beyond this is published as infinite.",
        unit="m", minimum=0.1, maximum=1000.0,
    )
    synchronization: SynchronizationConfig = section(SynchronizationConfig)

    @classmethod
    def from_parameters(cls, values: Mapping[str, Any]) -> NodeConfig:
        """Make a configuration from dotted names, ignoring the pipeline's."""
        _, mine = split_parameters(values)
        return build(cls, mine)


def split_parameters(values: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Split values by dotted name into the pipeline's and the node's.

    Raises
    ------
    InputError
        If a name belongs to neither; the nearest known one is named.
    """
    pipeline = {info.name for info in describe(PipelineConfig)}
    node = {info.name for info in describe(NodeConfig)}
    check_names(values, iter(sorted(pipeline | node)))
    return (
        {k: v for k, v in values.items() if k in pipeline},
        {k: v for k, v in values.items() if k in node},
    )


def read_yaml(path: str | Path) -> dict[str, Any]:
    """Read a ROS 2 parameter file as values by dotted name.

    The form is that of ``ros2 param dump``: a node's name (or ``/**``), then
    ``ros__parameters``, then the values, nested or with dots.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    dict of str to object

    Raises
    ------
    InputError
        If the file cannot be read or has another form.
    """
    import yaml

    try:
        text = Path(path).read_text(encoding="utf-8")
        content = yaml.safe_load(text)
    except OSError as error:
        raise InputError(f"cannot read parameter file {path}: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"parameter file {path} is not YAML: {reason}") from error
    values: dict[str, Any] = {}
    blocks = content.values() if isinstance(content, dict) else [None]
    for block in blocks:
        if not isinstance(block, dict) or not isinstance(block.get("ros__parameters"), dict):
            raise InputError(
                f"parameter file {path} has no 'ros__parameters' under a node's name: "
                "see config/uw_visibility.yaml for the form"
            )
        values.update(flatten(block["ros__parameters"]))
    return {k: v for k, v in values.items() if not k.startswith("qos_overrides.")}
