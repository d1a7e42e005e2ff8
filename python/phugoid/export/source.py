"""A model, with the parameters of a fit, as C source: plain C99 that needs math.h alone."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import DataError
from ..fit_result import FitResult
from ..modelling.model import Model
from ..writing import write
from .contents import checked_name, contents_of, identifier
from .writer import source

__all__ = ["export_c"]


def export_c(
    fit: FitResult | Model,
    folder: str | os.PathLike[str],
    parameters: Mapping[str, Any] | None = None,
    *,
    name: str | None = None,
    experiment: str | None = None,
    late_inputs: bool = False,
) -> tuple[Path, Path]:
    """Writes ``<name>.h`` and ``<name>.c``; returns their paths. The folder is made where it is not there.

    There are, for n_x states, n_u inputs, n_y outputs and n_p parameters (``<NAME>_N_X``, ...; ``<NAME>_X_<state>`` is
    the place of a state):

    ``<name>_dynamics(t, x, u, p, dx)``      dx = f, per s
    ``<name>_outputs(t, x, u, p, y)``        y = g
    ``<name>_jacobians(t, x, u, p, A, B, C, D)``  df/dx, df/du, dg/dx, dg/du, exact, row by row
    ``<name>_step(t, h, u0, u1, p, x)``      one classical Runge-Kutta step of x from t to t + h (order 4), over which
                                             inputs run linearly from u0 to u1; one that is held has one value in both
    ``<name>_p``, ``<name>_x0``              values of the parameters, and states to begin with
    ``<name>_x_names``, ``<name>_x_units``   and of u, y, p likewise

    All arrays are double; nothing is allocated, nothing kept between calls. Sub-expressions that are used more than
    once are computed once. Values are those of phugoid but for rounding: math.h is the platform's.

    ``parameters``, ``experiment``  as in `linearise`; ``x0`` is the first state of that experiment, 0 without a fit.
    ``name``         what files and functions are called; made from the model's unless given.
    ``late_inputs``  of a model with delays: take each late input, u(t - tau), as an input of its own, which the caller
                     delays, and leave delays of sensors to the caller too.

    Raises ModelError for a model with delays otherwise, and where values are missing or each experiment has its own;
    OptionError for a name that is none in C; DataError where the files cannot be written.
    """
    contents = contents_of("export_c", fit, parameters, experiment, late_inputs)
    code = source(contents, identifier(contents.model.name) if name is None else checked_name(name))
    target = Path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{folder}: the source cannot be written ({error.strerror})") from error
    paths = target / f"{code.name}.h", target / f"{code.name}.c"
    for path, text in zip(paths, (code.header, code.source), strict=True):
        write(path, text, "the source")
    return paths
