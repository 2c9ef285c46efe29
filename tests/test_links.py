"""Links and names that somebody laid in the way: nothing outside is read, written or deleted."""

import errno
import fcntl
import os
import re
import zlib
from pathlib import Path

import numpy as np
import pytest
from helpers import generate
from PIL import Image

from lbgc import outputs
from lbgc.data import manifest, picture, store
from lbgc.data.documents import Layout
from lbgc.data.place import Place, is_partial
from lbgc.data.schema import VARIABLES
from lbgc.data.store import Dataset
from lbgc.errors import InputError
from lbgc.outputs import (
    is_temporary,
    mark_latest,
    read_file,
    remove_temporary,
    task_directory,
    write_atomically,
)
from sim.generate import GenerateConfig, _draw_beside
from sim.render import ViewConfig, view

SECRET = b"-----BEGIN OPENSSH PRIVATE KEY-----"
OURS = ".lbgc-" + "0" * 32 + ".partial"


@pytest.fixture
def secret(tmp_path) -> Path:
    file = tmp_path / "secret"
    file.write_bytes(SECRET)
    return file


# --- writing ------------------------------------------------------------------------------------


def test_a_file_is_written_under_names_that_nobody_foresees(tmp_path, monkeypatch):
    seen: list[str] = []
    original = os.open

    def heard(path, flags, *more, **named):
        if flags & os.O_CREAT:
            assert flags & os.O_EXCL
            seen.append(Path(path).name)
        return original(path, flags, *more, **named)

    monkeypatch.setattr(os, "open", heard)
    for _ in range(20):
        write_atomically(tmp_path / "results.json", "x")
    assert len(set(seen)) == 20
    assert all(map(is_temporary, seen))
    assert os.listdir(tmp_path) == ["results.json"]


def test_a_planted_name_is_not_opened(tmp_path, secret, monkeypatch, capsys):
    """Also where it was foreseen: the file must be new."""
    home = tmp_path / "home"
    home.mkdir()
    (home / OURS).symlink_to(secret)
    monkeypatch.setattr(outputs.secrets, "token_hex", lambda _: "0" * 32)
    with pytest.raises(FileExistsError):
        write_atomically(home / "results.json", b"mine")
    mark_latest(home / "run")
    assert "no link" in capsys.readouterr().err
    assert not (home / "latest").is_symlink()
    assert secret.read_bytes() == SECRET


@pytest.mark.parametrize("target", ["secret", "absent"])
def test_a_link_in_a_files_place_is_replaced(tmp_path, secret, target):
    file = tmp_path / "results.json"
    file.symlink_to(tmp_path / target)
    write_atomically(file, "mine")
    assert not file.is_symlink()
    assert file.read_text() == "mine"
    assert secret.read_bytes() == SECRET
    assert not (tmp_path / "absent").exists()


def test_what_could_not_be_written_leaves_nothing(tmp_path, monkeypatch):
    (tmp_path / "results.json").write_text("before")
    full = OSError(errno.ENOSPC, "No space left on device")
    monkeypatch.setattr(Path, "replace", lambda *_: (_ for _ in ()).throw(full))
    with pytest.raises(OSError, match=r"No space left on device: .*results.json"):
        write_atomically(tmp_path / "results.json", "after")
    assert os.listdir(tmp_path) == ["results.json"]
    assert (tmp_path / "results.json").read_text() == "before"


def test_a_dataset_is_not_written_through_a_link_inside_it(tmp_path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    place = Place(tmp_path / "d.zarr")
    place.write("zarr.json", b"{}")
    (tmp_path / "d.zarr/gyro").symlink_to(elsewhere)
    with pytest.raises(OSError, match="gyro is a link"):
        place.write("gyro/c.0.0.0", b"mine")
    assert os.listdir(elsewhere) == []


@pytest.mark.parametrize("kind", ["png", "gif"])
def test_a_picture_is_not_drawn_through_a_link(tmp_path, secret, monkeypatch, kind):
    """Neither to a file nor to where none is yet."""

    def black(config, angles, quick=False):
        return (np.zeros((config.height, config.width, 3), np.uint8) for _ in angles)

    monkeypatch.setattr("sim.render._rendered", black)
    for target in (secret, tmp_path / "absent"):
        out = tmp_path / f"d.{kind}"
        out.unlink(missing_ok=True)
        out.symlink_to(target)
        view(ViewConfig(out=str(out), width=320, height=200, duration_s=0.2))
        assert secret.read_bytes() == SECRET
        assert not (tmp_path / "absent").exists()
        assert not out.is_symlink()
        with Image.open(out) as drawn:
            assert drawn.size[0] == 320


def test_what_is_no_link_is_not_made_the_latest(tmp_path):
    (tmp_path / "latest").write_text("a user's own")
    (tmp_path / "run").mkdir()
    mark_latest(tmp_path / "run")
    assert (tmp_path / "latest").read_text() == "a user's own"
    (tmp_path / "latest").unlink()
    for name in ("run", "gone", "run"):
        mark_latest(tmp_path / name)
        assert os.readlink(tmp_path / "latest") == name
    assert sorted(os.listdir(tmp_path)) == ["latest", "run"]


# --- deleting -----------------------------------------------------------------------------------

USERS = ("thesis.partial.docx", "notes.partial", ".partial", ".draft.partial-2", "a.lbgc-1.partial",
         f"x{OURS}", f"{OURS}.bak", ".lbgc-" + "G" * 32 + ".partial", "2026.12.partial",
         "zarr.copy.partial", "gyro/thesis.partial-7", "gyro/c/a.0g.partial", "9.png")  # fmt: skip
LEFT = (OURS, f"gyro/{OURS}", ".zarr.json.partial-77", "gyro/.zarr.json.partial-1",
        "gyro/c/0/0/.0.partial-4242", "gyro/c.0.0.0123456789abcdef0123456789abcdef.partial",
        "zarr.0123456789abcdef0123456789abcdef.partial")  # fmt: skip


@pytest.mark.parametrize("name", USERS)
def test_a_users_file_is_none_of_ours(name):
    assert not is_partial(name)


@pytest.mark.parametrize("name", LEFT)
def test_what_writers_left_is_known_by_its_name(name):
    assert is_partial(name)


LAYOUT = Layout(2, 10, 50.0, {"gyro": None, "accel": None})


def whole(path: Path) -> Dataset:
    dataset = store.create(path, LAYOUT, {"a": 1}, {})
    sizes = {"recording": 2, "time": 10, "axis": 3, "axis_in": 3}
    batch = {n: np.ones([sizes[d] for d in VARIABLES[n].dims]) for n in LAYOUT.variables}
    dataset.write_shard(0, batch)
    return Dataset.open_finished(path)


def test_going_on_with_a_dataset_deletes_nothing_of_its_users(tmp_path):
    home = tmp_path / "d.zarr"
    whole(home)
    other = tmp_path / "other"
    other.mkdir()
    (other / "kept").write_text("kept")
    for name in (*USERS, *LEFT):
        (home / name).parent.mkdir(parents=True, exist_ok=True)
        (home / name).write_text("?")
    (home / "notes").symlink_to(other)
    (home / "gyro/mine").symlink_to(other / "kept")
    with pytest.raises(InputError, match="holds what an interrupted run left"):
        Dataset.open_finished(home)
    store.create(home, LAYOUT, {"a": 1}, {})
    assert [n for n in USERS if not (home / n).exists()] == []
    assert [n for n in LEFT if (home / n).exists()] == []
    assert (home / "notes").is_symlink()
    assert (home / "gyro/mine").is_symlink()
    assert (other / "kept").read_text() == "kept"
    Dataset.open_finished(home)


@pytest.mark.parametrize(
    "name", ["zarr.json", "gyro", "gyro/zarr.json", "gyro/c.0.0.0", "time", "time/c.0", "manifest",
             "manifest/zarr.json", "manifest/shards", "manifest/shards/c.0.0"]
)  # fmt: skip
def test_a_link_in_a_datasets_own_place_is_refused_and_mended(name, tmp_path):
    home, elsewhere = tmp_path / "d.zarr", tmp_path / "elsewhere"
    digest = whole(home).digest()
    (home / name).rename(elsewhere)
    (home / name).symlink_to(elsewhere)
    assert manifest.strays(Place(home).entries()) == [name]
    with pytest.raises(InputError):
        Dataset.open_finished(home)
    assert whole(home).digest() == digest
    assert not (home / name).is_symlink()
    assert elsewhere.exists()


def test_a_directory_of_a_users_own_is_no_place_for_a_dataset(tmp_path):
    home = tmp_path / "work"
    home.mkdir()
    (home / "thesis.partial.docx").write_text("three years")
    with pytest.raises(InputError, match="is no dataset"):
        store.create(home, LAYOUT, {"a": 1}, {})
    assert (home / "thesis.partial.docx").read_text() == "three years"


def test_what_a_killed_writer_left_goes_and_what_is_being_written_stays(tmp_path):
    left, busy, link = (tmp_path / f".lbgc-{c * 32}.partial" for c in "abc")
    left.write_text("half")
    busy.write_text("half")
    link.symlink_to("nowhere")
    os.utime(link, (0, 0), follow_symlinks=False)
    with busy.open() as writing:
        fcntl.flock(writing, fcntl.LOCK_EX)
        remove_temporary(tmp_path)
    assert os.listdir(tmp_path) == [busy.name]
    remove_temporary(tmp_path)
    remove_temporary(tmp_path / "absent")
    assert os.listdir(tmp_path) == []


def test_a_link_by_such_a_name_is_not_followed(tmp_path, secret):
    home = tmp_path / "home"
    home.mkdir()
    (home / OURS).symlink_to(secret)
    os.utime(home / OURS, (0, 0), follow_symlinks=False)
    remove_temporary(home)
    assert secret.read_bytes() == SECRET
    assert os.listdir(home) == []


def test_a_task_begun_again_has_no_leavings(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    home = task_directory("fit", "0123")
    (home / "imu").mkdir()
    for place in (home, home / "imu", home.parent):
        (place / OURS).write_text("half")
        (place / "thesis.partial.docx").write_text("mine")
    assert task_directory("fit", "0123") == home
    assert list(home.parent.rglob(".lbgc-*")) == []
    assert len(list(home.parent.rglob("thesis.partial.docx"))) == 3


# --- reading ------------------------------------------------------------------------------------


def png(path: Path, size: tuple[int, int] = (30, 20), mode: str = "RGB") -> bytes:
    Image.new(mode, size).save(path)
    return path.read_bytes()


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "L", "P", "1", "I;16"])
def test_a_whole_picture_is_read(tmp_path, mode):
    assert picture.read(tmp_path / "d.png") is None
    content = png(tmp_path / "d.png", mode=mode)
    assert picture.read(tmp_path / "d.png") == content


def test_every_damage_to_a_picture_is_noticed(tmp_path, rng):
    file = tmp_path / "d.png"
    content = png(file)
    for _ in range(200):
        bad = bytearray(content)
        bad[rng.integers(len(bad))] ^= 1 << rng.integers(8)
        file.write_bytes(bad)
        assert picture.read(file) is None
    for bad in (content[:-1], content + SECRET, content[8:], b"", SECRET, content[:40]):
        file.write_bytes(bad)
        assert picture.read(file) is None


def test_a_picture_that_unfolds_to_more_than_it_says_is_none(tmp_path):
    def chunk(kind: bytes, data: bytes) -> bytes:
        size, checksum = len(data).to_bytes(4, "big"), zlib.crc32(kind + data).to_bytes(4, "big")
        return size + kind + data + checksum

    for side, rows in ((4, 10**8), (2**31 - 1, 100), (0, 0), (8192, 10)):
        header = side.to_bytes(4, "big") * 2 + bytes([8, 2, 0, 0, 0])
        packed = zlib.compress(bytes(rows), 9)
        parts = chunk(b"IHDR", header) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")
        (tmp_path / "d.png").write_bytes(b"\x89PNG\r\n\x1a\n" + parts)
        assert picture.read(tmp_path / "d.png") is None


def test_no_link_pipe_or_directory_is_a_picture(tmp_path, secret):
    whole_one = tmp_path / "elsewhere.png"
    png(whole_one)
    file = tmp_path / "d.png"
    for plant in (
        lambda: file.symlink_to(secret),
        lambda: file.symlink_to(whole_one),
        lambda: file.symlink_to("/dev/zero"),
        lambda: file.symlink_to(file),
        lambda: os.mkfifo(file),
        lambda: file.mkdir(),
    ):
        plant()
        assert picture.read(file) is None
        file.rmdir() if file.is_dir() and not file.is_symlink() else file.unlink()


def test_a_pictures_place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert picture.beside(Place("a/d.zarr")) == tmp_path / "a/d.png"
    assert picture.beside(Place(".")) == tmp_path.with_suffix(".png")
    assert picture.beside(Place("/")) is None
    assert picture.beside(Place("memory://a/d.zarr")) is None


def test_a_damaged_picture_is_drawn_again(tmp_path, monkeypatch):
    drawn: list[Path] = []

    def draw(out: Path, *_: object) -> None:
        drawn.append(out)
        png(tmp_path / "new.png")
        (tmp_path / "new.png").replace(out)

    monkeypatch.setattr("sim.generate.try_picture", draw)
    place, file = Place(tmp_path / "d.zarr"), tmp_path / "d.png"
    for spoil in (lambda: None, lambda: file.write_bytes(b"half"), lambda: file.symlink_to("x")):
        file.unlink(missing_ok=True)
        spoil()
        (tmp_path / OURS).write_text("half")
        _draw_beside(place, GenerateConfig())
        assert picture.read(file) is not None
        assert not (tmp_path / OURS).exists()
    _draw_beside(place, GenerateConfig())
    assert len(drawn) == 3


def test_no_secret_reaches_a_report(tmp_path, cli, secret):
    """By the links that came with a dataset: to its picture, and to its data."""
    data = generate(tmp_path / "d.zarr", recordings=3, duration_s=30.0, output="means",
                    split=[0, 0, 1])  # fmt: skip
    del data
    (tmp_path / "d.png").symlink_to(secret)
    done = cli("lbgc.evaluate", "data=d.zarr", "windows_s=[10]")
    assert done.code == 0, done.err
    page = Path(done.last_line).read_text()
    assert "The bench" not in page
    assert "LS0tLS1CRUdJTiBPUEVOU1NI" not in page
    assert not re.search("PRIVATE", page)


def test_a_file_is_read_up_to_its_bound_and_only_where_it_is_one(tmp_path, secret):
    assert read_file(secret, len(SECRET)) == SECRET
    with pytest.raises(ValueError, match="35 bytes, and 34 are the most"):
        read_file(secret, len(SECRET) - 1)
    (tmp_path / "link").symlink_to(secret)
    assert read_file(tmp_path / "link") == SECRET
    os.mkfifo(tmp_path / "pipe")
    for name in ("pipe", ".", "absent"):
        with pytest.raises(OSError, match=rf"{tmp_path / name}|Is a directory"):
            read_file(tmp_path / name)
    with pytest.raises(OSError, match="symbolic links"):
        read_file(tmp_path / "link", links=False)
