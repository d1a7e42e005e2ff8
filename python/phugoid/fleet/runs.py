"""Records that are read where they are needed."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from ..data.experiment import Experiment, completed
from ..data.read import read
from ..data.units import check_units
from ..errors import DataError, MissingDependency, PhugoidError
from ..modelling.model import Model

__all__ = ["Run", "as_runs"]


@dataclass(frozen=True)
class Run:
    """A record of a fleet that is read on the worker that evaluates it, and never passes through the driver.

    name     by which results name it; None: the file's name without its ending.
    source   a path, a URL that fsspec opens (``s3://bucket/flight.parquet``), or a function without arguments that
             returns an `Experiment` and can be pickled, such as ``functools.partial(load, 17)``.
    options  of `phugoid.read`, for a path or a URL: ``Run("f1.csv", outputs=["q"], rename={"DE": "de"})``.

    Raises DataError where the source is none of these.
    """

    source: str | os.PathLike[str] | Callable[[], Experiment]
    name: str = ""
    options: dict[str, Any] = field(default_factory=dict)

    def __init__(
        self, source: str | os.PathLike[str] | Callable[[], Experiment], name: str | None = None, **options: Any
    ) -> None:
        is_path = isinstance(source, (str, os.PathLike))
        if not is_path and not callable(source):
            raise DataError(
                f"Run: the source is a path, a URL or a function that returns an Experiment, not {source!r}"
            )
        if not is_path and name is None:
            raise DataError("Run: a function needs a name: Run(function, name='flight 17')")
        stem = PurePosixPath(os.fspath(source)).stem if is_path else ""  # type: ignore[arg-type]
        for key, value in (("source", source), ("name", name or stem), ("options", options)):
            object.__setattr__(self, key, value)

    def load(self, model: Model) -> Experiment:
        """Read the record and check that it fits the model.

        Raises DataError where it cannot be read or does not fit.
        """
        try:
            found = self._read()
        except PhugoidError:
            raise
        except Exception as error:
            raise DataError(f"run '{self.name}': cannot be read ({type(error).__name__}: {error})") from error
        if not isinstance(found, Experiment):
            raise DataError(f"run '{self.name}': its source gives {type(found).__name__}, not an Experiment")
        return checked(found, model)

    def _read(self) -> Any:
        if callable(self.source):
            return self.source()
        path = os.fspath(self.source)
        if "://" not in path:
            return read(path, name=self.name, **self.options)
        try:
            import fsspec
        except ModuleNotFoundError:
            raise MissingDependency(f"run '{self.name}': to open {path} needs fsspec: pip install fsspec") from None
        with tempfile.TemporaryDirectory() as folder:
            local = Path(folder) / PurePosixPath(path).name
            with fsspec.open(path, "rb") as there:
                local.write_bytes(there.read())
            return read(local, name=self.name, **self.options)


def checked(experiment: Experiment, model: Model) -> Experiment:
    """Return the record with what the model may leave out, after a check that it fits the model."""
    (found,) = completed([experiment], model.output_names)
    check_units(model, [found], "estimate")
    # An output that stands still here may move in another record, which then gives its sigma.
    found.check_for(model.input_names, model.output_names, {*model.output_names}, conditions=model.condition_names)
    return found


def as_runs(data: Any) -> list[Run | Experiment]:
    """Return the records of a fleet, each with a name of its own: experiments, runs, paths and URLs.

    Raises DataError for an empty fleet, for what is no record, and for two records of one name.
    """
    if isinstance(data, (Experiment, Run, str, os.PathLike)) or not isinstance(data, Sequence):
        raise DataError(f"estimate: a fleet is a list of experiments, runs or paths, not {type(data).__name__}")
    if not data:
        raise DataError("estimate: the fleet is empty; give at least one record")
    runs = [Run(one) if isinstance(one, (str, os.PathLike)) else one for one in data]
    if wrong := next((r for r in runs if not isinstance(r, (Experiment, Run))), None):
        raise DataError(f"estimate: a record of a fleet is an Experiment, a Run or a path, not {wrong!r}")
    names: dict[str, int] = {}
    for i, run in enumerate(runs):
        if run.name in names:
            raise DataError(
                f"estimate: records {names[run.name]} and {i} are both called '{run.name}'; name them: "
                "Run(path, name='...')"
            )
        names[run.name] = i
    return runs
