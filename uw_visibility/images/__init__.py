# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Images: files, codecs, pair checks, views, chroma, noise, flat fields, networks, overview."""
