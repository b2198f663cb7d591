# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A pipeline leaves the processors that it was not given to others, whatever BLAS would take."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

# Processor time of all other threads over that of the thread that calls the pipeline.
OTHERS = """
import time
import cv2
import numpy as np
from uw_visibility import Pipeline, PipelineConfig, StereoRig
from uw_visibility.pipeline.warm_up import warm_up_pair

cv2.setNumThreads(1)
rig = StereoRig(500.0, 0.12, (319.5, 239.5))
pipeline = Pipeline(rig, PipelineConfig.from_parameters({"threads": 1}))
pair = warm_up_pair((480, 640), np.dtype(np.uint8), grey=False)
pipeline.process(*pair)
own, every = time.thread_time(), time.process_time()
for _ in range(5):
    assert np.isfinite(pipeline.process(*pair).water.attenuation).any()
own, every = time.thread_time() - own, time.process_time() - every
print((every - own) / own)
"""


@pytest.mark.skipif(os.cpu_count() == 1, reason="needs two processors")
def test_threads_of_blas_do_not_wait_actively_beside_a_frame() -> None:
    environment = {
        name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    shown = subprocess.check_output([sys.executable, "-c", OTHERS], env=environment)
    assert float(shown) < 0.05
