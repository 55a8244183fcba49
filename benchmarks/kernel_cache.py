"""Run every kernel of the disk array once; print how many were loaded from the cache and how many were compiled."""

import stickslip as ss
from stickslip.core.contacts.forces import evaluate
from stickslip.core.dynamics.loop import step_loop


def main() -> None:
    """Run a few steps with the law of the paper."""
    law = ss.laws.for_pair(ss.laws.hertz_mindlin(mu=10.0, coulomb="smooth"), 0, 1)
    state = ss.packings.disk_array(10, press=5e-5, push=1e-5)
    ss.forces(state, law)
    ss.run(state, law, 10, 0.1)
    kernels = [kernel.stats for kernel in (step_loop(law.kind, law.coulomb, 2, 0, 0, False), evaluate)]
    print(sum(sum(k.cache_hits.values()) for k in kernels), sum(sum(k.cache_misses.values()) for k in kernels))


if __name__ == "__main__":
    main()
