"""A disk that is full, or a folder that cannot be written to: a clear error, and nothing is lost.

The disk is a limit on the size of files (RLIMIT_FSIZE), so that a write fails midway, as on a full one.
"""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from lag_case import lag, record

import phugoid as ph
from phugoid import writing


@pytest.fixture(scope="module")
def fit() -> ph.Fit:
    return ph.estimate(lag(), record())


WRITERS: dict[str, Callable[[ph.Fit, Path], Any]] = {
    "fit.json": lambda fit, path: fit.save(path),
    "fit.h5": lambda fit, path: fit.save(path),
    "model.json": lambda fit, path: fit.model.save(path),
    "page.html": lambda fit, path: fit.report(path),
    "misfit.html": lambda fit, path: ph.diagnose(fit, list(ph.candidates(fit.model))[:2]).report(path),
    "diagnosis.json": lambda fit, path: ph.diagnose(fit, list(ph.candidates(fit.model))[:2]).save(path),
    "lag.c": lambda fit, path: fit.export_c(path.parent),
    "lag.fmu": lambda fit, path: fit.export_fmu(path, binary=False),
}
NAMES = [
    pytest.param(n, marks=pytest.mark.skipif(n.endswith("h5") and find_spec("h5py") is None, reason="HDF5 needs h5py"))
    for n in WRITERS
]


@pytest.mark.parametrize("name", NAMES)
def test_the_old_file_stays_and_nothing_is_left_beside(
    name: str, fit: ph.Fit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / name
    path.write_text("old")

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(writing.os, "fsync", full)
    with pytest.raises(ph.DataError, match="No space left on device"):
        WRITERS[name](fit, path)
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == [name]


def limited(script: str, folder: Path) -> str:
    """What a script prints whose files may have no more than 4 kB."""
    pytest.importorskip("resource")
    head = f"""
import resource, signal, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from test_full_disk import *
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
fit = ph.estimate(lag(), record())
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
"""
    done = subprocess.run([sys.executable, "-c", head + script], capture_output=True, text=True, cwd=folder, timeout=60)
    assert done.returncode == 0, (done.returncode, done.stderr[-2000:])
    return done.stdout


@pytest.mark.parametrize("name", ["fit.json", pytest.param("fit.h5", marks=NAMES[1].marks), "page.html"])
def test_a_write_that_fails_midway_is_an_error_alone(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text("old")
    said = limited(
        f"""
try:
    WRITERS[{name!r}](fit, Path({name!r}))
except ph.DataError as error:
    print(error)
""",
        tmp_path,
    )
    assert said.startswith(f"{name}: the ")
    assert said.endswith(" cannot be written (File too large); nothing was changed there\n")
    assert (tmp_path / name).read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_a_multistart_goes_on_without_its_journal(tmp_path: Path) -> None:
    script = """
found = ph.multistart(lag(), record(), {"a": (0.5, 2.0)}, n=20, journal="starts.jsonl")
print(found.status, len(found.outcomes), *found.warnings)
"""
    said = limited(script, tmp_path)
    assert said.startswith("complete 20 journal starts.jsonl: cannot be written (File too large)")
    whole = (tmp_path / "starts.jsonl").read_bytes()
    assert whole.endswith(b"\n") and 0 < whole.count(b"\n") < 20
    again = ph.multistart(lag(), record(), {"a": (0.5, 2.0)}, n=20, journal=tmp_path / "starts.jsonl")
    assert (again.status, again.warnings) == ("complete", ())


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission_is_an_error(fit: ph.Fit, tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(ph.DataError, match="Permission denied"):
        fit.save(tmp_path / "fit.json")


def test_a_link_is_followed_and_permissions_stay(fit: ph.Fit, tmp_path: Path) -> None:
    (tmp_path / "there.json").write_text("old")
    (tmp_path / "there.json").chmod(0o640)
    (tmp_path / "link.json").symlink_to(tmp_path / "there.json")
    fit.save(tmp_path / "link.json")
    assert (tmp_path / "link.json").is_symlink()
    assert (tmp_path / "there.json").stat().st_mode & 0o777 == 0o640
    assert ph.load(tmp_path / "there.json").summary() == fit.summary()


def test_a_device_is_written_to_as_it_is(fit: ph.Fit) -> None:
    if not Path(os.devnull).is_char_device():
        pytest.skip("there is no null device here")
    fit.save(os.devnull)
    assert Path(os.devnull).is_char_device()
