"""A training's checkpoint in one file: tensors and JSON in safetensors' layout, without code."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors.torch import save
from torch import Tensor

from lbgc.errors import reading
from lbgc.learning import tensors
from lbgc.outputs import UNSEALED, as_json, is_sealed, read_file, seal, write_atomically

_WHAT, _SEALED = "checkpoint", "checksum"
_OWN = re.compile(rb'"checksum":"([0-9a-f]{64})"')
_MOST_BYTES, _MOST_HEADER = 2**32, 2**26
"""Largest sizes of a checkpoint, and of its header, which has the history."""
AGAIN = "delete it to start anew"


def write(file: Path, groups: Mapping[str, Mapping[str, Tensor]], said: Mapping[str, Any]) -> None:
    """Write a checkpoint, whole or not at all: a training that is killed meanwhile goes on from the
    checkpoint before.

    groups : name of a group -> its tensors by name; said : counters, which JSON can hold.
    """
    flat = {
        f"{group}/{name}": value.detach().cpu().contiguous().clone()
        for group, named in groups.items()
        for name, value in named.items()
    }
    content = save(flat, {_WHAT: as_json(said, indent=None), _SEALED: UNSEALED})
    write_atomically(file, seal(content))


def read(file: Path) -> tuple[dict[str, dict[str, Tensor]], dict[str, Any]]:
    """A checkpoint's groups of tensors and its counters, as `write` was given them. Raises
    InputError where the file is damaged."""
    groups: dict[str, dict[str, Tensor]] = {}
    with reading("checkpoint", file, f"is damaged; {AGAIN}"):
        content = read_file(file, _MOST_BYTES)
        own = _OWN.search(content)
        if own is None or not is_sealed(content, own[1].decode()):
            raise ValueError("it is not as it was written")
        for key, value in tensors.parse(content, _MOST_HEADER).items():
            group, name = key.split("/", 1)
            groups.setdefault(group, {})[name] = value
        header = json.loads(tensors.header(content, _MOST_HEADER))
        return groups, dict(json.loads(header["__metadata__"][_WHAT]))
