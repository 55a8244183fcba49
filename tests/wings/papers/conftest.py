"""Samples of gouge before any shear, each prepared once for all tests of a process: most tests shear the same one."""

import pickle
from functools import wraps

from stickslip.wings.papers.gouge import protocol, sample

_prepare_sample, _prepared = sample.prepare_sample, {}
LATER = {"protocol", "realizations", "ledger_steps", "seed"}  # what is used after the preparation
SHEAR = {"slip", "window", "change", "steady", "longest"}  # what `preparation` says of the first slide


@wraps(_prepare_sample)
def prepare_sample_once(scenario, seed, **how):
    """Prepare a sample, or copy one that an earlier test has prepared."""
    key = scenario.model_dump_json(exclude=dict.fromkeys(LATER, True) | {"preparation": SHEAR}), seed
    if key not in _prepared:
        _prepared[key] = pickle.dumps(_prepare_sample(scenario, seed, **how))
    return pickle.loads(_prepared[key])


sample.prepare_sample = protocol.prepare_sample = prepare_sample_once
