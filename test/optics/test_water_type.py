# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Jerlov water types, in order and by name."""

import pytest

from uw_visibility.errors import InputError
from uw_visibility.optics import water_type
from uw_visibility.optics.spectra import clear_water_attenuation, load_response


def test_turbid_water_types_attenuate_more():
    response = load_response("nikon_d5100")
    clear = clear_water_attenuation(response)
    types = water_type.water_types()
    assert {"IB", "II", "III"} <= set(types)
    betas = [water_type.water_type_attenuation(name, response) for name in ("IB", "II", "III")]
    assert (clear < betas[0]).all()
    assert (betas[0] < betas[1]).all()
    assert (betas[1] < betas[2]).all()
    with pytest.raises(InputError, match="IB"):
        water_type.water_type_attenuation("X", response)
