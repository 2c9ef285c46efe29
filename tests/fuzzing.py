"""What outside files may look like: valid ones of every kind that is read, and ways to spoil them.

Used by test_fuzz.py, a few cases each, and by `make study-fuzz`, many, in processes of their own.
"""

import contextlib
import hashlib
import json
import os
import re
import shutil
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path

import google_crc32c
import numpy as np
import pyarrow as pa
import pyarrow.parquet
from helpers import composed, labelled
from omegaconf import OmegaConf
from safetensors.torch import save
from written import EVERY, is_installed, keys_of, rows

from lbgc import user_yaml
from lbgc.calibrate import COLUMNS
from lbgc.commands import CONF
from lbgc.data import files, logs, manifest, store, unit_file
from lbgc.data.documents import Layout
from lbgc.data.logs import LogConfig
from lbgc.data.place import Place
from lbgc.data.record import mock_record
from lbgc.data.schema import VARIABLES
from lbgc.data.store import Dataset
from lbgc.data.unit_file import CalibratedUnit
from lbgc.data.windows import Labelled
from lbgc.errors import InputError, build, reading
from lbgc.evaluate import EvaluateConfig
from lbgc.learning import description
from lbgc.learning.augment import AugmentConfig
from lbgc.learning.batches import Drawn, Sensed, Stored
from lbgc.learning.estimator import WEIGHTS, Learned, load_net
from lbgc.learning.model import ModelConfig, make
from lbgc.learning.trainer import Trainer, TrainingPlan
from lbgc.outputs import UNSEALED, as_json, fingerprint, seal
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.known import Known
from lbgc.sensor.unit import coefficients

MOCK = mock_record()
NAMES = ["t", "w_x", "w_y", "w_z", "f_x", "f_y", "f_z"]
OTHER = "elsewhere"
"""A directory beside the one that is read: nothing in it may be reached through that one."""

TOKENS = (
    b"nan", b"inf", b"-inf", b"1e999", b"-1e308", b"1e308", b"5e-324", b"9" * 400, b"0", b"-0",
    b"-1", b"18446744073709551616", b"0x7f", b"1_000", b"", b"null", b"true", b"~", b"=", b"<<",
    b"2001-01-01", b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"\xc3\x28", "𝟘٣½".encode(),
    "\u202e\u2028é".encode(), b"\r\n",
    b"../../../etc/passwd", b"/etc/passwd", b"~nobody-such/x", b"/dev/zero", b"file:///etc/passwd",
    b"http://127.0.0.1:9/x", b"${oc.env:HOME}", b"${imu.name}", b"${${name}}", b"${now:}",
    b"!!python/object/apply:os.system ['true']", b"&a [*a, *a]", b"_target_: os.system", b"hydra:",
    b"defaults: [/etc/passwd]", b"import os", b"pickle", b"numcodecs.pickle", b"antigravity",
    b"[" * 3000, b"{" * 3000, b'{"a":' * 3000, b"[" * 60 + b"]" * 60, b"a: " * 50,
    b'"', b"'", b",", b":",
)  # fmt: skip
EXTREMES = [n.to_bytes(8, "little") for n in (0, 2**63 - 1, 2**63, 2**64 - 1, 2**31 - 1, 2**32 - 1)]
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")

Step = tuple[str, float, int]
"""A mutation: its name, where (a share of the file's length), and a number that says the rest."""


def _flip(c: bytearray, at: int, n: int, others: Sequence[bytes]) -> None:
    if c:
        c[min(at, len(c) - 1)] ^= 1 << n % 8


def _truncate(c: bytearray, at: int, n: int, others: Sequence[bytes]) -> None:
    del c[at:]


def _drop(c: bytearray, at: int, n: int, others: Sequence[bytes]) -> None:
    del c[at : at + 1 + n % 64]


def _repeat(c: bytearray, at: int, n: int, others: Sequence[bytes]) -> None:
    c[at:at] = bytes(c[at : at + 1 + n % 64]) * (1 + n // 64 % 200)


def _splice(c: bytearray, at: int, n: int, others: Sequence[bytes]) -> None:
    """Part of another file over what was there."""
    other = others[n % len(others)]
    first = n % (len(other) + 1)
    part = other[first : first + 1 + n // 7 % 256]
    c[at : at + len(part)] = part


def _insert(c: bytearray, at: int, n: int, others: Sequence[bytes]) -> None:
    c[at:at] = TOKENS[n % len(TOKENS)]


def _number(c: bytearray, at: int, n: int, others: Sequence[bytes]) -> None:
    """Another number, or no number at all, where one stands."""
    found = _NUMBER.search(bytes(c), at) or _NUMBER.search(bytes(c))
    if found:
        c[found.start() : found.end()] = TOKENS[n % len(TOKENS)]


def _extreme(c: bytearray, at: int, n: int, others: Sequence[bytes]) -> None:
    value = EXTREMES[n % len(EXTREMES)][: 4 if n % 2 else 8]
    c[at : at + len(value)] = value


def _grow(c: bytearray, at: int, n: int, others: Sequence[bytes]) -> None:
    """The same again and again, up to a quarter of a megabyte."""
    if c and len(c) < 250_000:
        c[:] = (bytes(c) * min(2 + n % 64, 1 + 250_000 // len(c)))[:250_000]


EDITS: dict[str, Callable[[bytearray, int, int, Sequence[bytes]], None]] = {
    "flip": _flip, "truncate": _truncate, "drop": _drop, "repeat": _repeat, "splice": _splice,
    "insert": _insert, "number": _number, "extreme": _extreme, "grow": _grow,
}  # fmt: skip
PLANTS = ("link", "dangling", "loop", "directory", "pipe", "absent", "name")
"""What else may stand where a file was."""


def edited(content: bytes, steps: Sequence[Step], others: Sequence[bytes]) -> bytes:
    """The content after some steps."""
    changed = bytearray(content)
    for name, where, number in steps:
        EDITS[name](changed, int(where * len(changed)), number, others)
    return bytes(changed)


@dataclass(frozen=True)
class Reader:
    """One kind of outside data: a valid example, and what reads it."""

    files: Mapping[str, bytes]
    """Of the example: relative name -> content."""
    read: Callable[[Path], object]
    """From the example's directory to an answer, for which `is_right` holds."""
    is_right: Callable[[object], bool]
    """Whether an answer is possible at all, whatever the file now says."""
    targets: Sequence[str] = ()
    """Files that get spoiled; all, if none is named."""
    reseal: Callable[[Path], None] | None = None
    """Makes the example's checksums fit what was done to it, as a forger would."""
    exact: bool = False
    """Any answer must be the valid example's, unless it was resealed."""
    closed: bool = False
    """A link in it must be refused."""


# --- logs -------------------------------------------------------------------------------------


def _rows(count: int) -> np.ndarray:
    """The mock record as a file has it: s, deg/s, m/s^2, (count, 7)."""
    gyro, accel = np.rad2deg(MOCK.gyro[:count]), MOCK.accel[:count]
    return np.column_stack([np.arange(count) / 10.0, gyro, accel])


def _csv(names: Sequence[str], rows: np.ndarray) -> bytes:
    lines = [",".join(names), *(",".join(f"{v:.9g}" for v in row) for row in rows)]
    return ("\n".join(lines) + "\n").encode()


def _parquet(compression: str) -> bytes:
    sink = pa.BufferOutputStream()
    table = pa.table(dict(zip(NAMES, _rows(40).T, strict=True)))
    pa.parquet.write_table(table, sink, compression=compression)
    return sink.getvalue().to_pybytes()


def _psins() -> bytes:
    head = "% comment\n1 2 -40.0 0 0 0\n32.76 35.0 0 0 100.0 9.78\n0.5 0.5 0.5 10 10 10\n"
    gyro = np.rad2deg(MOCK.gyro[:40]) * 3600 * 0.1 / 0.5
    rows = np.column_stack([gyro, MOCK.accel[:40] / 9.78 * 1e6 * 0.1 / 10])
    return (head + "\n".join(" ".join(f"{v:.6g}" for v in row) for row in rows) + "\n").encode()


def _log(reader: str, path: str, **changes: object) -> Reader:
    said = {"gyro_unit": "deg/s", "latitude": 32.76, "bias_limit_deg_per_h": 5.0} | changes
    content = {".csv": _csv(NAMES, _rows(40)), ".imu": _psins()}.get(Path(path).suffix)
    files = {path: _parquet(str(said.pop("compression", ""))) if content is None else content}

    def read(home: Path) -> object:
        where = home if reader == "recordings" else home / path
        return list(logs.read(LogConfig(path=str(where), reader=reader, **said)))  # type: ignore[arg-type]

    return Reader(files, read, _possible_records, closed=reader == "recordings")


def _format(kind: str, home: Path) -> Reader:
    """A file of a binary format, or the files of a bag's directory."""
    own = EVERY[kind]
    path = home / kind.replace(" ", "_") / own.name
    path.parent.mkdir()
    own.write(path, rows(40))
    files = [path] if path.is_file() else sorted(path.iterdir())
    content = {str(file.relative_to(path.parent)): file.read_bytes() for file in files}
    keys = {"latitude": 32.76, "bias_limit_deg_per_h": 5.0} | keys_of(kind)

    def read(home: Path) -> object:
        return list(logs.read(LogConfig(path=str(home / own.name), **keys)))

    return Reader(content, read, _possible_records, closed=path.is_dir())


FORMATS = (
    "text gz",
    "text bz2",
    "text xz",
    "text zip",
    "feather",
    "feather 1",
    "arrow stream",
    "npy",
    "npy 3.0",
    "npz",
    "matlab 4",
    "matlab 7",
    "matlab 7.3",
    "hdf5",
    "ros 1",
    "ros 2",
    "ros 2 mcap",
    "ulog combined",
    "dataflash",
    "dataflash text",
    "r",
    "r object",
    "rows",
)


def _possible_records(records: object) -> bool:
    assert isinstance(records, list)
    return all(
        np.isfinite(r.gyro).all()
        and np.isfinite(r.accel).all()
        and 0 < r.rate_hz < np.inf
        and abs(r.latitude) <= np.pi / 2
        and (r.heading_reference is None or abs(r.heading_reference) <= 2 * np.pi)
        for r in records
    )


def _means() -> Reader:
    rows = np.column_stack([np.arange(0, 360, 30.0), _rows(12)[:, 1:4], np.arange(12) % 2])

    def read(home: Path) -> object:
        return logs.columns(str(home / "means.csv"), COLUMNS, optional=("session",))

    content = {"means.csv": _csv([*COLUMNS, "session"], rows)}

    def is_right(found: object) -> bool:
        return isinstance(found, dict) and all(np.isfinite(own).all() for own in found.values())

    return Reader(content, read, is_right)


# --- configurations ---------------------------------------------------------------------------


@cache
def _defaults() -> object:
    return OmegaConf.create(asdict(composed(EvaluateConfig, "evaluate", "data=x", "imu=stim300")))


def _yaml(group: str, name: str, config: type) -> Reader:
    """As `--config-dir DIR group=name`: read, then merged into what is there and built."""

    def read(home: Path) -> object:
        raw = user_yaml.read(home, group, config).get("mine", {})
        if isinstance(raw, InputError):
            raise raw
        with reading(group, home):  # Hydra's part, whose errors `run_main` says
            own = {} if group == "log" else OmegaConf.select(_defaults(), group)  # type: ignore[arg-type]
            merged = OmegaConf.merge({group: own}, {group: raw})
            values = OmegaConf.to_container(merged, resolve=True)[group]  # type: ignore[index]
        built = build(config, {"path": "x"} | values if group == "log" else values)
        return built.model(100.0) if isinstance(built, ImuConfig) else built

    content = (Path(CONF) / group / f"{name}.yaml").read_bytes()
    content = content.replace(b"path: ???", b"path: x.csv").replace(b"???", b"1")
    return Reader({f"{group}/mine.yaml": content}, read, lambda _: True)


# --- models and checkpoints -------------------------------------------------------------------

_MODEL = ModelConfig("tiny", layers=1, hidden=2)
_IMU = build(ImuConfig, {"name": "tiny", "gyro": {"bias_unit_deg_per_h": 1.0}})


@cache
def _window() -> Labelled:
    noise = 1e-6 * np.random.default_rng(1).standard_normal((2, *MOCK.gyro.shape))
    return labelled(mock_record(gyro=MOCK.gyro + noise[0], accel=MOCK.accel + noise[1]), 25.0)


def tiny_trainer() -> Trainer:
    plan = TrainingPlan(_MODEL, {5.0: 1}, 2, 2, 0.004, "onecycle", 1.0, 1, None, 1, 1, 0, 0.0, 1)
    imu = _IMU.model(600.0)
    sensed = Sensed(_MODEL, _window().windows.rate_hz, imu)
    source = Stored(_window(), np.zeros(len(_window()), int), AugmentConfig(), imu.gyro)
    return Trainer(plan, Drawn(source, sensed), sensed, _window(), _window())


def _checkpoint(home: Path) -> Reader:
    file = home / "made.safetensors"
    tiny_trainer().run(file, lambda _: None)

    def read(home: Path) -> object:
        trainer = tiny_trainer()
        trainer.run(home / file.name, lambda _: None)
        return hashlib.sha256(save(trainer.net.state_dict()) + save(trainer.best)).hexdigest()

    def reseal(home: Path) -> None:
        content = (home / file.name).read_bytes()
        (home / file.name).write_bytes(_opened(content, rb'"checksum":"([^"]*)"'))

    return Reader({file.name: file.read_bytes()}, read, bool, reseal=reseal, exact=True)


def _known() -> CalibratedUnit:
    """What is known of a unit of the small network's sensor."""
    own = coefficients(_IMU.model(600.0), "unit")
    sigma = np.array(list(own.values()))
    known = Known(tuple(own), 0.5 * sigma, np.diag(0.3 * sigma**2))
    sizes = (1e-6,) * 3, (2e-6,) * 3, (3e-6,) * 3
    return CalibratedUnit(_IMU.name, fingerprint(asdict(_IMU)), sizes, known, 5, ("a",), None)


def _unit() -> Reader:
    def read(home: Path) -> object:
        own = unit_file.load(str(home / "unit.json"), _IMU)
        left = own.told(_IMU.model(600.0)).gyro
        return [*left.bias().tolist(), *own.known.mean.tolist(), *own.known.sigma.tolist()]

    def reseal(home: Path) -> None:
        file = home / "unit.json"
        with contextlib.suppress(ValueError, KeyError, TypeError, AttributeError, RecursionError):
            said = json.loads(file.read_bytes())
            del said["sha256"]
            said["sha256"] = hashlib.sha256(
                as_json(said, indent=None, sort_keys=True).encode()
            ).hexdigest()
            file.write_text(as_json(said))

    content = as_json(_known().content, indent=1).encode()
    return Reader({"unit.json": content}, read, _possible_headings, reseal=reseal, exact=True)


def _model() -> Reader:
    weights = save(make(_MODEL, seed=1).state_dict())
    said = {
        "model": asdict(_MODEL), "rate_hz": 0.2, "sensor": "tiny", "parameters": 100,
        "best_validation_deg": 1.0, "steps": 2, "training": {"windows_s": [25.0]},
        "dataset": "x", "protocol": "static", "latitude_deg": [32.0, 33.0],
        "imu_rate_hz": 600.0, "seconds": 1.0,
        "units": {"unit_seed": 4, "units": 1, "imu": asdict(_IMU)},
        "calibration": _known().content,
    }  # fmt: skip

    def read(home: Path) -> object:
        return Learned.load(home)(_window().windows).heading.tolist()

    def reseal(home: Path) -> None:
        file = home / description.DESCRIPTION
        own = hashlib.sha256((home / WEIGHTS).read_bytes()).hexdigest().encode()
        content = re.sub(rb'"weights": "[^"]*"', b'"weights": "' + own + b'"', file.read_bytes())
        file.write_bytes(_opened(content, rb'"checksum": "([^"]*)"'))

    files = {description.DESCRIPTION: description.compose(said, weights), WEIGHTS: weights}
    return Reader(files, read, _possible_headings, reseal=reseal, exact=True)


def model_files() -> Mapping[str, bytes]:
    """A run's files: a small network's."""
    return _model().files


def _opened(content: bytes, pattern: bytes) -> bytes:
    """Sealed anew, where there is still a place for the seal."""
    found = re.search(pattern, content)
    if found is None:
        return content
    return seal(content[: found.start(1)] + UNSEALED.encode() + content[found.end(1) :])


# --- stores -----------------------------------------------------------------------------------

LAYOUT = Layout(2, 4200, 50.0, {"gyro": 1e-6, "accel": None})
"""A shard of several chunks, so that there is an index of them as well."""


def _store(home: Path) -> dict[str, bytes]:
    path = home / "made.zarr"
    dataset = store.create(path, LAYOUT, {"a": 1}, {})
    sizes = {"recording": 2, "time": LAYOUT.samples, "axis": 3, "axis_in": 3}
    rng = np.random.default_rng(1)
    batch = {n: rng.integers(0, 2, [sizes[d] for d in VARIABLES[n].dims]) for n in LAYOUT.variables}
    dataset.write_shard(0, batch)
    return {f"d.zarr/{n}": dataset.place.read(n) or b"" for n in dataset.place.names()}


def _read_store(home: Path) -> object:
    dataset = Dataset.open_finished(home / "d.zarr")
    records = list(dataset.records(dataset.in_split("train")))
    return dataset.digest(), len(records), dataset.rate_hz


def _reseal_store(home: Path) -> None:
    """Every checksum: of chunks, of the shard, of the documents, of the manifest."""
    place = Place(home / "d.zarr")
    found = {name: place.read(name) or b"" for name in LAYOUT.documents}
    try:
        said = json.loads(found[files.ROOT])["attributes"]
        identity = fingerprint({"schema": said["schema"], **said["configuration"]})
        text = found[files.ROOT].replace(str(said["identity"]).encode(), identity.encode())
        place.write(files.ROOT, text)
        found[files.ROOT] = text
    except (ValueError, KeyError, TypeError, RecursionError):
        identity = "x"
    place.write(manifest.MANIFEST, manifest.compose(identity, found))
    for name in files.shard_files(0, LAYOUT.variables):
        content = place.read(name)
        if content and "/c.0.0.0" not in name:
            place.write(name, content[:-4] + _crc(content[:-4]))
    (file,), own = files.row_files(0), files.shard_files(0, LAYOUT.variables)
    entries = place.entries()
    sizes = {name: entries[name].size for name in own if name in entries}
    row = manifest.stored_checksum(identity, 0, own, place.read) + manifest.sizes_checksum(sizes)
    place.write(file, row + _crc(row))


def _crc(content: bytes) -> bytes:
    return google_crc32c.value(content).to_bytes(4, "little")


@dataclass
class Bench:
    """Where cases are tried: a directory with the valid example, spoiled and mended in turn."""

    home: Path
    reader: Reader
    others: Sequence[bytes]
    right: object = field(init=False)

    def __post_init__(self) -> None:
        self.place = self.home / "own"
        for name, content in self.reader.files.items():
            for directory in (self.place, self.home / OTHER):
                (directory / name).parent.mkdir(parents=True, exist_ok=True)
                (directory / name).write_bytes(content)
        self.right = self.reader.read(self.place)
        assert self.reader.is_right(self.right)

    def spoil(self, target: str, steps: Sequence[Step], forged: bool) -> None:
        """Do all steps to a file of the example."""
        file = self.place / target
        edits = [step for step in steps if step[0] in EDITS]
        file.write_bytes(edited(self.reader.files[target], edits, self.others))
        if forged and self.reader.reseal is not None:
            self.reader.reseal(self.place)
        for name, _, number in steps:
            if name in PLANTS:
                self._plant(name, file, number)

    def _plant(self, name: str, file: Path, number: int) -> None:
        file.unlink(missing_ok=True)
        elsewhere = self.home / OTHER / file.relative_to(self.place)
        if name == "link":
            up = os.path.relpath(elsewhere, file.parent)
            file.symlink_to(up if number % 2 else elsewhere)
        elif name == "dangling":
            file.symlink_to("/nowhere/at all")
        elif name == "loop":
            file.symlink_to(file.name)
        elif name == "directory":
            file.mkdir()
        elif name == "pipe":
            os.mkfifo(file)
        elif name == "name":
            told = ("9" * 200, "-1e5", "..", "nan", "é\u202e", "-0.5", "40_40", "\udcff")
            odd = f"{file.stem}_{told[number % len(told)]}{file.suffix}"
            (file.parent / odd).write_bytes(self.reader.files[str(file.relative_to(self.place))])

    def mend(self) -> None:
        """The valid example again."""
        for path in sorted(self.place.rglob("*"), reverse=True):
            name = str(path.relative_to(self.place))
            if path.is_dir() and not path.is_symlink():
                if name in self.reader.files:
                    shutil.rmtree(path)
            elif path.is_symlink() or not path.is_file() or name not in self.reader.files:
                path.unlink()
        for name, content in self.reader.files.items():
            path = self.place / name
            if not path.is_file() or path.read_bytes() != content:
                path.write_bytes(content)

    def verdict(self, answer: object, steps: Sequence[Step], forged: bool) -> str | None:
        """What is wrong with an answer, or None."""
        if self.reader.closed and any(name == "link" for name, _, _ in steps):
            return "followed a link out of its directory"
        if not self.reader.is_right(answer):
            return f"an impossible answer: {answer}"
        resealed = forged and self.reader.reseal is not None
        if self.reader.exact and not resealed and answer != self.right:
            return "another answer than the file's that was damaged"
        return None


def readers(home: Path) -> dict[str, Reader]:
    """Every reader of outside data, its example made below `home`."""
    stored = _store(home)
    payload = [n for n in stored if "/c." in n and "manifest" not in n]
    documents = [n for n in stored if n.endswith("zarr.json")]
    rows = [n for n in stored if "manifest" in n]

    def of_store(targets: Sequence[str]) -> Reader:
        return Reader(stored, _read_store, bool, targets, _reseal_store, exact=True, closed=True)

    return {
        "csv": _log("table", "log.csv", time_column="t"),
        "recordings": _log("recordings", "x_40.csv", rate_hz=10.0),
        "means": _means(),
        "parquet": _log("table", "log.parquet", time_column="t", compression="zstd"),
        "parquet snappy": _log("table", "log.parquet", time_column="t", compression="snappy"),
        "psins": _log("psins", "log.imu"),
        **{kind: _format(kind, home) for kind in FORMATS if is_installed(kind)},
        "imu yaml": _yaml("imu", "stim300", ImuConfig),
        "log yaml": _yaml("log", "csv", LogConfig),
        "checkpoint": _checkpoint(home),
        "model": _model(),
        "unit": _unit(),
        "store payload": of_store(payload),
        "store documents": of_store(documents),
        "manifest": of_store(rows),
    }


def exported(home: Path) -> bytes | None:
    """A network as ONNX; None where the packages of the extra `onnx` are missing."""
    from lbgc.learning import onnx

    made = home / "run"
    made.mkdir()
    for name, content in _model().files.items():
        (made / name).write_bytes(content)
    net, said = load_net(made)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the exporter's own
            onnx.write(net, said, made / "model.onnx")
    except InputError:
        return None
    return (made / "model.onnx").read_bytes()


def onnx_reader(content: bytes) -> Reader:
    """Of what `exported` gives."""
    from lbgc.learning import onnx

    def read(home: Path) -> object:
        return onnx.load(home / "model.onnx")(_window().windows).heading.tolist()

    return Reader({"model.onnx": content}, read, _possible_headings, exact=True)


def _possible_headings(heading: object) -> bool:
    return bool(np.isfinite(heading).all())  # type: ignore[call-overload]
