"""Values that are no numbers, or numbers that nothing can be done with, are refused in a sentence."""

import h5py
import numpy as np
import pytest

import stickslip as ss
from stickslip.core.laws.builtin import laws_equal
from stickslip.data import archive
from stickslip.data.checkpoint import Checkpoint

DATES = np.array(["2020-01-01", "2020-01-02"], "datetime64[D]")
PAIR = [[0.0, 0.0], [0.99, 0.0]]


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"mass": DATES}, "mass must be real numbers, got dates"),
        ({"mass": DATES - DATES[0]}, "got time differences"),
        ({"mass": ["1", "2"]}, "got words"),
        ({"mass": np.array([1.0, 2.0 + 1j])}, "got complex numbers"),
        ({"velocity": np.array([1, 1j, 0], object)}, "got complex numbers"),
        ({"material": [0.0, 0.5]}, r"expected whole numbers .* got 0\.5"),
    ],
)
def test_what_would_lose_a_part_is_refused(more, message):
    with pytest.raises(ValueError, match=message):
        ss.disks(PAIR, 0.5, **more)


LINEAR = ss.laws.linear()


def test_complex_positions_cells_and_walls_are_refused():
    bad = np.array(PAIR) + 1j
    for make in (lambda: ss.disks(bad, 0.5), lambda: ss.box(bad[1]), lambda: ss.flat_walls([0, 0], bad[1])):
        with pytest.raises(ValueError, match="got complex numbers"):
            make()
    with pytest.raises(ss.packings.PackingError, match="position contains entries that are not numbers"):
        ss.packings.from_arrays(bad, np.full(2, 0.5), LINEAR, dim=2)
    with pytest.raises(ss.packings.PackingError, match="mass contains entries that are not numbers"):
        ss.packings.from_arrays(np.array(PAIR), np.full(2, 0.5), LINEAR, mass=DATES, dim=2)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"coulomb": []}, r"coulomb must be 'sharp' or 'smooth', got \[\]"),
        ({"damping": {}}, r"damping must be one of 'velocity', .*, got \{\}"),
        ({"mu": 1e300}, r"mu must be at most 1e\+100.* got 1e\+300"),
        ({"kn": 1e-200}, r"kn at least 1e-100, .*, got 1e-200"),
        ({"kn": 1 + 2j}, "must be a number, got"),
        ({"kn": "1"}, "must be a number, got"),
        ({"kt": [1.0, 2.0]}, "must be a number, got"),
        ({"mu": np.datetime64("2020-01-01")}, "must be a number, got"),
    ],
)
def test_parameters_of_laws(more, message):
    for make in (ss.laws.linear, ss.laws.hertz_mindlin, ss.laws.hertz_mindlin_reff):
        with pytest.raises(ValueError, match=message):
            make(**more)


def test_scalars_of_numpy_are_parameters():
    assert laws_equal(ss.laws.linear(np.float32(2), np.int64(1), np.array(0.5)), ss.laws.linear(2.0, 1.0, 0.5))


@pytest.mark.filterwarnings("ignore")
def test_a_range_beyond_all_pairs_is_refused():
    with pytest.raises(ValueError, match=r"contact_range is 1e\+06 for a grain of radius 1: at most 100 radii are"):
        ss.laws.custom(
            normal_force=lambda overlap, kn: kn * overlap,
            contact_range=lambda r_eff: 1e6 + r_eff,
            parameters={"kn": 1.0},
        )


@pytest.mark.parametrize(
    ("gradient", "message"),
    [
        (np.diag([np.nan, 0.0]), "gradient contains NaN or infinity"),
        (np.diag([-1.0, 0.0]), "collapses or inverts the cell"),
        (np.diag([-2.0, 0.0]), "collapses or inverts the cell"),
        (np.zeros((2, 2), complex), "got complex numbers"),
    ],
)
def test_cells_that_are_none_are_refused(gradient, message):
    cell = ss.box([3.0, 3.0, 1.0], periodic=[True, True, False], dim=2)
    state = ss.assembly(ss.disks(PAIR, 0.5), cell=cell)
    with pytest.raises(ValueError, match=message):
        ss.packings.strained(state, gradient)


def test_grains_on_top_of_each_other_are_refused_before_all_pairs_are_listed():
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match=r"1000000 grains lie within one grain radius of \("):
        ss.assembly(ss.spheres(np.full((10**6, 3), 0.1), 0.5), cell=ss.box())
    loose = rng.uniform(0, 30, (2000, 3))
    ss.assembly(ss.spheres(loose, 0.5), cell=ss.box([40.0] * 3))


def test_an_archive_that_claims_far_more_than_it_holds_is_not_read(tmp_path):
    archive.write(tmp_path / "a.h5", {"x": np.zeros(10)})
    with h5py.File("memory", "w", driver="core", backing_store=False, userblock_size=archive._BLOCK) as file:
        file.attrs["schema"] = archive.SCHEMA
        file.create_dataset("x", (10**9,), "f4", chunks=(10**6,), compression="gzip", fillvalue=1.0)
        file.flush()
        image = file.id.get_file_image()
    (tmp_path / "a.h5").write_bytes(archive._checksum_block(image) + image)
    with pytest.raises(archive.ArchiveError, match=r"up to its /x it would need more than 67.1 MB"):
        archive.read(tmp_path / "a.h5")


def test_pieces_of_another_part_are_refused(tmp_path):
    kept = Checkpoint(tmp_path, "scenario")
    kept.of("a").save("x", {"y": 1.0})
    kept.of("a").folder.rename(kept.of("b").folder)
    with pytest.raises(archive.ArchiveError, match=r"contains pieces of a: restore the original folder names"):
        kept.of("b").load("x")
