"""Records and modes that programs of others have written, or spoiled."""

import re

import numpy as np
import pytest

import stickslip as ss
from stickslip.data.exchange.frame import frame_of, mode_frames, read_mode
from stickslip.wings.faults.friction.laboratory import read_record
from tests.conftest import make_law, make_packing, stirred


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,friction\n0," + "1" * 200_000 + "\n", "line 2, cannot be read (field larger than"),
        ('time,friction\n0,"1\n2,3\n', "quotation mark that is not closed"),
    ],
)
def test_fields_without_end(tmp_path, text, message):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(ValueError, match=re.escape(message)):
        read_record(tmp_path / "a.csv")


@pytest.mark.parametrize("kind", ["words", "dates", "objects"])
@pytest.mark.parametrize("spoiled", ["exponent", "translation", "rotation"])
def test_modes_that_are_no_numbers(tmp_path, kind, spoiled):
    arrays = {"translation": np.zeros((1, 4, 3)), "rotation": np.zeros((1, 4, 3)), "exponent": np.ones(1)}
    bad = {"words": "U3", "dates": "datetime64[s]", "objects": object}[kind]
    arrays[spoiled] = arrays[spoiled].astype(int).astype(bad)
    np.savez(tmp_path / "m.npz", **arrays)
    with pytest.raises(ss.packings.PackingError, match=r"contains (entries that are not numbers|no modes)"):
        read_mode(tmp_path / "m.npz", 0, 4)


def test_a_mode_without_exponent_sways():
    law = make_law("hertz_mindlin", "sharp")
    state = stirred(make_packing(2), law, np.random.default_rng(0))
    n = len(state.grains.radius)
    shift = np.ones((n, 3)) * [1, 0, 0]
    frames = mode_frames(frame_of(state, law), shift + 0j, 0j * shift, 0j, count=4)
    places = [frame.state.grains.position[0, 0] - state.grains.position[0, 0] for frame in frames]
    assert places == pytest.approx([places[0], 0, -places[0], 0], abs=1e-12)
    assert places[0] > 0
