"""The house rules that a machine can hold: arrows run one way, libraries keep to their rooms."""

import ast
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from helpers import ROOT
from recording import HELP

FILES = sorted([*(ROOT / "lbgc").rglob("*.py"), *(ROOT / "sim").rglob("*.py")])

# What each part may import of the project, beside itself. Entry points may import anything.
BASE = {
    "lbgc",
    "lbgc.errors",
    "lbgc.earth",
    "lbgc.frames",
    "lbgc.protocol",
    "lbgc.attitudes",
    "lbgc.units",
    "lbgc.outputs",
    "lbgc.cores",
    "lbgc.processes",
    "lbgc.machine",
}
MAY_IMPORT = {
    "lbgc.units": set(),
    "lbgc.outputs": set(),
    "lbgc.earth": set(),
    "lbgc.frames": set(),
    "lbgc.user_yaml": {"lbgc.errors", "lbgc.outputs"},
    "lbgc.command_line": {"lbgc.errors"},
    "lbgc.cores": set(),
    "lbgc.processes": set(),
    "lbgc.ending": {"lbgc.errors"},
    "lbgc.sweeps": {"lbgc.outputs"},
    "lbgc.errors": {"lbgc.units", "lbgc.outputs"},
    "lbgc.commands": BASE
    | {
        *("lbgc.ending", "lbgc.user_yaml", "lbgc.command_line", "lbgc.sweeps", "lbgc.sensor"),
        "lbgc.fault",
    },
    "lbgc.machine": {"lbgc.errors", "lbgc.units"},
    "lbgc.fault": {"lbgc", "lbgc.outputs"},
    "lbgc.protocol": {"lbgc.errors", "lbgc.frames"},
    "lbgc.attitudes": {"lbgc.frames", "lbgc.protocol", "lbgc.units"},
    "lbgc.sensor": BASE,
    "lbgc.data": BASE | {"lbgc.sensor"},
    "lbgc.estimators": BASE | {"lbgc.sensor", "lbgc.data"},
    "lbgc.metrics": BASE | {"lbgc.sensor", "lbgc.data", "lbgc.estimators"},
    "lbgc.headings": {"lbgc.frames"},
    "lbgc.answers": BASE
    | {"lbgc.sensor", "lbgc.data", "lbgc.estimators", "lbgc.metrics", "lbgc.headings"},
    "lbgc.learning": BASE | {"lbgc.sensor", "lbgc.data", "lbgc.estimators", "lbgc.metrics"},
    "lbgc.exports": BASE | {"lbgc.sensor"},
    "lbgc.report": BASE | {"lbgc.sensor", "lbgc.data", "lbgc.metrics", "lbgc.headings"},
    "lbgc.subjects": BASE | {"lbgc.sensor", "lbgc.data", "lbgc.report"},
    "lbgc.tumbling": BASE
    | {"lbgc.sensor", "lbgc.data", "lbgc.estimators", "lbgc.answers", "lbgc.report"}
    | {"lbgc.subjects"},
    "lbgc.outcome": BASE | {"lbgc.metrics", "lbgc.answers", "lbgc.report", "lbgc.verdict"},
    "lbgc.verdict": BASE | {"lbgc.sensor", "lbgc.data", "lbgc.estimators"},
    "lbgc.prospects": BASE | {"lbgc.sensor", "lbgc.data", "lbgc.estimators"},
    "lbgc.labelling": BASE | {"lbgc.sensor", "lbgc.data", "lbgc.estimators"},
    "lbgc.own_unit": BASE | {"lbgc.sensor", "lbgc.data", "lbgc.estimators"},
    "lbgc.ways": BASE | {"lbgc.sensor", "lbgc.data", "lbgc.estimators", "lbgc.labelling"},
    "sim": BASE | {"lbgc.sensor", "lbgc.data"},
}
ENTRY_POINTS = (
    "lbgc/bound.py",
    "lbgc/fit.py",
    "lbgc/info.py",
    "lbgc/calibrate.py",
    "lbgc/look.py",
    "lbgc/train.py",
    "lbgc/export.py",
    "lbgc/export_imu.py",
    "lbgc/compare.py",
    "lbgc/evaluate.py",
    "sim/generate.py",
    "sim/scene.py",
)
RENDERING = "sim/render.py"  # what `python sim/scene.py` runs; draws with lbgc.report
ROOMS = {
    "zarr": {"lbgc/data/store.py", "lbgc/data/documents.py", "lbgc/data/codec.py"},
    "fsspec": {"lbgc/data/place.py"},
    "pyarrow": {"lbgc/data/readers/tables.py", "lbgc/data/readers/formats/feather.py"},
    "mujoco": {"sim/turntable.py", "sim/hand.py", "sim/physics.py", "sim/held.py",
               "sim/render.py", "sim/opengl.py"},
    "matplotlib": {"lbgc/report/figures.py", "lbgc/report/page.py", "lbgc/report/allan_page.py",
                   "lbgc/report/look_page.py"},
    "PIL": {"sim/render.py"},
    "distributed": {"sim/cluster.py"},
    "fcntl": {"lbgc/data/place.py", "lbgc/outputs.py"},
    "hydra": {"lbgc/commands.py"},
    "omegaconf": {"lbgc/commands.py"},
    "yaml": {"lbgc/user_yaml.py"},
    "allantools": {"lbgc/sensor/allan.py"},
    "torch": {"lbgc/learning/model.py", "lbgc/learning/filter.py", "lbgc/learning/loss.py",
              "lbgc/learning/estimator.py", "lbgc/learning/demand.py",
              "lbgc/learning/trainer.py", "lbgc/learning/ahead.py", "lbgc/learning/checkpoint.py",
              "lbgc/learning/onnx.py", "lbgc/learning/board.py", "lbgc/learning/threads.py",
              "lbgc/learning/tensors.py", "lbgc/learning/in_context.py"},
}  # fmt: skip
VERSIONS_ONLY = {("sim/generate.py", "zarr")}
FILM_MAKING = {("sim/render.py", "matplotlib")}
# Half a second and more to import; who starts without waiting for it.
SLOW = {
    "torch": {"lbgc/bound.py", "lbgc/fit.py", "lbgc/info.py", "lbgc/calibrate.py",
              "lbgc/evaluate.py", "lbgc/export_imu.py", "lbgc/look.py", "sim/generate.py",
              "sim/scene.py"},
    "matplotlib": {"lbgc/calibrate.py", "lbgc/export.py", "lbgc/export_imu.py", "lbgc/compare.py",
                   "sim/generate.py", "sim/scene.py"},
    "scipy.signal": {"lbgc/bound.py", "lbgc/info.py", "lbgc/calibrate.py", "lbgc/train.py",
                     "lbgc/export.py", "lbgc/export_imu.py", "lbgc/compare.py", "sim/generate.py",
                     "sim/scene.py"},
}  # fmt: skip


_WHAT_WAS_IMPORTED = """
import atexit, sys
error = sys.stderr
atexit.register(lambda: print(*sys.modules, sep="\\n", file=error))
"""


def nodes(file: Path) -> Iterator[ast.AST]:
    """Every node of a file's syntax tree."""
    return ast.walk(ast.parse(file.read_text()))


@cache
def imports(file: Path) -> set[str]:
    """Dotted names of every module a file imports, wherever in it; relative ones in full."""
    names = set()
    inside = file.relative_to(ROOT).parent.parts
    for node in nodes(file):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = inside[: len(inside) - node.level + 1] if node.level else ()
            module = ".".join([*above, *filter(None, [node.module])])
            names |= {f"{module}.{alias.name}" for alias in node.names}
    return names


def test_relative_imports_are_read_in_full(tmp_path, monkeypatch):
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    (tmp_path / "lbgc/data").mkdir(parents=True)
    file = tmp_path / "lbgc/data/__init__.py"
    file.write_text("from . import a\nfrom .b import c\nfrom .. import d\nfrom ..e.f import g\n")
    assert imports(file) == {"lbgc.data.a", "lbgc.data.b.c", "lbgc.d", "lbgc.e.f.g"}


def part(name: str) -> str | None:
    """The part of the project that a dotted name belongs to, or None."""
    parts = name.split(".")
    if parts[0] == "sim" or parts[:2] == ["lbgc", "sim"]:
        return "sim"
    if parts[0] != "lbgc":
        return None
    return ".".join(parts[:2]) if len(parts) > 1 and parts[1][0].islower() else "lbgc"


@pytest.mark.parametrize("file", FILES, ids=lambda f: str(f.relative_to(ROOT)))
def test_arrows_run_one_way(file):
    where = str(file.relative_to(ROOT))
    own = part(where.removesuffix(".py").replace("/", "."))
    wanted = {p for p in map(part, imports(file)) if p} - {own, "lbgc"}
    if where.startswith("lbgc"):
        assert "sim" not in wanted
    if where not in (*ENTRY_POINTS, RENDERING) and own != "lbgc":
        assert wanted <= MAY_IMPORT[own or ""], where


def test_the_bench_calls_itself_by_no_name():
    """It is sim in the checkout, lbgc.sim in a wheel; the other name would be a second copy."""
    for file in FILES:
        text = file.read_text()
        assert not re.search(r"^ *(from|import) (lbgc\.|lbgc import .*\b)?sim\b", text, re.M), file
        beyond = file.is_relative_to(ROOT / "sim") and re.search(r"^ *from \.\.", text, re.M)
        assert not beyond, f"{file}: what is beside it in the checkout a wheel has elsewhere"


def test_inner_rooms_are_entered_from_one_side():
    """A sensor's law knows nothing of its fit, and a log's readers nothing of the checks."""
    for room, inner in (
        ("lbgc/sensor", "lbgc.sensor.fitting"),
        ("lbgc/data/readers", "lbgc.data.checks"),
        ("lbgc/data/readers/formats", "lbgc.data.checks"),
    ):
        for file in (ROOT / room).glob("*.py"):
            assert not any(name.startswith(f"{inner}.") for name in imports(file)), file


@pytest.mark.parametrize("library", ROOMS)
def test_libraries_keep_to_their_rooms(library):
    found = {
        str(f.relative_to(ROOT)) for f in FILES if library in {i.split(".")[0] for i in imports(f)}
    }
    exceptions = {f for f, lib in VERSIONS_ONLY | FILM_MAKING if lib == library}
    assert found - exceptions <= ROOMS[library]


def test_randomness_is_never_global():
    for file in FILES:
        text = file.read_text()
        for name in (
            "np.random.seed",
            "np.random.normal",
            "np.random.rand",
            "default_rng",
            "import random",
        ):
            assert name not in text, file
        if "torch.manual_seed" in text:
            assert file.name == "model.py"


def test_every_library_is_declared():
    """What an environment has by way of another library it may lose."""
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    groups = [declared["dependencies"], *declared["optional-dependencies"].values()]
    every = {re.split(r"[<>=]", one)[0] for group in groups for one in group}
    names = {name.lower().replace("-", "_") for name in every}
    called = {"yaml": "pyyaml", "PIL": "pillow", "hydra": "hydra_core"}
    used = {i.split(".")[0] for f in FILES for i in imports(f)} - {"lbgc", "sim"}
    used = {called.get(name, name) for name in used - set(sys.stdlib_module_names)}
    assert used <= names, used - names


def test_json_is_written_in_one_place():
    """JSON has no NaN; `lbgc.outputs.as_json` writes null."""
    for file in FILES:
        if file.name != "outputs.py":
            calls = (n.func for n in nodes(file) if isinstance(n, ast.Call))
            assert not {"json.dump", "json.dumps"} & set(map(ast.unparse, calls)), file
            assert "from json" not in file.read_text()


def test_windows_are_never_built_by_position():
    """Of arrays that are alike, two that change places would go unseen."""
    for file in [*FILES, *(ROOT / "tests").rglob("*.py")]:
        for node in nodes(file):
            if isinstance(node, ast.Call):
                name = ast.unparse(node.func).rpartition(".")[2]
                assert name not in ("Windows", "Labelled") or not node.args, file


def test_nothing_is_unpickled():
    for file in FILES:
        text = file.read_text()
        assert "pickle" not in text
        assert "torch.load" not in text


def modules() -> dict[str, set[str]]:
    """The project's modules, and which others of them each imports."""
    names = {".".join(f.relative_to(ROOT).with_suffix("").parts): f for f in FILES}
    names = {name.removesuffix(".__init__"): file for name, file in names.items()}
    found = {}
    for name, file in names.items():
        wanted = {n if n in names else n.rpartition(".")[0] for n in imports(file)}
        found[name] = (wanted & names.keys()) - {name, "lbgc", "sim"}
    return found


def test_no_two_files_import_each_other_round_a_circle():
    """Annotations included."""
    left = modules()
    while left:
        ends = {name for name, wanted in left.items() if not wanted & left.keys()}
        assert ends, f"a circle among {sorted(left)}"
        left = {name: wanted for name, wanted in left.items() if name not in ends}


def test_nothing_imports_an_entry_point():
    entries = {script.removesuffix(".py").replace("/", ".") for script in ENTRY_POINTS}
    assert "sim.recordings" in modules()["sim.generate"]
    for name, wanted in modules().items():
        assert not wanted & (entries - {name}), name


def test_nobody_outside_the_sensor_asks_what_type_a_term_is():
    """The classes of lbgc.sensor's error terms are named in lbgc/sensor alone: all others sum what
    every term can tell."""
    rooms = [ROOT / "lbgc/sensor" / f"{name}.py" for name in ("noise", "deterministic", "errors")]
    trees = (ast.parse(room.read_text()) for room in rooms)
    classes = {n.name for tree in trees for n in ast.walk(tree) if isinstance(n, ast.ClassDef)}
    terms = classes - {"Surroundings"}
    assert {"White", "Flicker", "Ramp", "Proportional"} <= terms
    for file in FILES:
        if file.is_relative_to(ROOT / "lbgc/sensor"):
            continue
        for node in nodes(file):
            named = {getattr(node, "id", None), getattr(node, "attr", None)}
            if isinstance(node, ast.ImportFrom):
                named |= {alias.name for alias in node.names}
            assert not named & terms, f"{file}: {named & terms}"


def test_files_can_be_read_in_one_sitting():
    for file in FILES:
        assert len(file.read_text().splitlines()) <= 400, file


def test_who_uses_the_library_does_not_load_hydra():
    done = subprocess.run(
        [sys.executable, "-c", "import sys, lbgc.protocol, lbgc.estimators, lbgc.data.logs; "
         "print([m for m in sys.modules if m.split('.')[0] in ('hydra', 'omegaconf')])"],
        capture_output=True, text=True, cwd=ROOT,
    )  # fmt: skip
    assert done.stdout.strip() == "[]", done.stdout + done.stderr


@pytest.mark.parametrize("script", ENTRY_POINTS)
def test_every_entry_point_runs_from_another_directory(script, tmp_path):
    """`python lbgc/train.py` puts lbgc/ itself first on the import path: no module there may
    shadow another's. Nor does it wait for libraries that it may not need. It says what it said."""
    own, home = tmp_path / "own", tmp_path / "home"
    for place in (own, home):
        place.mkdir()
    (own / "sitecustomize.py").write_text(_WHAT_WAS_IMPORTED)
    command = [sys.executable, str(ROOT / script), "--help"]
    environment = os.environ | {"PYTHONPATH": str(own)}
    done = subprocess.run(command, cwd=home, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    recorded = HELP / f"{script.removesuffix('.py').replace('/', '.')}.txt"
    assert done.stdout == recorded.read_text(), "a help text changed; if it is meant, make golden"
    imported = set(done.stderr.splitlines())
    assert "numpy" in imported
    assert not {library for library, who in SLOW.items() if script in who} & imported
    assert list(home.iterdir()) == []


def test_a_refusal_in_a_process_of_its_own_ends_with_two_and_no_traceback(tmp_path):
    done = subprocess.run(
        [sys.executable, str(ROOT / "sim/generate.py"), "latitude=91"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    assert "error: latitude = 91.0 deg: must be from -90 to 90" in done.stderr
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_configuration_files_mirror_the_dataclasses():
    """Every value of conf/ is a field; every field of what is not composed from its dataclass
    stands in the YAML where users look."""
    from dataclasses import fields

    import yaml

    from lbgc.data.logs import LogConfig
    from lbgc.evaluate import EvaluateConfig
    from lbgc.info import InfoConfig
    from lbgc.learning.model import ModelConfig
    from lbgc.protocol import ProtocolConfig
    from lbgc.sensor.datasheet import ImuConfig
    from lbgc.train import TrainConfig
    from sim.cluster import ClusterConfig
    from sim.generate import GenerateConfig
    from sim.render import ViewConfig
    from sim.turntable import SceneConfig

    conf = ROOT / "conf"

    def keys(path: Path) -> set[str]:
        return set(yaml.safe_load(path.read_text())) - {"defaults", "hydra"}

    groups = {"imu", "scene", "protocol", "model", "log", "cluster"}
    entry_points = {
        "generate": GenerateConfig,
        "train": TrainConfig,
        "evaluate": EvaluateConfig,
        "info": InfoConfig,
        "scene_view": ViewConfig,
    }
    for name, config in entry_points.items():
        assert keys(conf / f"{name}.yaml") == {f.name for f in fields(config)} - groups, name
    for path in (conf / "model").glob("*.yaml"):
        assert keys(path) == {f.name for f in fields(ModelConfig)}, path
    for path in (conf / "cluster").glob("*.yaml"):
        assert keys(path) == {f.name for f in fields(ClusterConfig)}, path
    for name, config in {
        "imu": ImuConfig,
        "scene": SceneConfig,
        "protocol": ProtocolConfig,
    }.items():
        for path in (conf / name).glob("*.yaml"):
            assert keys(path) <= {f.name for f in fields(config)}, path
    assert keys(conf / "log" / "csv.yaml") == {f.name for f in fields(LogConfig)}


def test_defaults_of_the_dataclasses_are_those_of_the_yaml():
    from dataclasses import replace

    from helpers import composed

    from lbgc.evaluate import EvaluateConfig
    from lbgc.train import TrainConfig
    from sim.generate import GenerateConfig

    generate = composed(GenerateConfig, "generate")
    assert replace(GenerateConfig(), imu=generate.imu) == generate
    assert composed(TrainConfig, "train", "data=x") == TrainConfig(data="x")
    assert composed(EvaluateConfig, "evaluate", "data=x") == EvaluateConfig(data="x")


@pytest.mark.parametrize("imu", [p.stem for p in (ROOT / "conf" / "imu").glob("*.yaml")])
def test_every_preset_is_a_sensor(imu):
    from helpers import default_config

    config = default_config(f"imu={imu}").imu
    assert config.name
    config.gyro.triad()
    config.accel.triad()
