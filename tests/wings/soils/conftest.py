"""Samples of soils, each made once for all tests of a process: many tests load the same one."""

import pickle
from functools import wraps

from stickslip.wings.soils.cyclic_shear import simulate as cyclic
from stickslip.wings.soils.element_test import sample
from stickslip.wings.soils.element_test import simulate as element

_make_sample, _made = sample.make_sample, {}


@wraps(_make_sample)
def make_sample_once(chosen, law, seed, report):
    """Make a sample, or copy one that an earlier test has made."""
    key = chosen.model_dump_json(), pickle.dumps(law), seed
    if key not in _made:
        _made[key] = pickle.dumps(_make_sample(chosen, law, seed, report))
    return pickle.loads(_made[key])


sample.make_sample = element.make_sample = cyclic.make_sample = make_sample_once
