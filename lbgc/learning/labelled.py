"""Which recordings train and which validate where an owner has a few labelled ones of one unit.

A number of labelled recordings is all that is known of the unit: the weights that are kept are
chosen by some of them too, not by a validation split of further labels.
"""

import numpy as np

from lbgc.data.store import Dataset
from lbgc.errors import require

_HELD_OUT = 5
"""One labelled recording in so many validates."""


def chosen(dataset: Dataset, split: str, labelled: int | None) -> np.ndarray:
    """The recordings of a dataset that serve as its split train or validation, in order.

    labelled : number of recordings, the first of the training split, that are all there is; of
    fewer than five all train, and validate as well. None: the splits as they are stored. Raises
    InputError where there are fewer, or where the dataset is of several units: a model of one would
    be asked about another.
    """
    if labelled is None:
        return dataset.in_split(split)
    units = len(np.unique(dataset.label("unit")))
    about = f"recordings would be of the {units} units in {dataset.place}, and labels are of one: "
    about += "generate units=1, or leave labelled out to train on all"
    require(units == 1, "labelled", labelled, about)
    every = dataset.in_split("train")
    about = f"is more than the {len(every)} recordings in the training split"
    require(labelled <= len(every), "labelled", labelled, about)
    own = every[:labelled]
    held = labelled // _HELD_OUT
    if held == 0:
        return own
    return own[-held:] if split == "validation" else own[:-held]
