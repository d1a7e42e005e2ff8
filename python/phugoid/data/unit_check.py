"""Whether a record has its channels in the units that a model declares."""

from __future__ import annotations

from collections.abc import Sequence

from ..errors import DataError
from ..modelling.model import Model
from .experiment import Experiment
from .readers.units import differ

__all__ = ["check_units"]


def check_units(model: Model, runs: Sequence[Experiment], caller: str) -> None:
    """Raises DataError, in the caller's name, for a channel in degrees that the model has in radians, and the like.

    Estimates from such data would be wrong without a sign of it. Units that are not told, or not known, are let pass.
    """
    declared = model.units
    for run in runs:
        for kind, names in (("input", model.input_names), ("output", model.output_names)):
            for name in names:
                told, wanted = run.units.get(name, ""), declared.get(name, "")
                if told and wanted and differ(told, wanted):
                    raise DataError(
                        f"{caller}: {kind} '{name}' of experiment '{run.name}' is in '{told}', but the model has it in "
                        f"'{wanted}'; convert it where it is read, units={{'{name}': ('{told}', '{wanted}')}}, or all "
                        f"channels to SI, convert=True (--convert at the command line); or put right a wrong label, "
                        f"units={{'{name}': '{wanted}'}} (--units {name}={wanted})"
                    )
