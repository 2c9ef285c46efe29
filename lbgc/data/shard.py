"""A shard's recordings in memory, while they are made."""

from collections.abc import Mapping

import numpy as np

from lbgc.data.documents import Layout
from lbgc.data.schema import VARIABLES


class Shard:
    """So many recordings of a layout, put in some at a time. What stands still in all of them, as
    half of a dataset does, is held once a recording, and read as if it were held every sample."""

    def __init__(self, layout: Layout, recordings: int):
        self._layout, self._recordings, self._filled = layout, recordings, 0
        self._held: dict[str, np.ndarray] = {}
        self._still = {name for name in layout.variables if "time" in VARIABLES[name].dims}

    def append(self, part: Mapping[str, np.ndarray]) -> None:
        """part : every variable of the next recordings; what stands still as `np.broadcast_to`
        gives it."""
        end = self._filled + len(part["heading"])
        for name, values in part.items():
            if name in self._still and values.strides[1] == 0:
                values = values[:, :1]
            elif name in self._still:
                self._spread(name)
            if name not in self._held:
                self._held[name] = self._room(name)
            self._held[name][self._filled : end] = values
        self._filled = end

    def variables(self) -> dict[str, np.ndarray]:
        """All of them, to be read: (recordings, ...) each."""
        found = dict(self._held)
        for name in self._still:
            shape = (self._recordings, self._layout.samples, *found[name].shape[2:])
            found[name] = np.broadcast_to(found[name], shape)
        return found

    def _spread(self, name: str) -> None:
        """Hold every sample of a variable, from now on and of those before."""
        self._still.remove(name)
        if name in self._held:
            before = self._held[name][: self._filled]
            self._held[name] = self._room(name)
            self._held[name][: self._filled] = before

    def _room(self, name: str) -> np.ndarray:
        samples = 1 if name in self._still else self._layout.samples
        return self._layout.room(name, self._recordings, samples)
