"""Whether a dataset's documents say what this version would have written: only then are its arrays
opened. What Zarr would look up by name (codecs), and every size, is held against the schema."""

import json
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from lbgc.data.documents import Layout
from lbgc.data.files import ROOT, names_of, row_arrays, separator
from lbgc.data.schema import ALWAYS, VARIABLES

_CODECS = {"transpose", "bytes", "blosc", "crc32c", "sharding_indexed"}
MOST_RECORDINGS, MOST_SAMPLES, MOST_SHARDS = 10**9, 10**8, 4 * 10**6
_LARGEST = 1e30
"""Size beyond which nothing is measured or drawn, in any unit of a dataset."""
_KEYS = "chunk_key_encoding"
_ANGLES = ("heading", "heading_reference", "roll", "pitch", "base_azimuth")


def layout_of(documents: Mapping[str, bytes], variables: Iterable[str], schema: int) -> Layout:
    """The dataset's shape, by its documents (name -> content), of this schema's names.

    Raises ValueError, saying which is not as it must be.
    """
    names = (n for n in names_of(variables, schema) if n.endswith(ROOT))
    said = {name: _object(name, documents.get(name, b"")) for name in names}
    layout = _layout(said, variables, schema)
    keys = {"name": "default", "configuration": {"separator": separator(schema)}}
    for name, (size, _) in row_arrays(schema).items():
        rows = {"shape": [layout.shards, size], "data_type": "uint8", _KEYS: keys}
        _check_array(name, said, rows, [1, size], [1, size])
    sizes = {"recording": layout.recordings, "time": layout.samples, "axis": 3, "axis_in": 3}
    for name in layout.variables:
        variable = VARIABLES[name]
        shape = tuple(sizes[d] for d in variable.dims)
        kind = str(layout.dtype(name))
        shard, chunk = (layout.shard, *shape[1:]), (layout.chunk(name), *shape[1:])
        stored = {"shape": list(shape), "data_type": kind, "dimension_names": list(variable.dims),
                  _KEYS: keys}  # fmt: skip
        _check_array(name, said, stored, list(shard), list(chunk))
    return layout


def check_values(name: str, values: np.ndarray, recordings: int) -> None:
    """Raise ValueError unless these values of a variable can be what it says: numbers, within the
    bounds of its kind. recordings : of the dataset, to which units and sessions are dealt."""
    if values.size == 0:
        return
    lowest, highest = values.min(), values.max()
    variable = VARIABLES[name]
    low, high = -_LARGEST, _LARGEST
    if variable.flags:
        low, high = 0, len(variable.flags) - 1
    elif name in ("unit", "session"):
        low, high = 0, recordings - 1
    elif name == "latitude":
        low, high = -math.pi / 2, math.pi / 2
    elif name in _ANGLES:
        low, high = -2 * math.pi, 2 * math.pi
    if not (low <= lowest and highest <= high):  # NaN is neither
        at = lowest if not low <= lowest else highest
        raise ValueError(f"{name} = {at:g} {variable.units}: must be from {low:g} to {high:g}")


def _object(name: str, content: bytes) -> dict[str, Any]:
    try:
        said = json.loads(content)
    except RecursionError:
        said = None
    if not isinstance(said, dict) or said.get("zarr_format") != 3:
        raise ValueError(f"{name} is no document of Zarr 3")
    return said


def _attributes(document: dict[str, Any]) -> dict[str, Any]:
    attributes = document.get("attributes")
    return attributes if isinstance(attributes, dict) else {}


def _layout(said: Mapping[str, dict[str, Any]], variables: Iterable[str], schema: int) -> Layout:
    """The layout, from the root's rate and the shape and scale of gyro and accel."""
    rate: Any = _attributes(said[ROOT]).get("rate_hz")
    _require(_is_number(rate) and 0 < rate < math.inf, ROOT, "rate_hz", rate)
    shape: Any = said["gyro/zarr.json"].get("shape")
    good = isinstance(shape, list) and len(shape) == 3 and all(type(n) is int for n in shape)
    _require(good, "gyro", "shape", shape)
    good = 0 < shape[0] <= MOST_RECORDINGS and 0 < shape[1] <= MOST_SAMPLES
    _require(good, "gyro", "shape", shape)
    scales = {}
    for name in ("gyro", "accel"):
        scale: Any = _attributes(said[f"{name}/zarr.json"]).get("scale_factor")
        good = scale is None or (_is_number(scale) and 0 < scale < math.inf)
        _require(good, name, "scale_factor", scale)
        scales[name] = None if scale is None else float(scale)
    missing = set(ALWAYS) - set(variables)
    _require(not missing, ROOT, "variables", f"all but {sorted(missing)}")
    layout = Layout(shape[0], shape[1], float(rate), scales, tuple(variables), schema)
    _require(layout.shards <= MOST_SHARDS, "gyro", "shape", shape)
    return layout


def _check_array(
    name: str,
    documents: Mapping[str, dict[str, Any]],
    expected: Mapping[str, Any],
    shard: list[int],
    chunk: list[int],
) -> None:
    """shard : of what lies in one file; chunk : of what is compressed together."""
    said = documents[f"{name}/zarr.json"]
    files = {"name": "regular", "configuration": {"chunk_shape": shard}}
    expected = {**expected, "node_type": "array", "fill_value": 0, "chunk_grid": files}
    for key, value in expected.items():
        _require(said.get(key) == value, name, key, said.get(key))
    _require(not said.get("storage_transformers"), name, "storage_transformers", "given")
    codecs = said.get("codecs")
    _require(_names(codecs) <= _CODECS, name, "codecs", codecs)
    if chunk != shard:
        inner = codecs[0]["configuration"]  # type: ignore[index]
        _require(inner.get("chunk_shape") == chunk, name, "codecs", codecs)
        _require(
            _names(inner.get("codecs")) <= _CODECS - {"sharding_indexed"}, name, "codecs", codecs
        )
        _require(_names(inner.get("index_codecs")) <= {"bytes", "crc32c"}, name, "codecs", codecs)
    else:
        _require("sharding_indexed" not in _names(codecs), name, "codecs", codecs)


def _names(codecs: Any) -> set[str]:
    """Names in a list of codecs; raises ValueError where it is none."""
    good = isinstance(codecs, list) and all(
        isinstance(c, dict)
        and isinstance(c.get("name"), str)
        and isinstance(c.get("configuration", {}), dict)
        for c in codecs
    )
    if not good:
        raise ValueError("codecs are not listed as they must be")
    return {c["name"] for c in codecs}


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _require(condition: bool, name: str, key: str, value: Any) -> None:
    if not condition:
        raise ValueError(f"{name}: {key} = {value} is not what this version writes")
