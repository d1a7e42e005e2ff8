"""Vanes off the centre of gravity or with a delay: a reconstruction tries both, and says which the data prefer."""

from __future__ import annotations

import flight_path as example
import flight_path_twin as twin
import pytest
from records import find

import phugoid as ph

OUTPUTS = ("V", "alpha", "beta", "phi", "theta", "psi")
BOOM = example.attas.BOOM
DELAYED = ("alpha", "beta")


@pytest.fixture(scope="module")
def truth() -> ph.results.Record:
    return twin.flown()


def on_boom(truth: ph.results.Record, seed: int = 0) -> ph.Experiment:
    """Vanes on the boom, in time; airspeed in time too, for estimation of delays takes long."""
    run = twin.measured(truth, seed, boom=BOOM)
    return ph.Experiment(run.t, channels={**run.channels, "V": twin.measured(truth, None, boom=BOOM).channels["V"]})


def test_a_place_that_is_not_given_is_found(truth: ph.results.Record) -> None:
    positions = ph.reconstruct(on_boom(truth), OUTPUTS).vane_positions
    assert positions is not None and positions.preferred and positions.delayed == ()
    for c in ("alpha", "beta"):
        e = positions.fit.parameters[f"x_{c}_vane"]
        assert abs(e.value - BOOM[0]) < 4 * positions.fit.robust().parameters[e.name].std_error + 0.15
    assert "prefer positions to vanes at the centre of gravity" in str(positions) and "alpha_vane=(x, y, z)" in str(
        positions
    )


def test_delays_that_were_asked_for_are_reported_as_positions(truth: ph.results.Record) -> None:
    """The delay looks right, x/V, and so does a scale factor that is not there."""
    path = ph.reconstruct(on_boom(truth), OUTPUTS, delayed=DELAYED)
    assert path.fit.parameters["tau_alpha"].value == pytest.approx(BOOM[0] / twin.V0, abs=0.01)
    assert path.fit.parameters["K_alpha"].value < 0.95 * twin.ERRORS["K_alpha"]
    assert path.vane_positions is not None and path.vane_positions.preferred and path.vane_positions.delayed == DELAYED
    assert path.vane_positions.fit.parameters["K_alpha"].value == pytest.approx(twin.ERRORS["K_alpha"], abs=0.01)
    assert "instead of delays of alpha and beta" in path.summary() and "prefer positions to delays" in path.summary()


def test_vanes_that_are_late_are_told_to_be_late(truth: ph.results.Record) -> None:
    positions = ph.reconstruct(twin.measured(truth), OUTPUTS, delayed=("V", *DELAYED)).vane_positions
    assert positions is not None and positions.preferred is False
    assert "the data prefer delays" in str(positions)


def test_a_place_that_is_given_is_not_tried(truth: ph.results.Record) -> None:
    known = {"alpha_vane": BOOM, "beta_vane": BOOM, "flank": True}
    assert ph.reconstruct(on_boom(truth), OUTPUTS, **known).vane_positions is None
    one = ph.reconstruct(on_boom(truth), OUTPUTS, alpha_vane=BOOM).vane_positions
    assert one is not None and one.channels == ("beta",)


def test_a_coordinate_that_is_none_is_a_parameter() -> None:
    m = ph.models.flight_path("V alpha", alpha_vane=(None, -0.5, None))
    assert {"x_alpha_vane", "z_alpha_vane"} <= {*m.parameter_names} and m.units["alpha"] == "rad"
    assert "y_alpha_vane" not in m.parameter_names
    with pytest.raises(ph.OptionError, match="beta_vane is its position"):
        ph.models.flight_path("V beta", beta_vane=(None, 0.0))
    with pytest.raises(ph.OptionError, match="alpha_vane is its position"):
        ph.models.flight_path("V alpha", alpha_vane=(None, 0.0, float("nan")))


@pytest.mark.skipif(any(find(n) is None for n in example.attas.RECORDS), reason="the ATTAS records are not here")
def test_attas_positions_are_those_of_the_boom() -> None:
    """Asked for neither positions nor delays, which is quick."""
    positions = ph.reconstruct(example.records(), OUTPUTS, per_experiment=example.INERTIAL).vane_positions
    assert positions is not None and positions.preferred
    p, errors = positions.fit.parameters, positions.fit.robust().parameters
    for c in ("alpha", "beta"):
        assert abs(p[f"x_{c}_vane"].value - BOOM[0]) < 2 * errors[f"x_{c}_vane"].std_error
        assert abs(p[f"K_{c}"].value - 1.0) < 2 * errors[f"K_{c}"].std_error
