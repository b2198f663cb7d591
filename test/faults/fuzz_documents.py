# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Parameter files, calibrations and tables with damage and absurd values in them."""

from __future__ import annotations

import copy
import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml
from fuzz import Outcome
from hostile import ABSURD_VALUES
from mutations import mutate

from uw_visibility.commands.calibration_file import read_camera_infos, read_rig
from uw_visibility.config.schema import NodeConfig, PipelineConfig, read_yaml
from uw_visibility.errors import InputError
from uw_visibility.optics.spectra import load_response
from uw_visibility.stereo.rectification import Rectifier

MORE_VALUES = (
    *ABSURD_VALUES, "9" * 5000, 2**200, "0x" + "f" * 200, "1:2:3", "2024-99-99", "!!python/name:os",
    "*alias", "{a: 1, a: 2}", "[[[[", 1e-300, -0.0, "1e999", 0.5, 12, [1.0, 2.0, 3.0],
)

MATRIX = {"rows": 3, "cols": 3, "data": [90.0, 0, 48, 0, 90, 36, 0, 0, 1]}
CAMERA = {
    "image_width": 96, "image_height": 72, "camera_name": "left", "camera_matrix": MATRIX,
    "distortion_model": "plumb_bob",
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.0] * 5},
    "rectification_matrix": {"rows": 3, "cols": 3, "data": [1.0, 0, 0, 0, 1, 0, 0, 0, 1]},
    "projection_matrix": {"rows": 3, "cols": 4, "data": [90.0, 0, 48, 0, 0, 90, 36, 0, 0, 0, 1, 0]},
}
RIGHT = copy.deepcopy(CAMERA)
RIGHT["projection_matrix"]["data"][3] = -9.0  # type: ignore[index]
PROJECTIONS = {
    "P1": [[90, 0, 48, 0], [0, 90, 36, 0], [0, 0, 1, 0]],
    "P2": [[90, 0, 48, -9], [0, 90, 36, 0], [0, 0, 1, 0]],
    "width": 96, "height": 72, "K_left": [[90, 0, 48], [0, 90, 36], [0, 0, 1]],
    "D_left": [0, 0, 0, 0, 0], "R1": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
}
PARAMETERS = Path(__file__).resolve().parents[2] / "config" / "uw_visibility.yaml"
TABLE = "wavelength_nm,red,green,blue\n" + "".join(
    f"{w},{w / 700},{1 - abs(w - 550) / 200},{400 / w}\n" for w in range(400, 701, 10)
)


class Cases:
    """Documents of the kinds that are read, changed in their text or their values."""

    case = ""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        (folder / "right.yaml").write_text(yaml.safe_dump(RIGHT))
        self._kinds: dict[str, tuple[Any, Callable[[Path], None]]] = {
            "params.yaml": (yaml.safe_load(PARAMETERS.read_text("utf-8")), self._read_parameters),
            "left.yaml": (CAMERA, self._read_cameras),
            "rig.json": (PROJECTIONS, self._read_rig),
            "response.csv": (TABLE, self._read_table),
        }

    def run(self, seed: int) -> Outcome:
        """Change a document and read it."""
        rng = random.Random(seed)
        name = rng.choice(list(self._kinds))
        content, read = self._kinds[name]
        path = self._folder / name
        what = "values"
        if name.endswith("csv") or rng.random() < 0.4:
            text = content if isinstance(content, str) else _dump(name, content)
            what, data = mutate(text.encode(), rng)
            path.write_bytes(data)
        else:
            path.write_text(_dump(name, _changed(content, rng)), errors="replace")
        self.case = f"{name} {what}"
        try:
            read(path)
        except InputError as error:
            good = str(error).isprintable() and len(str(error)) <= 1000
            return Outcome(self.case, "refused" if good else "unprintable", str(error))
        return Outcome(self.case, "read")

    @staticmethod
    def _read_parameters(path: Path) -> None:
        values = read_yaml(path)
        PipelineConfig.from_parameters(values)
        NodeConfig.from_parameters(values)

    def _read_cameras(self, path: Path) -> None:
        infos = read_camera_infos([path, self._folder / "right.yaml"])
        read_rig([path, self._folder / "right.yaml"])
        Rectifier(*infos)

    @staticmethod
    def _read_rig(path: Path) -> None:
        rig, _ = read_rig([path])
        assert 0.0 < rig.focal_length * rig.baseline < float("inf")
        read_camera_infos([path])

    @staticmethod
    def _read_table(path: Path) -> None:
        load_response(str(path))


def _changed(content: Any, rng: random.Random) -> Any:
    """Return a copy with an absurd value at a place or two."""
    changed = copy.deepcopy(content)
    for _ in range(rng.choice((1, 1, 2))):
        node = changed
        while True:
            key = rng.choice(list(range(len(node))) if isinstance(node, list) else list(node))
            inner = node[key]
            if not isinstance(inner, dict | list) or not inner or rng.random() < 0.1:
                # A copy: the next change may be made inside of it.
                node[key] = copy.deepcopy(rng.choice(MORE_VALUES))
                break
            node = inner
    return changed


def _dump(name: str, content: Any) -> str:
    if name.endswith("json"):
        return json.dumps(content)
    return yaml.safe_dump(content, default_flow_style=False)
