"""Small packings whose first events come early."""

import stickslip as ss
from stickslip.core.dynamics.run import stable_time_step

FRICTIONLESS, LINEAR = ss.laws.hertz_mindlin(mu=0.0), ss.laws.linear(mu=10.0)
SMOOTH = ss.laws.linear(mu=10.0, coulomb="smooth")
STEP = 1e-3


def packing(law, seed, fraction=0.86):
    return ss.packings.jammed(16, packing_fraction=fraction, dim=2, seed=seed, law=law)[0]


def drag(state, law, share=0.1):
    """A share of the highest frequency."""
    return share * 2 / stable_time_step(state, law)


_FOUND = {}


def found(law, seed, to, **how):
    """Search for the first event under a law of this file, made once for all tests, none of which changes it."""
    key = id(law), seed, to, *sorted(how.items())
    if key not in _FOUND:
        _FOUND[key] = search(law, seed, to, most=1, **how)
    return _FOUND[key]


def search(law, seed, to, *, fraction=0.86, share=0.1, **options):
    """Events in steps of STEP, small ones, too: overlaps are large, and the events of few grains are small."""
    state = packing(law, seed, fraction)
    how = {"step": STEP, "smallest": 1e-3, **options}
    return ss.protocols.find_events(state, law, to=to, drag=drag(state, law, share), **how)
