"""Running an entry point; the only module that knows Hydra."""

import _thread
import os
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

from lbgc import sweeps, user_yaml
from lbgc.errors import InputError, build, reading, require
from lbgc.outputs import LONGEST, printable, shown
from lbgc.sensor.datasheet import ALTERNATIVES
from lbgc.sweeps import Ended

_PLACES = [parent / "conf" for parent in Path(__file__).resolve().parents[:2]]
CONF = str(next(filter(Path.is_dir, _PLACES), _PLACES[0]))
"""In lbgc/ where that was installed, beside it in the checkout."""
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

    Exit codes: 0 done, 2 the input was wrong (one clear message, no traceback), 130 interrupted.
    In a sweep each failing job is named and the others go on, in whatever process; the sweep then
    ends with 2, or with 1 and a traceback where it was no input that was wrong.
    """
    os.environ["HYDRA_FULL_ERROR"] = "1"  # exceptions reach this function; else Hydra exits with 1
    failed: list[str] = []

    def job(raw: DictConfig) -> float | None:
        """Run one job with Hydra's configuration; its score."""
        run = HydraConfig.get()
        sweeping = run.mode == RunMode.MULTIRUN
        own = (int(run.job.num), run.job.override_dirname) if sweeping else (0, "")
        try:
            values = OmegaConf.to_container(raw, resolve=True, throw_on_missing=True)
            _replace_alternatives(values, run.overrides.task)
            with redirect_stdout(_Printable(sys.stdout)):
                path = main(build(config_class, values))  # type: ignore[arg-type]
        except Exception as error:
            if sweeping:  # a job in a launcher's other process cannot report a failure otherwise
                sweeps.report(Ended(*own, None, str(error) or type(error).__name__))
                raise
            if not isinstance(error, InputError):
                raise
            failed.append(str(error))
            print(f"error: {error}", file=sys.stderr)
            return None
        if path is not None:
            print(printable(str(path)), flush=True)
        if sweeping:
            sweeps.report(Ended(*own, None if path is None else str(path), None))
        return None if score is None or path is None else score(Path(path))

    with sweeps.sweep() as directory:
        try:
            stored = store_defaults(config_class)
            for brought in user_yaml.brought(sys.argv[1:]):
                with reading("--config-dir", brought, "cannot be taken"):
                    user_yaml.check_directory(brought)
                for file in (brought / f"{name}.yaml" for name in stored):
                    ours = "is composed by the program itself, and cannot be brought along"
                    require(not file.exists(), "--config-dir", file, ours)
            with _interruptible():
                hydra.main(version_base="1.3", config_path=CONF, config_name=config_name)(job)()
            _conclude(directory, summary)
            if failed:
                sys.exit(2)
        except InputError as error:
            if _conclude(directory, summary) == 0:
                print(f"error: {error}", file=sys.stderr)
            sys.exit(2)
        except (HydraException, OmegaConfBaseException, RecursionError) as error:
            print(f"error: {printable(_message_of(error))}", file=sys.stderr)
            sys.exit(2)
        except KeyboardInterrupt:
            print("interrupted; run the same command again to go on", file=sys.stderr)
            sys.exit(130)
        except Exception:
            _conclude(directory, summary)
            raise


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
    """Print the summary of a sweep's results, and its jobs' errors; the number of jobs that
    failed."""
    jobs = sweeps.ended(directory)
    lost = [own for own in jobs if own.error is not None]
    good = [Path(own.path) for own in jobs if own.path is not None]
    if summary is not None and good:
        summary(good)
    for own in lost:
        which = f"job {own.number} ({shown(own.overrides)})"
        print(f"error: {which}: {shown(own.error, 20 * LONGEST)}", file=sys.stderr)
    if lost:
        print(f"{len(lost)} of {len(jobs)} jobs failed; the same command again skips what is "
              "finished", file=sys.stderr)  # fmt: skip
    return len(lost)


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
                place = place[name]
            for other in group - {key}:
                if [*path, other] not in given and other in place:
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
