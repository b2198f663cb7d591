# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Quality of service, subscriptions and message classes."""
