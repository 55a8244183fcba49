"""The header of the compiled core agrees with the tables of Python, and the loader refuses what does not fit."""

import numpy as np
import pytest

from stickslip.core.contacts.forces import FREE, FROZEN, HELD, Bodies
from stickslip.core.contacts.neighbors import with_neighbor_list
from stickslip.core.fields import FIELDS
from stickslip.core.library import _DTYPES, core
from stickslip.core.state import OPEN, SLIDE, STICK
from tests.conftest import make_packing


def test_contacts_have_the_types_of_the_table_of_fields():
    fields = FIELDS["contacts"]
    for kind, pointer, name in core.structs["Contacts"].members:
        if not name.startswith(("len_", "width_")):
            assert pointer and _DTYPES[kind] == np.dtype(fields[name].dtype), name


def test_bodies_have_the_types_of_grains():
    known = (
        FIELDS["grains"] | FIELDS["walls"] | {"inverse_mass": FIELDS["grains"]["mass"], "rate": FIELDS["cell"]["rate"]}
    )
    for kind, _, name in core.structs["Bodies"].members:
        if not name.startswith(("len_", "width_")):
            assert name in Bodies._fields and _DTYPES[kind] == np.dtype(known[name].dtype), name


def test_constants_are_those_of_python():
    assert (core.OPEN, core.STICK, core.SLIDE) == (OPEN, STICK, SLIDE)
    assert (core.FROZEN, core.HELD, core.FREE) == (FROZEN, HELD, FREE)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda slip: slip.astype(np.float32), "slip has type float32: the compiled core needs float64"),
        (lambda slip: slip[::-1], "slip is not contiguous"),
    ],
)
def test_arrays_of_another_type_or_layout_are_refused(change, message):
    contacts = with_neighbor_list(make_packing(2)).contacts
    with pytest.raises(TypeError, match=message):
        core.fill("Contacts", contacts._replace(slip=change(contacts.slip)))
