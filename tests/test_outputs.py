"""One writer of JSON, which every reader takes."""

import json
import sys

import numpy as np

from lbgc.commands import run_main
from lbgc.errors import InputError
from lbgc.info import InfoConfig
from lbgc.outputs import as_json, printable


def test_what_is_no_number_is_null():
    content = {
        "a": float("nan"),
        "b": [np.inf, 1.5],
        "c": np.array([1.0, np.nan]),
        "d": (True, None),
    }

    def refuse(name):
        raise AssertionError(name)

    said = json.loads(as_json(content), parse_constant=refuse)
    assert said == {"a": None, "b": [None, 1.5], "c": [1.0, None], "d": [True, None]}


def test_control_characters_are_spelled_out():
    """They come from names of files, columns and sensors."""
    red = "\x1b[31m\x07mine\x9b0m\u202e"
    assert printable(red) == r"\x1b[31m\x07mine\x9b0m\u202e"
    plain = "a\tb\nStraße 90°, ±1 µrad"
    assert printable(plain) == plain
    assert "\x1b" not in str(InputError("log.path", red, "", "is no file"))


def test_no_entry_point_prints_them(monkeypatch, capsys, tmp_path):
    def main(config: InfoConfig) -> None:
        print("sensor \x1b[31mmine\t1")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["info", "data=x"])
    run_main(main, InfoConfig, "info")
    assert capsys.readouterr().out == "sensor \\x1b[31mmine\t1\n"


def test_it_is_what_json_writes_of_plain_content():
    content = {"b": [1, 2.5, "x", None, True], "a": {"c": {}}}
    assert as_json(content) == json.dumps(content, indent=2)
    assert as_json(content, None, sort_keys=True) == json.dumps(content, sort_keys=True)
    assert as_json({"n": np.int64(3), "x": np.float32(0.5)}, None) == '{"n": 3, "x": 0.5}'
