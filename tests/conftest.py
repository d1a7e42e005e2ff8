"""What several files share: figures without a window, models and records, and the size of campaigns.

Campaigns repeat one test over many cases. By default some of their cases run, spread evenly over the list; with
``PHUGOID_FULL=1``, as in `make test-all`, all of them do.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

os.environ["MPLBACKEND"] = "Agg"
# Before numpy is imported: each of several processes would start threads for all cores, which wait for each other in
# loops and take ten times the time.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

FULL = os.environ.get("PHUGOID_FULL", "") not in ("", "0")

# How many cases of a campaign run by default, spread evenly over its list; or the parameter of which each value runs
# once. Every kind of case that a campaign has is kept.
CAMPAIGNS: dict[str, int | str] = {
    # One for each kind of effect: aerodynamic, control, state, sensor, friction, stiffness, disturbance, two together.
    "test_diagnose.py::test_what_is_hidden_is_found": 8,
    "test_diagnose.py::test_nothing_is_found_where_nothing_is_hidden": 4,
    "test_situations.py::test_what_is_wrong_is_named_and_nothing_else": "what",
    "test_situations.py::test_a_fit_of_a_model_that_misses_much_converges": 2,
    "test_situations.py::test_a_term_that_no_library_has_is_shown_as_a_function": 2,
    "test_ringing.py::test_hardening_and_softening_are_named": 3,
    "test_ringing.py::test_sensor_noise_is_nothing": 2,
    "test_ringing.py::test_no_term_is_named_where_the_mass_is_shaken": 3,
    "test_multivariate_noise.py::test_turbulence_is_no_missing_physics": 2,
    "test_petab.py::test_published_points_have_their_published_likelihood_and_are_kept": 3,
    # In full size only: each takes half a minute and more. A constant force is named on a simulated cart too, in
    # test_free_simulation.py; the vane on one of the two records; a mode that softens in test_ringing.py; and dry
    # friction in several files, of which this kind is in test_candidates.py.
    "test_real_records.py::test_the_force_on_a_real_cart_is_named": 0,
    "test_diagnose_data.py::test_attas_without_the_vane_in_both_records_together": 0,
    "test_f16.py::test_what_repeats_in_the_residuals_is_the_mode_that_softens": 0,
    "test_memory.py::test_friction_that_is_larger_at_rest_is_no_plain_friction": 0,
}


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out the cases of campaigns that run in full size only, unless a case is asked for by its name."""
    if FULL or any("[" in argument for argument in config.invocation_params.args):
        return
    left_out: list[pytest.Item] = []
    for name, wanted in CAMPAIGNS.items():
        cases = [item for item in items if item.nodeid.partition("[")[0].endswith(name)]
        if isinstance(wanted, str):
            first: dict[Any, int] = {}
            for k, item in enumerate(cases):
                first.setdefault(item.callspec.params.get(wanted, k), k)  # type: ignore[attr-defined]
            kept = {*first.values()}
        elif len(cases) > wanted:
            kept = {round(k * (len(cases) - 1) / (wanted - 1)) for k in range(wanted)}
        else:
            continue
        left_out += [item for k, item in enumerate(cases) if k not in kept]
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in left_out]


@pytest.fixture(autouse=True)
def _close() -> Iterator[None]:
    """Closes the figures of each test."""
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


@pytest.fixture(scope="session")
def full_size() -> bool:
    """Whether campaigns run in full size."""
    return FULL


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with the files of `cli_case`."""
    from cli_case import write

    write(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def published() -> Callable[[str], Path]:
    """Returns the path of a published record of a name; without it the test is skipped."""
    folder = Path(os.environ.get("PHUGOID_DATA", Path(__file__).parents[2] / "shared" / "data"))

    def path(name: str) -> Path:
        if not (folder / name).exists():
            pytest.skip(f"no {name}: put the published data into ../shared/data or name a folder in PHUGOID_DATA")
        return folder / name

    return path
