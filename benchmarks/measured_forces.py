"""Agreement of verdicts from measured, balanced forces with those of the true packing.

python -m benchmarks measured_forces           # the table
python -m benchmarks measured_forces example   # writes examples/measured_disks.csv and measured_forces.csv
"""

import warnings
from pathlib import Path

import numpy as np

import stickslip as ss
from stickslip.core.contacts.jacobian import linearise

LAW = ss.laws.hertz_mindlin(1.0, 2 / 7, 0.3)
ERRORS = ((1e-2, 0.1), (1e-2, 1e-2), (1e-3, 1e-2), (1e-4, 1e-3))  # errors of positions [radii] and forces [mean forces]
PACKINGS, DRAWS, DISKS = 10, 4, 40


def sheared(n, fraction, strain, seed):
    """Periodic disks at rest after three steps of shear."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        state, _ = ss.packings.jammed(n, packing_fraction=fraction, dim=2, seed=seed, tolerance=1e-12)
        for _ in range(3):
            state, outcome = ss.equilibrate(ss.packings.strained(state, strain / 3 * np.eye(2, k=1)), LAW)
            assert outcome.ok
    return state


def cut(state, law=LAW):
    """Packing without periodic sides, and the grains that touched across them, which are held."""
    rows, contacts, grains = ss.measure.touching(state), state.contacts, state.grains
    across = contacts.image[rows].any(axis=1)
    held = np.unique([contacts.i[rows[across]], contacts.j[rows[across]]])
    rows = rows[~across]
    memory = {name: getattr(contacts, name)[rows] for name in ("slip", "mode")}
    ends = {"pair_i": contacts.i[rows], "pair_j": contacts.j[rows]}
    out = ss.packings.from_arrays(grains.position, grains.radius, law, **ends, **memory, density=1.0, dim=2)
    return out._replace(control=ss.control.fixed(out.control, held)), held


def forces_of(state, law=LAW):
    """Grains of each contact, normal forces, and tangential forces along n × z."""
    rows = ss.measure.touching(state)
    line = linearise(state, law)
    normal, force = line.normal[rows], line.force[rows]
    along = np.einsum("ck,ck->c", normal, force)
    across = force[:, 0] * normal[:, 1] - force[:, 1] * normal[:, 0]
    return state.contacts.i[rows], state.contacts.j[rows], along, across


def measured(truth, held, *, move, push, seed=0, law=LAW, errors=True):
    """Forces of a state, with errors of positions over the mean radius and errors of forces over the mean force."""
    rng, (i, j, along, across) = np.random.default_rng(seed), forces_of(truth, law)
    place, radius = truth.grains.position[:, :2], truth.grains.radius
    move, push = move * radius.mean(), push * along.mean()
    known = {"position_error": move, "force_n_error": push, "force_t_error": push} if errors else {}
    place = place + move * rng.normal(size=place.shape)
    along = np.maximum(along + push * rng.normal(size=len(along)), 0.0)
    across = across + push * rng.normal(size=len(along))
    return ss.io.measured_forces(place, radius, i, j, along, across, held=held, **known)


def write_example() -> None:
    """Write the tables of a measured packing."""
    m = measured(*cut(sheared(30, 0.85, 2e-3, 1)), move=1e-2, push=0.05, errors=False)
    folder = Path(__file__).parents[1] / "examples"
    grains = np.column_stack([m.position, m.radius, ~m.free])
    contacts = np.column_stack([m.pair_i, m.pair_j, m.force_n, m.force_t])
    law = "Law: kn = 1, mu = 0.3; errors of 1 % of a radius and of 5 % of the mean force"
    for name, head, rows, form in (
        ("disks", f"# Disks of which positions were measured. {law}\nx,y,radius,fixed", grains, "%.6g,%.6g,%.6g,%d"),
        ("forces", f"# Forces between measured_disks.csv. {law}\ni,j,fn,ft", contacts, "%d,%d,%.6g,%.6g"),
    ):
        text = "\n".join([head, *(form % tuple(row) for row in rows)]) + "\n"
        (folder / f"measured_{name}.csv").write_text(text, encoding="utf-8")


def rows(*words: str, smallest: bool = False):
    """One row per pair of errors; with the word `example`, write the example instead."""
    if words == ("example",):
        write_example()
        return
    strains, packings = (5e-4, 2e-3), 1 if smallest else PACKINGS
    truths = [cut(sheared(DISKS, 0.85, strains[seed % 2], seed)) for seed in range(1, packings + 1)]
    grows = [ss.stability(state, LAW).grows for state, _ in truths]
    yield f"{sum(grows)} of {packings} packings are unstable"
    for move, push in ERRORS[-1:] if smallest else ERRORS:
        agree, chi, before, after = 0, [], 0.0, 0.0
        for seed in range(DRAWS * packings):
            (state, held), (*_, along, across) = truths[seed // DRAWS], forces_of(truths[seed // DRAWS][0])
            network = measured(state, held, move=move, push=push, seed=seed)
            out, change = ss.packings.from_forces(network, LAW)
            agree += ss.stability(out, LAW).grows == grows[seed // DRAWS]
            chi.append(change.chi_square / change.degrees)
            if not change.opened:
                *_, new_n, new_t = forces_of(out)
                scale = along.mean()
                before += (((network.force_n - along) / scale) ** 2 + ((network.force_t - across) / scale) ** 2).sum()
                after += (((new_n - along) / scale) ** 2 + ((new_t - across) / scale) ** 2).sum()
        ratio, draws = np.sqrt(after / before), DRAWS * packings
        yield (f"| {move:g}, {push:g} | {np.mean(chi):.2f} ± {np.std(chi):.2f} | {ratio:.2f} | {agree} of {draws} |")
