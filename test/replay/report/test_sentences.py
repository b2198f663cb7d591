# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The sentences that a result opens with are true, and name what they should."""

from __future__ import annotations

import json
import math
import re
import sys
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from frame_records import frame_estimate, frame_record, write_table

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.optics.light_model import visibility_distance
from uw_visibility.plausibility.comparison import Verdict
from uw_visibility.replay.columns import COLUMNS
from uw_visibility.replay.records import JoinedFrame
from uw_visibility.replay.report.report import quantities
from uw_visibility.replay.report.sentences import definition, number, rounded, verdict
from uw_visibility.replay.results.provenance import Origin
from uw_visibility.replay.results.summary import Summary
from uw_visibility.replay.table import read_table
from uw_visibility.status import Status
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.assessment import Visibility
from uw_visibility.water.meaning.derived import QUANTITIES, DerivedQuantities
from uw_visibility.water.observations import Envelopes
from uw_visibility.water.series.filter import FilteredWater
from uw_visibility.water.series.survey import SurveyEstimate
from uw_visibility.water.series.tracking import TrackingEvent

BASE = 1_700_000_000.0


def envelope(low: float, high: float) -> Envelopes:
    nothing = np.zeros((3, 1))
    return Envelopes(
        np.ones(1), np.ones(1, np.int64), nothing, nothing, nothing, nothing, nothing,
        np.zeros(3), np.zeros(3), False, limits=(low, high),
    )


def seen(
    number: int, distance: float, stddev: float = 0.1, *, reach: tuple[float, float] = (1.0, 9.0),
    status: Status = Status.OK, filtered: float | None = None,
    event: TrackingEvent = TrackingEvent.UPDATED, survey: SurveyEstimate | None = None,
) -> JoinedFrame:
    """Frame with a distance, or without (NaN), and what a filter makes of it."""
    estimate = frame_estimate(
        status, status=status, distance=distance, distance_stddev=stddev + 0.0 * distance,
        distance_low=distance - stddev, distance_high=distance + stddev)
    estimate = replace(estimate, water=replace(estimate.water, envelope=envelope(*reach)))
    of_filter = None
    if filtered is not None:
        visibility = Visibility(
            Status.OK, Status.OK, distance=filtered, distance_stddev=stddev,
            distance_low=filtered - stddev, distance_high=filtered + stddev)
        of_filter = FilteredWater(estimate.water, visibility, event, survey=survey)
    derived = DerivedQuantities(
        black_disc_visibility=0.8 * distance, black_disc_visibility_stddev=0.08 * distance,
        secchi_depth=0.7 * distance, secchi_depth_stddev=0.14 * distance)
    return JoinedFrame(
        frame_record(BASE + number, number, estimate=estimate), of_filter, derived=derived)


def told(*frames: JoinedFrame, contrast: float = 0.05) -> tuple[list[str], Summary]:
    """Sentences of frames, as text."""
    summary = Summary("bag", "out")
    baselines = {frame.record.estimate.rig.baseline for frame in frames if frame.record.estimate}
    with tempfile.TemporaryDirectory() as folder:
        summary.read(
            read_table(write_table(Path(folder), frames), COLUMNS), contrast, baselines)
    return ["".join(map(str, parts)) for parts in verdict(summary)], summary


def told_again(summary: Summary, folder: Path, *frames: JoinedFrame) -> list[str]:
    """Sentences of a finished result, by its state and its table."""
    origin = Origin("bag", "of its files", "1.0", summary.provenance["parameters"])
    state = json.loads(json.dumps(summary.state(origin)))
    again = Summary.of_finished("bag", "out", state, write_table(folder, frames))
    return ["".join(map(str, parts)) for parts in verdict(again)]


def test_when_where_and_how_far_one_could_see() -> None:
    distances = [8.0, 8.1, 8.0, 6.0, 4.0, 4.05, 7.0, 7.9]
    frames = [seen(k, d, reach=(0.5 + k, 3.0 + k)) for k, d in enumerate(distances)]
    sentences, summary = told(*frames)
    assert sentences[0] == (
        "Visibility was assessed in all 8 frames, from 2023-11-14 22:13:20 to 22:13:27 UTC, "
        "over ranges from 0.50 to 10 m.")
    assert sentences[2].startswith(
        "Visibility distance was from 4.00 ± 0.10 m to 8.10 ± 0.10 m, median 7.45 m")
    assert "2.35/β of green, the clearest channel" in sentences[1]
    assert "so beyond one" not in sentences[3]
    assert sentences[2].endswith("worst in frame 4, best in frame 1.")
    assert "beyond" not in sentences[3]
    linked = [part.number for part in verdict(summary)[2] if not isinstance(part, str)]
    assert linked == [4, 1]
    assert sentences[-1] == "Frames were not filtered over time."


def test_the_black_disc_and_the_distance_of_the_paper_stand_side_by_side() -> None:
    sentences, summary = told(seen(0, 10.0, 2.0), seen(1, 10.0, 2.0), seen(2, 30.0, 6.0))
    # Of a factor exp(0.1) and exp(0.2) up and down; Kd is not known.
    assert sentences[1].startswith(
        "Black-disc visibility 8.0 m (7.2 to 8.8): horizontal distance at which a diver loses")
    assert QUANTITIES["black_disc_visibility"].definition[1:] in sentences[1]
    assert ("; visibility distance 10 m (8 to 12): 2.35/β of green, the clearest channel; Secchi "
            "depth 7 m (6 to 9): depth at which a white disk disappears from view" in sentences[1])
    assert sentences[1].endswith(" In brackets: 16th to 84th percentile of the median frame.")
    columns = {name: np.full(3, math.nan) for name in COLUMNS}
    rows = quantities(columns, summary, "2.35/β")
    assert [row["value"] for row in rows] == [
        "8.0 m (7.2 to 8.8)", "10 m (8 to 12)", "7 m (6 to 9)"]
    assert rows[0]["what"].startswith("horizontal distance at which a diver")
    assert rows[0]["source"] == QUANTITIES["black_disc_visibility"].source
    assert (rows[1]["title"], rows[1]["what"]) == (
        "visibility distance", "2.35/β of the clearest channel")


def test_a_value_that_is_hardly_known_is_neither_worst_nor_best() -> None:
    sentences, _ = told(seen(0, 6.0), seen(1, 40.0, 35.0), seen(2, 8.0), seen(3, 1.0, 9.0))
    assert sentences[2].startswith("Visibility distance was from 6.00 ± 0.10 m to 8.00 ± 0.10 m")
    assert sentences[2].endswith("worst in frame 0, best in frame 2.")
    # The page shows the quantiles too, which lie beyond.
    assert ("allows for one standard deviation; 90 % of the distances are from 1.75 to "
            "35.2 m." in sentences[3])


def test_one_frame_does_not_differ_from_itself() -> None:
    sentences, _ = told(seen(0, 6.0))
    assert sentences[0].startswith(
        "Visibility was assessed in the only frame, at 2023-11-14 22:13:20 UTC, over")
    assert sentences[2] == "Visibility distance was 6.00 ± 0.10 m in frame 0."
    sentences, _ = told(seen(0, math.nan, status=Status.TOO_DARK), seen(1, 6.0))
    assert sentences[2] == "Visibility distance was 6.00 ± 0.10 m in frame 1."


def test_what_differs_within_sigma_is_no_change() -> None:
    distances = (6.05, 6.0, 6.08, 6.02, 6.06, 5.98)
    sentences, _ = told(*(seen(k, distance) for k, distance in enumerate(distances)))
    assert sentences[2].startswith("Visibility distance was 6.04 ± 0.10 m throughout")
    assert sentences[2].endswith("within the standard deviations. Lowest, 5.98 m, in frame 5; "
        "highest, 6.08 m, in frame 2.")
    # The most certain frame is neither the lowest nor the highest.
    sentences, _ = told(seen(0, 6.2, 0.9), seen(1, 6.0, 0.1), seen(2, 5.9, 0.9))
    assert sentences[2].endswith("within the standard deviations.")


def test_estimates_that_jump_or_rise_within_sigma_are_not_called_constant() -> None:
    noise = np.exp(0.05 * np.random.default_rng(0).normal(size=40))
    jumping = np.where(np.arange(40) % 3 == 0, 9.0, 25.0) * noise
    sentences, summary = told(*(seen(k, d, 0.5 * d) for k, d in enumerate(jumping)))
    assert summary.synopsis is not None and not summary.synopsis.differs
    assert "throughout" not in sentences[2]
    found = re.search(
        r"Frames fall into two groups, (\S+) m in 14 and (\S+) m in 26:", sentences[2])
    assert found
    assert [float(value) for value in found.groups()] == pytest.approx([9.0, 25.0], rel=0.05)
    rising = np.geomspace(9.0, 14.0, 40) * noise
    sentences, summary = told(*(seen(k, d, 0.5 * d) for k, d in enumerate(rising)))
    assert summary.synopsis is not None and not summary.synopsis.differs
    assert "throughout" not in sentences[2] and "groups" not in sentences[2]
    assert re.search(r" It rises: median of the first third of the frames (9|10)\.", sentences[2])
    sentences, _ = told(*(seen(k, d, 0.5 * d, filtered=10.0) for k, d in enumerate(rising)))
    assert " It rises: median of the first third of the single frames " in sentences[2]
    sentences, _ = told(*(seen(k, d, 0.5 * d, filtered=10.0) for k, d in enumerate(jumping)))
    assert " Single frames fall into two groups, " in sentences[2]
    sentences, _ = told(*(seen(k, d, 0.5 * d) for k, d in enumerate(12.0 * noise)))
    assert "throughout" in sentences[2] and "rise" not in sentences[2]


def test_what_was_carried_over_frames_that_saw_nothing_is_not_said_of_them() -> None:
    """Water that has become too murky to match is not as clear as before."""
    blind = [
        seen(k, math.nan, status=Status.TOO_FEW_SUPPORT_POINTS, filtered=6.0,
             event=TrackingEvent.PREDICTED) for k in range(1, 9)]
    sentences, _ = told(seen(0, 6.0, filtered=6.0, event=TrackingEvent.STARTED), *blind)
    assert sentences[2].startswith(
        "Visibility distance was 6.00 ± 0.10 m in the median frame: ")
    assert "throughout" not in "".join(sentences)
    sentences, _ = told(*blind)
    assert sentences[2].startswith("Visibility distance was 6.00 ± 0.10 m in the median frame: ")


def test_nothing_assessed_is_said_first_and_why() -> None:
    sentences, summary = told(
        *(seen(k, math.nan, status=Status.RANGE_SPREAD_TOO_SMALL) for k in range(3)),
        JoinedFrame(frame_record(BASE + 3.0, 3, reason="too dark")),
    )
    assert sentences[0] == ("Visibility could not be assessed in any of 4 frames, from "
                            "2023-11-14 22:13:20 to 22:13:23 UTC.")
    assert sentences[1].startswith(
        "Reasons why visibility could not be assessed from 4 frames alone, with numbers of frames: "
        "range spread too small (3), that is: everything")
    assert "too dark (1)" in sentences[1]
    assert "%" not in "".join(sentences)
    assert summary.synopsis is not None and summary.synopsis.assessed == 0
    sentences, summary = told()
    assert sentences == ["There are no frames, so that nothing can be said about the water."]
    summary.dropped["left image unmatched"] = 4
    sentences = ["".join(map(str, parts)) for parts in verdict(summary)]
    assert sentences[1] == "Images that are in no frame: left image unmatched (4)."
    assert "raise synchronization.tolerance" in sentences[2]
    summary.dropped = Counter({"left image without a stamp": 4})
    sentences = ["".join(map(str, parts)) for parts in verdict(summary)]
    assert sentences[2:] == ["Let the driver fill header.stamp with the time of exposure."]


def test_a_frame_refused_is_a_share_below_all() -> None:
    frames = [seen(k, 6.0) for k in range(999)]
    sentences, _ = told(*frames, seen(999, math.nan, status=Status.TOO_DARK))
    assert "in 999 of 1000 frames (99 %)" in sentences[0]
    assert any(
        s.startswith("Reasons why visibility could not be assessed from 1 frame alone, with "
                     "numbers of frames: too dark (1)") for s in sentences)


def test_what_lies_beyond_all_that_was_seen_is_said_to_be_extrapolated() -> None:
    sentences, _ = told(seen(0, 20.0), seen(1, 20.0))
    assert "Nothing was seen beyond 9.0 m" in sentences[3]
    assert "the standard deviation is 0.50 % in the median frame" in sentences[3]
    assert "not a wrong calibration or camera setting" in sentences[3]


@pytest.mark.parametrize("start", [0.0, 5e5, 315_964_800.0])
def test_times_of_a_clock_that_was_not_set_are_not_those_of_the_day(
    start: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.modules[__name__], "BASE", start)
    assert any("clock was not set" in sentence for sentence in told(seen(0, 6.0))[0])
    monkeypatch.setattr(sys.modules[__name__], "BASE", 1.7e9)
    assert not any("clock" in sentence for sentence in told(seen(0, 6.0))[0])


def test_a_clock_that_is_set_forward_makes_no_day_of_a_short_recording() -> None:
    day = 86400
    sentences, _ = told(*(seen(k + day * (k > 3), 8.0) for k in range(8)))
    assert (
        "Most of this time has no frames, 2023-11-14 22:13:23 to 2023-11-15 22:13:24 UTC: a "
        "camera was off, or the clock was set in between.") in sentences
    # Neither steady frames nor one that is missing.
    for times in (range(8), (0, 1, 2, 4, 5), (0, 10), (0, 1, 3)):
        assert not any("no frames" in sentence for sentence in told(
            *(seen(k, 8.0) for k in times))[0]), times


def test_numbers_say_in_how_many_frames_they_are_known() -> None:
    """A depth of a single frame of many is not that of the recording."""
    nan = math.nan
    columns = {name: np.full(12, nan) for name in COLUMNS}
    columns["depth"][3], columns["depth_stddev"][3] = 2.0, 0.5
    columns["mean_attenuation"][:5], columns["mean_attenuation_stddev"][:5] = 0.3, 0.1
    _, summary = told(seen(0, 6.0), seen(1, nan, status=Status.TOO_DARK), seen(2, 6.0))
    texts = [row["what"] for row in quantities(columns, summary, "2.35/β")][-2:]
    assert texts[0].endswith("median of 5 of 12 frames, 0.300 to 0.300 1/m in 90 % of them")
    assert texts[1] == "by the colour of daylight; in 1 of 12 frames"
    columns["depth"][:] = 2.0
    texts = [row["what"] for row in quantities(columns, summary, "2.35/β")]
    assert texts[-1] == (
        "by the colour of daylight; median, 2.00 to 2.00 m in 90 % of the frames")


def test_a_depth_sensor_that_disagrees_is_told_in_the_verdict() -> None:
    verdicts = (Verdict.NOT_ASSESSABLE, Verdict.OK, Verdict.WARN, Verdict.ERROR, Verdict.ERROR)
    frames = [replace(seen(k, 6.0), verdict=each) for k, each in enumerate(verdicts)]
    sentences, _ = told(*frames)
    assert ("The depth sensor disagrees with the colour of daylight: error in 2 frames, warning in "
            "1 frame, see plausibility_reason in frames.csv.") in sentences
    sentences, _ = told(*frames[:2])
    assert "sensor" not in "".join(sentences)


def test_what_is_assumed_of_camera_and_light_is_said(tmp_path: Path) -> None:
    _, summary = told(seen(0, 6.0))
    summary.provenance = {"parameters": PipelineConfig().to_parameters(), "told": []}
    sentences = ["".join(map(str, parts)) for parts in verdict(summary)]
    (said,) = [s for s in sentences if "transfer linear (assumed; --transfer srgb for video)" in s]
    assert said.endswith("baseline 0.12 m.")
    # A finished recording that is told again says the same.
    assert told_again(summary, tmp_path, seen(0, 6.0)) == sentences


def test_the_filter_and_surveys_are_told() -> None:
    event = TrackingEvent
    sentences, _ = told(
        seen(0, 5.0, filtered=6.0, event=event.STARTED), seen(1, 9.0, filtered=6.1),
        seen(2, 1.0, filtered=6.2, event=event.OUTLIER),
        seen(3, math.nan, status=Status.NO_TEXTURE, filtered=6.3, event=event.PREDICTED),
    )
    assert "from 6.00 ± 0.10 m to 6.30 ± 0.10 m" in sentences[2]
    assert "filtered over frames" in sentences[1]
    assert ("1 frame has no distance of its own, but that of other frames: changes of the water in "
            "between are not detected." in sentences[3])
    assert "The filter rejected 1 of 3 frames." in sentences
    sentences, _ = told(seen(0, 5.0, filtered=6.0, event=event.STARTED))
    assert sentences[-1] == "The filter rejected none of 1 frame."
    together = SurveyEstimate(frame_estimate().water, 30, 20.0, 1.6, 2.2)
    sentences, _ = told(*(
        seen(k, math.nan, status=Status.RANGE_SPREAD_TOO_SMALL, filtered=6.0,
             event=event.SURVEYED, survey=together) for k in range(2)))
    assert sentences[0].startswith("None of 2 frames has a visibility distance of its own; taken "
                                   "together, 2 have one")
    assert sentences[0].endswith("over ranges from 1.6 to 2.2 m.")
    assert sentences[-1].startswith("Filtered water of 2 frames is from a survey: up to 30")


def test_frames_that_the_filter_rejected_are_not_called_alike() -> None:
    frames = [seen(k, 39.0, 9.0, filtered=39.0) for k in range(3)]
    passing = [
        seen(3 + k, d, filtered=math.nan, event=TrackingEvent.OUTLIER)
        for k, d in enumerate((15.4, 8.3))
    ]
    sentences, _ = told(*frames, *passing)
    assert "differences between frames that the filter accepted are within" in sentences[2]
    assert sentences[2].endswith(
        "Distances of frames that the filter rejected: 8.30 to 15.4 m.")
    sentences, _ = told(*frames)
    assert "differences between frames are within" in sentences[2]
    assert "rejected" not in sentences[2]


def test_the_definition_is_that_of_the_code() -> None:
    for contrast in (0.02, 0.05, 0.1):
        found = re.search(r"= ([\d.]+)/β", definition(contrast))
        assert found
        assert float(found[1]) == pytest.approx(visibility_distance(1.0, contrast), abs=0.005)
    assert "a Michelson contrast of 5 %" in definition(0.05)
    assert "in front of open water as bright as the white patch" in definition(0.05)
    assert "ln(1/C)/c = 3.0/c" in definition(0.05)


def test_a_finished_result_is_told_as_before(tmp_path: Path) -> None:
    outlier = seen(2, 2.0, filtered=6.0, event=TrackingEvent.OUTLIER)
    for frames in (
        [seen(0, 4.0), seen(1, 8.0)], [seen(0, math.nan, status=Status.TOO_DARK)], [],
        [seen(1, 6.0, filtered=6.0), outlier],
    ):
        _, summary = told(*frames)
        summary.provenance = {"parameters": PipelineConfig().to_parameters(), "told": []}
        sentences = ["".join(map(str, parts)) for parts in verdict(summary)]
        assert told_again(summary, tmp_path, *frames) == sentences


@pytest.mark.parametrize("value, text", [
    (0.0, "0"), (0.01234, "0.0123"), (9.999, "10.00"), (12.34, "12.3"), (1234.0, "1234"),
    (math.inf, "inf"),
])
def test_numbers_have_no_exponents(value: float, text: str) -> None:
    assert number(value) == text


def test_a_value_has_the_digits_that_its_deviation_allows() -> None:
    assert rounded(4.1312, 1.9) == "4.1 ± 1.9"
    assert rounded(123.4, 25.0) == "123 ± 25"
    assert rounded(6.1234, 0.012) == "6.123 ± 0.012"


def test_what_frames_refute_together_is_not_told_of_those_that_show_it_alone() -> None:
    """Two frames of a night pass for daylight."""
    night = WaterEstimate.not_assessable(Status.LIT_BY_LAMPS)
    refused = Visibility(Status.LIT_BY_LAMPS, Status.LIT_BY_LAMPS)
    frames = []
    for k, distance in enumerate([math.nan, 60.0, math.nan, 65.0]):
        status = Status.OK if math.isfinite(distance) else Status.LIT_BY_LAMPS
        frames.append(replace(seen(k, distance, status=status), filtered=FilteredWater(
            night, refused, TrackingEvent.NOT_ASSESSABLE)))
    sentences, summary = told(*frames)
    assert sentences[0].startswith("Visibility could not be assessed in any of 4 frames")
    assert any("numbers of frames: lit by lamps: set lighting.model (4)" in s for s in sentences)
    assert not any("60" in sentence for sentence in sentences)
    assert summary.synopsis is not None and summary.synopsis.told == 0
