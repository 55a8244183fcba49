"""Arguments of `ss.friction` that make no sense are refused in one sentence, which names them."""

import numpy as np
import pytest

from stickslip import friction
from stickslip.friction import RateState, Recording

SURFACE = RateState(0.010, 0.006, 1e-5)
LEGS = friction.velocity_steps([1e-6, 1e-5], distance=2e-4)
HISTORY = friction.spring_slider(SURFACE, friction.Spring(1e4), LEGS)
DATA = friction.Data(HISTORY.time, HISTORY.friction, LEGS)
KNOWN = {"stiffness": 1e4}


def fault(**more):
    given = {"a": 0.02, "b": 0.015, "dc": 8e-3, "normal": 50e6}
    return friction.line_fault(10e3, 100.0, **given | more)


def injection(**more):
    return friction.Injection(**{"flux": 1e-9, "storage": 1e-9, "diffusivity": 0.1, "stop": 1e6} | more)


def simulated(years=1e-3, tolerance=1e-4, changes=(), **recording):
    return friction.simulate_fault(fault(changes=changes), years, recording=Recording(**recording), tolerance=tolerance)


def of_data(**fields):
    return friction.fit(DATA._replace(**fields), fixed=KNOWN)


def sampled(**options):
    return friction.posterior(DATA, **{"fixed": KNOWN} | options)


REFUSED = {
    "fixed must be a dict of word and numbers or None, got a value of type int": lambda: sampled(fixed=5),
    "fixed must be a dict of word and numbers or None, got a value of type list": lambda: sampled(fixed=[1]),
    "free must be a list, got a value of type int": lambda: sampled(free=5),
    "fixed['stiffness'] must be a number, got a value of type str": lambda: friction.fit(
        DATA, fixed={"stiffness": "x"}
    ),
    "legs must be a list of LoadStep or a tuple of LoadStep, got a value of type int": lambda: of_data(legs=5),
    "before must be a number or None, got a value of type str": lambda: of_data(before="x"),
    "before must be positive, got inf": lambda: of_data(before=np.inf),
    "before must be positive, got -inf": lambda: friction.record_data(
        friction.LabRecord(HISTORY.time, HISTORY.friction, HISTORY.load_point), before=-np.inf
    ),
    "velocity must be zero or positive": lambda: friction.critical_stiffness(SURFACE, np.inf),
    "damping must be zero or positive, got -1": lambda: friction.critical_stiffness(SURFACE, 1e-6, -1),
    "damping must be zero or positive, at": lambda: friction.critical_stiffness(SURFACE, 1e-6, np.inf),
    "b must be finite, got inf": lambda: friction.critical_wavelength(1.0, 0.01, np.inf, 1.0, 1.0),
    "roughness must be zero or positive": lambda: friction.load_steps([0, 1, 2], [0, 1, 2], roughness=-1),
    "normal must be positive and finite, got -1": lambda: friction.load_steps([0, 1, 2], [0, 1, 2], [1, -1, 1]),
    "a must be a number, or pairs of depth and value, got b'1'": lambda: fault(a=b"1"),
    "a contains a whole number beyond": lambda: fault(a=10**400),
    "b contains a whole number beyond": lambda: fault(b=[(0, 10**400)]),
    "thickness must be positive, or inf, got -1": lambda: fault(thickness=-1),
    "tolerance must be at least 1e-14, got 1e-140": lambda: simulated(tolerance=1e-140),
    "tolerance must be at least 1e-14": lambda: friction.spring_slider(
        SURFACE, friction.Spring(1e4), LEGS, tolerance=1e-15
    ),
    "recording.quiet_profiles = 1e-09 s makes profiles of": lambda: simulated(quiet_profiles=1e-9),
    "recording.spacing = 1e-09 m makes 1e+13 points": lambda: simulated(spacing=1e-9),
    "recording.quiet_sampling = 1e-09 s makes": lambda: simulated(quiet_sampling=1e-9, changes=(injection(),)),
    "recording.seismic_profiles = 1e-12 s makes profiles of": lambda: friction.simulate_fault(
        fault(), 1e-3, start=friction.initial_state(fault(), velocity=1e-2), recording=Recording(seismic_profiles=1e-12)
    ),
    "recording.stations must be a list of number, got a value of type int": lambda: simulated(stations=5),
    "recording.stations[0] must be a number, got a value of type str": lambda: simulated(stations=["x"]),
    "text: expected velocities and times": lambda: friction.stated_steps("fast", [0, 1]),
    "text ends at 0.5 s": lambda: friction.stated_steps("1 until 0.5", [0, 1]),
    "velocity: expected velocities and times": lambda: friction.record_data(
        friction.LabRecord(HISTORY.time, HISTORY.friction), velocity="fast"
    ),
}  # fmt: skip


@pytest.mark.parametrize("sentence", REFUSED)
def test_one_sentence_names_the_argument(sentence):
    with pytest.raises((TypeError, ValueError)) as caught:
        REFUSED[sentence]()
    said = str(caught.value)
    assert said.removeprefix("Data are not valid: ").startswith(sentence) and "\n" not in said


def test_arrays_without_dimensions_are_numbers():
    given = {"start": np.array(10.0), "stop": np.array(1e4)}
    same = simulated(1e-4, changes=(injection(**{name: float(value) for name, value in given.items()}),))
    assert simulated(1e-4, changes=(injection(**given),)).steps == same.steps
    assert fault(shear_modulus=np.array(32.04e9)).transfer is fault().transfer


def test_lists_are_as_good_as_tuples():
    assert fault(changes=[injection()]).changes == (injection(),)
    for places in ([0.0, 5e3], np.array([0.0, 5e3])):
        assert simulated(1e-4, stations=places).slip.shape[1] == 2
    assert sampled(free=iter(()), fixed=KNOWN | {"a": 0.01, "dc": 1e-5, "b": 0.006}, walkers=4).names == ("mu0",)


def test_every_line_of_a_comment_is_a_comment(tmp_path):
    path = friction.write_csv(
        tmp_path / "r.csv", friction.LabRecord(HISTORY.time, HISTORY.friction, HISTORY.load_point), ("a\nb", "")
    )
    assert path.read_text().splitlines()[:3] == ["# a", "# b", "# "]
    assert len(friction.read_record(path).time) == len(HISTORY.time)
