"""Assignment to a method, or to an attribute that does not exist, is refused instead of ignored."""

import pickle

import pytest

import phugoid as ph


def methods(kind: type) -> list[str]:
    return [n for n in dir(kind) if not n.startswith("_") and callable(getattr(kind, n))]


@pytest.fixture
def experiment() -> ph.Experiment:
    return ph.Experiment([0.0, 1.0], outputs={"y": [1.0, 2.0]})


@pytest.mark.parametrize("name", methods(ph.Model))
def test_a_method_of_a_model_is_not_replaced(name: str) -> None:
    m = ph.Model("m")
    with pytest.raises(AttributeError, match=rf"Model\.{name} is a method: call it"):
        setattr(m, name, 1.0)


@pytest.mark.parametrize("name", methods(ph.Experiment))
def test_a_method_of_an_experiment_is_not_replaced(name: str, experiment: ph.Experiment) -> None:
    with pytest.raises(AttributeError, match=rf"Experiment\.{name} is a method: call it"):
        setattr(experiment, name, 1.0)


def test_the_message_says_how_to_call_it() -> None:
    m = ph.Model("m")
    with pytest.raises(ph.PhugoidError, match=r"Model\.noise is a method: call it, `\.noise\(StudentT\("):
        m.noise = ph.StudentT()  # type: ignore[method-assign, assignment]


def test_a_property_is_read_only(experiment: ph.Experiment) -> None:
    with pytest.raises(AttributeError, match="Model.name is read-only"):
        ph.Model("m").name = "other"  # type: ignore[misc]
    with pytest.raises(AttributeError, match="Experiment.t is read-only"):
        experiment.t = [0.0, 2.0]  # type: ignore[misc, assignment]


def test_an_unknown_attribute_is_refused_with_the_nearest_name(experiment: ph.Experiment) -> None:
    with pytest.raises(AttributeError, match="a Model has no attribute 'dynamic'. Did you mean 'dynamics'?"):
        ph.Model("m").dynamic = 1.0  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match="an Experiment has no attribute 'output_s'"):
        experiment.output_s = 1.0  # type: ignore[attr-defined]


def test_a_subclass_may_have_attributes_of_its_own() -> None:
    class Aircraft(ph.Model):
        pass

    aircraft = Aircraft("a")
    aircraft.mass = 1.0  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match="Aircraft.noise is a method"):
        aircraft.noise = ph.StudentT()  # type: ignore[method-assign, assignment]


def test_a_record_is_pickled_as_before(experiment: ph.Experiment) -> None:
    assert pickle.loads(pickle.dumps(experiment)).output("y").tolist() == [1.0, 2.0]
