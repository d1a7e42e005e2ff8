"""What somebody new to the package gets wrong: each time told in his names, with what to do."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_case import TRUTH, run

import phugoid as ph

T = 0.1 * np.arange(21)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "run1.csv"
    path.write_text("t,u,x\n0,1,0\n0.1,1,0.2\n0.2,-1,0.3\n")
    return path


def refuses(error: type[Exception], words: str, call: Callable[[], Any]) -> None:
    with pytest.raises(error, match=words):
        call()


def test_a_forgotten_comma_is_named() -> None:
    m = ph.Model("lag")
    q = m.states(q="rad/s")
    a, b = m.parameters("a b")
    words = r"^\(q,\) is a tuple.*write `q, = ...`, with a comma"
    for wrong in (
        lambda: a * q,
        lambda: q * a,
        lambda: 2 * q,
        lambda: a + q,
        lambda: q + a,
        lambda: -q,
        lambda: q / a,
        lambda: q**2,
        lambda: m.dynamics(q=q),
        lambda: m.outputs(q=q),
    ):
        refuses(ph.ModelError, words, wrong)


def test_declared_symbols_are_a_tuple_as_ever() -> None:
    m = ph.Model("m")
    both = m.states("a b") + m.states("c")
    assert [str(s) for s in both] == ["a", "b", "c"] and isinstance(both, tuple)
    assert [str(s) for s in pickle.loads(pickle.dumps(m.parameters("d e")))] == ["d", "e"]
    assert str((np.eye(2) @ m.inputs("u v"))[1]) == "0*u + 1*v"


def test_options_of_read_of_the_wrong_kind(file: Path) -> None:
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"window": 3}, r"window=3: give its begin and end, such as"),
        ({"window": "0,1"}, r"window='0,1': give its begin and end"),
        ({"rename": "u"}, r"rename='u': give names by name"),
        ({"units": "deg"}, r"units='deg': give units by name"),
        ({"time": 0}, r"time=0: give the name of the time column"),
    ]
    for options, words in wrong:
        refuses(ph.DataError, words, lambda options=options: ph.read(file, **options))


def test_data_of_the_wrong_kind() -> None:
    refuses(ph.DataError, "units are texts by name", lambda: ph.Experiment(T, units="deg"))  # type: ignore[arg-type]
    refuses(ph.DataError, "units are texts by name", lambda: ph.Experiment(T, units={"q": 1}))  # type: ignore[dict-item]
    values = np.array([np.complex128(1 + 1j)] * T.size, dtype=object)  # as polars gives a column of them
    refuses(ph.DataError, "which is not a real number", lambda: ph.Experiment(T, outputs={"q": values}))
    m = ph.Model("m")
    refuses(ph.DataError, "not ndarray; make one with ph.read", lambda: ph.estimate(m, T))  # type: ignore[arg-type]


def test_names_that_are_no_text(file: Path) -> None:
    m = ph.Model("m")
    (x,) = m.states(x="")
    (a,) = m.parameters("a")
    m.dynamics(x=a)
    m.outputs(x=x)
    refuses(ph.ModelError, "start: '1' is not a parameter", lambda: ph.estimate(m, ph.read(file), start={1: 2}))  # type: ignore[dict-item]
    refuses(ph.ModelError, "at: give states and inputs by name", lambda: ph.linear.linearise(m, {"a": 1}, at=3))  # type: ignore[arg-type]


def test_files_that_cannot_be_written_or_read(file: Path) -> None:
    m = ph.Model("m")
    (x,) = m.states(x="")
    a, b = m.parameters("a b")
    (u,) = m.inputs("u")
    m.dynamics(x=a * x + b * u)
    m.outputs(x=x)
    fit = ph.estimate(m, ph.read(file))
    nowhere = file.parent / "nowhere" / "x.html"
    refuses(ph.DataError, r"x\.html: cannot be saved, since there is no folder", lambda: fit.report(nowhere))
    refuses(ph.DataError, "cannot be written", lambda: fit.report(file.parent))
    refuses(ph.DataError, "cannot be saved", lambda: m.save(nowhere))
    refuses(ph.DataError, r"x\.html: cannot be read", lambda: ph.Model.load(nowhere))


def test_unicode_text_of_a_spreadsheet(file: Path) -> None:
    other = file.with_name("wide.csv")
    other.write_bytes(file.read_text().encode("utf-16"))
    np.testing.assert_array_equal(ph.read(other).output("x"), ph.read(file).output("x"))
    other.write_bytes(b"\xff\xfe" + bytes(range(1, 100)))  # odd: no UTF-16 after all
    refuses(ph.DataError, r"wide\.csv", lambda: ph.read(other))


def test_a_file_that_is_no_table(tmp_path: Path) -> None:
    path = tmp_path / "fit.csv"
    path.write_text("a,b\n1,2\n" + '"' + "x" * 200_000 + '",1\n')
    refuses(ph.DataError, r"fit\.csv: is not a table of text", lambda: ph.read(path))
    path.write_text("t;x\n1,000;2,500\n1,001;3,500\n")
    refuses(ph.DataError, r"decimal comma.*pandas\.read_csv\(.*decimal=','\)", lambda: ph.read(path))


def test_the_command_line_converts_units(here: Path) -> None:
    text = (here / "run1.csv").read_text().removeprefix("t,u,x\n")
    rows = np.loadtxt(text.splitlines(), delimiter=",")
    rows[:, 2] *= 100.0
    np.savetxt("cm.csv", rows, "%.9g", ",", header="t,u [m/s],x [cm]", comments="")
    done = run("fit", "model.py", "cm.csv")
    assert done.exit_code == 2 and "output 'x' of experiment 'cm' is in 'cm'" in done.stderr
    assert "--convert" in done.stderr and "Traceback" not in done.stderr
    done = run("fit", "model.py", "cm.csv", "--convert", "--save", "cm.json")
    assert done.exit_code == 0, done.output
    assert run("fit", "model.py", "run1.csv", "--save", "m.json").exit_code == 0
    found, expected = (ph.load(f).parameters["b"].value for f in ("cm.json", "m.json"))
    assert found == pytest.approx(expected, rel=1e-3)
    # A label that is wrong is put right, and then means what it says.
    np.savetxt("none.csv", rows, "%.9g", ",", header="t,u,x [furlong]", comments="")
    done = run("fit", "model.py", "none.csv", "--units", "x=cm", "--convert", "--save", "told.json")
    assert done.exit_code == 0, done.output
    assert ph.load("told.json").parameters["b"].value == pytest.approx(expected, rel=1e-3)
    assert run("fit", "model.py", "none.csv", "--units", "y=cm").exit_code == 2


def test_a_fit_in_hdf5_brings_parameters(here: Path) -> None:
    pytest.importorskip("h5py")
    assert run("fit", "model.py", "run1.csv", "--save", "fit.h5").exit_code == 0
    done = run("simulate", "model.py", "run2.csv", "--parameters", "fit.h5", "--out", "sim.csv")
    assert done.exit_code == 0 and os.path.getsize("sim.csv") > 0, done.output


def test_a_misspelt_method_in_a_model_file_is_named(here: Path) -> None:
    (here / "typo.py").write_text("import phugoid as ph\nm = ph.Model('m')\nm.dinamics(x=1)\n")
    done = run("fit", "typo.py", "run1.csv")
    assert done.exit_code == 2 and "typo.py, line 3" in done.stderr and "Did you mean 'dynamics'?" in done.stderr


def test_the_command_line_names_columns_of_a_file_without_header(here: Path) -> None:
    table = (here / "run1.csv").read_text().partition("\n")[2]
    (here / "raw.asc").write_text(table.replace(",", "  "))
    done = run("fit", "model.py", "raw.asc")
    assert done.exit_code == 2 and "with --columns A,B" in done.stderr
    done = run("fit", "model.py", "raw.asc", "--columns", "t,u,x", "--save", "raw.json")
    assert done.exit_code == 0, done.output
    assert ph.load("raw.json").parameters["a"].value == pytest.approx(TRUTH["a"], rel=0.1)


def test_a_variable_that_is_no_channel_says_why(tmp_path: Path) -> None:
    from scipy.io import savemat

    m = ph.Model("lag")
    (x,) = m.states(x="")
    (u,) = m.inputs("u")
    a, b = m.parameters("a b")
    m.dynamics(x=a * x + b * u)
    m.outputs(x=x)
    for values, words in ((T[:-1], "it has 20 values, but its times 't' 21"), ("text", "it holds no numbers")):
        savemat(tmp_path / "run1.mat", {"t": T, "u": np.sin(T), "x": values})
        data = ph.read(tmp_path / "run1.mat")
        for record in (data, data.window(0.0, 1.0)):
            refuses(ph.DataError, f"no output 'x'. The file has it, but {words}", lambda r=record: ph.estimate(m, r))
