# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Methods of one's own in `evaluate`, by the entry points of an installed package."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from pathlib import Path

import cv2
import pytest

OWN = '''
import numpy as np
from uw_visibility_lab.evaluation.backscatter import fit_backscatter
from uw_visibility_lab.evaluation.baselines import semi_global_matching
from uw_visibility_lab.evaluation.methods import method

@method("matcher", "twin of SGBM")
def match(left, right, max_disparity):
    return semi_global_matching(left, right, max_disparity + 1)

@method("restorer", "as it is")
def restore(image, ranges):
    assert ranges.shape == image.shape[:2]
    return image

@method("estimator", "Sea-thru")
def estimate(image, ranges, transfer):
    return fit_backscatter(image, ranges, transfer)

@method("matcher", "too small")
def small(left, right, max_disparity):
    return np.zeros((2, 2), np.float32)

def unmarked(left, right, max_disparity):
    return None
'''


def evaluate(
    scene: Path, folder: Path, entries: str
) -> subprocess.CompletedProcess[str]:
    """Run the command beside a package that has these entry points."""
    beside = folder / "beside"
    metadata = beside / "mine-1.0.dist-info"
    metadata.mkdir(parents=True)
    (beside / "mine.py").write_text(OWN)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(f"[uw_visibility.methods]\n{entries}\n")
    options = ["--quick", "--attenuation", "0.2", "--noise", "0"]
    return subprocess.run(
        [sys.executable, "-m", "uw_visibility.cli", "evaluate", str(scene), "-o",
         str(folder / "out"), *options],
        capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": str(beside)},
    )


@pytest.mark.node
def test_own_methods_stand_beside_the_peers(scene_folder: Path, tmp_path: Path) -> None:
    done = evaluate(
        scene_folder, tmp_path, "twin = mine:match\nplain = mine:restore\nthru = mine:estimate")
    assert done.returncode == 0, done.stderr
    with (tmp_path / "out" / "cases.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert row["correct.twin"] == row["correct.sgbm"]
    assert row["colour_difference.plain"] == row["colour_difference.degraded"]
    assert float(row["thru.mean_attenuation"]) > 0.0
    for title in ("twin of SGBM", "as it is", "Sea-thru"):
        assert title in done.stdout
    assert cv2.imread(str(tmp_path / "out" / "fig6.png")) is not None


@pytest.mark.node
@pytest.mark.parametrize("entries, said", [
    ("mine = mine:unmarked", "method mine of uw_visibility.methods is not marked as one"),
    ("mine = mine:small", "matcher 'too small' returns the shape (2, 2): return ("),
])
def test_what_is_no_method_is_one_sentence(
    entries: str, said: str, scene_folder: Path, tmp_path: Path
) -> None:
    done = evaluate(scene_folder, tmp_path, entries)
    assert done.returncode == 2
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
