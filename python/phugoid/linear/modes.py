"""The modes of a fit, with standard errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..fit_result import FitResult
from ..modelling.model import Model
from .gauge import Uncertainty
from .jacobians import Jacobians
from .linearise import labels_of, numbers_of
from .mode_table import Modes, table_of
from .state_space import StateSpace

__all__ = ["modes"]

_Array: TypeAlias = NDArray[np.float64]
_Complex: TypeAlias = NDArray[np.complex128]


def modes(
    fit: FitResult | Model | StateSpace,
    parameters: Mapping[str, Any] | None = None,
    *,
    at: Mapping[str, float] | None = None,
    experiment: str | None = None,
) -> Modes:
    """Natural frequencies, damping ratios and time constants: of the eigenvalues of A = df/dx, exactly differentiated.

    ``parameters``  values by name of a model; of a fit instead of its own.
    ``at``          of a model that is not linear, states, inputs (and time) about which it is linearised, by name. The
                    point is taken as it is: it does not move with the parameters.
    ``experiment``  whose parameters to take, where experiments have their own.

    Of a fit with its own parameters there are standard errors, to first order (the delta method), from the covariance
    of the parameters and d lambda = w' dA v / (w' v), with v and w the right and left eigenvectors. They are right too
    where parameters trade off, if the modes do not depend on how: a scale between b and c, or a state space without
    canonical form. Where the data leave a mode open, and where eigenvalues meet (they have no derivative there), they
    are NaN. An eigenvalue that is real is taken to stay real.

    Raises ModelError for names that are not there, values that are missing, and a model that is not linear without
    ``at``.

    >>> m = Model("oscillator")
    >>> x, v = m.states("x v")
    >>> k, d = m.parameters("k d")
    >>> m.dynamics(x=v, v=-k*x - d*v)
    >>> m.outputs(x=x)
    >>> print(modes(m, {"k": 100.0, "d": 1.0}))
    frequency, Hz  damping ratio  time constant, s  eigenvalue, 1/s
    -------------  -------------  ----------------  ---------------
    1.59155        0.05           2                 -0.5 ± 9.98749j
    """
    if isinstance(fit, StateSpace):
        return fit.modes
    model, values = numbers_of("modes", fit, parameters, experiment)
    jacobians = Jacobians(model, "modes", blocks="A")
    numbers = jacobians.point(values, at)
    A = jacobians.matrix("A", numbers)
    if not isinstance(fit, FitResult) or parameters is not None:
        return table_of(np.linalg.eigvals(A).astype(np.complex128))
    lam, right = np.linalg.eig(A)
    try:
        left = np.linalg.inv(right)
    except np.linalg.LinAlgError:
        return table_of(lam.astype(np.complex128))
    uncertainty = Uncertainty(fit)
    labels = labels_of("modes", fit, experiment)
    slopes = np.zeros((lam.size, len(uncertainty.names)), dtype=np.complex128)
    for name in jacobians.parameters:
        column = uncertainty.names.index(labels[name])
        for (i, j), value in jacobians.slopes(name, numbers)["A"]:
            slopes[:, column] += left[:, i] * value * right[j, :]
    covariances = np.array([uncertainty.covariance(np.array([d.real, d.imag])) for d in slopes])
    # Digits that the eigenvectors have lost are lost to the derivatives.
    meet = np.linalg.norm(left, axis=1) * np.linalg.norm(right, axis=0) > 1e7
    covariances[meet] = np.nan
    return table_of(lam.astype(np.complex128), covariances)
