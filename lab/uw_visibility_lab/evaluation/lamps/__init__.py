# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Study under lamps: frames of a reef by night, and a survey of the floor."""
