"""Running an entry point; the only module that knows Hydra."""

import _thread
import os
import re
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any, get_args, get_type_hints

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException, OverrideParseException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, OmegaConfBaseException

from lbgc import fault, sweeps, user_yaml
from lbgc.errors import InputError, build, reading, require
from lbgc.fault import Fault
from lbgc.outputs import printable
from lbgc.sensor.datasheet import ALTERNATIVES
from lbgc.sweeps import Ended

_PLACES = [parent / "conf" for parent in Path(__file__).resolve().parents[:2]]
CONF = str(next(filter(Path.is_dir, _PLACES), _PLACES[0]))
"""In lbgc/ where that was installed, beside it in the checkout."""
_NO_NAME = re.compile(r"null|none|~|true|false|[-+]?[\d.]+(e[-+]?\d+)?", re.IGNORECASE)
COMPLETE = ("imu", "scene", "protocol")
"""Groups whose files say only what they change: the rest is as the dataclass has it."""


def store_defaults(config_class: type) -> list[str]:
    """Let Hydra find `imu_defaults` and its like: every key of such a field of the configuration,
    at its default. Returns their names."""
    hints, names = get_type_hints(config_class), []
    for field in (name for name in COMPLETE if name in hints):
        (own,) = filter(is_dataclass, (hints[field], *get_args(hints[field])))
        names.append(f"{field}_defaults")
        ConfigStore.instance().store(names[-1], as_written(asdict(own())), package=field)  # type: ignore[operator]
    return names


def as_written(value: Any) -> Any:
    """A value as YAML has it: lists, and whole numbers without a point."""
    if isinstance(value, dict):
        return {key: as_written(own) for key, own in value.items()}
    if isinstance(value, list | tuple):
        return [as_written(own) for own in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value


def run_main(
    main: Callable[[Any], Path | str | None],
    config_class: type,
    config_name: str,
    score: Callable[[Path], float] | None = None,
    summary: Callable[[list[Path]], None] | None = None,
) -> None:
    """Run an entry point under Hydra: `main(config)`, its returned path printed last.

    score : a result's figure that an optimising sweeper minimises; summary : prints a summary of
    all results when a sweep ends.

    Exit codes: 0 done, 2 the input was wrong (one clear message), 3 a fault of this program's own
    (two lines: what and where, and the file with its traceback), 130 interrupted. In a sweep each
    failing job is named and the others go on, in whatever process; the sweep then ends with 2, or
    with 3 where any job had a fault of its own.
    """
    os.environ["HYDRA_FULL_ERROR"] = "1"  # exceptions reach this function; else Hydra exits with 1
    failed: list[int] = []  # exit codes

    def job(raw: DictConfig) -> float | None:
        """Run one job with Hydra's configuration; its score."""
        run = HydraConfig.get()
        sweeping = run.mode == RunMode.MULTIRUN
        own = (int(run.job.num), run.job.override_dirname) if sweeping else (0, "")
        try:
            path = _run(main, config_class, raw, run.overrides.task)
        except Exception as error:
            if sweeping:  # a job in a launcher's other process cannot report a failure otherwise
                sweeps.report(Ended(*own, None, str(error), isinstance(error, Fault)))
                raise
            if not isinstance(error, InputError | Fault):
                raise
            failed.append(_said(error, fault.EXIT if isinstance(error, Fault) else 2))
            return None
        if path is not None:
            print(path, flush=True)
        if sweeping:
            sweeps.report(Ended(*own, None if path is None else str(path)))
        return None if score is None or path is None else score(Path(path))

    with sweeps.sweep() as directory:
        try:
            _check_groups(sys.argv[1:])
            stored = store_defaults(config_class)
            for brought in user_yaml.brought(sys.argv[1:]):
                with reading("--config-dir", brought, "cannot be taken"):
                    user_yaml.check_directory(brought)
                for file in (brought / f"{name}.yaml" for name in stored):
                    ours = "is composed by the program itself, and cannot be brought along"
                    require(not file.exists(), "--config-dir", file, ours)
            with _interruptible():
                hydra.main(version_base="1.3", config_path=CONF, config_name=config_name)(job)()
            if code := _conclude(directory, summary) or max(failed, default=0):
                sys.exit(code)
        except InputError as error:
            sys.exit(_conclude(directory, summary) or _said(error, 2))
        except (HydraException, OmegaConfBaseException, RecursionError) as error:
            print(f"error: {printable(_message_of(error))}", file=sys.stderr)
            sys.exit(2)
        except KeyboardInterrupt:
            print("interrupted; run the same command again to go on", file=sys.stderr)
            sys.exit(130)
        except Exception as error:
            own_fault = fault.reported(error)
            sys.exit(_conclude(directory, summary) or _said(own_fault, fault.EXIT))


def _check_groups(arguments: Sequence[str]) -> None:
    """Raise InputError where a group is set to null or a number, of which Hydra makes no sense."""
    for group, _, value in (own.lstrip("+").partition("=") for own in arguments):
        if value and _NO_NAME.fullmatch(value) and (Path(CONF) / group).is_dir():
            files = sorted(file.stem for file in (Path(CONF) / group).glob("*.yaml"))
            raise InputError(group, value, "", files)


def _run(
    main: Callable[[Any], Path | str | None],
    config_class: type,
    raw: DictConfig,
    overrides: Sequence[str],
) -> Path | str | None:
    """What `main` returns, called with Hydra's configuration. Raises InputError or Hydra's own
    errors where the input is wrong, and Fault, its report written, for whatever else is raised."""
    try:
        values = OmegaConf.to_container(raw, resolve=True, throw_on_missing=True)
    except RecursionError as error:
        raise InputError("configuration", "(interpolated)", "", "refers to itself") from error
    try:
        _replace_alternatives(values, overrides)
        with redirect_stdout(_Printable(sys.stdout)):
            return main(build(config_class, values))  # type: ignore[arg-type]
    except InputError:
        raise
    except Exception as error:
        raise fault.reported(error) from error


def _said(error: Exception, code: int) -> int:
    """The exit code, once the error is printed."""
    print(f"error: {error}", file=sys.stderr)
    return code


class _Printable:
    """A text stream that writes control characters spelled out, since names of files and columns
    may contain them."""

    def __init__(self, stream: Any):
        self._stream = stream

    def write(self, text: str) -> int:
        """Write the text without control characters."""
        return self._stream.write(printable(text))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _conclude(directory: Path, summary: Callable[[list[Path]], None] | None) -> int:
    """Print the summary of a sweep's results, and its jobs' errors; the exit code that these have,
    0 where no job failed."""
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
    return max((fault.EXIT if own.fault else 2 for own in lost), default=0)


@contextmanager
def _interruptible() -> Iterator[None]:
    """Repeat an interruption that Python would ignore. Where Ctrl-C falls into a callback of the
    interpreter's, Python prints it and goes on; inside this `with` block it is raised again a
    moment later."""
    before, over = sys.unraisablehook, threading.Event()

    def again() -> None:
        """Interrupt the main thread, unless the block has ended."""
        if not over.is_set():
            _thread.interrupt_main()

    def hook(ignored: Any) -> None:
        """Handle an exception that Python ignores."""
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


def _replace_alternatives(values: Any, overrides: Sequence[str]) -> None:
    """Set alternatives of each key given on the command line to null: the figure given replaces the
    preset's, even where the preset states it by another key, in another unit."""
    given = [override.lstrip("+").split("=", 1)[0].split(".") for override in overrides]
    for *path, key in given:
        for group in (g for g in ALTERNATIVES if key in g):
            place = values
            for name in path:
                place = place.get(name) if isinstance(place, dict) else None
            for other in group - {key}:
                if [*path, other] not in given and isinstance(place, dict) and other in place:
                    place[other] = None


def _message_of(error: BaseException) -> str:
    """The text of an error of Hydra's; for an unknown key this project's own, which lists the keys
    that exist there."""
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
