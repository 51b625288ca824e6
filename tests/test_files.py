"""Files from outside come through one door; what is written is whole or not there at all."""

from __future__ import annotations

import errno
import hashlib
import os
import signal
import socket
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
import pytest

from thzcl import errors, files
from thzcl.errors import FileError
from thzcl.sensing import bands


def listen(path):
    with socket.socket(socket.AF_UNIX) as server, _in(path.parent):
        server.bind(path.name)  # a path may be too long for it


@contextmanager
def _in(folder):
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


SMALL = files.Kind(1000, "give a letter")
MAKERS = {
    "folder": (Path.mkdir, "a folder, not a regular file; give a letter"),
    "pipe": (os.mkfifo, "a pipe, not a regular file; give a letter"),
    "socket": (listen, "a socket, not a regular file"),
    "device": (lambda path: path.symlink_to("/dev/zero"), "a device, not a regular file"),
    "link to itself": (lambda path: path.symlink_to(path.name), "mend the link"),
    "link to nothing": (lambda path: path.symlink_to("no"), "paths start from the scenario's"),
    "missing": (lambda path: path, "No such file or directory; paths start from the scenario's"),
    "too large": (lambda path: path.write_bytes(bytes(1001)), "larger than 0.001 MB; give less"),
}


@contextmanager
def in_time(seconds=10):
    """Raises TimeoutError in what takes longer, as reading a pipe would."""

    def late(*_):
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("case", MAKERS)
@pytest.mark.parametrize(
    "read", [files.read_bytes, files.read_text, files.digest, files.open_regular]
)
def test_only_regular_files_of_bounded_size_are_read(tmp_path, case, read):
    make, expected = MAKERS[case]
    make(tmp_path / "file")
    with in_time(), pytest.raises(FileError) as caught:
        read(tmp_path / "file", SMALL)
    assert str(caught.value).startswith(f"{tmp_path / 'file'}: ")
    assert expected in str(caught.value)


@pytest.mark.parametrize("name", ["a\0b", "\udcff\ud800"])
def test_a_name_that_no_file_can_have_is_refused(tmp_path, name):
    with pytest.raises(FileError, match="no file can have this name"):
        files.read_text(tmp_path / name, SMALL)


def test_a_file_that_tells_less_than_it_holds_is_bounded_too():
    """Files of /proc tell a size of 0."""
    status = Path("/proc/self/status")
    assert status.stat().st_size == 0
    with pytest.raises(FileError, match="larger than"):
        files.read_bytes(status, files.Kind(10, "give a letter"))


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        (errno.EACCES, "cannot be read: Permission denied; change its permissions"),
        (errno.EIO, "cannot be read: Input/output error; the disk or the network failed"),
        (errno.EMFILE, "raise the limit on open files"),
    ],
)
def test_the_remedy_is_of_what_failed(tmp_path, monkeypatch, number, expected):
    """Root may read everything, so that refusals are played."""
    (tmp_path / "file").write_bytes(b"a")

    def refuse(path, *_, **__):
        raise OSError(number, os.strerror(number), str(path))

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(FileError) as caught:
        files.read_text(tmp_path / "file", SMALL)
    assert expected in str(caught.value)


def test_text_is_read_as_it_was_meant(tmp_path):
    (tmp_path / "dos").write_bytes(b"\xef\xbb\xbfa = 1\r\nb = '\xc3\xa9'\rc\n")
    assert files.read_text(tmp_path / "dos", SMALL) == "a = 1\nb = 'é'\nc\n"
    (tmp_path / "latin").write_bytes(b"# caf\xe9")
    with pytest.raises(FileError, match=r"latin: not UTF-8 text \(byte 5\); save it as UTF-8"):
        files.read_text(tmp_path / "latin", SMALL)


def test_a_digest_is_of_the_bytes(tmp_path):
    (tmp_path / "file").write_bytes(b"abc")
    assert files.digest(tmp_path / "file", SMALL) == hashlib.sha256(b"abc").hexdigest()


NO_NETCDF = {
    "classic NetCDF": (b"CDF\1" + bytes(100), "convert it with nccopy -k nc4"),
    "text": (b"not a result", "cannot be read: Unable to synchronously open file"),
    "empty": (b"", "cannot be read"),
    "a head alone": (b"\x89HDF\r\n\x1a\n" + bytes(100), "cannot be read"),
}


@pytest.mark.parametrize("case", NO_NETCDF)
def test_what_is_no_netcdf_is_refused(tmp_path, case):
    data, expected = NO_NETCDF[case]
    (tmp_path / "a.nc").write_bytes(data)
    with (
        pytest.raises(FileError, match=expected) as caught,
        files.open_netcdf(tmp_path / "a.nc", SMALL),
    ):
        pass
    assert str(caught.value).startswith(f"{tmp_path / 'a.nc'}: ")


def test_whatever_breaks_while_netcdf_is_read_is_told_with_the_file(tmp_path):
    path = tmp_path / "a.nc"
    with h5py.File(path, "w") as file:
        file.create_dataset("a", data=np.arange(10_000), chunks=(10_000,), compression="gzip")
        at = file["a"].id.get_chunk_info(0).byte_offset
    broken = bytearray(path.read_bytes())
    broken[at : at + 50] = bytes(50)
    path.write_bytes(broken)
    large = files.Kind(10**6, "give another")
    with (
        pytest.raises(FileError, match=r"cannot be read: .*; give another"),
        files.open_netcdf(path, large) as file,
    ):
        file["a"][...]
    with (
        pytest.raises(FileError, match=r"cannot be read: .*'nothing'.*; give another"),
        files.open_netcdf(path, large) as file,
    ):
        file["nothing"]
    with files.open_netcdf(path, large) as file:
        assert file["a"].shape == (10_000,)


def test_a_table_is_read(tmp_path):
    (tmp_path / "t.csv").write_text("# made by hand\nfrequency,response\n\n1,2\n3, 4e1 \n")
    assert files.read_table(tmp_path / "t.csv").tolist() == [[1, 2], [3, 40]]
    (tmp_path / "t.csv").write_bytes("\ufeff1,2\r\n3,4\r\n".encode())  # the first row is no name
    assert files.read_table(tmp_path / "t.csv").tolist() == [[1, 2], [3, 4]]


NO_TABLE = {
    "words": ("a,b\n1,2\nx,4\n", ":3: not comma-separated numbers: x,4"),
    "two lines of names": ("a,b\nc,d\n1,2\n", ":2: not comma-separated numbers"),
    "ragged": ("1,2\n3\n", ":2: 1 columns, the lines before have 2"),
    "NaN": ("1,2\n3,nan\n", ":2: not finite: 3,nan"),
    "infinite": ("1,2\n3,1e999\n", ":2: not finite: 3,1e999"),
    "no numbers": ("a,b\n", ": holds no numbers"),
    "empty": ("", ": holds no numbers"),
    "latin": ("é\n", ": not UTF-8 text"),
}


@pytest.mark.parametrize("case", NO_TABLE)
def test_what_is_no_table_is_refused_with_its_line(tmp_path, case):
    text, expected = NO_TABLE[case]
    (tmp_path / "t.csv").write_text(text, encoding="latin-1")
    with pytest.raises(FileError) as caught:
        files.read_table(tmp_path / "t.csv")
    assert f"t.csv{expected}" in str(caught.value)


NO_BAND = {
    "one column": ([[600], [700]], "needs two columns"),
    "one row": ([[600, 1]], "two rows or more"),
    "twice": ([[600, 1], [600, 1]], "its frequencies do not ascend"),
    "in Hz": ([[600e9, 1], [700e9, 1]], "above 0 and up to 100000 GHz"),
    "from 0": ([[0, 1], [700, 1]], "above 0 and up to 100000 GHz"),
    "negative": ([[600, -1], [700, 1]], "its response must be at least 0"),
    "dark": ([[600, 0], [700, 0]], "above 0 somewhere"),
}


@pytest.mark.parametrize("case", NO_BAND)
def test_a_table_that_is_no_band_is_refused(case):
    rows, expected = NO_BAND[case]
    with pytest.raises(FileError, match=f"t.csv: .*{expected}"):
        bands.tabulated(np.array(rows, dtype=float), "t.csv")


def test_a_table_is_a_band():
    band = bands.tabulated(np.array([[600.0, 0.0], [700.0, 2.0]]), "t.csv")
    assert (band.low_hz, band.high_hz) == (600e9, 700e9)
    assert band.response(np.array([600e9, 650e9, 675e9])) == pytest.approx([0, 1, 1.5])


def test_names_stay_inside_a_folder(tmp_path):
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "out").touch()
    (inner / "link").symlink_to(tmp_path / "out")
    for name in ("../out", "link", str(tmp_path / "out")):
        with pytest.raises(FileError, match="leads out of the scenario's folder"):
            files.inside(inner, name, allow_outside=False)
        assert files.inside(inner, name, allow_outside=True) == inner / name
    assert files.inside(inner, "new", allow_outside=False) == inner / "new"
    (inner / "loop").symlink_to("loop")
    with pytest.raises(FileError, match="loop"):
        files.read_bytes(files.inside(inner, "loop", allow_outside=False), SMALL)
    with pytest.raises(FileError, match="mend the link or the name"):
        files.inside(inner, "a\0b", allow_outside=True)


def test_a_file_is_written_whole_or_not_at_all(tmp_path):
    path = tmp_path / "file.txt"
    files.write_whole(path, lambda part: part.write_text("old"))
    for error in (OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()):

        def write(part, error=error):
            part.write_text("new")
            raise error

        with pytest.raises(type(error)):
            files.write_whole(path, write)
        assert path.read_text() == "old"
        assert list(tmp_path.iterdir()) == [path]
    assert path.stat().st_mode & 0o777 == 0o666 & ~_mask()


def _mask():
    mask = os.umask(0)
    os.umask(mask)
    return mask


def test_errors_of_writing_name_what_the_user_named(tmp_path):
    def full(part):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(part))

    for path, write, expected in (
        (tmp_path / "a.nc", full, "No space left on device; make room, or choose another place"),
        (tmp_path / "no" / "a.nc", full, "No such file or directory; check the name"),
        (tmp_path, lambda part: part.touch(), "Is a directory; give a file, not a folder"),
    ):
        with pytest.raises(OSError) as caught:  # noqa: PT011 (any)
            files.write_whole(path, write)
        assert errors.explained(caught.value) == (2, (f"{path}: {expected}",))
    (tmp_path / "file").touch()
    with pytest.raises(OSError) as caught:  # noqa: PT011
        files.make_folder(tmp_path / "file")
    assert errors.explained(caught.value)[1][0].startswith(f"{tmp_path / 'file'}: File exists; ")


def system(number, *names):
    return OSError(number, os.strerror(number), *names)


@pytest.mark.parametrize(
    ("error", "code", "expected"),
    [
        (errors.UsageError("write it so"), 2, "write it so"),
        (FileError("a: mend it"), 2, "a: mend it"),
        (errors.DeviceError("install one"), 3, "install one"),
        (errors.NumbersError("not finite", None), 4, "not finite"),
        (errors.PluginFailure("broke"), 4, "broke"),
        (KeyboardInterrupt(), 130, "interrupted; nothing was left half-written"),
        (system(errno.ENOENT, "a.dat"), 2, "a.dat: No such file or directory; check the name"),
        (system(errno.EACCES, "a"), 2, "a: Permission denied; change its permissions"),
        (system(errno.EISDIR, "a"), 2, "a: Is a directory; give a file, not a folder"),
        (system(errno.EEXIST, "a"), 2, "a: File exists; a file stands in the way"),
        (system(errno.EROFS, "a"), 2, "a: Read-only file system; choose another place"),
        (system(errno.ENOSPC), 2, "No space left on device; make room, or choose another place"),
        (system(errno.ENOMEM, "a"), 2, "a: too large for the memory that this process may use"),
        (system(errno.ENODEV, "a"), 2, "a: No such device; check the file and where it lies"),
        (OSError("some library's own"), 2, "some library's own; check the file"),
        (OSError(), 2, "OSError; check the file"),
        (MemoryError(), 2, "too large for the memory that this process may use; lower pixels"),
        (MemoryError("Unable to allocate 9 TiB"), 2, "may use (Unable to allocate 9 TiB); lower"),
    ],
)
def test_errors_have_an_exit_code_and_say_what_to_do(error, code, expected):
    found = errors.explained(error)
    assert found[0] == code
    assert expected in found[1][0]


def test_every_problem_of_a_scene_is_told():
    assert errors.explained(errors.ScenarioError(["a", "b", "a"])) == (2, ("a", "b"))


@pytest.mark.parametrize("error", [ValueError("a"), RecursionError(), SystemExit(0), KeyError(1)])
def test_other_errors_are_bugs(error):
    assert errors.explained(error) is None


@pytest.mark.parametrize("number", [errno.ENOENT, errno.EACCES, errno.EISDIR, errno.EIO])
def test_only_outputs_are_a_matter_of_room(number):
    """A missing file is not answered with "make room"."""
    assert "room" not in errors.advice(system(number, "a"))
