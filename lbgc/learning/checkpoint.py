"""Where a training stands, in one file: tensors and JSON in safetensors' layout, no code in it."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors.torch import load, save
from torch import Tensor

from lbgc.errors import reading
from lbgc.outputs import UNSEALED, as_json, is_sealed, read_file, seal, write_atomically

_WHAT, _SEALED = "checkpoint", "checksum"
_OWN = re.compile(rb'"checksum":"([0-9a-f]{64})"')
AGAIN = "delete it to start anew"


def write(file: Path, groups: Mapping[str, Mapping[str, Tensor]], said: Mapping[str, Any]) -> None:
    """Whole or not at all: a training that is killed meanwhile goes on from the one before.

    groups : name -> tensors by name; said : JSON-able.
    """
    flat = {
        f"{group}/{name}": value.detach().cpu().contiguous().clone()
        for group, tensors in groups.items()
        for name, value in tensors.items()
    }
    content = save(flat, {_WHAT: as_json(said, indent=None), _SEALED: UNSEALED})
    write_atomically(file, seal(content))


def read(file: Path) -> tuple[dict[str, dict[str, Tensor]], dict[str, Any]]:
    """What `write` was given. Raises InputError where the file is damaged."""
    groups: dict[str, dict[str, Tensor]] = {}
    with reading("checkpoint", file, f"is damaged; {AGAIN}"):
        content = read_file(file)
        own = _OWN.search(content)
        if own is None or not is_sealed(content, own[1].decode()):
            raise ValueError("it is not as it was written")
        for key, value in load(content).items():
            group, name = key.split("/", 1)
            groups.setdefault(group, {})[name] = value
        header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
        return groups, dict(json.loads(header["__metadata__"][_WHAT]))
