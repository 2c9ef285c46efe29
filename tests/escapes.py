"""Ways in which a directory that is brought along, or a command line that somebody sent, may try to
have something run, read, written or told: drawn from a seed, and tried under an audit hook.

    python tests/escapes.py SEED FIRST COUNT     says how many got out, and which

Used by test_escapes.py, a few of each kind, and by `make study-fuzz`, a thousand.
"""

import contextlib
import io
import json
import os
import pickle
import random
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

SECRET, SECRET_NAME = "open-sesame-5521", "LBGC_TEST_SECRET"
TARGETS = ("os.system", "subprocess.run", "builtins.eval", "builtins.exec", "escape_canary.run",
           "escape_canary.Callback", "importlib.import_module", "pickle.loads", "shutil.rmtree",
           "logging.FileHandler", "urllib.request.urlopen", "hydra.utils.get_method")  # fmt: skip
FILLED_IN = (
    "${{oc.env:{0}}}", "x${{oc.env:{0}}}y", "${{oc.env:{0},none}}",
    "${{oc.decode:${{oc.env:{0}}}}}",
    "${{oc.create:{{a: ${{oc.env:{0}}}}}}}", "\\${{oc.env:{0}}}", "\\\\${{oc.env:{0}}}",
    "${{oc.select:hydra.runtime.cwd}}", "${{hydra:runtime.cwd}}", "${{now:%Y}}", "${{imu.name}}",
    "${{oc.create:'{{_target_: os.system}}'}}", "${{oc.${{imu.name}}:{0}}}", "${{",
    "$${{oc.env:{0}}}",
)  # fmt: skip
INSIDE = {
    "imu": [(), ("gyro",), ("accel",), ("gyro", "lines"), ("temperature",), ("timing",)],
    "scene": [(), ("floor",), ("floor", "knocks"), ("sway",)],
    "protocol": [()],
    "experiment": [(), ("imu",), ("imu", "gyro"), ("protocol",)],
    "model": [()],
    "log": [()],
}
TEXTS = {"imu": "name", "scene": "physics_hz", "protocol": "name", "experiment": "output",
         "model": "name", "log": "name"}  # fmt: skip
ENTRIES = {"imu": "generate", "scene": "generate", "protocol": "bound", "experiment": "generate",
           "model": "train", "log": "evaluate"}  # fmt: skip


@dataclass(frozen=True)
class Variant:
    """One attempt: an entry point's name, its arguments, and what lies in the directory."""

    kind: str
    entry: str
    arguments: list[str]
    files: dict[str, str] = field(default_factory=dict)
    links: dict[str, str] = field(default_factory=dict)
    honest: bool = False
    """It must be done, not refused."""


Draw = Callable[[random.Random], Variant]


def _written(rng: random.Random, values: Any) -> str:
    """Values as YAML, in one of its styles; keys and texts at times spelled out."""
    style = rng.choice([None, True, False])
    text = yaml.safe_dump(values, default_flow_style=style, sort_keys=rng.random() < 0.5)
    if rng.random() < 0.2:
        text = json.dumps(values)
    if rng.random() < 0.15:
        text = (
            json.dumps(values).replace("$", "\\u0024").replace("_t", "\\x5ft").replace("h", "\\x68")
        )
    return text


def _put(values: dict[str, Any], path: tuple[str, ...], what: dict[str, Any]) -> dict[str, Any]:
    place = values
    for name in path:
        place = place.setdefault(name, {})
    place |= what
    return values


def _brought(rng: random.Random, kind: str, group: str, text: str, **more: Any) -> Variant:
    asked = rng.choice([["--config-dir", "DIR"], ["--config-dir=DIR"], ["-cd", "DIR"]])
    many = ["--multirun", f"{group}=mine,mine"] if rng.random() < 0.2 else [f"{group}=mine"]
    return Variant(kind, ENTRIES[group], [*asked, *many], {f"{group}/mine.yaml": text}, **more)


def _payload(rng: random.Random) -> dict[str, Any]:
    target = rng.choice(TARGETS)
    what = {rng.choice(["_target_", "_target_ ", "()", "class", "_call_"]): target}
    if rng.random() < 0.7:
        what |= {rng.choice(["_args_", "args", "command"]): ["touch escaped"]}
    return (
        {rng.choice(["x", "callbacks", "name", "root", "launcher"]): what}
        if rng.random() < 0.5
        else what
    )


def instantiated(rng: random.Random) -> Variant:
    group = rng.choice(list(INSIDE))
    path = rng.choice(INSIDE[group])
    return _brought(rng, "_target_", group, _written(rng, _put({}, path, _payload(rng))))


def of_hydra(rng: random.Random) -> Variant:
    """Hydra's settings in a file, as a key, by a header, or both."""
    group = rng.choice(list(INSIDE))
    callback = {"escape": {"_target_": rng.choice(TARGETS)}}
    setting = rng.choice(
        [
            {"callbacks": callback},
            {"searchpath": ["file://ELSEWHERE", "pkg://escape_canary"]},
            {"launcher": {"_target_": "escape_canary.Callback"}},
            {"launcher": {"setup": ["touch escaped"], "submitit_folder": "ELSEWHERE/jobs"}},
            {"sweeper": {"_target_": "escape_canary.Callback", "params": {"seed": "1,2"}}},
            {
                "sweeper": {
                    "custom_search_space": "escape_canary.run",
                    "storage": "sqlite:///escaped",
                }
            },
            {
                "job_logging": {
                    "version": 1,
                    "handlers": {
                        "h": {"class": "logging.FileHandler", "filename": "ELSEWHERE/log"}
                    },
                    "root": {"handlers": ["h"]},
                }
            },
            {"run": {"dir": "ELSEWHERE/run"}},
            {"sweep": {"dir": "ELSEWHERE/sweep"}},
            {"output_subdir": "escaped"},
            {
                "job": {
                    "chdir": True,
                    "env_set": {"PYTHONPATH": "ELSEWHERE"},
                    "env_copy": [SECRET_NAME],
                }
            },
            {"help": {"template": "${oc.env:" + SECRET_NAME + "}"}},
            {"mode": "MULTIRUN"},
        ]
    )
    head, values = "", {"hydra": setting}
    if rng.random() < 0.5:
        (name, own), *_ = setting.items()
        of = rng.choice([f"hydra.{name}", "hydra", "_global_.hydra", f"_global_.hydra.{name}"])
        head = f"{rng.choice(['# @package', '#@package', ' # @package'])} {of}\n"
        values = own if isinstance(own, dict) and of.endswith(name) else setting
    elif rng.random() < 0.7:
        head = "# @package _global_\n"
    return _brought(rng, "hydra", group, head + _written(rng, values))


def defaults(rng: random.Random) -> Variant:
    """A list of defaults that reaches where it must not."""
    group = rng.choice(list(INSIDE))
    of = rng.choice(
        [
            "hydra.callbacks",
            "hydra.launcher",
            "hydra",
            "_global_",
            "_global_.hydra.callbacks.x",
            "${oc.create:hydra.callbacks}",
            "hydra.${oc.env:HOME}",
        ]
    )
    name = rng.choice(
        [
            "evil",
            "../../ELSEWHERE/evil",
            "/ELSEWHERE/evil",
            "${oc.env:HOME}",
            "../experiment/evil",
            "pkg://escape_canary",
            "file://ELSEWHERE/evil",
        ]
    )
    entry = rng.choice(
        [
            f"/imu@{of}: {name}",
            f"evil@{of}",
            f"/{group}/{name}@{of}",
            {f"/imu@{of}": name},
            {f"override /hydra/launcher@{of}": name},
            {"override /hydra/job_logging": "stdout"},
            {"override /hydra/launcher": "joblib"},
            {"override hydra/sweeper": "optuna"},
            {f"optional /imu@{of}": name},
            {"/hydra/callbacks": "x"},
            name + "/x",
            {"override /imu": "../../ELSEWHERE/evil"},
            {"/imu": [name, name]},
            {"override /cluster": "dask"},
            [["evil"]],
            {"override /imu@hydra.callbacks": "evil"},
            f"{name} ",
        ]
    )
    listed: Any = [entry, "_self_"] if rng.random() < 0.7 else ["_self_", entry]
    variant = _brought(rng, "defaults", group, _written(rng, {"defaults": listed}))
    evil = _written(rng, {"x": rng.choice([{"_target_": rng.choice(TARGETS)}, CREATED])})
    return replace(variant, files=variant.files | {f"{group}/evil.yaml": evil})


def filled_in(rng: random.Random) -> Variant:
    """A text that the environment or another key would be put into."""
    group = rng.choice(list(INSIDE))
    text = rng.choice(FILLED_IN).format(SECRET_NAME)
    values = rng.choice([{TEXTS[group]: text}, {text: 1}, {TEXTS[group]: [text]}, {"gyro": text}])
    return _brought(rng, "${}", group, _written(rng, values))


def tagged(rng: random.Random) -> Variant:
    group = rng.choice(list(INSIDE))
    tag = rng.choice(
        [
            "!!python/object/apply:",
            "!!python/object/new:",
            "!!python/name:",
            "!!python/module:",
            "!<tag:yaml.org,2002:python/object/apply:",
            "!!python/object:",
        ]
    )
    target = rng.choice(TARGETS) + (">" if tag.startswith("!<") else "")
    text = rng.choice(
        [
            f"{TEXTS[group]}: {tag}{target} ['touch escaped']",
            f"? {tag}{target} ['touch escaped']\n: 1",
            "%TAG !e! tag:yaml.org,2002:python/\n---\n"
            f"{TEXTS[group]}: !e!object/apply:{target.strip('>')} [x]",
            f"{TEXTS[group]}: !!binary aGk=",
            f"{TEXTS[group]}: !!set {{x, y}}",
            f"{TEXTS[group]}: !local x",
            f"defaults: !!python/tuple [{tag}{target} [x]]",
            f"{TEXTS[group]}: !!merge x",
        ]
    )
    return _brought(rng, "tag", group, text)


def grown(rng: random.Random) -> Variant:
    """A small file that unfolds."""
    group, n = rng.choice(list(INSIDE)), rng.randrange(8, 40)
    key = TEXTS[group]
    text = rng.choice(
        [
            f"{key}: [&a0 [x, x]" + "".join(f", &a{i + 1} [*a{i}, *a{i}]" for i in range(n)) + "]",
            f"{key}: &a [*a, *a]",
            f"{key}: &a {{b: *a}}",
            f"{key}: " + "[" * n * 40 + "]" * n * 40,
            f"{key}: " + "{a: " * n * 40 + "}" * n * 40,
            f"{key}: " + "9" * n * 1000,
            f"{key}: " + "1:" * n * 1000 + "1",
            "\n".join(f"k{i}: 1" for i in range(n * 300)),
            "x0: &x0 {a: 1, b: 2}\n"
            + "\n".join(f"x{i + 1}: &x{i + 1} {{<<: [*x{i}, *x{i}]}}" for i in range(n)),
            f"? &k [*k]\n: {key}",
            f"{key}: '" + "x" * n * 5000 + "'",
            "# " + "x" * 200_000 + f"\n{key}: x",
            "? [&a0 [x, x]" + "".join(f", &a{i + 1} [*a{i}, *a{i}]" for i in range(n)) + "]\n: 1",
        ]
    )
    return _brought(rng, "growth", group, text)


def planted(rng: random.Random) -> Variant:
    """What lies beside the file, or in its place."""
    group = rng.choice(list(INSIDE))
    variant = _brought(rng, "planted", group, f"{TEXTS[group]}: x" if group != "scene" else "{}")
    evil = "# @package _global_\nhydra: {callbacks: {e: {_target_: escape_canary.Callback}}}\n"
    code = "open('escaped', 'w')\n"
    more = rng.choice(
        [
            {"hydra/launcher/basic.yaml": evil},
            {"hydra/callbacks/e.yaml": evil},
            {f"{variant.entry}.yaml": evil},
            {"common.yaml": evil},
            {"imu_defaults.yaml": evil},
            {"hydra_plugins/evil.py": code, "hydra_plugins/x/evil.py": code},
            {"__init__.py": code, "conf.py": code, "escape_canary.py": code},
            {"config.yaml": evil, "hydra.yaml": evil},
            {"cluster/mine.yaml": "kind: dask\naddress: tcp://127.0.0.1:9"},
            {f"{group}/__init__.py": code, ".hydra/config.yaml": evil},
        ]
    )
    links = rng.choice(
        [
            {},
            {},
            {f"{group}/mine.yaml": "ELSEWHERE/secret"},
            {f"{group}/mine.yaml": "/dev/zero"},
            {f"{group}/mine.yaml": "/proc/self/environ"},
            {f"{group}/mine.yaml": "mine.yaml"},
        ]
    )
    files = {name: text for name, text in variant.files.items() if name not in links} | more
    arguments = [*variant.arguments, *(["cluster=mine"] if "cluster/mine.yaml" in more else [])]
    return replace(variant, files=files, links=links, arguments=arguments)


def placed(rng: random.Random) -> Variant:
    """An experiment that says where to write, what to open or whom to connect to."""
    where = rng.choice(
        ["ELSEWHERE/d.zarr", "s3://bucket/d.zarr", "http://127.0.0.1:9/d", "~/d.zarr", "/d.zarr"]
    )
    values = rng.choice(
        [
            {"out": where},
            {"cluster": {"kind": "dask", "address": "tcp://127.0.0.1:9"}},
            {"cluster": {"kind": "local", "workers": 10**6}},
            {"data": where},
            {"run": where},
        ]
    )
    return _brought(rng, "places", "experiment", "# @package _global_\n" + _written(rng, values))


def options(rng: random.Random) -> Variant:
    """Options of Hydra's that name a place, whole or cut short."""
    name, value = rng.choice(
        [
            ("config-path", "ELSEWHERE"),
            ("config-name", "evil"),
            ("config-name", "../../ELSEWHERE/evil"),
            ("experimental-rerun", "ELSEWHERE/evil.pickle"),
            ("config-path", "pkg://escape_canary"),
        ]
    )
    short = {"config-path": "-cp", "config-name": "-cn"}
    whole = f"--{name[: rng.randrange(len('config-n') if 'config' in name else 3, len(name) + 1)]}"
    word = rng.choice([whole, f"--{name}", short.get(name, whole)])
    said = rng.choice([[word, value], [f"{word}={value}"]])
    rest = ["imu=ideal"] if rng.random() < 0.5 else []
    return Variant("options", "bound", rng.choice([[*said, *rest], [*rest, *said]]))


def overrides(rng: random.Random) -> Variant:
    """Hydra's settings, and choices that are paths, on the command line."""
    target = rng.choice(TARGETS)
    word = rng.choice(
        [
            "hydra.searchpath=[file://ELSEWHERE]",
            "hydra.searchpath=[pkg://escape_canary]",
            f"+hydra.callbacks.e._target_={target}",
            f"+hydra.callbacks={{e: {{_target_: {target}}}}}",
            f"hydra.launcher._target_={target}",
            f"hydra.sweeper._target_={target}",
            "hydra/launcher=evil",
            "hydra/launcher=../../ELSEWHERE/evil",
            "hydra/job_logging=stdout",
            "hydra/hydra_logging=default",
            "hydra={callbacks: {}}",
            "+imu@hydra.callbacks=ideal",
            "imu@hydra.launcher=ideal",
            "~hydra.run",
            "hydra.run.dir=ELSEWHERE/run",
            "hydra.sweep.dir=ELSEWHERE/sweep",
            "hydra.output_subdir=escaped",
            "hydra.job.chdir=true",
            "+hydra.job.env_set.PYTHONPATH=ELSEWHERE",
            f"hydra.job.env_copy=[{SECRET_NAME}]",
            "hydra.help.template=x",
            "hydra/env=../../ELSEWHERE/evil",
            "hydra.verbose=true",
            "+hydra.launcher.setup=['touch escaped']",
            "hydra.launcher.partition='x\\n touch escaped'",
            "hydra.sweeper.storage=sqlite:///escaped",
            "+hydra.sweeper.custom_search_space=escape_canary.run",
            "hydra.launcher.pre_dispatch='__import__(\"escape_canary\")'",
            "+hydra.sweeper.params.seed='1,2'",
            "imu=../../ELSEWHERE/evil",
            "imu=/ELSEWHERE/evil",
            "'imu=\\../evil'",
            "imu=[../evil]",
            "imu=${oc.env:HOME}",
            "+experiment=../../ELSEWHERE/evil",
            "+hydra/callbacks=evil",
            f"++hydra.job_logging.handlers.h.class={target}",
            "hydra.launcher.temp_folder=ELSEWHERE",
            "+hydra.sweeper.sampler._target_=escape_canary.run",
            "hydra.mode='x y'",
        ]
    ).replace("ELSEWHERE", rng.choice(["ELSEWHERE", "../elsewhere"]))
    entry = rng.choice(["bound", "generate"])
    several = ["--multirun", "latitude=1,2"] if rng.random() < 0.4 else []
    about = rng.choice([[], [], ["--cfg", "all"], ["--help"]])
    extra = rng.choice([[], ["imu=ideal"], ["latitude=3"]])
    words = [word, *extra] if rng.random() < 0.5 else [*extra, word]
    return Variant("overrides", entry, [*(several or about), *words])


def told(rng: random.Random) -> Variant:
    """The environment on the command line is the user's own word, and is said aloud."""
    text = rng.choice(FILLED_IN[:5]).format(SECRET_NAME)
    return Variant("told", rng.choice(["bound", "generate"]), [f"imu.name='{text}'"])


def honest(rng: random.Random) -> Variant:
    """What users do, which must go on."""
    name, latitude = f"sensor {rng.randrange(1000)}", rng.randrange(80)
    imu: dict[str, Any] = {"name": name, "gyro": {"arw_deg_per_sqrt_h": 0.15}}
    if rng.random() < 0.5:
        imu["defaults"] = rng.choice(
            [["stim300", "_self_"], ["/imu_defaults@_global_.imu", "_self_"], ["theirs"]]
        )
    files = {
        "imu/mine.yaml": _written(rng, imu),
        "imu/theirs.yaml": "",
        "imu/broken.yaml": "a: b: c",
        "notes.yaml": "!!python/none",
        "docker/compose.yaml": "x: ${y}",
        "experiment/e.yaml": "defaults: [{override /imu: mine}]\nrecordings: 3",
    }
    asked = rng.choice(
        [
            ["imu=mine"],
            ["experiment=e"],
            ["--multirun", "imu=mine,theirs"],
            ["imu=mine", "imu.gyro.arw_deg_per_sqrt_h=1e-3"],
            ["--multirun", "imu=mine", "seed=1,2"],
        ]
    )
    return Variant(
        "honest",
        "generate",
        ["--config-dir", "DIR", *asked, f"latitude={latitude}"],
        files,
        honest=True,
    )


KINDS: tuple[Draw, ...] = (
    instantiated,
    of_hydra,
    defaults,
    filled_in,
    tagged,
    grown,
    planted,
    placed,
    options,
    overrides,
    told,
    honest,
)


def _file(group: str, text: str, *more: str) -> Variant:
    """A file beside one whose text would become a callback of Hydra's."""
    files = {f"{group}/mine.yaml": text, f"{group}/evil.yaml": f'x: "{CREATED}"'}
    return Variant("issue", ENTRIES[group], ["--config-dir", "DIR", *more, f"{group}=mine"], files)


CREATED = "${oc.create:'{_target_: escape_canary.run}'}"
"""What has no key _target_ until it is filled in."""
SWEPT = ("--multirun", "seed=1,2")
CANARY = """
import sys

class Callback:
    def __init__(self, *_, **__):
        sys.audit("escape")

run = Callback
"""
EXAMPLES = (
    _file("imu", "defaults:\n- evil@_global_.hydra.callbacks\n- _self_"),
    _file("imu", "defaults:\n- /imu@_global_.hydra.callbacks: evil\n- _self_"),
    _file("imu", "defaults:\n- /imu@_global_.hydra.sweeper: evil", *SWEPT),
    _file("experiment", f'# @package _global_\nhydra: {{sweeper: "{CREATED}"}}', *SWEPT),
    _file("experiment", f'# @package _global_\nhydra: {{launcher: "{CREATED}"}}', *SWEPT),
    _file("experiment", "# @package _global_\nhydra: {sweep: {dir: ELSEWHERE/sweep}}", *SWEPT),
    _file(
        "experiment",
        "# @package _global_\ndefaults: [{override /hydra/launcher: submitit_local}]\n"
        "hydra: {launcher: {submitit_folder: ELSEWHERE/jobs, setup: [touch escaped]}}",
        *SWEPT,
    ),
    _file(
        "experiment",
        "# @package _global_\ndefaults: [{override /hydra/sweeper: optuna}]\n"
        "hydra: {sweeper: {custom_search_space: escape_canary.run, n_trials: 1}}",
        *SWEPT,
    ),
    Variant("issue", "bound", ["hydra.searchpath=[file://ELSEWHERE]", "imu=evil"]),
    Variant("issue", "bound", ["--experimental-rerun", "ELSEWHERE/evil.pickle"]),
    _file("imu", "name: ${oc.env:" + SECRET_NAME + "}"),
)
"""What got out when this was an issue, and its next of kin."""


def variant(seed: int, number: int) -> Variant:
    """One of them, by its number: the examples, then what is drawn, each kind in turn."""
    if number < len(EXAMPLES):
        return EXAMPLES[number]
    return KINDS[number % len(KINDS)](random.Random(f"{seed} {number}"))


# --- trying one ---------------------------------------------------------------------------------

STARTED = ("subprocess.", "os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.fork", "pty.",
           "socket.", "urllib.", "ftplib.", "smtplib.", "pickle.", "marshal.", "ctypes.", "exec",
           "compile", "import", "code.", "escape")  # fmt: skip
CHANGED = ("os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.symlink", "os.link", "os.chmod",
           "os.truncate", "os.utime", "os.chdir", "shutil.", "tempfile.")  # fmt: skip

AT_DIRECTORY = ("os.mkdir", "os.remove", "os.rmdir", "shutil.rmtree")
"""Events whose last argument is an open directory that the path is in, or -1."""


class Watch:
    """An audit hook's findings: what was started, imported, written outside outputs/, or read of
    what nobody brought along."""

    def __init__(self, home: Path, readable: tuple[str, ...]):
        self.home, self.readable = str(home), readable
        self.on = False
        self.seen: list[str] = []
        sys.addaudithook(self._hear)

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.on:
            return
        if event.startswith(STARTED):
            self.seen.append(f"{event} {str(arguments[:1])[:100]}")
        elif event == "open" and isinstance(arguments[0], str | bytes):
            path = os.path.abspath(os.fsdecode(arguments[0]))
            writes = arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
            if writes and not self._own(path):
                self.seen.append(f"wrote {path}")
            elif not path.startswith(self.readable):
                self.seen.append(f"read {path}")
        elif event.startswith(CHANGED):
            path = os.fsdecode(arguments[0])
            if event in AT_DIRECTORY and isinstance(arguments[-1], int) and arguments[-1] >= 0:
                path = os.path.join(os.readlink(f"/proc/self/fd/{arguments[-1]}"), path)
            path = os.path.abspath(path)
            if not self._own(path) and path != f"{self.home}/work":
                self.seen.append(f"{event} {path}")

    def _own(self, path: str) -> bool:
        return path == os.devnull or (path + "/").startswith(f"{self.home}/work/outputs/")


class Trial:
    """A place to try variants in, one after the other, in this process."""

    def __init__(self, home: Path):
        from lbgc.bound import BoundConfig
        from lbgc.commands import CONF
        from lbgc.evaluate import EvaluateConfig
        from lbgc.train import TrainConfig
        from sim.generate import GenerateConfig

        self.home = home
        self.configs = {"generate": GenerateConfig, "bound": BoundConfig, "train": TrainConfig,
                        "evaluate": EvaluateConfig}  # fmt: skip
        for name in ("work", "brought", "elsewhere"):
            (home / name).mkdir()
        evil = "# @package _global_\nx: {_target_: escape_canary.run}\n"
        elsewhere = {
            "evil.yaml": evil,
            "imu/evil.yaml": evil,
            "secret": f"name: {SECRET}\n",
            "escape_canary.py": CANARY,
        }
        (home / "elsewhere/imu").mkdir()
        for name, text in elsewhere.items():
            (home / "elsewhere" / name).write_text(text)
        (home / "elsewhere/evil.pickle").write_bytes(pickle.dumps(Path))
        sys.path.append(str(home / "elsewhere"))
        os.environ[SECRET_NAME] = SECRET
        os.chdir(home / "work")
        packages = {sys.prefix, sys.base_prefix, *filter(None, sys.path[:-1])}
        sources = (CONF, str(Path(__file__).resolve().parents[1]))
        self.watch = Watch(home, (str(home / "brought"), str(home / "work"), *packages, *sources))
        self.got: list[Any] = []
        for number in range(len(KINDS)):  # whatever libraries load when they are first needed
            self.tried(variant(-1, len(EXAMPLES) + number))
            if "escape_canary" in sys.modules:
                raise RuntimeError("a module was imported while warming up")

    def tried(self, attempt: Variant) -> str | None:
        """How it got out, or None."""
        self._furnish(attempt)
        arguments = [self._here(word) for word in attempt.arguments]
        self.watch.seen.clear()
        self.got.clear()
        began, out = time.monotonic(), io.StringIO()
        self.watch.on = True
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
                code = self._run(attempt.entry, arguments)
        finally:
            self.watch.on = False
        said = out.getvalue()
        if self.watch.seen:
            return f"did {self.watch.seen[:3]}"
        if code not in (0, 2):
            return f"ended with {code}: {said[-300:]}"
        if time.monotonic() - began > 10:
            return "took more than 10 s"
        if attempt.honest and (code != 0 or not self.got):
            return f"an honest one was refused: {said[-300:]}"
        if SECRET in said + repr([asdict(config) for config in self.got]):
            aloud = (
                attempt.kind == "told" and f"{SECRET_NAME} is taken from the environment" in said
            )
            return None if aloud else "told the secret"
        left = {place.name for place in self.home.glob("*/*")} - set(
            os.listdir(self.home / "brought")
        )
        left -= {
            "outputs",
            "imu",
            "evil.yaml",
            "secret",
            "escape_canary.py",
            "evil.pickle",
            "__pycache__",
        }
        return f"left {sorted(left)}" if left else None

    def _run(self, entry: str, arguments: list[str]) -> int | str:
        """A command whose configuration is only kept; its exit code, or what it raised."""
        from lbgc.commands import run_main

        before, sys.argv = sys.argv, [f"{entry}.py", *arguments]
        try:
            run_main(self.got.append, self.configs[entry], entry)
        except SystemExit as ended:
            return int(ended.code or 0)
        except BaseException as error:
            return f"{type(error).__name__}: {error}"
        finally:
            sys.argv = before
        return 0

    def _here(self, text: str) -> str:
        text = text.replace("ELSEWHERE", str(self.home / "elsewhere"))
        return text.replace("DIR", str(self.home / "brought"))

    def _furnish(self, attempt: Variant) -> None:
        place = self.home / "brought"
        shutil.rmtree(place)
        place.mkdir()
        for name, text in attempt.files.items():
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            (place / name).write_text(self._here(text))
        for name, target in attempt.links.items():
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            (place / name).symlink_to(self._here(target))


def main(seed: int, first: int, count: int) -> None:
    """Try so many, from a number on, and print what came of it as JSON."""
    with tempfile.TemporaryDirectory() as home:
        trial = Trial(Path(home))
        escapes = []
        for number in range(first, first + count):
            attempt = variant(seed, number)
            how = trial.tried(attempt)
            if how is not None:
                escapes.append(f"{number} ({attempt.kind}): {how}: {attempt}"[:1500])
        os.chdir("/")
    print(json.dumps({"variants": count, "escapes": escapes}))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
