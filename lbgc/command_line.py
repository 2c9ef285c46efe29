"""What a command line may tell Hydra: the options that it takes, and which of Hydra's own settings.

Hydra would run what some of them name (callbacks, logging, launchers of any module), read
configurations from any place, and write to any. What is allowed stands here, and all else is
refused.
"""

import argparse
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lbgc.errors import InputError, require, require_choice

_FLAGS = ("help", "hydra-help", "version", "resolve", "run", "multirun", "shell-completion")
_VALUED = ("config-dir", "cfg", "package", "info")
_OWN = ("verify",)
"""Options that are not Hydra's."""
_SHORT = {"help": "-h", "run": "-r", "multirun": "-m", "shell-completion": "-sc",
          "config-dir": "-cd", "cfg": "-c", "package": "-p", "info": "-i"}  # fmt: skip
_CHOICES = {
    "hydra/launcher": ["basic", "joblib", "submitit_local", "submitit_slurm"],
    "hydra/sweeper": ["basic", "optuna"],
    "hydra/sweeper/sampler": ["tpe", "random", "cmaes", "nsgaii", "motpe", "grid"],
}
"""The launchers and sweepers that the extras joblib, submitit, slurm and optuna bring."""
_SETTINGS = {
    "hydra.launcher": "n_jobs verbose timeout timeout_min cpus_per_task gpus_per_node nodes "
    "tasks_per_node mem_gb partition qos constraint exclude gres account cpus_per_gpu "
    "gpus_per_task mem_per_gpu mem_per_cpu signal_delay_s max_num_timeout array_parallelism",
    "hydra.sweeper": "n_trials n_jobs max_batch_size max_failure_rate direction",
    "hydra.sweeper.sampler": "seed n_startup_trials n_ei_candidates multivariate population_size "
    "mutation_prob crossover_prob swapping_prob sigma0 n_ehvi_candidates",
    "hydra": "mode",
}
_WORD = re.compile(r"[\w.:+@-]*")
"""What a setting's text may be: a partition, an account, a share of memory. It stands in a job's
script, where a space or an end of line would begin something else."""


def taken_apart(arguments: Sequence[str]) -> tuple[Path | None, bool, list[str], list[str]]:
    """The directory of `--config-dir`, whether `--verify` is given, Hydra's options, and the
    overrides. Raises InputError at an option that is not taken."""
    parser = argparse.ArgumentParser(add_help=False, exit_on_error=False)
    for name in (*_FLAGS, *_VALUED, *_OWN):
        written = [f"--{name}", *([_SHORT[name]] if name in _SHORT else [])]
        how: dict[str, Any] = {} if name in _VALUED else {"action": "store_true"}
        how |= {"nargs": "?", "const": "all"} if name == "info" else {}
        parser.add_argument(*written, dest=name, **how)
    try:
        known, rest = parser.parse_known_args(list(arguments))
    except argparse.ArgumentError as error:
        raise InputError("option", error.argument_name, "", str(error.message)) from None
    given = vars(known)
    for word in (word for word in rest if word.startswith("-")):
        raise InputError("option", word, "", [f"--{name}" for name in given])
    verify = given.pop("verify")
    directory = None if (said := given.pop("config-dir")) is None else Path(said)
    require(directory is None or directory.is_dir(), "--config-dir", directory, "is no directory")
    options = [f"--{name}" if given[name] is True else f"--{name}={given[name]}"
             for name in given if given[name] not in (False, None)]  # fmt: skip
    return directory, verify, options, rest


def _is_name(choice: Any) -> bool:
    """Whether one choice, as Hydra has parsed it, can be a file's name: null, a number, a list and
    a group cannot, and Hydra would go on without one or break down."""
    name = getattr(choice, "text", choice)  # in quotes or not
    return isinstance(name, str) and name.lower() not in ("", "none")


def require_allowed(override: Any, groups: Mapping[str, Sequence[str]]) -> None:
    """Raise InputError where Hydra may not be given this override, as it has parsed it: a choice
    that is a path, is no name or is put into another place, or a setting of Hydra's that is not in
    the list.

    groups : the choices of each group that come with lbgc.
    """
    key, said = override.key_or_group, str(override.input_line)
    require(override.package is None, "override", said, "a choice cannot be put elsewhere by @")
    text = said.partition("=")[2]
    value = None if override.is_delete() else override.value()
    if key in groups and not override.is_delete():
        require(not set("/\\$") & set(text), key, text, "must be a choice's name, and no path")
        if not all(map(_is_name, getattr(value, "list", getattr(value, "include", [value])))):
            raise InputError(key, text, "", groups[key])
    if re.split(r"[./]", key)[0] != "hydra":
        return
    if key in _CHOICES:
        require_choice(key, "null" if value is None else str(value), _CHOICES[key])
        return
    group, _, name = key.rpartition(".")
    names = _SETTINGS.get(group, "").split()
    allowed = name in names and not override.is_delete()
    require(allowed, "key", key, [*_CHOICES, *(f"{group}.{own}" for own in names)])
    good = isinstance(value, int | float) or _WORD.fullmatch(
        value if isinstance(value, str) else " "
    )
    require(bool(good) or value is None, key, value, "must be a number or one word")
