"""pyPESTO with Fides on AMICI as a peer of `petab_problems`: the same starts, a line of JSON for each.

    python benchmarks/petab_pypesto.py PROBLEM.yaml STARTS.json SECONDS

Needs an interpreter with `pip install "pypesto[fides,petab]" amici cmake swig` and a C++ compiler. It ends after all
starts, or when so many seconds of processor time are used.
"""

import json
import logging
import sys
import time
import warnings
from pathlib import Path


def main():
    """Run each start until the time is used."""
    warnings.filterwarnings("ignore")
    import numpy as np
    import petab.v1
    import pypesto.optimize
    import pypesto.petab

    path, starts, seconds = sys.argv[1], json.loads(Path(sys.argv[2]).read_text()), float(sys.argv[3])
    logging.disable(logging.CRITICAL)
    flat = petab.v1.Problem.from_yaml(path)
    petab.v1.flatten_timepoint_specific_output_overrides(flat)  # AMICI takes no others
    importer = pypesto.petab.PetabImporter(flat, model_name=Path(path).stem)
    problem = importer.create_problem()
    scale = importer.petab_problem.parameter_df["parameterScale"]
    free = [problem.x_names[i] for i in problem.x_free_indices]
    to_scale = {"log10": np.log10, "log": np.log, "lin": lambda v: v}
    optimizer = pypesto.optimize.FidesOptimizer(verbose=logging.CRITICAL)
    began = time.process_time()
    for i, start in enumerate(starts):
        x0 = np.array([to_scale[scale[n]](start[n]) for n in free])
        before = time.process_time()
        try:
            result = optimizer.minimize(problem, x0=x0, id=str(i))
            value = float(result.fval)
        except Exception as error:  # of a start that cannot be simulated
            value = float("nan")
            print(f"start {i}: {error}"[:200], file=sys.stderr)
        print(json.dumps({"start": i, "nllh": value, "cpu": time.process_time() - before}), flush=True)
        if time.process_time() - began > seconds:
            break


if __name__ == "__main__":
    main()
