"""First pairs under several laws: intervals with closed forms, and the skew part of a contact's block."""

import numpy as np
import pytest

import stickslip as ss
from benchmarks.births import births_by_law
from benchmarks.pairs_by_law import PAGE, read_births, table
from stickslip.core.contacts.jacobian import linearise
from stickslip.wings.papers.sphere_shear.claims import share_interval


def test_interval_of_a_share_solves_the_quadratic_equation_of_wilson():
    for count, total in ((0, 60), (7, 60), (30, 60), (60, 60)):
        for end in share_interval(count, total):
            expected = 1.959963984540054**2 * end * (1 - end) / total
            assert (count / total - end) ** 2 == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_packings_without_a_pair_make_the_median_infinite_and_births_at_the_limit_are_counted():
    law = {"kind": "linear", "coulomb": "sharp", "mu": 0.5, "pairs": 1.0}
    born = [law | {"strain": s, "at_limit": a, "mobilisation": 1.0} for s, a in ((1e-3, 0.0), (2e-3, 0.1))]
    never = [law | {"strain": np.nan, "at_limit": np.nan, "mobilisation": np.nan}] * 3
    (few,) = births_by_law(born + never)
    assert (few.packings, few.born, few.limited, few.strain) == (5, 2, 1, np.inf)
    (most,) = births_by_law(born * 3 + never)
    assert most.strain == 2e-3
    assert most.share == pytest.approx(0.05)


def test_the_page_has_the_table_of_the_stored_packings():
    packings = read_births()
    assert len(packings) == 840
    assert table(births_by_law(packings)) in PAGE.read_text(encoding="utf-8")


@pytest.mark.filterwarnings("ignore::stickslip.solve.equilibrate.UnstableEquilibriumWarning")
@pytest.mark.parametrize(
    ("kind", "coulomb", "mu"),
    [
        ("hertz_mindlin", "smooth", 10.0),
        ("hertz_mindlin", "sharp", 0.05),
        ("linear", "sharp", 0.05),
        ("linear", "sharp", 1e9),
    ],
)
def test_the_skew_part_of_a_contact_is_that_of_the_page(kind, coulomb, mu):
    law = getattr(ss.laws, kind)(kn=1.0, kt=2 / 7, mu=mu, coulomb=coulomb)
    state, _ = ss.packings.jammed(20, packing_fraction=0.7, seed=1)
    protocol = ss.protocols.aqs(law)
    for strain in (1e-3, 2e-3):
        state = protocol.step(state, strain).state
    line, (block, _) = linearise(state, law), ss.modes.contact_blocks(state, law)
    size = np.linalg.norm(line.slip, axis=1)
    along = line.slip / np.where(size > 0, size, 1.0)[:, None]
    across = np.cross(line.normal, along)

    def outer(size, a, b):
        return size[:, None, None] * a[:, :, None] * b[:, None, :]

    lopsided, turn = np.zeros_like(block), line.secant * size * line.inverse
    lopsided[:, :3, :3] = outer(line.by_overlap, along, line.normal) + outer(turn, line.normal, along)
    lopsided[:, 3:, :3] = -outer(line.by_overlap, across, line.normal) - outer(turn, line.normal, across)
    rest = block - lopsided
    largest = np.abs(block).max()
    # small slips are perpendicular to the normal only to the round-off of the displacements they were made of
    assert np.abs(rest - rest.transpose(0, 2, 1)).max() < 1e-12 * largest
    assert np.abs(block - block.transpose(0, 2, 1)).max() > 1e-6 * largest
    assert (line.slides > 0).any() == (mu < 0.1)
    assert (np.abs(line.by_overlap).max() == 0) == (mu > 1e6)
