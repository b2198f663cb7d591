# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Option ``--params-file``: the node's parameter file, for a command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from uw_visibility.errors import InputError


def read_params_file(path: Path | None) -> dict[str, Any]:
    """Read a parameter file, of which `PipelineConfig` and `NodeConfig` take what is theirs.

    Parameters
    ----------
    path : Path or None
        The file; None gives no values.

    Returns
    -------
    dict of str to object
        Values by dotted name, each known and allowed.

    Raises
    ------
    InputError
        If the file cannot be read, or a parameter is unknown or not allowed;
        names the file.
    """
    from uw_visibility.config.schema import NodeConfig, PipelineConfig, read_yaml

    values: dict[str, Any] = {} if path is None else read_yaml(path)
    try:
        NodeConfig.from_parameters(values)
        PipelineConfig.from_parameters(values)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return values
