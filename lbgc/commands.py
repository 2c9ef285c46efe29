"""Running an entry point; the only module that knows Hydra."""

import _thread
import logging
import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, get_type_hints

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, OmegaConfBaseException
from omegaconf.resolvers import oc

from lbgc import command_line, ending, fault, machine, sweeps, user_yaml
from lbgc.errors import InputError, build, require
from lbgc.fault import Fault
from lbgc.outputs import LONGEST, printable, shown
from lbgc.processes import end_with_parent
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
        own = user_yaml.group_of(hints[field])
        assert own is not None
        names.append(f"{field}_defaults")
        ConfigStore.instance().store(names[-1], as_written(asdict(own())), package=field)
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

    Exit codes: 0 done, 2 the input was wrong, or files could not be read or written (one clear
    message), 3 a fault of this program's own (two lines: what and where, and the file with its
    traceback), 128 + n told to end by the signal n (SIGINT, SIGTERM, SIGHUP), 141 what it printed
    was not read to its end; the work was done all the same.
    In a sweep each failing job is named and the others go on, in whatever process; the sweep then
    ends with 2, or with 3 where any job had a fault of its own.
    """
    os.environ["HYDRA_FULL_ERROR"] = "1"  # exceptions reach this function; else Hydra exits with 1
    logging.getLogger().addHandler(logging.NullHandler())  # what libraries log is no answer
    failed: list[int] = []  # exit codes
    here = os.getpid()

    def job(raw: DictConfig) -> float | None:
        """Run one job with Hydra's configuration; its score."""
        if os.getpid() != here:  # a launcher's other process
            end_with_parent()
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
            print(printable(str(path)), flush=True)
        if sweeping:
            sweeps.report(Ended(*own, None if path is None else str(path)))
        return None if score is None or path is None else score(Path(path))

    with ending.streams() as out, ending.Signals() as told, sweeps.sweep() as directory:
        try:
            store_defaults(config_class)
            with _brought(config_class), _interruptible():
                hydra.main(version_base="1.3", config_path=CONF, config_name=config_name)(job)()
            code = _conclude(directory, summary) or max(failed, default=0)
            out.flush()
            if out.lost is not None:
                code = code or ending.unprinted(out.lost)
            if code:
                sys.exit(code)
        except InputError as error:
            sys.exit(_conclude(directory, summary) or _said(error, 2))
        except (HydraException, OmegaConfBaseException, RecursionError) as error:
            ending.say(f"error: {printable(_message_of(error))}")
            sys.exit(2)
        except OSError as error:
            _conclude(directory, summary)
            ending.say(f"error: {ending.said(error)}")
            sys.exit(2)
        except KeyboardInterrupt:
            ending.say("interrupted; run the same command again to go on")
            sys.exit(128 + told.number)
        except Exception as error:
            own_fault = fault.reported(error)
            sys.exit(_conclude(directory, summary) or _said(own_fault, fault.EXIT))


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
    except OSError as error:
        raise ending.said(error) from error
    except Exception as error:
        raise fault.reported(error) from error


def _said(error: Exception, code: int) -> int:
    """The exit code, once the error is printed."""
    ending.say(f"error: {error}")
    return code


@contextmanager
def _brought(config_class: type) -> Iterator[None]:
    """Check the command line, take `--config-dir` out of what Hydra reads of it, and let Hydra find
    the files that are brought along as values that stand in no directory. Raises InputError instead
    of Hydra's error where one that it does not find was refused."""
    before = sys.argv
    directory, verify, options, overrides = command_line.taken_apart(before[1:])
    groups = {
        place.name: sorted(file.stem for file in place.glob("*.yaml"))
        for place in Path(CONF).iterdir()
        if place.is_dir()
    }
    overrides = [*overrides, *_log_of_a_file(overrides, config_class)]
    for group, _, value in (own.lstrip("+").partition("=") for own in overrides):
        if value == "~" and group in groups:  # YAML's null, and no word of Hydra's
            raise InputError(group, value, "", groups[group])
    for override in OverridesParser.create().parse_overrides(overrides):
        command_line.require_allowed(override, groups)
    OmegaConf.register_new_resolver("oc.env", _of_environment, replace=True)
    refused: dict[str, InputError] = {}
    try:
        sys.argv = [before[0], *options, *overrides]
        if verify:
            os.environ[machine.VERIFY] = "1"
        if directory is not None:
            refused = _store_files(directory, config_class)
        yield
    except MissingConfigException as error:
        if error.missing_cfg_file in refused:
            raise refused[error.missing_cfg_file] from error
        raise
    finally:
        sys.argv = before
        if verify:
            del os.environ[machine.VERIFY]
        for group in user_yaml.GROUPS:
            ConfigStore.instance().repo.pop(group, None)


def _log_of_a_file(overrides: Sequence[str], config_class: type) -> list[str]:
    """The override that `log.path=FILE` alone stands for, in commands that take a log."""
    schema = user_yaml.group_of(get_type_hints(config_class).get("log"))
    takes = schema is not None and "reader" in {own.name for own in fields(schema)}
    keys = {own.lstrip("+").partition("=")[0] for own in overrides}
    return ["log=auto"] if takes and "log.path" in keys and "log" not in keys else []


def _store_files(directory: Path, config_class: type) -> dict[str, InputError]:
    """Let Hydra find the files of a directory; the errors of those that are refused, by
    GROUP/NAME."""
    refused: dict[str, InputError] = {}
    hints = get_type_hints(config_class) | {"experiment": config_class}
    for group in (group for group in user_yaml.GROUPS if group in hints):
        schema = user_yaml.group_of(hints[group])
        assert schema is not None
        for name, values in user_yaml.read(directory, group, schema).items():
            own = f"{group}/{name}.yaml"
            taken = "has the name of a file that comes with lbgc: give it another"
            require(not Path(CONF, own).exists(), group, directory / own, taken)
            if isinstance(values, InputError):
                refused[f"{group}/{name}"] = values
            else:
                package = "_global_" if group == "experiment" else None
                ConfigStore.instance().store(name, values, group, package)
    return refused


def _of_environment(name: str, *default: Any) -> Any:
    """`${oc.env:NAME}` of the command line, where it is said aloud: what it stands for may get into
    a dataset that is given away."""
    print(f"note: {printable(name)} is taken from the environment", file=sys.stderr)
    return oc.env(name, *default)


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
        which = f"job {own.number} ({shown(own.overrides)})"
        print(f"error: {which}: {shown(own.error, 20 * LONGEST)}", file=sys.stderr)
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
