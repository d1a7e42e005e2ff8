"""pyPESTO with Fides as a peer of `petab_problems`, on AMICI where that is installed, else on RoadRunner.

    python benchmarks/petab_pypesto.py PROBLEM.yaml STARTS.json SECONDS LIMIT

Prints a line of JSON that says what is used, then one for each start. It ends after all starts, or when SECONDS of
processor time are used; no start has more than LIMIT. Compiling the model is not counted.

AMICI gives exact forward sensitivities and the Fisher information as the Hessian, which is what its authors recommend
with Fides: `pip install "pypesto[fides,petab]" amici cmake ninja swig`, and a C++ compiler. RoadRunner (`pip install
"pypesto[fides,petab,roadrunner]"`) has no sensitivities: the gradient is by forward differences at tight tolerances
of its integrator, the Hessian by BFGS.
"""

import contextlib
import json
import logging
import sys
import time
import warnings
from pathlib import Path


class Spent(Exception):
    """The processor time of a start is used."""


class Clock:
    """Cuts a start, whose objective raises when its time is used, and keeps the best point."""

    until = float("inf")
    best = (float("inf"), None)

    def over(self, objective):
        """Let an objective look at this clock at each call."""
        clock = self

        class Timed(type(objective)):
            def __call__(self, x, *arguments, **options):
                if time.process_time() > clock.until:
                    raise Spent
                found = super().__call__(x, *arguments, **options)
                value = found["fval"] if isinstance(found, dict) else found[0] if isinstance(found, tuple) else found
                if value < clock.best[0]:
                    clock.best = float(value), x.copy()
                return found

        objective.__class__ = Timed


def on_amici(flat, name):
    """Return problem and PEtab problem by AMICI, and Fides with the Fisher information."""
    import amici
    import pypesto.petab

    importer = pypesto.petab.PetabImporter(flat, model_name=name)
    problem = importer.create_problem()
    return problem, importer.petab_problem, f"AMICI {amici.__version__}, exact sensitivities, Fisher information", {}


def on_roadrunner(flat):
    """Return the same by RoadRunner: gradients by differences, Hessian by BFGS."""
    import fides
    import pypesto.objective
    import roadrunner
    from pypesto.objective.roadrunner import PetabImporterRR, SolverOptions

    problem = PetabImporterRR(flat).create_problem()
    problem.objective.solver_options = SolverOptions(relative_tolerance=1e-10, absolute_tolerance=1e-13)
    problem.objective = pypesto.objective.FD(
        problem.objective, grad=True, hess=False, method=pypesto.objective.FD.FORWARD, delta_fun=1e-5
    )
    about = f"RoadRunner {roadrunner.__version__}, forward differences, BFGS"
    return problem, flat, about, {"hessian_update": fides.BFGS()}


def main():
    """Run each start until the time is used."""
    warnings.filterwarnings("ignore")
    import numpy as np
    import petab.v1
    import pypesto.optimize

    path, starts = sys.argv[1], json.loads(Path(sys.argv[2]).read_text())
    seconds, limit = float(sys.argv[3]), float(sys.argv[4])
    logging.disable(logging.CRITICAL)
    flat = petab.v1.Problem.from_yaml(path)
    petab.v1.flatten_timepoint_specific_output_overrides(flat)  # neither simulator takes others
    try:
        problem, flat, about, options = on_amici(flat, Path(path).stem)
    except ImportError:
        problem, flat, about, options = on_roadrunner(flat)
    scale = flat.parameter_df["parameterScale"]
    free = [problem.x_names[i] for i in problem.x_free_indices]
    to_scale = {"log10": np.log10, "log": np.log, "lin": lambda v: v}
    from_scale = {"log10": lambda v: 10.0**v, "log": np.exp, "lin": lambda v: v}
    nominal = problem.get_reduced_vector(np.array(flat.x_nominal_scaled))
    print(json.dumps({"about": about, "nominal": float(problem.objective(nominal))}), flush=True)
    clock = Clock()
    clock.over(problem.objective)
    began = time.process_time()
    for i, start in enumerate(starts):
        before = time.process_time()
        clock.until, clock.best = before + min(limit, seconds - (before - began)), (float("inf"), None)
        x0 = np.array([to_scale[scale[n]](start[n]) for n in free])
        with contextlib.suppress(Exception):  # a start that cannot be simulated, or is cut
            pypesto.optimize.FidesOptimizer(verbose=logging.CRITICAL, **options).minimize(problem, x0=x0, id=str(i))
        cpu, (value, x) = time.process_time() - before, clock.best
        at = None if x is None else {n: float(from_scale[scale[n]](v)) for n, v in zip(free, x, strict=True)}
        print(json.dumps({"value": value if at else float("nan"), "cpu": cpu, "at": at}), flush=True)
        if time.process_time() - began > seconds:
            break


if __name__ == "__main__":
    main()
