"""Text from files, wherever people get it: on one line, short, and nothing in it acts."""

import csv
import io
import json
import re
from typing import ClassVar
from unicodedata import category

import numpy as np
import pytest
import yaml
from test_logs import columns, write

from lbgc.data import logs
from lbgc.data.logconfig import LogConfig
from lbgc.data.static import Static
from lbgc.errors import InputError, build, require_name
from lbgc.learning.model import ModelConfig
from lbgc.outputs import LONGEST, as_csv, as_json, printable, shown
from lbgc.protocol import ProtocolConfig
from lbgc.report import figures
from lbgc.report.fitted_yaml import sensor_yaml
from lbgc.report.page import page_environment
from lbgc.sensor.datasheet import ImuConfig

EVIL = {
    "colour": "\x1b[31mred",
    "title": "\x1b]0;owned\x07",
    "eight bits": "\x9b2J",
    "delete": "a\x7fb",
    "back": "good\rEVIL",
    "line": "a\nerror: all is lost",
    "next line": "a\x85b",
    "separators": "a\u2028b\u2029c",
    "right to left": "\u202egpj.exe",
    "isolates": "\u2066a\u2069\u2067b",
    "marks": "a\u200e\u200f\u061cb",
    "no width": "me\u200ban\u200c\u200d\ufeff",
    "joiner": "a\u2060\u2061b\u034f",
    "soft hyphen": "me\u00adan",
    "fillers": "a\u3164\u115f\uffa0b",
    "blank": "\u2800\u2800",
    "selectors": "a\ufe0f\U000e0100",
    "tags": "a\U000e0041\U000e0042",
    "surrogate": "a\udcff",
    "no break": "a\u00a0b\u2003c",
    "null": "a\x00b",
    "private": "a\ue000b",
    "pile": "a" + "\u0301\u0302" * 20,
}
ACTS = re.compile("[\x00-\x1f\x7f-\x9f\u00ad\u034f\u061c\u115f\u200b-\u200f\u2028-\u202e\u2060-\u2069\u2800\u3164\ufe0f\ufeff\uffa0\ue000\udcff\U000e0041\U000e0100]|[\u0301\u0302]{4}")  # fmt: skip  # noqa: E501


@pytest.mark.parametrize("name", EVIL)
def test_what_acts_is_spelled_out(name):
    text = EVIL[name]
    assert not ACTS.search(shown(text))
    assert not ACTS.search(printable(text).replace("\n", ""))
    assert shown(shown(text)) == shown(text)
    assert not ACTS.search(str(InputError(text, text, "", text)))
    assert not ACTS.search(str(InputError("key", "x", "", [text, text])))


def test_what_does_not_act_stays():
    for text in ("Straße 90°, ±1 µrad", "北極星", "Ω = 7.29e-5", "a b", "x_40.csv", "Zoë", "שלום"):
        assert shown(text) == text == printable(text)
    for marked in ("Zoe\u0308", "ế".join("ab"), "שָׁלוֹם", "กำลังที่นี่", "a\u0301\u0302\u0303" * 9):
        assert shown(marked) == marked == printable(marked)


def test_marks_piled_upon_one_character_are_spelled_out():
    """Above (Mn) or around (Me) it: a fourth mark is text, and what follows it is as it was."""
    for mark, said in (("\u0301", "\\u0301"), ("\u0489", "\\u0489"), ("\U0001e8d0", "\\U0001e8d0")):
        assert printable(f"x{4 * mark}y{mark}") == f"x{3 * mark}{said}y{mark}"
    pile = printable("a" + "\u0316\u20dd" * 50)
    assert sum(category(c) in ("Mn", "Me") for c in pile) == 3


@pytest.mark.parametrize("text", ["x" * 10**6, "\x1b" * 10**6, "\u202e" * 500, "ü" * 201])
def test_it_is_cut(text):
    assert len(shown(text)) == LONGEST
    assert shown(text).endswith("...")
    assert len(str(InputError(text, text, "", text))) < 6000
    assert "\n" not in str(InputError("a", [text], "", [text] * 99))


def test_what_is_shown_of_anything():
    assert shown(3) == "3"
    assert shown(None) == "None"
    assert shown("x" * LONGEST) == "x" * LONGEST


FORMULAS = ("=HYPERLINK(1)", "+1+cmd|' /C calc'!A0", "-2+3", "@SUM(1)", "=\n1")


def test_a_table_holds_no_formula_and_every_row_stands_on_a_line():
    names = [*FORMULAS, *EVIL.values(), 'a"b', "a,b", "-0.5", "+3", "plain"]
    rows = list(csv.reader(io.StringIO(as_csv([("name", "value"), *((n, 1.5) for n in names)]))))
    assert rows[0] == ["name", "value"]
    assert len(rows) == len(names) + 1
    assert as_csv([(n, 1.5) for n in names]).count("\n") == len(names)
    for name, (cell, value) in zip(names, rows[1:], strict=True):
        assert value == "1.5"
        assert not ACTS.search(cell)
        assert cell[:1] not in "=+-@" or cell in ("-0.5", "+3"), name
    assert rows[-1][0] == "plain"
    assert rows[-3:-1] == [["-0.5", "1.5"], ["+3", "1.5"]]


@pytest.mark.parametrize("name", EVIL)
def test_json_is_ascii(name):
    text = as_json({EVIL[name]: EVIL[name]})
    assert text.isascii()
    assert text.count("\n") == 2
    assert json.loads(text) == {EVIL[name]: EVIL[name]}


@pytest.mark.parametrize("name", EVIL)
@pytest.mark.parametrize("kind", [ImuConfig, ProtocolConfig, LogConfig, ModelConfig])
def test_a_name_that_acts_is_refused(kind, name):
    more = {"path": "x"} if kind is LogConfig else {}
    with pytest.raises(InputError, match="name = ") as refused:
        build(kind, {"name": EVIL[name], **more})
    assert not ACTS.search(str(refused.value))
    build(kind, {"name": "STIM300, 2nd unit (°/h)", **more})


@pytest.mark.parametrize("value", ["", " mean", "mean ", "x" * 101])
def test_a_name_is_one(value):
    with pytest.raises(InputError, match="must be a name of up to 100 printable"):
        require_name("name", value)


ODD = ("a\nb_40.csv", "\x1b[31m_40.csv", "=1+1_40.csv", "\u202e_40.csv", "$x^{_40.csv", "x" * 240)


@pytest.mark.parametrize("file", ODD)
def test_a_files_name_is_shown_on_one_line(tmp_path, file):
    path = write(tmp_path / "log.csv", columns())
    path = path.rename(tmp_path / file)
    for reader in ("recordings", "table"):
        (record,) = logs.read(LogConfig(path=str(path), reader=reader, latitude=32.76,
                                        rate_hz=10.0, accept=["bias"]), north=False)  # fmt: skip
        assert not ACTS.search(record.name)
        assert len(record.name) <= LONGEST


def test_no_two_recordings_have_one_name(tmp_path):
    """Names that are cut alike would put one recording's rows in another's place."""
    for end in ("a", "b", "c"):
        write(tmp_path / f"{'x' * 230}{end}_40.csv", columns())
    config = LogConfig(path=str(tmp_path), reader="recordings", latitude=32.76, rate_hz=10.0)
    names = [record.name for record in logs.read(config, north=False)]
    assert len(set(names)) == 3


def test_a_column_is_shown(tmp_path):
    values = columns()
    values["\x1b[31mevil\u202e"] = values.pop("w_x")
    path = write(tmp_path / "log.csv", values)
    with pytest.raises(InputError) as refused:
        list(logs.read(LogConfig(path=str(path), latitude=32.76, time_column="t")))
    assert not ACTS.search(str(refused.value))


def test_a_fitted_sensors_file_says_nothing_else(monkeypatch):
    evil = "log\ngyro: {arw_deg_per_sqrt_h: 0}\u2028name: x"
    still = np.zeros((1, 10, 3))
    static = Static(shown(evil), still, still, 0.1, 0.5, None, None)
    monkeypatch.setattr("lbgc.report.fitted_yaml._yaml_line", lambda *_: [])
    monkeypatch.setattr("lbgc.report.fitted_yaml._yaml_of_lines", lambda *_: [])
    monkeypatch.setattr("lbgc.report.fitted_yaml.beside", lambda *_: _Beside())
    for name in ("mine", "null", "true", "on", "Größe"):
        text = sensor_yaml(name, [static], {"gyro": [_Fit()] * 3, "accel": [_Fit()] * 3})
        said = yaml.safe_load(text)
        assert said["name"] == name
        assert set(said) == {"name", "gyro", "accel"}
        assert "arw_deg_per_sqrt_h" not in said["gyro"]


class _Fit:
    corners = (1.0, 3600.0)


class _Beside:
    top: ClassVar = ()
    triads: ClassVar = {"gyro": (), "accel": ()}


def test_a_figure_draws_names_letter_by_letter():
    formulas = ["$", r"$\frac", "a$b$c", "_hidden", r"\$x^", "{", "$$"]
    names = [*EVIL.values(), *formulas]
    rows = {name: ([10.0, 20.0], [2.0, 1.0]) for name in names}
    figure = figures.error_against_window(rows)
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert len(labels) == len(names)
    assert not any(map(ACTS.search, labels))
    figures.png(figure)
    for name in formulas:
        figures.png(figures.bound_against_time({name: ([10.0, 20.0], [2.0, 1.0])}, name))


def test_a_page_shows_no_tag_and_no_mark():
    text = "<script>alert(1)</script>\u202e\x1b\u200b"
    page = page_environment().from_string(
        "<p title='{{ a }}'>{{ a }} {{ b | join(', ') }} {{ 1 }}</p>"
    )
    said = page.render(a=text, b=[text, text])
    assert "<script>" not in said
    assert not ACTS.search(said)
    assert said.endswith(" 1</p>")
