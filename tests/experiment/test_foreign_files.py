"""Files as instruments and programs write them: what they say, and which are refused."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import pytest

import zeno_orbits as zo
from zeno_orbits.errors import DataFileError, InputError
from zeno_orbits.experiment import description_of, read_recording

G = 9.80665
DEGREE = 0.017453292519943295


class Foreign(NamedTuple):
    """A file, what its user says of it, and its times and signals by hand."""

    text: str | bytes
    notes: zo.ColumnNotes
    time: tuple[float, float]
    signals: Mapping[str, tuple[str, float, float]]


PLAIN = zo.ColumnNotes()
FILES = {
    "phyphox": Foreign(
        '"Time (s)","Acceleration z (m/s^2)"\n0.000E0,9.81E0\n1.0E-2,1.9E1\n',
        PLAIN,
        (0.0, 0.01),
        {"Acceleration z": ("m/s^2", 9.81, 19.0)},
    ),
    "phyphox with decimal commas": Foreign(
        '"Time (s)";"Gyroscope x (rad/s)"\n0,000E0;1,5E0\n2,5E-2;-1,5E0\n',
        PLAIN,
        (0.0, 0.025),
        {"Gyroscope x": ("rad/s", 1.5, -1.5)},
    ),
    "acceleration in g": Foreign(
        "t (ms),accel_x (g)\n0,1\n10,-2.5\n",
        PLAIN,
        (0.0, 0.01),
        {"accel_x": ("m/s^2", G, -2.5 * G)},
    ),
    "mass in g": Foreign(
        "t (ms),load (g)\n0,1\n10,2\n", PLAIN, (0.0, 0.01), {"load": ("kg", 0.001, 0.002)}
    ),
    "Tracker": Foreign(
        "mass_A\t\t\nt\tx\ty\n0.0\t0.10\t1.00\n0.033\t0.12\t0.95\n",
        zo.ColumnNotes(units={"t": "s", "x": "m", "y": "m"}),
        (0.0, 0.033),
        {"x": ("m", 0.1, 0.12), "y": ("m", 1.0, 0.95)},
    ),
    "a video in pixels": Foreign(
        "frame,y_px\n100,512\n101,500\n",
        zo.ColumnNotes(
            names={"y_px": "height"},
            units={"height": "-0.5 mm"},
            zeros={"height": 512.0},
            frame_rate=200.0,
        ),
        (0.5, 0.505),
        {"height": ("m", 0.0, 0.006)},
    ),
    "rows as frames": Foreign(
        "x [mm],y [mm]\n1,2\n3,4\n",
        zo.ColumnNotes(frame_rate=50.0),
        (0.0, 0.02),
        {"x": ("m", 0.001, 0.003), "y": ("m", 0.002, 0.004)},
    ),
    "an oscilloscope with a preamble": Foreign(
        "Model,TBS1072\nFirmware,v1.2\nHorizontal Units,s\n\nTIME,CH1\n-0.01,0.04\n-0.008,4.96\n",
        zo.ColumnNotes(units={"TIME": "s", "CH1": "V"}),
        (-0.01, -0.008),
        {"CH1": ("V", 0.04, 4.96)},
    ),
    "a preamble of numbers": Foreign(
        "Model,TBS1072\nRecord Length,2500\nInterval,4e-6\nTrigger,0.5\nTIME,CH1\n"
        "-0.01,0.04\n-0.008,4.96\n-0.006,4.9\n",
        zo.ColumnNotes(units={"TIME": "s", "CH1": "V"}),
        (-0.01, -0.006),
        {"CH1": ("V", 0.04, 4.9)},
    ),
    "an oscilloscope with values beside its preamble": Foreign(
        "Record Length,2500,Points,-0.001,0.5,\nInterval,4e-6,s,-0.0009,0.6,\n,,,-0.0008,0.7,\n",
        zo.ColumnNotes(names={"4": "time", "5": "CH1"}, units={"time": "s", "CH1": "V"}),
        (-0.001, -0.0008),
        {"CH1": ("V", 0.5, 0.7)},
    ),
    "units in a line below the titles": Foreign(
        "Source,CH1\nSecond,Volt\n-0.007,0.024\n-0.006,0.025\n",
        zo.ColumnNotes(names={"Source": "time"}),
        (-0.007, -0.006),
        {"CH1": ("V", 0.024, 0.025)},
    ),
    "units in brackets below the titles": Foreign(
        "time\tangle\n(ms)\t(deg)\n0\t90\n5\t-90\n",
        PLAIN,
        (0.0, 0.005),
        {"angle": ("rad", 90 * DEGREE, -90 * DEGREE)},
    ),
    "counts of a sampler": Foreign(
        "X,CH1,Start,Increment,\nSequence,Volt,-1.0e-3,2.0e-6,\n0,0.4,,\n1,0.5,,\n",
        zo.ColumnNotes(names={"1": "time", "2": "CH1"}, units={"time": "2e-6 s", "CH1": "V"}),
        (0.0, 2e-6),
        {"CH1": ("V", 0.4, 0.5)},
    ),
    "a spreadsheet that names its separator": Foreign(
        "sep=;\ntime [s];angle [deg]\n0;1,5\n1;2,5\n",
        PLAIN,
        (0.0, 1.0),
        {"angle": ("rad", 1.5 * DEGREE, 2.5 * DEGREE)},
    ),
    "a measurement with a long head": Foreign(
        "Writer_Version\t2\nSeparator\tTab\n***End_of_Header***\t\n"
        "Channels\t2\t\nX_Value\tVoltage\tComment\n0.0\t1.0\t\n0.1\t2.0\t\n",
        zo.ColumnNotes(names={"X_Value": "time"}, units={"time": "s", "Voltage": "V"}),
        (0.0, 0.1),
        {"Voltage": ("V", 1.0, 2.0)},
    ),
    "a microcontroller without titles": Foreign(
        "1000,512\n1010,540\n1020,533\n",
        zo.ColumnNotes(
            names={"1": "time", "2": "angle"},
            units={"time": "ms", "angle": "0.25 deg"},
            zeros={"time": 1000.0, "angle": 512.0},
        ),
        (0.0, 0.02),
        {"angle": ("rad", 0.0, 21 * 0.25 * DEGREE)},
    ),
    "a logic analyser": Foreign(
        "Time[s], Channel 0\n0.000000000, 0\n0.000125000, 1\n",
        zo.ColumnNotes(names={"Channel 0": "contact"}, units={"contact": "1"}),
        (0.0, 0.000125),
        {"contact": ("1", 0.0, 1.0)},
    ),
    "columns of text": Foreign(
        "time [s],state,angle [rad],note\n0,idle,1,\n1,run,2,late\n",
        PLAIN,
        (0.0, 1.0),
        {"angle": ("rad", 1.0, 2.0)},
    ),
    "empty columns": Foreign(
        "time [s],angle [rad],\n0,1,\n1,2,\n", PLAIN, (0.0, 1.0), {"angle": ("rad", 1.0, 2.0)}
    ),
    "an encoder and a motor": Foreign(
        "t [us]\tenc [counts]\tpwm [%]\n0\t0\t50\n1000\t1024\t-50\n",
        zo.ColumnNotes(units={"enc": "0.087890625 deg", "pwm": "0.24 V"}),
        (0.0, 0.001),
        {"enc": ("rad", 0.0, 90 * DEGREE), "pwm": ("V", 12.0, -12.0)},
    ),
    # Head of Siglent's SDS series, as the README of SigFyCSV (M. Cowen) quotes it.
    "Siglent, units in place of titles": Foreign(
        "Record Length,Analog:14000\nSample Rate,100000000.0\nVertical Scale,CH1: 0.05\n"
        "Vertical Offset,CH1:0.00000\nHorizontal Scale, 0.000010000\nSecond,Volt\n"
        "-0.0007,-0.194\n-0.0006,-0.192\n",
        PLAIN,
        (-0.0007, -0.0006),
        {"Volt": ("V", -0.194, -0.192)},
    ),
    "PicoScope": Foreign(
        "Time,Channel A,Channel B\n(ms),(V),(mV)\n\n-5.0,0.1,200\n-4.9,0.2,-200\n",
        PLAIN,
        (-0.005, -0.0049),
        {"Channel A": ("V", 0.1, 0.2), "Channel B": ("V", 0.2, -0.2)},
    ),
    "PicoScope in German": Foreign(
        "Zeit;Kanal A\n(ms);(V)\n\n-5,0;0,1\n-4,9;0,2\n",
        zo.ColumnNotes(names={"Zeit": "time"}),
        (-0.005, -0.0049),
        {"Kanal A": ("V", 0.1, 0.2)},
    ),
    "LeCroy": Foreign(
        "LECROYWR104Xi,12345,Waveform\nSegments,1,SegmentSize,3\n"
        "Segment,TrigTime,TimeSinceSegment1\n#1,17-Mar-2024 11:50:45,0\nTime,Ampl\n"
        "-0.5,0.1\n-0.4,0.2\n-0.3,0.25\n",
        zo.ColumnNotes(units={"Time": "s", "Ampl": "V"}),
        (-0.5, -0.3),
        {"Ampl": ("V", 0.1, 0.25)},
    ),
    "Tektronix MDO": Foreign(
        "Model,MDO3024\nFirmware Version,1.26\n,\nPoint Format,Y\nHorizontal Units,s\n"
        "Sample Interval,4e-08\nRecord Length,10000\nVertical Units,V\nVertical Position,-1\n"
        ",,\n,,\nTIME,CH1\n-2.0e-04,0.04\n-1.9e-04,0.08\n",
        zo.ColumnNotes(units={"TIME": "s", "CH1": "V"}),
        (-2.0e-4, -1.9e-4),
        {"CH1": ("V", 0.04, 0.08)},
    ),
    # National Instruments, Specification for the LabVIEW Measurement File: tags, two ends of
    # headers, and a last column `Comment` that lines of values may lack.
    "LabVIEW": Foreign(
        "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\n"
        "Multi_Headings\tYes\nDate\t2010/06/15\nTime\t14:12:23.5\n***End_of_Header***\t\n\t\n"
        "Channels\t2\t\t\nSamples\t3\t3\t\nX0\t0.0E+0\t0.0E+0\t\nDelta_X\t0.001\t0.001\t\n"
        "***End_of_Header***\t\t\t\nX_Value\tVoltage_0\tVoltage_1\tComment\n"
        "0.000\t1.0\t2.0\n0.001\t1.1\t2.1\n0.002\t1.2\t2.2\n",
        zo.ColumnNotes(
            names={"X_Value": "time"}, units={"time": "s", "Voltage_0": "V", "Voltage_1": "V"}
        ),
        (0.0, 0.002),
        {"Voltage_0": ("V", 1.0, 1.2), "Voltage_1": ("V", 2.0, 2.2)},
    ),
    "LabVIEW with decimal commas": Foreign(
        "Separator\tTab\nDecimal_Separator\t,\n***End_of_Header***\t\nChannels\t1\nX0\t0,0E+0\n"
        "Delta_X\t0,001\n***End_of_Header***\t\nX_Value\tVoltage\tComment\n"
        "0,000\t1,0\t\n0,001\t1,1\t\n0,002\t1,2\t\n",
        zo.ColumnNotes(names={"X_Value": "time"}, units={"time": "s", "Voltage": "V"}),
        (0.0, 0.002),
        {"Voltage": ("V", 1.0, 1.2)},
    ),
    # Three lines of titles: scorer, bodyparts, coords.
    "DeepLabCut": Foreign(
        "scorer,D,D,D\nbodyparts,ball,ball,ball\ncoords,x,y,likelihood\n"
        "0,101.5,201.5,0.99\n1,102.5,199.5,0.98\n",
        zo.ColumnNotes(
            names={"coords": "frame"}, units={"x": "mm", "y": "-0.5 mm"}, frame_rate=100.0
        ),
        (0.0, 0.01),
        {"x": ("m", 0.1015, 0.1025), "y": ("m", -0.10075, -0.09975)},
    ),
    "DeepLabCut, two body parts": Foreign(
        "scorer,D,D,D,D\nbodyparts,ball,ball,bar,bar\ncoords,x,y,x,y\n0,1,2,3,4\n1,5,6,7,8\n",
        zo.ColumnNotes(
            names={"coords": "frame", "5": "height"}, units={"height": "mm"}, frame_rate=100.0
        ),
        (0.0, 0.01),
        {"height": ("m", 0.004, 0.008)},
    ),
    # Saleae, Binary and CSV Export Formats: `X` where a channel has no data.
    "Saleae": Foreign(
        "Time [s],Channel 0,Channel 1\n0.0,0,1\n0.000125,1,X\n0.000225,0,1\n",
        zo.ColumnNotes(
            names={"Channel 0": "contact.a", "Channel 1": "contact.b"},
            units={"contact.a": "1", "contact.b": "1"},
        ),
        (0.0, 0.000225),
        {"contact.a": ("1", 0.0, 0.0), "contact.b": ("1", 1.0, 1.0)},
    ),
    # The README of hantek-dso2000 (P. Marek): a number of the sample before the time.
    "Hantek": Foreign(
        "nr,time,ch1,ch2\n0,0,-0.16,-0.02\n1,2e-05,-0.16,-0.02\n2,4e-05,-0.08,-0.02\n",
        zo.ColumnNotes(units={"time": "s", "ch1": "V", "ch2": "V"}),
        (0.0, 4e-5),
        {"ch1": ("V", -0.16, -0.08), "ch2": ("V", -0.02, -0.02)},
    ),
    "marks and a minus sign of other programs": Foreign(
        "time [s],x [m]\n0,\N{MINUS SIGN}1.5\n0.1,--\n0.2,1.#QNAN\n0.3,2.5\n",
        PLAIN,
        (0.0, 0.3),
        {"x": ("m", -1.5, 2.5)},
    ),
    "MATLAB": Foreign(
        "time,angle\n0,1\n0.01,NaN\n0.02,1.5e+00\n",
        zo.ColumnNotes(units={"time": "s", "angle": "rad"}),
        (0.0, 0.02),
        {"angle": ("rad", 1.0, 1.5)},
    ),
    "a script with OpenCV": Foreign(
        "frame,x,y\n0,1.5,NA\n1,1.6,2.5\n",
        zo.ColumnNotes(frame_rate=25.0, units={"x": "mm"}),
        (0.0, 0.04),
        {"x": ("m", 0.0015, 0.0016)},
    ),
    "Kinovea": Foreign(
        "Time (ms);Trajectory 1/0 Y\n0;2\n33;2,2\n",
        zo.ColumnNotes(units={"Trajectory 1/0 Y": "cm"}),
        (0.0, 0.033),
        {"Trajectory 1/0 Y": ("m", 0.02, 0.022)},
    ),
    "Vernier": Foreign(
        "Latest: Time (s),Latest: Position (m)\n0,1.0\n0.05,0.99\n",
        zo.ColumnNotes(names={"Latest: Time": "time", "Latest: Position": "height"}),
        (0.0, 0.05),
        {"height": ("m", 1.0, 0.99)},
    ),
    "Excel, Unicode text": Foreign(
        "time [s]\tx [m]\r\n0,0\t1,5\r\n0,1\t2,5\r\n".encode("utf-16"),
        PLAIN,
        (0.0, 0.1),
        {"x": ("m", 1.5, 2.5)},
    ),
    "Excel, CSV UTF-8": Foreign(
        "\ufefftime [s];angle [°]\n0,0;1,5\n0,1;2,5\n",
        PLAIN,
        (0.0, 0.1),
        {"angle": ("rad", 1.5 * DEGREE, 2.5 * DEGREE)},
    ),
    "signs of units": Foreign(
        "Time (µs),Acceleration x (m/s²)\n0,1\n10,2\n".encode("latin-1"),
        PLAIN,
        (0.0, 1e-5),
        {"Acceleration x": ("m/s^2", 1.0, 2.0)},
    ),
    "other ends of lines": Foreign(
        "time [s],x [m]\r\n0,1\r\n1,2\r\n", PLAIN, (0.0, 1.0), {"x": ("m", 1.0, 2.0)}
    ),
}


@pytest.mark.parametrize("name", FILES)
def test_a_file_is_read_as_its_instrument_meant_it(name: str, tmp_path: Path) -> None:
    file, path = FILES[name], tmp_path / "data.csv"
    path.write_bytes(file.text if isinstance(file.text, bytes) else file.text.encode())
    found = description_of(path, columns=file.notes)
    assert found.recording is not None, found.trouble
    recording = found.recording
    assert (recording.time[0], recording.time[-1]) == pytest.approx(file.time, rel=1e-12)
    assert set(recording.names) == set(file.signals)
    for signal, (unit, first, last) in file.signals.items():
        values = recording.signal(signal)
        assert values.unit == unit
        assert (values.values[0], values.values[-1]) == pytest.approx((first, last), rel=1e-12)
    # A recording that is written is read alike.
    zo.write_recording(recording, tmp_path / "again.csv")
    again = read_recording(tmp_path / "again.csv")
    assert again.signals == recording.signals
    assert again.time.tolist() == recording.time.tolist()


REFUSED = {
    "pixels": ("time [s],y [px]\n0,1\n1,2\n", PLAIN, "the unit of column `y` is not clear: `px`"),
    "no unit": ("t,x [m]\n0,1\n1,2\n", PLAIN, "column `t` lacks a unit"),
    "no time": ("x [m],y [m]\n0,1\n1,2\n", PLAIN, "no column named `time`"),
    "dates": ("time,x [m]\n12:00:01,1\n12:00:02,2\n", PLAIN, "column `time` holds text"),
    "dates of a spreadsheet": (
        "time [s];x [m]\n01.02.2024 12:00:00;1,5\n01.02.2024 12:00:01;1,6\n",
        PLAIN,
        "write seconds since the start",
    ),
    "stamps of a serial monitor": (
        "12:00:01.123 -> 1000,512\n12:00:01.133 -> 1010,540\n",
        zo.ColumnNotes(names={"1": "time", "2": "a"}, units={"time": "ms", "a": "deg"}),
        "write seconds since the start",
    ),
    "labels of a serial plotter": (
        "angle:1.0,speed:2.0\nangle:1.1,speed:2.2\n",
        PLAIN,
        "line 1 names a quantity beside each number",
    ),
    "two segments": (
        "X_Value\tx [m]\tComment\n0.0\t1.0\t\n0.1\t1.1\t\n\nChannels\t1\n"
        "X_Value\tx [m]\tComment\n0.0\t1.0\t\n0.1\t1.1\t\n",
        PLAIN,
        "line 2 has values above the titles in line 6: split the file there",
    ),
    "thousands separators": (
        "time [s];x [m]\n0;1.234,5\n1;1.2,5\n",
        PLAIN,
        "`1.234,5` .* write it without thousands separators",
    ),
    "two decimal points": ("time [s],x [m]\n0,1..2\n1,1\n", PLAIN, "`1..2` .* correct or empty"),
    "a title with more words": (
        "Latest: Time (s),x (m)\n0,1\n1,2\n",
        PLAIN,
        "rename `Latest: Time` to `time`",
    ),
    "spaces": ("time x\n0 1\n1 2\n", PLAIN, "must separate its columns"),
    "no titles": ("0,1\n1,2\n", PLAIN, "numbers in place of the column titles"),
    "a page": ("<html><body>data</body></html>\n", PLAIN, "it is a web page"),
    "text": ("Dear reader, this is\nno table, at all.\n", PLAIN, "no column named `time`"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_missing_is_named(name: str, tmp_path: Path) -> None:
    text, notes, reason = REFUSED[name]
    path = tmp_path / "data.csv"
    path.write_text(text)
    with pytest.raises(DataFileError, match=reason):
        read_recording(path, columns=notes)


def test_rows_that_are_changes_of_channels_are_named(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    path.write_text("time [s],contact [1]\n0,0\n0.3,1\n0.301,0\n0.5,1\n0.502,0\n")
    assert any("rows are changes" in word for word in read_recording(path).remarks)
    path.write_text("time [s],contact [1]\n0,0\n0.1,1\n0.2,1\n0.3,0\n0.4,1\n")
    assert read_recording(path).remarks == ()


def test_broken_utf_16_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    path.write_bytes("time [s],x [m]\n0,1\n1,2\n".encode("utf-16")[:-1])
    with pytest.raises(DataFileError, match="broken UTF-16 text; save it as UTF-8"):
        read_recording(path)


WRONG = {
    "an unknown title": ({"names": {"z": "x"}}, "Argument `names`: unknown"),
    "a number beyond the last": ({"names": {"9": "x"}}, "Argument `names`: unknown"),
    "an unknown quantity": ({"units": {"z": "m"}}, "Argument `units`: unknown"),
    "no unit": ({"units": {"x": "furlong"}}, "Argument `units`: `furlong` is not a unit"),
    "no size": ({"units": {"x": "0 m"}}, "Argument `units` has for `x` a unit of size 0"),
    "an infinite size": ({"units": {"x": "1e999 m"}}, "Argument `units` has for `x` a unit of"),
    "an infinite zero": ({"zeros": {"x": float("inf")}}, r"zeros\[x\]"),
    "a rate": ({"frame_rate": -1.0}, "Argument `frame_rate` must be a positive number"),
}


@pytest.mark.parametrize("name", WRONG)
def test_notes_that_do_not_fit_are_refused(name: str, tmp_path: Path) -> None:
    given, reason = WRONG[name]
    path = tmp_path / "data.csv"
    path.write_text("time [s],x [m]\n0,1\n1,2\n")
    with pytest.raises(InputError, match=reason):
        description_of(path, columns=zo.ColumnNotes(**given))


@pytest.mark.parametrize(
    ("wrong", "column"), [("2,lost", "x"), ("lost,2", "time"), ("lost,lost", "time")]
)
@pytest.mark.parametrize("after", ["", "3,4\n4,5\n"])
def test_a_wrong_line_among_values_stays_an_error(
    wrong: str, column: str, after: str, tmp_path: Path
) -> None:
    path = tmp_path / "data.csv"
    path.write_text(f"time [s],x [m]\n0,1\n1,2\n{wrong}\n{after}")
    with pytest.raises(DataFileError, match=f"line 4 has `lost` where column `{column}"):
        read_recording(path)


def test_values_above_a_wrong_line_are_not_left_out(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    path.write_text("1000,512\n1010,lost\n1020,533\n1030,540\n")
    notes = zo.ColumnNotes(names={"1": "time", "2": "a"}, units={"time": "ms", "a": "deg"})
    with pytest.raises(DataFileError, match="line 1 holds numbers in place of the column titles"):
        read_recording(path, columns=notes)
