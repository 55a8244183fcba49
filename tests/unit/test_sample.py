"""Packings from elsewhere: arrays and files in, accepted states out, one sentence for what cannot be taken."""

import json

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.measure import touching
from stickslip.data import archive
from stickslip.data.sample import PackingError, PackingWarning, accepted, from_arrays
from stickslip.loading.packing import jammed
from stickslip.loading.protocols import ramp
from stickslip.loading.quasistatic import aqs
from stickslip.loading.reading import read_packing
from stickslip.solve.stability import stability
from tests.conftest import stickslip_here as run

LAW = ss.laws.hertz_mindlin(1.0, 2 / 7, 10.0, coulomb="smooth")


@pytest.fixture(scope="module")
def unstable():
    """Thirty spheres, sheared until there are complex pairs; large slip, sheared cell."""
    state, _ = jammed(30, packing_fraction=0.7, seed=2)
    path = ramp(state, np.arange(0, 21) * 1e-3, aqs(LAW))
    return max(path, key=lambda p: len(p.spectrum.pairs)).state


def arrays_of(state):
    rows, c = touching(state), state.contacts
    return {
        "position": state.grains.position, "radius": state.grains.radius, "cell": state.cell.vectors,
        "pair_i": c.i[rows], "pair_j": c.j[rows], "image": c.image[rows], "slip": c.slip[rows],
    }  # fmt: skip


def test_a_packing_comes_back_with_the_same_forces_and_spectrum(unstable, tmp_path):
    np.savez(tmp_path / "p.npz", **arrays_of(unstable))
    state, law, notes = read_packing(tmp_path / "p.npz", mu=10.0, i0=0.4)
    assert not notes
    before, after = ss.forces(unstable, LAW)[0], ss.forces(state, law)[0]
    np.testing.assert_allclose(after.force, before.force, atol=1e-15)
    result, direct = stability(state, law), ss.spectrum(unstable, LAW)
    assert len(result.pairs) == len(direct.pairs) > 0
    np.testing.assert_allclose(result.pairs, direct.pairs, rtol=1e-9)


def test_pairs_may_be_given_in_either_direction_and_any_order(unstable):
    given = arrays_of(unstable)
    rng = np.random.default_rng(0)
    flip = rng.random(len(given["pair_i"])) < 0.5
    order = rng.permutation(len(flip))
    sign = np.where(flip, -1, 1)[:, None]
    other = given | {
        "pair_i": np.where(flip, given["pair_j"], given["pair_i"])[order],
        "pair_j": np.where(flip, given["pair_i"], given["pair_j"])[order],
        "image": (sign * given["image"])[order],
        "slip": (sign * given["slip"])[order],
    }
    a, b = (ss.forces(from_arrays(law=LAW, **arrays), LAW)[0] for arrays in (given, other))
    assert np.array_equal(a.force, b.force)


def test_positions_may_lie_in_other_boxes(unstable):
    """Shifting grains by whole boxes shifts the images; nothing else changes."""
    given = arrays_of(unstable)
    boxes = np.random.default_rng(1).integers(-2, 3, (30, 3))
    i, j = given["pair_i"], given["pair_j"]
    other = given | {
        "position": given["position"] + boxes @ given["cell"],
        "image": given["image"] - boxes[i] + boxes[j],
    }
    a, b = (stability(from_arrays(law=LAW, **arrays), LAW).pairs for arrays in (given, other))
    np.testing.assert_allclose(a, b, rtol=1e-7)


def test_contacts_may_be_left_out(unstable):
    given = {k: v for k, v in arrays_of(unstable).items() if k in ("position", "radius", "cell")}
    state = from_arrays(law=LAW, **given)
    assert len(touching(state)) == len(touching(unstable))
    assert not state.contacts.slip.any()


def test_slip_that_is_not_tangential_is_projected_and_reported(unstable):
    given = arrays_of(unstable)
    with pytest.warns(PackingWarning, match="normal part was up to"):
        state = from_arrays(law=LAW, **given | {"slip": given["slip"] + 1e-3})
    c, rows = state.contacts, touching(state)
    normal = c.pair[rows] / np.linalg.norm(c.pair[rows], axis=1)[:, None]
    assert np.abs(np.einsum("ck,ck->c", c.slip[rows], normal)).max() < 1e-17


def test_slip_that_is_too_long_for_a_number_is_refused(unstable):
    """As in a damaged file: its square would overflow."""
    slip = unstable.contacts.slip.copy()
    slip[touching(unstable)[0]] = 1e200
    with pytest.raises(PackingError, match=r"slip must be at most 1e\+30, got 1e\+200"):
        accepted(unstable._replace(contacts=unstable.contacts._replace(slip=slip)), LAW, memory=ss.FROZEN)


def test_slip_beyond_the_limit_and_missing_pairs_are_reported(unstable):
    given = arrays_of(unstable)
    with pytest.warns(PackingWarning, match="slip beyond the Coulomb limit at"):
        from_arrays(law=ss.laws.hertz_mindlin(mu=1e-3), **given)
    fewer = {k: v[1:] if k in ("pair_i", "pair_j", "image", "slip") else v for k, v in given.items()}
    with pytest.warns(PackingWarning, match="1 touching pair"):
        from_arrays(law=LAW, **fewer)


def wrong(given, **changes):
    return {k: v for k, v in (given | changes).items() if v is not None}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda g: {"radius": g["radius"][:-1]}, "radius has 29 entries"),
        (lambda g: {"position": g["position"][:, :2]}, r"without z: give dim=2"),
        (lambda g: {"position": np.where(np.arange(90).reshape(30, 3) == 4, np.nan, g["position"])}, "NaN or infinity"),
        (lambda g: {"radius": 3 * g["radius"]}, "less than the diameter of the largest grain"),
        (lambda g: {"position": 0 * g["position"]}, "more than a radius"),
        (lambda g: {"cell": g["cell"][:2]}, "cell has shape"),
        (lambda g: {"cell": 0.2 * g["cell"]}, "less than the diameter of the largest grain"),
        (lambda g: {"cell": None, "periodic": [True] * 3}, "requires a cell"),
        (lambda g: {"pair_i": g["pair_i"][[0, *range(len(g["pair_i"]) - 1)]]}, "do not touch|given twice"),
        (
            lambda g: {k: np.append(g[k], g[k][-1:], axis=0) for k in ("pair_i", "pair_j", "image", "slip")},
            "given twice",
        ),
        (lambda g: {"pair_j": g["pair_j"] + 30}, "use 0 to 29"),
        (lambda g: {"pair_i": g["pair_i"] + 0.5}, "entries that are not integers"),
        (lambda g: {"image": -g["image"] + 1}, "do not touch"),
        (lambda g: {"pair_i": None}, "pair_i and pair_j must be given together"),
        (lambda g: {"pair_i": None, "pair_j": None}, "require pair_i"),
        (lambda g: {"slip": g["slip"][:, :2]}, "slip has shape"),
        (lambda g: {"mass": -1.0}, "must be positive"),
        (lambda g: {"dim": 4}, "dim must be 2 or 3, got 4"),
        (lambda g: {"dim": 2}, "leaves the plane"),
    ],
)
def test_what_cannot_be_taken_gives_a_one_sentence_error(unstable, change, message):
    given = arrays_of(unstable)
    with pytest.raises(PackingError, match=message) as problem:
        from_arrays(law=LAW, **wrong(given, **change(given)))
    assert "\n" not in str(problem.value)


def test_the_command_prints_one_object_with_the_documented_keys(unstable, tmp_path):
    np.savez(tmp_path / "p.npz", **arrays_of(unstable))
    options = ["--law", "hertz_mindlin", "--coulomb", "smooth", "--kn", "1", "--kt", str(2 / 7), "--mu", "10"]
    done = run("stability", str(tmp_path / "p.npz"), *options, "--i0", "0.4", "--json")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    documented = {
        "n", "contacts", "bonded", "rattlers", "residual", "tolerance", "balanced", "causes", "settled", "stable",
            "at_limit", "if_stuck", "pairs", "assumed", "geometry", "met",
        "negative", "zero_modes", "unverified", "spectrum", "method", "scope",
    }  # fmt: skip
    of_every_command = {"command", "status", "folder", "files", "versions"}
    assert set(answer) == documented | of_every_command | {"notes", "verdict"}
    truth = ss.spectrum(unstable, LAW)
    assert answer["n"] == 30
    assert answer["stable"] is False
    assert answer["balanced"] is True and not answer["causes"] and answer["settled"] is None
    assert answer["zero_modes"] == 3
    assert answer["residual"] < 1e-10
    assert set(answer["pairs"][0]) == {"re_lambda", "im_lambda", "omega", "growth_rate"}
    np.testing.assert_allclose(
        [p["growth_rate"] for p in answer["pairs"]], truth.growth_rate[truth.pair_indices], rtol=1e-6
    )


def test_the_command_says_the_verdict_and_writes_the_modes(unstable, tmp_path):
    archive.write(tmp_path / "p.h5", {"state": unstable, "law": LAW})
    done = run("stability", str(tmp_path / "p.h5"), "--modes", str(tmp_path / "m.npz"))
    assert done.returncode == 0, done.stderr
    assert "oscillatory instability" in done.stdout
    modes, truth = np.load(tmp_path / "m.npz"), ss.spectrum(unstable, LAW)
    # M⁻¹J applied to the mode gives −λ times the mode: check by Rayleigh's quotient of its parts
    fastest = np.concatenate([modes["translation"][0], modes["rotation"][0]], axis=1).ravel()
    mine = truth.modes[:, truth.pair_indices[0]]
    assert abs(np.vdot(mine * truth.free.mass, fastest[truth.free.component])) == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        ({"positions": np.zeros((3, 3))}, [], "did you mean 'position'"),
        ({"radius": None}, [], "has no array 'radius'"),
        ({}, ["--law", "hooke"], "law must be hertz_mindlin or linear"),
        ({}, ["--mu", "-1"], "not negative"),
        ({}, ["--method", "magic"], "'auto', 'fastest', 'all', 'certify', 'dense' or 'pairs', got 'magic'"),
        ({"slip": np.zeros((2, 3))}, [], "slip has shape"),
    ],
)
def test_a_wrong_file_ends_with_code_2_and_one_sentence(unstable, tmp_path, change, options, message):
    np.savez(tmp_path / "p.npz", **wrong(arrays_of(unstable), **change))
    done = run("stability", str(tmp_path / "p.npz"), *options)
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("content", [b"", b"no zip", None])
def test_a_file_that_is_none_ends_with_code_2(tmp_path, content):
    if content is not None:
        (tmp_path / "p.npz").write_bytes(content)
    done = run("stability", str(tmp_path / "p.npz"))
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1


def test_vectors_in_the_plane_may_have_two_components():
    law = ss.laws.linear(1.0, 0.5, 0.5, coulomb="sharp")
    flat = {"radius": [0.5, 0.5], "law": law, "dim": 2, "pair_i": [0], "pair_j": [1]}
    two = ss.packings.from_arrays(
        [[0.1, 0.2], [1.09, 0.2]], slip=[[0, 1e-3]], image=[[0, 0]], cell=[[4, 0], [1, 4]], **flat
    )
    three = ss.packings.from_arrays(
        [[0.1, 0.2, 0], [1.09, 0.2, 0]], slip=[[0, 1e-3, 0]], image=[[0, 0, 0]],
        cell=[[4, 0, 0], [1, 4, 0], [0, 0, 1]], **flat,
    )  # fmt: skip
    for name in ("position", "velocity"):
        assert np.array_equal(getattr(two.grains, name), getattr(three.grains, name))
    assert np.array_equal(two.cell.vectors, three.cell.vectors)
    assert np.array_equal(ss.measure.contact_forces(two, law), ss.measure.contact_forces(three, law))
    assert ss.packings.from_arrays([[0, 0]], [0.5], law, dim=2, cell=[4, 5]).cell.vectors.tolist() == [
        [4, 0, 0],
        [0, 5, 0],
        [0, 0, 1],
    ]
    with pytest.raises(ss.packings.PackingError, match="without z: give dim=2"):
        ss.packings.from_arrays([[0, 0]], [0.5], law)


def test_masses_may_be_given_by_density(tmp_path):
    """ρ times the volume of spheres or the area of disks; in a file as in Python."""
    place, radius = [[0, 0, 0], [3, 0, 0]], np.array([0.5, 1.0])
    for density in (2.0, [2.0, 3.0]):
        for dim, volume in ((3, 4 / 3 * np.pi * radius**3), (2, np.pi * radius**2)):
            state = from_arrays(place, radius, LAW, density=density, dim=dim)
            np.testing.assert_allclose(state.grains.mass, np.multiply(density, volume), rtol=1e-15)
            np.savez(tmp_path / "p.npz", position=place, radius=radius, density=density, dim=dim)
            there, _, _ = read_packing(tmp_path / "p.npz", mu=0.5)
            assert np.array_equal(there.grains.mass, state.grains.mass)
            assert np.array_equal(there.grains.inertia, state.grains.inertia)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"mass": 1.0, "density": 2.0}, "mass and density exclude each other: give one"),
        ({"density": 0.0}, "density must be positive, got 0"),
        ({"density": [1.0, 2.0, 3.0]}, r"density has shape \(3,\): \(2,\) is needed"),
        ({"density": np.nan}, "density contains NaN"),
    ],
)
def test_densities_that_cannot_be_used(given, message):
    with pytest.raises(PackingError, match=message):
        from_arrays([[0, 0, 0], [3, 0, 0]], [0.5, 1.0], LAW, **given)


@pytest.mark.parametrize(
    "name",
    [
        "cell",
        "periodic",
        "position",
        "slip",
        "mode",
        "pair_i",
        "velocity",
        "external_force",
        "mass",
        "density",
        "radius",
    ],
)
def test_rows_of_different_lengths_are_refused(name):
    given = {"position": [[0.0, 0.0, 0.0]], "radius": [0.5]} | {name: [[1.0, 2.0], [3.0]]}
    with pytest.raises(PackingError, match=f"^{name} "):
        ss.packings.from_arrays(given.pop("position"), given.pop("radius"), ss.laws.linear(), **given)


def test_cells_of_disks_span_an_area():
    state = from_arrays([[0, 0, 0], [1, 0, 0]], [0.5, 0.5], LAW, cell=[4.0, 4.0, 1.0], dim=2)
    flat = state._replace(cell=state.cell._replace(vectors=state.cell.vectors[::-1].copy()))
    with pytest.raises(ValueError, match="span no area"):
        ss.packings.check(flat)


@pytest.mark.parametrize(
    "law", [ss.laws.jkr(work=0.03), ss.laws.liquid_bridge(surface_tension=1e-3, volume=1e-2)], ids=["jkr", "wet"]
)
def test_a_bond_across_a_gap_exists_if_it_is_listed(law):
    arrays = {"position": [[0, 0, 0], [1.05, 0, 0]], "radius": [0.5, 0.5], "law": law}
    apart = ss.packings.from_arrays(**arrays)
    bonded = ss.packings.from_arrays(**arrays, pair_i=[0], pair_j=[1])
    assert not ss.measure.contact_forces(apart, law).any()
    drawn = ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], law)
    drawn = drawn._replace(grains=drawn.grains._replace(position=bonded.grains.position))
    known = ss.forces(drawn, law)[0].force
    assert known[0, 0] > 0
    np.testing.assert_array_equal(ss.forces(bonded, law)[0].force, known)


def test_a_file_is_read_with_a_law_as_it_is_written_elsewhere(tmp_path):
    """A Law, with other numbers if given; other options, and values that are no law, are named in one sentence."""
    np.savez(tmp_path / "a.npz", position=[[0, 0, 0], [0.99, 0, 0]], radius=[0.5, 0.5])
    law = ss.laws.jkr(work=1e-3)
    found = ss.io.read_packing(tmp_path / "a.npz", law=law)
    assert found.law is law or np.array_equal(found.law.table, law.table)
    assert not found.assumed or "law" not in found.assumed[0]
    assert ss.io.read_packing(tmp_path / "a.npz", law=law, mu=0.3).law.table[0, 0, 2] == 0.3
    with pytest.raises(PackingError, match="coulomb does not apply to a complete law"):
        ss.io.read_packing(tmp_path / "a.npz", law=law, coulomb="sharp")
    for wrong in (3, [law]):
        with pytest.raises(TypeError, match="law must be a word or a Path or a Law, got "):
            ss.io.read_packing(tmp_path / "a.npz", law=wrong)
