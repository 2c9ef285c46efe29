"""Where every random number comes from: SFC64 on a SeedSequence whose spawn key says what for.

`seed` says which recordings, `unit_seed` whose sensor. A recording's numbers depend on its own
index and on nothing else: not on workers, order, resumption or how many recordings follow.
"""

from enum import IntEnum

import numpy as np


class Purpose(IntEnum):
    """What of a recording is drawn; each has a stream of its own."""

    LABELS = 0
    GYRO = 1
    ACCEL = 2
    TIMING = 3
    MOTION = 4


_RECORDING, _UNIT, _SESSION, _SPLIT, _TRAINING, _FIGURES = range(6)


def recording(seed: int, index: int, purpose: Purpose) -> np.random.Generator:
    return _generator(seed, _RECORDING, index, int(purpose))


def child(rng: np.random.Generator, number: int) -> np.random.Generator:
    """The number-th of a stream's own children: what `rng.spawn` gives, made alone."""
    seed = rng.bit_generator.seed_seq
    assert isinstance(seed, np.random.SeedSequence)
    assert isinstance(seed.entropy, int)
    return _generator(seed.entropy, *seed.spawn_key, number)


def unit(unit_seed: int, index: int) -> np.random.Generator:
    return _generator(unit_seed, _UNIT, index)


def session(unit_seed: int, unit_index: int, index: int) -> np.random.Generator:
    return _generator(unit_seed, _SESSION, unit_index, index)


def split(seed: int, block: int) -> np.random.Generator:
    return _generator(seed, _SPLIT, block)


def training(seed: int, step: int) -> np.random.Generator:
    """Of one training step, so that a resumed run draws what an uninterrupted one would."""
    return _generator(seed, _TRAINING, step)


def figures() -> np.random.Generator:
    """Of what is worked out by drawing: intervals by resampling, expectations. Always the same."""
    return _generator(0, _FIGURES)


def _generator(entropy: int, *key: int) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(entropy, spawn_key=key)))
