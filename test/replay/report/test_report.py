# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The report holds everything itself, and says what was not assessable and why."""

from __future__ import annotations

import base64
import io
import json
import re
import sys
from collections.abc import Iterator, Sequence
from html.parser import HTMLParser
from pathlib import Path
from time import sleep

import cv2
import numpy as np
import pytest
import tqdm.std
from bag_copies import FRAMES, Message, copy_bag, parameter_file, run
from numpy.typing import NDArray

from uw_visibility.compute.jit import counts
from uw_visibility.replay import progress
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.columns import COLUMNS
from uw_visibility.replay.inputs.sensors import ScalarTopic
from uw_visibility.replay.report import figures
from uw_visibility.replay.report.figures import MOST_POINTS, draw_series
from uw_visibility.replay.report.gallery import ColourScale
from uw_visibility.replay.report.meaning import MEANINGS, REMEDIES, meaning
from uw_visibility.replay.report.report import fit_joins
from uw_visibility.replay.report.track import draw_tracks, round_length
from uw_visibility.replay.table import read_rows, read_table
from uw_visibility.status import Status
from uw_visibility.water.meaning import assessment


class Page(HTMLParser):
    """Elements and addresses of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.addresses: list[str] = []
        self.scripts: list[dict[str, str | None]] = []
        self.text = path.read_text(encoding="utf-8")
        self.feed(self.text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.scripts += [dict(attrs)] if tag == "script" else []
        self.addresses += [
            value or "" for name, value in attrs if name in ("src", "href", "data", "xlink:href")
        ]


def test_the_page_needs_no_network(replayed: Path) -> None:
    page = Page(replayed / "report.html")
    assert all(a.startswith(("data:", "#")) for a in page.addresses)
    assert not {"iframe", "object"} & set(page.tags)
    # Its own script asks for nothing and tells nobody.
    assert page.scripts == [{"type": "module"}]
    assert not re.search(r"@import|\bimport\b|url\((?!#)|fetch|XMLHttp|WebSocket|sendBeacon|"
                         r"localStorage|cookie|innerHTML", page.text)
    assert "svg" in page.tags


def views(text: str) -> dict[int, dict[str, NDArray[np.float64]]]:
    """Images of a page, by frame and what they show."""
    found: dict[int, dict[str, NDArray[np.float64]]] = {}
    for number, what, address in re.findall(
        r'<img alt="Frame (\d+): ([^"]*)"[^>]*base64,([^"]*)"', text
    ):
        data = np.frombuffer(base64.b64decode(address), np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_COLOR)
        found.setdefault(int(number), {})[what] = image.astype(float)
    return found


def test_pictures_show_raw_enhanced_and_disparity(replayed: Path) -> None:
    shown = views(Page(replayed / "report.html").text)
    assert 4 <= len(shown) <= FRAMES
    for images in shown.values():
        assert list(images) == [
            "left image as recorded", "left image without the water", "disparity"]
        raw, enhanced, disparity = images.values()
        assert raw.shape == enhanced.shape == disparity.shape == (120, 160, 3)
        # Water takes contrast, and the enhanced image has it back.
        assert enhanced.std() > raw.std()
        assert disparity.std(axis=2).mean() > 20.0


def test_colours_mean_the_same_disparity_in_all_pictures(replayed: Path) -> None:
    """A frame whose range of disparities is its own would have colours of its own."""
    with BagReader(replayed / "results.mcap") as reader:
        messages = [reader.deserialize(m) for m in reader.messages(["/disparity"])]
    text = Page(replayed / "report.html").text
    colours: dict[int, list[NDArray[np.float64]]] = {}
    for number, images in views(text).items():
        drawn = images["disparity"]
        tenths = (10.0 * messages[number].image.data.view(np.float32)).round().astype(int)
        tenths = tenths.reshape(120, 160)
        for value in np.unique(tenths[tenths > 0]):
            colours.setdefault(value, []).append(drawn[tenths == value].mean(axis=0))
    several = [np.ptp(seen, axis=0).max() for seen in colours.values() if len(seen) > 1]
    assert len(several) > 20
    assert max(several) < 16.0
    assert re.search(r"[\d.]+ px \([\d.]+ m\) or less", text)


def test_numbers_tables_and_parameters_are_there(replayed: Path, tmp_path: Path) -> None:
    text = Page(replayed / "report.html").text
    for words in (
        '<th scope="row">visibility distance</th>', "2.35/β of the clearest channel.",
        '<th scope="row">black-disc visibility</th>',
        "SHA-256", "stereo.max_disparity", "± ",
        "/depth_sensor",
    ):
        assert words in text
    assert "Partial result" not in text
    assert "could be used" not in text


def said(page: str) -> str:
    """The sentences that a page opens with, as text."""
    opening = re.search(r'<div class="verdict">(.*?)</div>', page, re.DOTALL)
    assert opening
    return " ".join(re.sub(r"<[^>]*>", "", opening[1]).split())


def test_the_report_opens_with_what_the_table_says(replayed: Path) -> None:
    page = Page(replayed / "report.html")
    rows = list(read_rows(replayed / "frames.csv"))
    filtered = [float(row["filtered_visibility_distance"]) for row in rows]
    opening = said(page.text)
    assert f"Visibility was assessed in all {FRAMES} frames, from 2023-11-14 22:13:20" in opening
    # The water becomes twice as turbid.
    found = re.search(
        r"distance was from ([\d.]+) ± [\d.]+ m to ([\d.]+) ± [\d.]+ m, median ([\d.]+) m", opening)
    assert found, opening
    assert [float(value) for value in found.groups()] == pytest.approx(
        [min(filtered), max(filtered), np.median(filtered)], rel=0.01)
    assert "The filter rejected none" in opening
    # Other rows of its table are not filtered, and have other medians.
    text = re.sub(r"\s+", " ", page.text)
    assert "Rows with brackets are filtered over frames, those with ± are of single frames." in text
    shown = re.search(r'mean attenuation α</th><td data-label="Value">([\d.]+) ±', text)
    single = [float(row["mean_attenuation"]) for row in rows]
    assert shown and float(shown[1]) == pytest.approx(np.median(single), rel=0.01)
    # Before any figure, and with its definition.
    places = [page.text.index(part) for part in ('"verdict"', 'id="definition"', "<svg")]
    assert places == sorted(places)
    linked = [address for address in page.addresses if address.startswith("#frame-")]
    assert linked
    assert all(f'id="{address[1:]}"' in page.text for address in linked)


def test_what_was_not_assessable_is_explained(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def grey(messages: Iterator[Message]) -> Iterator[Message]:
        for topic, kind, message, time in messages:
            if kind == "sensor_msgs/msg/Image":
                message.encoding, message.step = "mono8", message.width
                message.data = np.ascontiguousarray(message.data[1::3])
            yield topic, kind, message, time

    done = run(copy_bag(transect, tmp_path / "bag", edit=grey), tmp_path / "out", capsys=capsys)
    assert done.code == 0
    assert {row["status"] for row in done.rows} == {"no_colour"}
    assert {row["visibility_distance"] for row in done.rows} == {""}
    text = Page(tmp_path / "out" / "report.html").text
    assert MEANINGS[Status.NO_COLOUR] in text
    # The table has a word, and captions the sentence.
    assert re.search(r'id="caption-0">frame 0, [\d:]+ UTC: visibility distance: no colour<', text)
    assert said(text).startswith(f"Visibility could not be assessed in any of {FRAMES} frames")
    assert "not assessable" in text
    assert "100 %" not in text[:text.index("<figure")]
    opening = f"{tmp_path / 'bag'}: Visibility could not be assessed in any of"
    assert done.out.startswith(opening)
    again = run(tmp_path / "bag", tmp_path / "out", "--resume", capsys=capsys)
    assert again.out.startswith(done.out.partition("\n")[0])


def test_a_refused_distance_or_depth_is_told_though_the_water_was_assessed(
    transect: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(assessment, "MAX_RELATIVE_STDDEV", 1e-9)
    monkeypatch.setattr(assessment, "WIDEST_INTERVAL", 1.0)
    done = run(transect, tmp_path / "out", "--every", "3", capsys=capsys)
    assert {row["status"] for row in done.rows} == {"ok"}
    unbounded = "the depth is not assessable: ambient light unbounded"
    assert {row["plausibility_reason"] for row in done.rows} == {unbounded}
    text = Page(tmp_path / "out" / "report.html").text
    assert "UTC: visibility distance: attenuation too uncertain<" in text
    state = json.loads((tmp_path / "out" / "replay.json").read_text())
    for what, why in (
        ("visibility distance", "attenuation too uncertain"),
        ("depth by colour", "ambient light unbounded"),
        ("plausibility of the depth sensor", unbounded),
    ):
        assert f"not assessable: {what}: {why} (2), frames 0-3\n" in done.out
        row = (
            rf'row">{what}</th><td data-label="Why">{why}</td>\s*'
            r'<td class="n" data-label="Frames">2</td><td data-label="Which">0-3</td>')
        assert re.search(row, text)
        assert [r["count"] for r in state["not_assessable"] if r["what"] == what] == [2]


def test_frames_that_the_filter_rejected_are_told(
    dive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    params = parameter_file(tmp_path / "params.yaml", {
        "tracking.gate_probability": 0.5, "tracking.common_error": 0.0,
    })
    done = run(dive, tmp_path / "out", "--params-file", str(params), capsys=capsys)
    events = [row["filtering"] for row in done.rows]
    rejected, accepted = events.count("outlier"), events.count("restarted")
    assert rejected > 0
    told = f"The filter rejected {rejected} of {len(events)} frames"
    told += f", and accepted {accepted} run" * (accepted > 0)
    state = json.loads((tmp_path / "out" / "replay.json").read_text())
    assert state["filtering"]["outlier"] == rejected
    assert told in said(Page(tmp_path / "out" / "report.html").text)
    again = run(dive, tmp_path / "out", "--params-file", str(params), "--resume", capsys=capsys)
    assert told in done.out
    assert told in again.out


def test_every_reason_has_a_meaning_and_a_remedy() -> None:
    assert set(MEANINGS) == set(REMEDIES) == set(Status) - {Status.OK}
    assert meaning(str(Status.TOO_DARK)).endswith(REMEDIES[Status.TOO_DARK])
    assert meaning("ok") == meaning("unheard of") == ""


def test_frames_that_are_all_unusable_are_exit_code_1_with_the_reason(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def black(messages: Iterator[Message]) -> Iterator[Message]:
        for topic, kind, message, time in messages:
            if kind == "sensor_msgs/msg/Image":
                message.data = np.zeros_like(message.data)
            yield topic, kind, message, time

    with pytest.raises(SystemExit) as ended:
        run(copy_bag(transect, tmp_path / "bag", edit=black), tmp_path / "out")
    assert ended.value.code == 1
    assert "too dark" in capsys.readouterr().out
    assert "too dark" in Page(tmp_path / "out" / "report.html").text


def table(frames: int, **known: float | Sequence[float]) -> dict[str, NDArray[np.float64]]:
    """Columns of so many frames, of which these are known; a second lies between two frames."""
    columns = {name: np.full(frames, np.nan) for name in COLUMNS}
    columns["stamp"] = 1.7e9 + np.arange(frames)
    return columns | {name: np.zeros(frames) + values for name, values in known.items()}


@pytest.fixture
def visibility_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw the first of the figures over time alone."""
    monkeypatch.setattr(figures, "QUANTITIES", figures.QUANTITIES[:1])


@pytest.mark.parametrize("count", [1, MOST_POINTS + 1])
def test_the_series_is_drawn_whatever_is_known(count: int) -> None:
    columns = table(count)
    drawn = draw_series(columns)
    assert [each.title.partition(" ")[0] for each in drawn] == ["Visibility", "Mean", "Depth"]
    assert all("not assessable</text>" in each.drawing for each in drawn)
    columns |= {name: np.linspace(1.0, 2.0, count) for name in COLUMNS if name != "stamp"}
    drawn = draw_series(columns)
    assert len(drawn) == 4
    assert "not assessable" not in "".join(each.drawing for each in drawn)
    # More frames than can be told apart: what a point is is told where one points at it.
    assert drawn[0].together == (2 if count > MOST_POINTS else 1)
    assert ("<title>median of 2 frames about" in drawn[0].drawing) == (count > MOST_POINTS)
    # The same result has the same page.
    assert count > 1 or drawn == draw_series(columns)


def test_progress_is_a_line_every_ten_seconds(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [100.0]
    monkeypatch.setattr(tqdm.std, "time", lambda: now[0])
    shown = progress.Progress("dive", 600)
    # A minute of compiling says nothing of the time that frames take.
    now[0] += 60.0
    for _ in range(45):
        shown.add()
        now[0] += 0.5
    now[0] += 200.0
    shown.add()
    shown.close()
    lines = [" ".join(line.split()) for line in capsys.readouterr().err.split("\n")]
    assert lines[:2] == [
        "dive: 21 of 600 frames, 2.00 frames/s, 04:49 left",
        "dive: 41 of 600 frames, 2.00 frames/s, 04:39 left",
    ]
    # Slow frames have a rate, too, and the last line is that of all.
    assert [line for line in lines if line][-1] == (
        "dive: 46 of 600 frames, 0.20 frames/s, 45:39 left")


def test_compiling_is_told_long_before_the_first_period_is_over(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    # What is printed while capsys is read may be lost.
    told = io.StringIO()
    monkeypatch.setattr(sys, "stderr", told)
    monkeypatch.setattr(progress, "PERIOD", 3600.0)
    monkeypatch.setattr(progress, "LOOK", 0.01)
    with progress.compiling():
        monkeypatch.setattr(counts, "compiled", counts.compiled + 7)
        while "\n" not in told.getvalue():
            sleep(0.01)
        sleep(0.05)
    assert told.getvalue() == "compiling, kernels so far: 7\n"


def test_long_compiling_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    told = io.StringIO()
    monkeypatch.setattr(sys, "stderr", told)
    monkeypatch.setattr(progress, "PERIOD", 0.01)
    shown = progress.Progress("dive", 600)
    with progress.compiling():
        monkeypatch.setattr(counts, "compiled", counts.compiled + 7)
        while not all(
            line in told.getvalue()
            for line in ("kernels so far: 7\n", "dive: no frame is done yet")
        ):
            sleep(0.01)
    shown.close()
    # What is done in time, and what compiles nothing, is not told.
    before = told.getvalue()
    for _ in range(3):
        progress.Progress("dive", 1).close()
    with progress.compiling():
        sleep(0.05)
    assert told.getvalue() == before


def test_the_track_is_drawn_where_there_are_positions(replayed: Path) -> None:
    assert draw_tracks({"": table(5)}) == []
    assert 'id="map"' not in Page(replayed / "report.html").text
    # Some frames were not assessed, and one has no position; one stands still.
    places = (0.0, 1.0, 2.0, np.nan, 3.0)
    columns = table(5, visibility_distance=(5.0, np.nan, 7.0, 8.0, 9.0), x=places, y=places)
    (drawn,) = draw_tracks({"": columns})
    assert "x [m]" in drawn
    columns["longitude"], columns["latitude"] = np.full(5, 10.5), np.full(5, 60.0)
    place = draw_tracks({"": columns})[0]
    assert "longitude [°]" in place
    assert len(re.findall(r">\d m</text>", place)) == 2
    columns["latitude"] = 60.0 + np.arange(5) * 1e-3
    columns["longitude"] = 10.5 + np.arange(5) * 1e-3
    columns["mean_attenuation"] = np.full(5, 0.2)
    visibility, attenuation = draw_tracks({"": columns})
    assert "visibility distance [m]" in visibility
    assert "mean attenuation α [1/m]" in attenuation
    for word in ("start", "end", r"\d+ m"):
        assert len(re.findall(f">{word}</text>", visibility)) == 2


def test_labels_on_a_map_do_not_lie_on_one_another() -> None:
    """Recordings of a day often begin at one mooring, and their ends are near on its map."""
    def leg(x: float, length: float) -> dict[str, np.ndarray]:
        return table(4, x=np.linspace(x, x + length, 4), y=0.0)

    drawn = draw_tracks({
        "a": leg(0.0, 2.0), "b": leg(1.0, 500.0), "c": leg(1000.0, 3.0)})[0]
    labels = re.findall(r">([^<>]*(?:start|end))</text>", drawn.partition("plot narrow")[0])
    assert sorted(labels) == ["a, b start", "c start", "end"]
    drawn = draw_tracks({name: leg(0.0, 1.0) for name in "abcde"} | {"f": leg(500.0, 1.0)})[0]
    assert ">a, b, c and 2 more start</text>" in drawn


def test_a_track_across_the_date_line_is_short() -> None:
    longitude = (179.996, 179.999, -179.998, -179.995)
    (drawn,) = draw_tracks(
        {"": table(4, latitude=10.0, longitude=longitude, visibility_distance=5.0)})
    assert "1 track over 986 m by 0 m" in drawn
    # Degrees as charts have them.
    assert ">−179.995</text>" in drawn
    assert ">180.005</text>" not in drawn


def test_a_track_at_the_pole_has_a_map() -> None:
    columns = table(3, latitude=90.0, longitude=(0.0, 120.0, -120.0))
    assert "longitude [°]" in draw_tracks({"": columns})[0]


def test_no_axis_goes_above_the_surface(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figures, "QUANTITIES", figures.QUANTITIES[2:])
    drawn = draw_series(table(9, depth=1.3, depth_stddev=2.0))[0].drawing
    assert ">3</text>" in drawn
    assert ">−1</text>" not in drawn


def test_the_band_of_the_filtered_values_is_within_the_axis(visibility_alone: None) -> None:
    columns = table(
        9, frame=range(9), filtered_visibility_distance=4.0,
        filtered_visibility_distance_stddev=2.5)
    drawn = draw_series(columns)[0].drawing
    assert all(f">{metres}</text>" in drawn for metres in (2, 4, 6))


def test_a_figure_shows_clock_time_and_values_to_point_at() -> None:
    every = draw_series(table(
        9, stamp=1.7e9 + 60.0 * np.arange(9), frame=range(9),
        visibility_distance=np.linspace(5.0, 9.0, 9), visibility_distance_stddev=0.5,
        filtered_visibility_distance=7.0, filtered_visibility_distance_stddev=0.25))
    drawn = every[0].drawing
    for text in (">time (UTC)<", ">22:15<", ">2023-11-14<", ">filtered, ± 1 σ<"):
        assert text in drawn
    shown = "frame 2, 22:15:20 UTC; single frame 6.00 ± 0.50 m; filtered 7.00 ± 0.25 m"
    assert f"<title>{shown}</title>" in drawn
    assert "single frames: 9 of 9 known, from 5.00 to 9.00 m, median 7.00" in drawn
    # Nothing that two drawings of a page would both be called.
    names = re.findall(r'\bid="([^"]*)"', "".join(each.drawing for each in every))
    assert len(names) == len(set(names))
    used = re.findall(r'(?:href="|url\()#([^")]*)', drawn)
    assert used
    assert set(used) <= set(names)


def test_times_around_midnight_have_both_dates(visibility_alone: None) -> None:
    def dates(first: float) -> list[str]:
        drawn = draw_series(table(5, stamp=first + np.arange(5)))[0].drawing
        return re.findall(r">(20\d\d-[^<]*)</text>", drawn)

    midnight = 1_700_006_400.0
    assert set(dates(midnight - 2.0)) == {"2023-11-14 to 11-15"}
    assert set(dates(midnight)) == {"2023-11-15"}
    assert set(dates(1_704_067_198.0)) == {"2023-12-31 to 01-01"}


def test_times_are_within_the_drawing(visibility_alone: None) -> None:
    for stamps in ([1.7e9], 1.7e9 + 0.5 * np.arange(5)):
        drawn = draw_series(table(len(stamps), stamp=stamps))[0].drawing
        width = float(re.search(r'viewBox="0 0 (\d+)', drawn)[1])  # type: ignore[index]
        wide = drawn.partition("plot narrow")[0]
        places = [float(x) for x in re.findall(r'x="([\d.]+)"[^>]*>22:13:2[\d.]*</text>', wide)]
        # Half of 22:13:20 is 23 px wide.
        assert places
        assert all(x + 23.0 < width for x in places)


def told_of_fit(
    folder: Path, topic: ScalarTopic, beam: Sequence[float], stddev: float, values: Sequence[float]
) -> dict[str, str]:
    """What a report tells of the fit of a sensor's values to beam attenuations, one a second."""
    names = ("stamp", "beam_attenuation", "beam_attenuation_stddev", topic.column)
    rows = (f"{k},{b},{stddev},{v}" for k, (b, v) in enumerate(zip(beam, values, strict=True)))
    (folder / "frames.csv").write_text("\n".join([",".join(names), *rows]))
    (told,) = fit_joins(
        folder, read_table(folder / "frames.csv", dict.fromkeys(names, COLUMNS["depth"])), [topic])
    return told


BEAM = 0.1 + 0.02 * np.arange(20)


@pytest.mark.parametrize("stddev, left", [
    (0.05, "are within the standard deviations"), (1e-4, "are 0.01 beyond the standard deviations"),
])
def test_what_a_fit_leaves_is_told_beside_what_the_estimates_may_be_off_by(
    stddev: float, left: str, tmp_path: Path
) -> None:
    """A scatter of nothing would contradict the residuals in the figure beside it."""
    values = BEAM + 0.01 * (-1.0) ** np.arange(20)
    section = told_of_fit(tmp_path, ScalarTopic("/c"), BEAM, stddev, values)
    assert left in section["text"]
    assert "scatter 0" not in section["text"]


def test_too_few_values_for_a_fit_have_no_residuals(tmp_path: Path) -> None:
    section = told_of_fit(tmp_path, ScalarTopic("/t"), [0.1], 0.02, [0.2])
    assert "no fit" in section["figure"]
    assert "time (UTC)" not in section["figure"]


def test_what_falls_with_attenuation_is_drawn_with_its_deviations(tmp_path: Path) -> None:
    """Such as the transmission, in percent, that a transmissometer publishes."""
    section = told_of_fit(
        tmp_path, ScalarTopic("/t", unit="percent"), BEAM, 0.02, 90.0 - 20.0 * BEAM)
    assert section["text"].startswith("/t [percent] = (90 ± ")
    assert "+ (-20 ± " in section["text"]
    assert section["figure"].count("/t [percent]") > 0
    assert section["figure"].count("/t minus fit [percent]") > 0
    assert "Slope -20, intercept 90." in section["figure"]


def test_far_ranges_of_the_scale_have_no_exponents() -> None:
    assert ColourScale(0.3, 20.0, 400.0).describe(0.3) == "0.3 px (1333 m)"


@pytest.mark.parametrize("longest, length", [(3.2, 2.0), (5.0, 5.0), (0.99, 0.5), (1e4, 1e4)])
def test_a_scale_bar_has_a_round_length(longest: float, length: float) -> None:
    assert round_length(longest) == pytest.approx(length)


def test_a_recording_may_be_called_anything(visibility_alone: None) -> None:
    columns = table(3, x=range(3), y=range(3), visibility_distance=range(3))
    name = "<b> $x_{ \x1b[31m"
    drawn = draw_tracks({name: columns, "other": columns})[0]
    assert "&lt;b&gt; $x_{ " in drawn
    assert "\x1b" not in drawn
    series = {column: np.arange(3.0) for column in COLUMNS} | {"recording": np.zeros(3)}
    drawn = draw_series(series, [name])[0].drawing
    assert "<title>&lt;b&gt; $x_{ " in drawn
    assert "\x1b" not in drawn
