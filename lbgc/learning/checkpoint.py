"""Where a training stands, in one file: tensors and JSON in safetensors' layout, no code in it."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from lbgc.errors import InputError
from lbgc.outputs import write_atomically

_WHAT = "checkpoint"


def write(file: Path, groups: Mapping[str, Mapping[str, Tensor]], said: Mapping[str, Any]) -> None:
    """Whole or not at all: a training that is killed meanwhile goes on from the one before.

    groups : name -> tensors by name; said : JSON-able.
    """
    flat = {
        f"{group}/{name}": value.detach().cpu().contiguous().clone()
        for group, tensors in groups.items()
        for name, value in tensors.items()
    }
    write_atomically(file, save(flat, {_WHAT: json.dumps(said)}))


def read(file: Path) -> tuple[dict[str, dict[str, Tensor]], dict[str, Any]]:
    """What `write` was given. Raises InputError where the file is damaged."""
    groups: dict[str, dict[str, Tensor]] = {}
    try:
        with safe_open(file, "pt") as content:
            said = json.loads(content.metadata()[_WHAT])
            for key in content.keys():  # noqa: SIM118 (it is no mapping)
                group, name = key.split("/", 1)
                groups.setdefault(group, {})[name] = content.get_tensor(key)
    except (SafetensorError, OSError, ValueError, KeyError, TypeError) as error:
        what = f"is damaged ({error}); delete it to start anew"
        raise InputError("checkpoint", file, "", what) from error
    return groups, said
