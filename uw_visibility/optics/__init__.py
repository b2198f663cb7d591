# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Light in water: the light model, spectra, tables and transfer of code values."""
