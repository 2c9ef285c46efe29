"""What a user can get wrong, said once: InputError, the typed configuration, and `run_main`."""

import _thread
import dataclasses
import os
import sys
import threading
import types
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Any, TypeVar

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException, OverrideParseException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, OmegaConfBaseException

from lbgc import configs, sweeps
from lbgc.outputs import printable
from lbgc.sweeps import Ended
from lbgc.units import unit_of

CONF = str(Path(__file__).resolve().parents[1] / "conf")
Config = TypeVar("Config")

_LONGEST = 300
"""Characters that are shown of another parser's message, at most."""

Axes = float | list[float]
"""A configured value for all three axes, or one for each (forward, right, down)."""

Spread = float | tuple[float, ...]
"""A configured value, or the [low, high] from which each recording draws its own, uniformly."""


class InputError(ValueError):
    """The user's input is wrong: which parameter, its value and unit, and what it could be."""

    def __init__(self, name: str, value: Any, unit: str = "", choices: str | Sequence[str] = ""):
        self.name, self.value, self.unit, self.choices = name, value, unit, choices
        super().__init__(name, value, unit, choices)

    def __str__(self) -> str:
        choices = self.choices
        if not isinstance(choices, str):
            choices = "choose from " + ", ".join(map(str, choices))
        shown = f"{self.name} = {self.value}" + (f" {self.unit}" if self.unit else "")
        return printable(f"{shown}: {choices}" if choices else shown)

    def within(self, prefix: str) -> "InputError":
        """This error with its parameter named from one level further out."""
        return InputError(f"{prefix}.{self.name}", self.value, self.unit, self.choices)


def require(condition: bool, name: str, value: Any, choices: str | Sequence[str]) -> None:
    """Raise InputError unless the condition holds; the unit is read off the parameter's name."""
    if not condition:
        raise InputError(name, value, unit_of(name), choices)


@contextmanager
def reading(name: str, value: Any, what: str = "cannot be read") -> Iterator[None]:
    """Whatever another's parser raises on what it is given is said as InputError: an outside file
    may be anything. For calls of such parsers, and nothing else."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        why = " ".join(str(error).split())[:_LONGEST] or type(error).__name__
        raise InputError(name, value, "", f"{what} ({why})") from error


def require_choice(name: str, value: str, choices: Sequence[str]) -> None:
    require(value in choices, name, value, choices)


def require_positive(name: str, value: float) -> None:
    require(value > 0, name, value, "must be greater than zero")


def require_not_negative(config: Any, *names: str) -> None:
    """Every named field of a dataclass (a number, or one an axis) must be zero or more."""
    for name in names:
        value = getattr(config, name)
        lowest = min(value) if isinstance(value, list | tuple) else value
        require(lowest >= 0, name, value, "must not be negative")


def require_spread(config: Any, *names: str, least: float = 0.0) -> None:
    """Every named field must be a number, or [low, high], not below `least`."""
    for name in names:
        value = getattr(config, name)
        ends = value if isinstance(value, tuple) else (value, value)
        ordered = len(ends) == 2 and ends[0] <= ends[1]
        require(ordered, name, value, "must be a number, or [low, high] to draw from")
        require(ends[0] >= least, name, value, f"must be {least:g} or more")


def build(cls: type[Config], mapping: Mapping[str, Any]) -> Config:
    """A frozen configuration dataclass from what YAML and the command line gave.

    Types are checked against the annotations, numbers must be finite, unknown keys are refused.

    Raises InputError, naming the parameter by its full key.
    """
    adopted = getattr(cls, "adopted", None)
    if adopted is not None:  # other people's names for what it holds
        mapping = adopted(mapping)
    hints = typing.get_type_hints(cls)
    fields = {f.name: f for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
    for key in mapping:
        require_choice("key", str(key), list(fields))
    for name, field in fields.items():
        has_default = (field.default, field.default_factory) != (dataclasses.MISSING,) * 2
        require(name in mapping or has_default, name, "(missing)", "must be given")
    return cls(**{key: _convert(hints[key], key, value) for key, value in mapping.items()})


def _convert(annotation: Any, name: str, value: Any) -> Any:
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        options = typing.get_args(annotation)
        if value is None and type(None) in options:
            return None
        is_list = isinstance(value, list | tuple)
        for option in options:
            takes_list = typing.get_origin(option) in (list, tuple)
            if takes_list == is_list and option is not type(None):
                return _convert(option, name, value)
        raise InputError(name, value, unit_of(name), f"must be {_spelled(annotation)}")
    if dataclasses.is_dataclass(annotation):
        if not isinstance(value, Mapping):
            raise InputError(name, value, "", "must be a group of parameters")
        try:
            return build(annotation, value)  # type: ignore[arg-type]
        except InputError as error:
            raise error.within(name) from None
    kind = typing.get_origin(annotation)
    if kind in (list, tuple) and isinstance(value, list | tuple):
        return kind(_convert(typing.get_args(annotation)[0], name, v) for v in value)
    if annotation is float and isinstance(value, int | float) and not isinstance(value, bool):
        # no int is infinite, but one may be more than a float can be
        require(abs(value) <= sys.float_info.max, name, value, "must be a finite number")
        return float(value)
    if annotation in (int, str, bool) and type(value) is annotation:
        return value
    if annotation is Any:
        return value
    raise InputError(name, value, unit_of(name), f"must be {_spelled(annotation)}")


def _spelled(annotation: Any) -> str:
    words = {float: "a number", int: "a whole number", str: "a text", bool: "true or false"}
    if annotation is type(None):
        return "null"
    if typing.get_origin(annotation) in (list, tuple):
        return f"a list [...] of which each is {_spelled(typing.get_args(annotation)[0])}"
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return " or ".join(_spelled(option) for option in typing.get_args(annotation))
    return words.get(annotation, "a group of parameters")


def run_main(
    main: Callable[[Any], Path | str | None],
    config_class: type,
    config_name: str,
    score: Callable[[Path], float] | None = None,
    summary: Callable[[list[Path]], None] | None = None,
) -> None:
    """Run an entry point under Hydra: `main(config)`, its returned path printed last.

    score : of a result, what an optimising sweeper makes small; summary : of all results, printed
    when a sweep ends.

    Exit codes: 0 done, 2 the input was wrong (one clear message, no traceback), 130 interrupted.
    In a sweep each failing job is named and the others go on, in whatever process; the sweep then
    ends with 2, or with 1 and a traceback where it was no input that was wrong.
    """
    os.environ["HYDRA_FULL_ERROR"] = "1"  # let exceptions reach us instead of Hydra's exit(1)
    failed: list[str] = []

    def job(raw: DictConfig) -> float | None:
        run = HydraConfig.get()
        sweeping = run.mode == RunMode.MULTIRUN
        own = (int(run.job.num), run.job.override_dirname) if sweeping else (0, "")
        try:
            values = OmegaConf.to_container(raw, resolve=True, throw_on_missing=True)
            _replace_alternatives(values, run.overrides.task)
            with redirect_stdout(_Printable(sys.stdout)):
                path = main(build(config_class, values))  # type: ignore[arg-type]
        except Exception as error:
            if sweeping:  # a launcher's other process has no other way to say that it failed
                sweeps.report(Ended(*own, None, str(error) or type(error).__name__))
                raise
            if not isinstance(error, InputError):
                raise
            failed.append(str(error))
            print(f"error: {error}", file=sys.stderr)
            return None
        if path is not None:
            print(path, flush=True)
        if sweeping:
            sweeps.report(Ended(*own, None if path is None else str(path), None))
        return None if score is None or path is None else score(Path(path))

    with sweeps.sweep() as directory:
        try:
            for brought in configs.brought(sys.argv[1:]):
                with reading("--config-dir", brought, "cannot be taken"):
                    configs.check_directory(brought)
            with _never_forgotten():
                hydra.main(version_base="1.3", config_path=CONF, config_name=config_name)(job)()
            _conclude(directory, summary)
            if failed:
                sys.exit(2)
        except InputError as error:
            if _conclude(directory, summary) == 0:
                print(f"error: {error}", file=sys.stderr)
            sys.exit(2)
        except (HydraException, OmegaConfBaseException, RecursionError) as error:
            print(f"error: {printable(_hydra_says(error))}", file=sys.stderr)
            sys.exit(2)
        except KeyboardInterrupt:
            print("interrupted; run the same command again to go on", file=sys.stderr)
            sys.exit(130)
        except Exception:
            _conclude(directory, summary)
            raise


class _Printable:
    """A stream whose readers get no control characters, whatever files and columns are called."""

    def __init__(self, stream: Any):
        self._stream = stream

    def write(self, text: str) -> int:
        return self._stream.write(printable(text))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _conclude(directory: Path, summary: Callable[[list[Path]], None] | None) -> int:
    """Say what became of a sweep's jobs; how many failed."""
    jobs = sweeps.ended(directory)
    lost = [own for own in jobs if own.error is not None]
    good = [Path(own.path) for own in jobs if own.path is not None]
    if summary is not None and good:
        summary(good)
    for own in lost:
        print(f"error: job {own.number} ({own.overrides}): {own.error}", file=sys.stderr)
    if lost:
        print(f"{len(lost)} of {len(jobs)} jobs failed; the same command again skips what is "
              "finished", file=sys.stderr)  # fmt: skip
    return len(lost)


@contextmanager
def _never_forgotten() -> Iterator[None]:
    """An interruption that falls into a callback of the interpreter's, where Python prints it and
    goes on as if nothing had been, comes again a moment later instead."""
    before, over = sys.unraisablehook, threading.Event()

    def again() -> None:
        if not over.is_set():
            _thread.interrupt_main()

    def hook(ignored: Any) -> None:
        if issubclass(ignored.exc_type, KeyboardInterrupt):
            timer = threading.Timer(0.01, again)
            timer.daemon = True
            timer.start()
        else:
            before(ignored)

    sys.unraisablehook = hook
    try:
        yield
    finally:
        over.set()
        sys.unraisablehook = before


ALTERNATIVES = (
    {"arw_deg_per_sqrt_h", "noise_deg_per_s_per_sqrt_hz"},
    {"noise_ug_per_sqrt_hz", "vrw_m_per_s_per_sqrt_h"},
    {"bias_instability_deg_per_h", "allan_minimum_deg_per_h"},
    {"bias_instability_ug", "allan_minimum_ug", "allan_minimum_mg"},
)
"""Keys that say one thing in different units or words."""


def _replace_alternatives(values: Any, overrides: Sequence[str]) -> None:
    """A figure given on the command line replaces the preset's, in whatever unit that stood."""
    given = [override.lstrip("+").split("=", 1)[0].split(".") for override in overrides]
    for *path, key in given:
        for group in (g for g in ALTERNATIVES if key in g):
            place = values
            for name in path:
                place = place[name]
            for other in group - {key}:
                if [*path, other] not in given and other in place:
                    place[other] = None


def _hydra_says(error: BaseException) -> str:
    """Hydra's message; for an unknown key, ours, with the keys that stand there."""
    cause = error.__cause__
    if isinstance(cause, ConfigKeyError | ConfigAttributeError):
        siblings = cause.parent_node
        if isinstance(siblings, DictConfig):
            return str(InputError("key", cause.full_key, "", [str(k) for k in siblings]))
    said = str(error).strip()
    if isinstance(error, OverrideParseException):
        said = f"{error.override}: {said}"
    if cause is not None and str(cause).strip() not in said:
        said += "\n" + str(cause).strip()
    return said
