# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Opening sentences of a report: visibility, its uncertainty, and what limits it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import NamedTuple

from uw_visibility.config.assumptions import assumptions
from uw_visibility.errors import printable
from uw_visibility.optics.light_model import visibility_distance
from uw_visibility.plausibility.comparison import Verdict
from uw_visibility.replay.columns import word
from uw_visibility.replay.report.meaning import MEANINGS
from uw_visibility.replay.results.summary import (
    DISTANCE,
    OVER_FRAMES,
    WHOLE_FRAME,
    Summary,
)
from uw_visibility.replay.results.synopsis import TOLD, Synopsis
from uw_visibility.water.meaning.derived import QUANTITIES
from uw_visibility.water.series.tracking import TrackingEvent

# 1990, ns: clocks that were never set start in 1970 or 1980.
FIRST_DATE = 631_152_000 * 10**9
# Most reasons in a sentence; the table of refusals has all.
MOST_REASONS = 3
UNMATCHED = (
    "Stamps of left and right differ: trigger both cameras together, or raise "
    "synchronization.tolerance, to less than half of the time between images.")
WITHOUT_STAMP = "Let the driver fill header.stamp with the time of exposure."
CLOCK_NOT_SET = (
    "The recording's clock was not set: times do not show the time of day.")


class Frame(NamedTuple):
    """Frame named in a sentence, to be linked to its picture; `transect` only of several."""

    transect: str
    number: int

    def __str__(self) -> str:
        return ", ".join([self.transect] * bool(self.transect) + [f"frame {self.number}"])


Sentence = list[str | Frame]


def verdict(summary: Summary) -> list[Sentence]:
    """Return the opening sentences, each in parts; none without a synopsis."""
    synopsis = summary.synopsis
    if synopsis is None:
        return []
    if not synopsis.frames:
        dropped = ", ".join(f"{why} ({count})" for why, count in summary.dropped.most_common())
        texts = ["There are no frames, so that nothing can be said about the water."]
        texts += [f"Images that are in no frame: {dropped}."] if dropped else []
        texts += [UNMATCHED] if "unmatched" in dropped else []
        texts += [WITHOUT_STAMP] if "without a stamp" in dropped else []
        return [[text] for text in texts]
    found = [_seen(synopsis)]
    if synopsis.told:
        found += [_headline(synopsis)] if synopsis.typical else []
        found += [_distance(synopsis), _trust(synopsis)]
    if summary.provenance:
        found.append([assumed(summary)])
    if synopsis.start < FIRST_DATE:
        found.append([CLOCK_NOT_SET])
    if synopsis.gap:
        before, after = synopsis.gap
        found.append([
            f"Most of this time has no frames, {time_span(before, after)}: a camera was off, "
            "or the clock was set in between."])
    if sensor := disagreement(summary):
        found.append([
            f"The depth sensor disagrees with the colour of daylight: {sensor}, "
            "see plausibility_reason in frames.csv."])
    refused = _refused(summary, synopsis)
    return [*found, *([refused] if refused else []), *filtering(summary)]


def disagreement(summary: Summary) -> str:
    """Say in how many frames the depth sensor disagrees; empty if in none."""
    return ", ".join(
        f"{each} in {amount(count, 'frame')}" for each in (Verdict.ERROR, Verdict.WARN)
        if (count := summary.counts["plausibility"][word(each)]))


def assumed(summary: Summary) -> str:
    """Return the assumptions about camera and light of a recording."""
    baselines = () if summary.synopsis is None else summary.synopsis.baselines
    provenance = summary.provenance
    return assumptions(provenance["parameters"], provenance["told"], baselines)


def definition(contrast: float) -> str:
    """Return the definition of the distances."""
    disc = QUANTITIES["black_disc_visibility"]
    return (
        "Black-disc visibility is closest to what divers call visibility: "
        f"{_lower(disc.definition)} ({disc.source}). {disc.caveat} "
        "Visibility distance is the distance at which a white and a black patch side by side have "
        f"a Michelson contrast of {100.0 * contrast:g} %, in front of open water as bright as the "
        "white patch (it is larger if the water is darker): ln((1 + C)/(2C))/β = "
        f"{formula(contrast)}, where C is that contrast and β the attenuation of the clearest "
        "channel (Roser, Dunbabin and Geiger 2014, eq. 12). It is not Koschmieder's distance of a "
        "black object in front of open water, ln(1/C)/c = "
        f"{number(math.log(1.0 / contrast), 2)}/c (Duntley 1963)."
    )


class Told(NamedTuple):
    """Quantity of a verdict: value with its interval, and definition."""

    name: str
    title: str
    value: str
    what: str


def headline(typical: Mapping[str, Sequence[float]], paper: str) -> list[Told]:
    """Return the main quantities with their intervals.

    typical: 16, 50 and 84 % quantiles of those of `TOLD` that are known, by name.
    paper: definition of visibility distance: formula and channel.
    """
    found = []
    for name in (name for name in TOLD if name in typical):
        title, unit, what = "visibility distance", "m", paper
        if name in QUANTITIES:
            title, what = QUANTITIES[name].title, _lower(QUANTITIES[name].definition)
            unit = QUANTITIES[name].unit.replace("m-1", "1/m")
        low, middle, high = typical[name]
        digits = f".{len(number(0.5 * (high - low), 1).partition('.')[2])}f"
        value = f"{middle:{digits}} {unit} ({low:{digits}} to {high:{digits}})"
        found.append(Told(name, title, value, what))
    return found


def formula(contrast: float) -> str:
    """Return visibility distance as a short formula, such as ``2.35/β``."""
    return f"{visibility_distance(1.0, contrast):.3g}/β"


def time_span(start: int, end: int) -> str:
    """Return the span between two stamps, ns, as text; what both have in common is told once."""
    first, last = (f"{datetime.fromtimestamp(stamp / 1e9, UTC):%Y-%m-%d %H:%M:%S}"
                   for stamp in (start, end))
    if first == last:
        return f"{first} UTC"
    return f"{first} to {last.removeprefix(first[:11])} UTC"


def clock(stamp: int) -> str:
    """Return a stamp, ns, as time of day (UTC)."""
    return f"{datetime.fromtimestamp(stamp / 1e9, UTC):%H:%M:%S} UTC"


def _seen(synopsis: Synopsis) -> Sentence:
    span = time_span(synopsis.start, synopsis.end)
    when = f"from {span}" if " to " in span else f"at {span}"
    if not synopsis.told:
        return [
            f"Visibility could not be assessed in any of {amount(synopsis.frames, 'frame')}, "
            f"{when}."
        ]
    where = ""
    if synopsis.ranges:
        low, high = synopsis.ranges
        where = f", over ranges from {number(low, 2)} to {number(high, 2)} m"
    if not synopsis.assessed:
        return [
            f"None of {synopsis.frames} frames has a visibility distance of its own; taken "
            f"together, {synopsis.told} have one, {when}{where}."
        ]
    return [
        f"Visibility was assessed in {share(synopsis.assessed, synopsis.frames)}, {when}{where}."
    ]


def _headline(synopsis: Synopsis) -> Sentence:
    paper = f"{formula(synopsis.contrast)} of {_channels(synopsis)}"
    paper += ", filtered over frames" if synopsis.filtered else ""
    parts = "; ".join(
        f"{each.title} {each.value}: {each.what}" for each in headline(synopsis.typical, paper))
    return [
        f"{parts[0].upper()}{parts[1:]}. In brackets: 16th to 84th percentile of the median frame."]


def _distance(synopsis: Synopsis) -> Sentence:
    low, high = synopsis.lowest, synopsis.highest
    assert low is not None and high is not None
    worst, best = Frame(low.transect, low.frame), Frame(high.transect, high.frame)
    apart, others = "", ""
    if synopsis.filtered and synopsis.rejected_distances:
        least, most = map(number, synopsis.rejected_distances)
        shown = f"{least} m" if least == most else f"{least} to {most} m"
        apart = f" Distances of frames that the filter rejected: {shown}."
        others = "that the filter accepted "
    apart = f"{course(synopsis)}{apart}"
    if synopsis.told == 1:
        return [
            f"Visibility distance was {rounded(low.value, low.stddev)} m in ", worst, f".{apart}"]
    if not synopsis.differs:
        spread = synopsis.relative_stddev * synopsis.median
        constant = synopsis.constant and synopsis.assessed == synopsis.frames
        where = "throughout" if constant else "in the median frame"
        text = (
            f"Visibility distance was {rounded(synopsis.median, spread)} m {where}: differences "
            f"between frames {others}are within the standard deviations.")
        if worst == best:
            # The most certain frame may have both the lowest upper and the highest lower bound.
            return [f"{text}{apart}"]
        return [
            f"{text} Lowest, {number(low.value)} m, in ", worst,
            f"; highest, {number(high.value)} m, in ", best, f".{apart}",
        ]
    return [
        f"Visibility distance was from {rounded(low.value, low.stddev)} m to "
        f"{rounded(high.value, high.stddev)} m, median {number(synopsis.median)} m; worst in ",
        worst, ", best in ", best, f".{apart}",
    ]


def course(synopsis: Synopsis) -> str:
    """Say whether the distance has two values, rises or falls; empty if neither."""
    # The filter smooths both, so that its extremes may lie within.
    single = synopsis.filtered and synopsis.assessed > 0
    if synopsis.groups:
        (low, few), (high, many) = synopsis.groups
        return (
            f" {'Single frames' if single else 'Frames'} fall into two groups, {number(low)} m in "
            f"{few} and {number(high)} m in {many}: at most one of them is right, unless the water "
            "differed between them.")
    if synopsis.trend:
        first, last = synopsis.trend
        return (
            f" It {'rises' if last > first else 'falls'}: median of the first third of the "
            f"{'single frames' if single else 'frames'} {number(first)} m, of the last third "
            f"{number(last)} m (Kendall's test, beyond 2 σ).")
    return ""


def _trust(synopsis: Synopsis) -> Sentence:
    text = (
        f"Uncertainty: the standard deviation is {percentage(synopsis.relative_stddev)} in the "
        "median frame. It includes noise and what the scene leaves open, but not a wrong "
        "calibration or camera setting."
    )
    low, high = synopsis.lowest, synopsis.highest
    assert low is not None and high is not None
    if synopsis.differs and (synopsis.low < low.value or synopsis.high > high.value):
        text += (
            " The choice of the worst and the best frame allows for one standard deviation; "
            f"90 % of the distances are from {number(synopsis.low)} to "
            f"{number(synopsis.high)} m."
        )
    if synopsis.ranges and synopsis.median > synopsis.ranges[1]:
        text += (
            f" Nothing was seen beyond {number(synopsis.ranges[1], 2)} m: the distance assumes the "
            "same water farther away."
        )
    if synopsis.filtered and synopsis.assessed and synopsis.told > synopsis.assessed:
        bridged = synopsis.told - synopsis.assessed
        own = "has no distance of its own, but" if bridged == 1 else "have none of their own, but"
        text += f" {amount(bridged, 'frame')} {own} that of other frames: "
        text += "changes of the water in between are not detected."
    return [text]


def _refused(summary: Summary, synopsis: Synopsis) -> Sentence:
    missing = synopsis.frames - (synopsis.assessed if synopsis.told else 0)
    if not missing:
        return []
    refused = {WHOLE_FRAME, DISTANCE} if synopsis.told else {WHOLE_FRAME, DISTANCE, OVER_FRAMES}
    counts: Counter[str] = Counter()
    for refusal in summary.refusals:
        if refused.intersection(refusal.what.split(", ")):
            counts[refusal.why] += refusal.count
    reasons = counts.most_common()
    text = (
        f"Reasons why visibility could not be assessed from {amount(missing, 'frame')} alone, with "
        "numbers of frames: ")
    text += "; ".join(_reason(*each) for each in reasons[:MOST_REASONS])
    more = len(reasons) - MOST_REASONS
    return [text + (f"; and {more} further reasons." if more > 0 else ".")]


def _reason(reason: str, count: int) -> str:
    """Return a reason with its count and, of a status, the meaning."""
    meant = MEANINGS.get(reason, "")
    why = printable(reason)
    if meant:
        # The remedy is in the table.
        why = why.partition(" (")[0]
    text = f"{why} ({count})"
    return f"{text}, that is: {_lower(meant).rstrip('.')}" if meant else text


def filtering(summary: Summary) -> list[Sentence]:
    """Return sentences on the filter over frames, and on surveys."""
    found: list[Sentence] = []
    events = {event: summary.counts["filtering"][word(event)] for event in TrackingEvent}
    rejected, runs = events[TrackingEvent.OUTLIER], events[TrackingEvent.RESTARTED]
    estimates = rejected + runs + events[TrackingEvent.STARTED] + events[TrackingEvent.UPDATED]
    if estimates:
        changes = f", and accepted {amount(runs, 'run')} of such frames as a change"
        found.append([
            f"The filter rejected {rejected or 'none'} of {amount(estimates, 'frame')}"
            f"{changes if rejected and runs else ''}."])
    elif not summary.counts["filtering"]:
        found.append(["Frames were not filtered over time."])
    if summary.survey:
        found.append([
            "Filtered water of {count} frames is from a survey: up to {frames} frames together, "
            "ranges from {range_min:.2f} to {range_max:.2f} m.".format(**summary.survey)])
    return found


def _lower(text: str) -> str:
    return text[0].lower() + text[1:]


def _channels(synopsis: Synopsis) -> str:
    """Name the channels that visibility distance is taken from."""
    counts = sorted(synopsis.channels.items(), key=lambda item: -item[1])
    if not counts:
        return "the clearest channel"
    if len(counts) == 1:
        return f"{counts[0][0]}, the clearest channel"
    named = ", ".join(f"{name} in {amount(count, 'frame')}" for name, count in counts)
    return f"the clearest channel: {named}"


def rounded(value: float, stddev: float) -> str:
    """Return a value, with the digits that its standard deviation allows, and that if known."""
    if not math.isfinite(stddev):
        return number(value)
    spread = number(stddev, 2)
    return f"{value:.{len(spread.partition('.')[2])}f} ± {spread}"


def number(value: float, digits: int = 3) -> str:
    """Return a number with so many significant digits, without exponent."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    decimals = max(digits - 1 - math.floor(math.log10(abs(value))), 0)
    return f"{value:.{decimals}f}"


def share(part: int, whole: int) -> str:
    """Return a share as text; 100 % only for all, 0 % never."""
    if part == whole:
        return {1: "the only frame", 2: "both frames"}.get(whole, f"all {whole} frames")
    percent = min(max(100.0 * part / whole, 1.0), 99.0)
    return f"{part} of {whole} frames ({percent:.0f} %)"


def amount(count: int, thing: str) -> str:
    """Return a count with its noun, singular or plural."""
    return f"{count} {thing}" if count == 1 else f"{count} {thing}s"


def percentage(part: float) -> str:
    return f"{number(100.0 * part, 2)} %"
