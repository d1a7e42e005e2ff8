"""Two thousand mutations of saved models, fits, diagnoses and records, in full size five thousand: errors of phugoid
alone, within 1 GB of memory.

``PHUGOID_MUTATIONS`` says another number, ``PHUGOID_SEED`` another seed.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

pytest.importorskip("resource")  # limits of memory and alarms are those of POSIX
sys.path.insert(0, str(Path(__file__).parent))

import saved_files


def test_mutated_files_lead_to_errors_of_phugoid_alone(full_size: bool) -> None:
    usual = "5000" if full_size else "2000"
    count, seed = int(os.environ.get("PHUGOID_MUTATIONS", usual)), int(os.environ.get("PHUGOID_SEED", "0"))
    counts, failures = saved_files.run(count, seed)
    assert not failures, "\n".join(f"{number}: {text}" for number, text in failures.items())
    # Some get through, so that what is done with them is tried too.
    for kind in ("model: used", "fit: used", "diagnosis: used"):
        assert counts[kind] > count // 1000, counts
