"""The saved model that the Rust crate's tests read is what Python saves and evaluates today.

rust/core/tests/suite/saved_model.rs reads the same file and compares bit by bit: together they say that a model saved
by Python evaluates identically in Rust.
"""

from __future__ import annotations

import saved_model


def test_the_file_that_rust_reads_is_up_to_date() -> None:
    assert saved_model.FIXTURE.read_text(encoding="utf-8") == saved_model.text(), "run python tools/saved_model.py"
