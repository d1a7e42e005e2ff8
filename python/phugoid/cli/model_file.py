"""Models from files: Python code that builds one, or saved JSON."""

from __future__ import annotations

import inspect
import json
import sys
import traceback
from contextlib import redirect_stdout
from pathlib import Path
from types import ModuleType
from typing import Any

from ..api import load_fit
from ..errors import DataError, ModelError, did_you_mean, listing
from ..modelling.model import Model
from ..result import Fit
from ..saving.files import DIAGNOSIS, FORMAT, SUFFIXES

__all__ = ["load_model", "load_source"]

# A function without arguments is called for its model where it is called so, or says that it returns one.
_MAKERS = ("model", "make_model", "build_model")


def load_model(source: str) -> Model:
    """Return the model of ``model.py``, ``model.py:name``, ``model.json`` or a saved fit."""
    found = load_source(source)
    return found.model if isinstance(found, Fit) else found


def load_source(source: str) -> Model | Fit:
    """Return the model of a file, or the fit that the file holds.

    A Python file defines one `Model`, or a function without arguments that makes it; ``file.py:name`` says which.
    Raises ModelError with file and line for what goes wrong in it, DataError for a file that cannot be read.
    """
    file, name = _split(source)
    path = Path(file)
    if path.suffix.lower() in SUFFIXES:
        return load_fit(path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise DataError(f"{path}: there is no such file in {path.parent.resolve()}") from None
    except UnicodeDecodeError:
        raise DataError(f"{path}: is neither Python nor a saved model (it is not text)") from None
    if path.suffix == ".json":
        return _saved(path, text)
    if path.suffix != ".py":
        raise DataError(f"{path}: a model is a Python file (.py), or a saved model or fit (.json, .h5)")
    names = _run(path, text)
    value = _named(path, names, name) if name else _only(path, names)
    return _made(path, value)


def _split(source: str) -> tuple[str, str]:
    file, colon, name = source.rpartition(":")
    if colon and name.isidentifier() and not Path(source).exists():
        return file, name
    return source, ""


def _saved(path: Path, text: str) -> Model | Fit:
    try:
        document = json.loads(text)
    except json.JSONDecodeError as error:
        raise DataError(f"{path}: is not complete JSON (line {error.lineno}: {error.msg})") from None
    if isinstance(document, dict) and document.get("format") == FORMAT:
        return load_fit(path)
    if isinstance(document, dict) and document.get("format") == DIAGNOSIS:
        raise DataError(f"{path}: holds a diagnosis, not a model or a fit; phugoid.load reads it")
    try:
        return Model.from_json(text)
    except (ModelError, AttributeError, KeyError, TypeError, ValueError) as error:
        raise ModelError(f"{path}: is not a model saved by phugoid ({error})") from None


def _run(path: Path, text: str) -> dict[str, Any]:
    """Execute a Python file and return the names that it defines. Its output goes to stderr, since stdout is for
    results."""
    module = ModuleType(f"phugoid_model_{path.stem}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # dataclasses look their module up
    folder = str(path.resolve().parent)
    if folder not in sys.path:
        sys.path.insert(0, folder)  # its neighbours can be imported, as in `python model.py`
    try:
        with redirect_stdout(sys.stderr):
            exec(compile(text, str(path), "exec"), module.__dict__)
    except (Exception, SystemExit) as error:
        raise _at_line(path, error) from error
    return module.__dict__


def _at_line(path: Path, error: BaseException) -> ModelError:
    """Return an error as a ModelError that names the innermost line of the user's file."""
    if isinstance(error, SyntaxError) and error.filename == str(path):
        return ModelError(f"{path}, line {error.lineno}: {error.msg}")
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == str(path)]
    where = f"{path}, line {lines[-1]}" if lines else str(path)
    kind = "" if isinstance(error, ModelError) else f"{type(error).__name__}: "
    # Python itself suggests the nearest name only where it prints the traceback.
    hint = did_you_mean(error.name, dir(error.obj)) if isinstance(error, AttributeError) and error.name else ""
    return ModelError(f"{where}: {kind}{error}{'.' if hint else ''}{hint}")


def _named(path: Path, names: dict[str, Any], name: str) -> Any:
    if name not in names:
        defined = [n for n, value in names.items() if not n.startswith("_") and not inspect.ismodule(value)]
        raise ModelError(f"{path}: there is no '{name}'.{listing(name, defined)}")
    return names[name]


def _only(path: Path, names: dict[str, Any]) -> Any:
    models = {id(v): (n, v) for n, v in reversed(names.items()) if isinstance(v, Model)}
    found = list(models.values()) or [(n, v) for n, v in names.items() if _makes(n, v, names["__name__"])]
    if not found:
        raise ModelError(
            f"{path}: defines no phugoid.Model, and no function without arguments that is annotated to return one "
            f"(-> phugoid.Model); name it, as in {path.name}:make"
        )
    if len(found) > 1:
        listed = ", ".join(sorted(n for n, _ in found))
        raise ModelError(f"{path}: has several models ({listed}); choose one, as in {path.name}:{found[-1][0]}")
    return found[0][1]


def _makes(name: str, value: Any, module: str) -> bool:
    if not inspect.isfunction(value) or value.__module__ != module:
        return False
    required = [p for p in inspect.signature(value).parameters.values() if p.default is p.empty]
    if any(p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD) for p in required):
        return False
    returned = value.__annotations__.get("return")
    return returned is Model or str(returned).rpartition(".")[2] == "Model" or name in _MAKERS


def _made(path: Path, value: Any) -> Model | Fit:
    if inspect.isfunction(value):
        try:
            with redirect_stdout(sys.stderr):
                made = value()
        except (Exception, SystemExit) as error:
            raise _at_line(path, error) from error
        if not isinstance(made, Model):
            raise ModelError(f"{path}: {value.__name__}() returns a {type(made).__name__}, not a phugoid.Model")
        return made
    if not isinstance(value, Model):
        raise ModelError(f"{path}: a {type(value).__name__} is not a phugoid.Model, nor a function that makes one")
    return value
