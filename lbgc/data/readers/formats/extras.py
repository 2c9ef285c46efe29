"""Libraries that only some formats need: the extra `logs`."""

import importlib
import importlib.util
from typing import Any

from lbgc.errors import InputError


def require_installed(module: str) -> None:
    """Raise InputError unless a module of the extra is there."""
    if importlib.util.find_spec(module) is None:
        about = f"is not installed: python -m pip install 'lbgc[logs]' (or {module}) "
        raise InputError("package", module, "", about + "brings it")


def needed(module: str) -> Any:
    """A module of an optional package, imported. Raises InputError where it is not installed."""
    require_installed(module.partition(".")[0])
    return importlib.import_module(module)
