# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Summary of an evaluation as text for a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from uw_visibility.evaluation.cases import IMAGES, MATCHES, READINGS
from uw_visibility.evaluation.degrade import title_of
from uw_visibility.evaluation.depth_edges import DISTANCE, MAPS
from uw_visibility.evaluation.methods import of_kind
from uw_visibility.evaluation.summary import TURBID, Summary
from uw_visibility.evaluation.tables import number

# Places that are listed of one reason; evaluation.json has them all.
PLACES_SHOWN = 4
TRANSECT = {"pipeline": "", "tracked": ", filtered", "exact": ", exact ranges"}
SHORT_MATCHES = (
    "SGBM", "CLAHE+", "oracle+", "ours raw", "ours", "true w.",
    *(name[:8] for name in of_kind("matcher")),
)
SHORT_IMAGES = (
    "input", "hist.", "CLAHE", "step 1", "final", "oracle",
    *(name[:6] for name in of_kind("restorer")),
)


def as_text(summary: Summary) -> str:
    """Return the summary as tables for a terminal.

    Returns
    -------
    str
        Lines of up to 100 columns, but for lists of places.
    """
    parts = []
    if summary["cases"]:
        parts += [
            f"{summary['cases']} cases: {', '.join(summary['scenes'])}",
            _water(summary), _disparity(summary), _colour(summary), _conditions(summary),
            _unmatched(summary), _noise(summary["noise"]), _depth_edges(summary),
            _not_assessed(summary["water"]),
        ]
    if summary["transect"] is not None:
        parts.append(_transect(summary["transect"]))
    return "\n\n".join(part for part in parts if part)


def _water(summary: Summary) -> str:
    lines = [
        _line("mean attenuation |α̂ − α| [1/m]", "mean", "worst", "assessed"),
        *_error_lines(summary, "mean_attenuation_error", READINGS, 4),
        "",
        _line(f"visibility distance, relative, α ≥ {TURBID:g}", "mean", "worst", "assessed"),
        *_error_lines(summary, "distance_relative_error_turbid", ("pipeline", "exact"), 3),
        "",
        _line("depth |ẑ − z| [m]", "mean", "worst", "assessed"),
        *_error_lines(summary, "depth_error", ("pipeline", "exact"), 3),
        "",
        _line("normalised errors of β within", "1 σ", "2 σ", "of"),
    ]
    for name in ("pipeline", "exact"):
        within = summary["water"][name]["attenuation_within"]
        lines.append(_line(
            f"  {READINGS[name]}", number(within["1_sigma"], 2), number(within["2_sigma"], 2),
            str(within["of"]),
        ))
    return "\n".join(lines)


def _error_lines(summary: Summary, field: str, names: Any, digits: int) -> list[str]:
    lines = []
    for name in names:
        errors = summary["water"][name][field]
        line = _error_line(READINGS[name], errors, digits)
        where = errors["worst_at"]
        lines.append(f"{line}  {where}" if where else line)
    return lines


def _error_line(title: str, errors: Summary, digits: int) -> str:
    return _line(
        f"  {title}", number(errors["mean"], digits), number(errors["worst"], digits),
        f"{errors['assessed']}/{errors['of']}",
    )


def _disparity(summary: Summary) -> str:
    lines = [_line("disparity, mean share of pixels", "correct", "unmatched", "")]
    for name, title in MATCHES.items():
        found = summary["disparity"][name]
        lines.append(_line(
            f"  {title}", number(found["correct"], 3), number(found["unmatched"], 3), ""
        ))
    return "\n".join(lines)


def _colour(summary: Summary) -> str:
    lines = [_line("colour difference ΔE*ab to the scene in air", "mean", "", "of")]
    for name, title in IMAGES.items():
        found = summary["colour_difference"][name]
        lines.append(_line(
            f"  {title}", number(found["mean"], 2), "", f"{found['assessed']}/{summary['cases']}"
        ))
    return "\n".join(lines)


def _conditions(summary: Summary) -> str:
    """Means over the scenes for each water."""
    lines = [
        f"{'mean over the scenes':14s}{'correct disparities':>32s}{'ΔE*ab':>34s}",
        _row("α", "z", SHORT_MATCHES, SHORT_IMAGES),
    ]
    for condition in summary["conditions"]:
        lines.append(_row(
            f"{condition['mean_attenuation']:.3g}", f"{condition['depth']:g}",
            [number(condition["disparity"][name]["correct"], 3) for name in MATCHES],
            [number(condition["colour_difference"][name]["mean"], 1) for name in IMAGES],
        ))
    return "\n".join(lines)


def _unmatched(summary: Summary) -> str:
    lines = [
        "unmatched, largest over α (Fig. 6; the paper: 0.92 and 0.72 conventional, 0.23 its own)",
        f"  {'scene':16s}{'z':>4s} {''.join(f'{name:>9s}' for name in SHORT_MATCHES)}"
        f"{'above true w.':>15s}",
    ]
    for place in summary["unmatched"]:
        values = "".join(f"{number(place['largest'][name], 3):>9s}" for name in MATCHES)
        lines.append(
            f"  {place['scene']:16s}{place['depth']:4g} {values}"
            f"{number(place['above_oracle'], 3):>15s}"
        )
    return "\n".join(lines)


def _noise(rows: Sequence[Summary]) -> str:
    """Means over the scenes for each noise and α."""
    if not rows:
        return ""
    names = list(MATCHES)
    lines = [
        f"noise at z = {rows[0]['depth']:g} m, mean over the scenes: correct, wrong among matched",
        f"{'α':>5s} {'':20s}{''.join(f'{name:>9s}' for name in SHORT_MATCHES)}{'|α̂ − α|':>12s}",
    ]
    for row in rows:
        for what in ("correct", "wrong"):
            values = "".join(
                f"{number(row['disparity'][name][what], 3):>9s}" for name in names)
            first = what == "correct"
            error = number(row["mean_attenuation_error"]["pipeline"], 4) if first else ""
            left = f"{row['mean_attenuation']:5.3g} {title_of(row['noise']) if first else '':20s}"
            lines.append(f"{left if first else ' ' * len(left)}{values}{error:>10s}".rstrip())
    return "\n".join(lines)


def _depth_edges(summary: Summary) -> str:
    """Errors within a few pixels of true depth edges, and elsewhere."""
    lines = [
        f"{f'within {DISTANCE} px of depth edges / elsewhere':46s}{'disparity [px]':>20s}"
        f"{'ΔE*ab':>20s}"
    ]
    for name, errors in summary["depth_edges"].items():
        disparity, colour = (
            f"{number(errors[f'{what}_near'], 2)} / {number(errors[f'{what}_elsewhere'], 2)}"
            for what in ("disparity", "colour")
        )
        lines.append(f"  {MAPS[name]:44s}{disparity:>20s}{colour:>20s}")
    return "\n".join(lines if len(lines) > 1 else [])


def _not_assessed(water: Summary) -> str:
    lines = []
    for name, title in READINGS.items():
        known = water[name]["not_assessed"]
        for what in ("", "distance", "depth"):
            for reason, places in water[name][f"{what}_not_assessed".lstrip("_")].items():
                # What stops the estimate stops the rest: only what is lacking beyond it is new.
                more = [place for place in places if not what or place not in known.get(reason, ())]
                if more:
                    subject = f"{what}, {title}" if what else title
                    lines.append(f"  {subject}: {reason}, {len(more)} x: {_places(more)}")
    return "\n".join(["not assessed" if lines else "not assessed: none", *lines])


def _places(places: Sequence[str]) -> str:
    more = len(places) - PLACES_SHOWN
    shown = "; ".join(places[:PLACES_SHOWN])
    return f"{shown}; and {more} more" if more > 0 else shown


def _transect(transect: Summary) -> str:
    lines = [_line(f"transect of {transect['frames']} frames", "mean", "worst", "assessed")]
    for name, how in TRANSECT.items():
        for field, title, digits in (
            ("mean_attenuation_error", "|α̂ − α| [1/m]", 4),
            ("distance_relative_error", "visibility distance, relative", 3),
            ("depth_error", "|ẑ − z| [m]", 3),
        ):
            lines.append(_error_line(f"{title}{how}", transect[name][field], digits))
        within = transect[name]["mean_attenuation_within"]
        shares = (number(within[f"{k}_sigma"], 2) for k in (1, 2, 3))
        lines.append(f"  α within 1 / 2 / 3 σ{how}: {' / '.join(shares)}")
        change = number(transect[name]["frame_to_frame"], 4)
        lines.append(f"  error of α from frame to frame, rms{how}: {change} 1/m")
        for reason, places in transect[name]["not_assessed"].items():
            lines.append(f"  not assessed{how}: {reason}, {len(places)} x")
    return "\n".join(lines)


def _line(title: str, first: str, second: str, third: str) -> str:
    return f"{title:46s}{first:>9s}{second:>11s}{third:>10s}".rstrip()


def _row(attenuation: str, depth: str, matches: Sequence[str], images: Sequence[str]) -> str:
    left = "".join(f"{value:>9s}" for value in matches)
    right = "".join(f"{value:>7s}" for value in images)
    return f"{attenuation:>5s}{depth:>4s} {left} {right}"
