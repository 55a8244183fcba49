"""Measured forces: the nearest state in balance against truth and a slow twin, files of two kinds, bad input."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from scipy.optimize import minimize
from typer.testing import CliRunner

import stickslip as ss
from benchmarks.measured_forces import LAW, cut, forces_of, measured, sheared
from stickslip.cli.app import app
from stickslip.core.contacts.jacobian import linearise
from stickslip.data.exchange.files import is_measured
from stickslip.data.exchange.force_network import MeasuredForces


@pytest.fixture(scope="module")
def truth():
    """Unstable, with a few contacts at the Coulomb limit."""
    return cut(sheared(60, 0.845, 2e-3, seed=1))


@pytest.fixture(scope="module")
def few():
    return cut(sheared(9, 0.87, 3e-3, seed=3))


def test_exact_measurements_are_left_as_they_are(truth):
    state, held = truth
    out, change = ss.packings.from_forces(measured(state, held, move=0, push=0, errors=False), LAW)
    np.testing.assert_allclose(out.grains.position, state.grains.position, atol=1e-10)
    for after, before in zip(forces_of(out), forces_of(state), strict=True):
        np.testing.assert_allclose(after, before, atol=1e-8 * forces_of(state)[2].mean())
    assert change.at_limit == (linearise(state, LAW).mobilisation > 1 - 1e-5).sum() > 0
    found, wanted = ss.stability(out, LAW), ss.stability(state, LAW)
    np.testing.assert_allclose(found.pairs, wanted.pairs, rtol=1e-5)


@pytest.mark.parametrize("coulomb", ["sharp", "smooth"])
def test_the_state_is_balanced_within_the_limit_and_as_far_away_as_chance_says(truth, coulomb):
    law = ss.laws.hertz_mindlin(1.0, 2 / 7, 0.3, coulomb=coulomb)
    state, held = truth
    changes = []
    for seed in range(3):
        network = measured(state, held, move=1e-2, push=0.05, seed=seed)
        out, change = ss.packings.from_forces(network, law)
        assert ss.stability(out, law).residual < 1e-7
        i, _, along, across = forces_of(out, law)
        assert (np.abs(across) <= 0.3 * along * (1 + 1e-9)).all()
        assert len(i) == len(network.force_n) - len(change.opened)
        changes.append(change)
    total, degrees = (sum(getattr(c, name) for c in changes) for name in ("chi_square", "degrees"))
    assert abs(total / degrees - 1) < 4 * np.sqrt(2 / degrees)
    assert any(c.moved_to_limit for c in changes)


def test_forces_are_nearer_to_the_truth_than_measured(truth):
    state, held = truth
    before = after = 0.0
    for seed in range(2):
        network = measured(state, held, move=1e-3, push=0.02, seed=seed)
        out, change = ss.packings.from_forces(network, LAW)
        assert not change.opened
        true, new = forces_of(state), forces_of(out)
        before += ((network.force_n - true[2]) ** 2 + (network.force_t - true[3]) ** 2).sum()
        after += ((new[2] - true[2]) ** 2 + (new[3] - true[3]) ** 2).sum()
    assert after < 0.65 * before


def test_errors_are_estimated_from_gaps_and_imbalance(truth):
    state, held = truth
    network = measured(state, held, move=1e-2, push=0.05, errors=False)
    _, change = ss.packings.from_forces(network, LAW)
    assert change.position_error == pytest.approx(1e-2 * state.grains.radius.mean(), rel=0.2)
    assert change.force_error == pytest.approx(0.05 * forces_of(state)[2].mean(), rel=0.3)


def test_a_slow_twin_finds_the_same_minimum(few):
    """SLSQP minimises over positions and forces, with the Hertzian overlaps and the balance written out again."""
    state, held = few
    m = measured(state, held, move=1e-2, push=0.2, seed=1)
    _, change = ss.packings.from_forces(m, LAW)
    n, count, mean = len(m.radius), len(m.pair_i), m.force_n.mean()
    error = np.concatenate([np.repeat(m.position_error, 2), m.force_n_error, m.force_t_error])
    given = np.concatenate([m.position.ravel(), m.force_n, m.force_t])
    contact = {frozenset(pair) for pair in zip(m.pair_i.tolist(), m.pair_j.tolist(), strict=True)}
    others = np.array([(a, b) for a in range(n) for b in range(a) if {a, b} not in contact]).T

    def parts(z):
        place, along, across = np.split(given + error * z, [2 * n, 2 * n + count])
        return place.reshape(n, 2), along, across

    def equations(z):
        place, along, across = parts(z)
        branch = place[m.pair_i] - place[m.pair_j]
        distance = np.linalg.norm(branch, axis=1)
        normal = branch / distance[:, None]
        force = along[:, None] * normal + across[:, None] * np.stack([normal[:, 1], -normal[:, 0]], axis=1)
        total = np.zeros((n, 3))
        for ends, sign in ((m.pair_i, 1), (m.pair_j, -1)):
            np.add.at(total, ends, np.column_stack([sign * force, across]))
        overlap = np.maximum(along, 0) ** (2 / 3)
        closure = distance + overlap - m.radius[m.pair_i] - m.radius[m.pair_j]
        return np.concatenate([total[m.free].ravel() / mean, closure / m.radius.mean()])

    def limits(z):
        place, along, across = parts(z)
        gap = np.linalg.norm(place[others[0]] - place[others[1]], axis=1) - m.radius[others].sum(axis=0)
        return np.concatenate([along, 0.3 * along - across, 0.3 * along + across, gap * mean]) / mean

    constraints = [{"type": "eq", "fun": equations}, {"type": "ineq", "fun": limits}]
    twin = minimize(
        lambda z: 0.5 * z @ z, np.zeros(len(given)), jac=lambda z: z, method="SLSQP", constraints=constraints,
        options={"maxiter": 500, "ftol": 1e-13},
    )  # fmt: skip
    assert twin.success and change.moved_to_limit > 0
    assert change.chi_square == pytest.approx(2 * twin.fun, rel=1e-6)


def write_tables(folder, m, *, ids=None, unit="m", force="N", **columns):
    """Two tables, rows in reverse."""
    n = len(m.radius)
    ids = np.arange(n) if ids is None else ids
    head = [f"x [{unit}]", f"y [{unit}]", f"radius [{unit}]", "fixed", "id", *columns]
    rows = np.column_stack([m.position, m.radius, ~m.free, ids, *columns.values()])[::-1]
    for name, names, values in (
        ("grains.csv", head, rows),
        ("forces.csv", ["i", "j", f"fn [{force}]", "ft [N]"], np.column_stack([*ids[m.ends], m.force_n, m.force_t])),
    ):
        text = "\n".join([",".join(names), *(",".join(map(repr, map(float, row))) for row in values)])
        (folder / name).write_text(text + "\n")
    return folder / "grains.csv", folder / "forces.csv"


def test_tables_are_read_as_they_were_measured(truth, tmp_path):
    m = measured(*truth, move=1e-3, push=0.02, errors=False)
    back = ss.io.read_forces(*write_tables(tmp_path, m, ids=np.arange(len(m.radius)) * 3 + 5))
    for name in ("position", "radius", "free", "pair_i", "pair_j", "force_n", "force_t"):
        np.testing.assert_array_equal(getattr(back, name), getattr(m, name))


def write_pegs(path, m, *, scale=1e-4, name="particle", noise=0.0, wall=True, **changed):
    """File as PeGS writes it: pixels, angles β to the contact and α of the force, seen from each grain.

    The force on a grain at a contact in the direction β is −f (cos(β − α), sin(β − α)).
    """
    grains, rng = [], np.random.default_rng(0)
    branch = m.position[m.pair_j] - m.position[m.pair_i]
    out = branch / np.linalg.norm(branch, axis=1, keepdims=True)
    across = np.stack([-out[:, 1], out[:, 0]], axis=1)
    on_i = -m.force_n[:, None] * out + m.force_t[:, None] * across
    for k in range(len(m.radius)):
        betas, alphas, forces, near = [], [], [], []
        for ends, sign in ((m.pair_i, 1), (m.pair_j, -1)):
            for c in np.flatnonzero(ends == k):
                push, way = sign * on_i[c] + noise * rng.normal(size=2), sign * out[c]
                beta = np.arctan2(way[1], way[0])
                turn = beta - np.arctan2(-push[1], -push[0])
                near.append((m.pair_j if sign > 0 else m.pair_i)[c] + 1)
                betas.append(beta), alphas.append((turn + np.pi) % (2 * np.pi) - np.pi)
                forces.append(np.linalg.norm(push))
        if wall and not m.free[k]:
            near.append(-1), betas.append(0.0), alphas.append(0.0), forces.append(1.0)
        x, y = m.position[k] / scale
        grains.append({
            "id": k + 1, "x": x, "y": y, "r": m.radius[k] / scale, "rm": m.radius[k], "z": len(near),
            "forces": np.array(forces), "betas": np.array(betas), "alphas": np.array(alphas),
            "neighbours": np.array(near, float),
        } | changed)  # fmt: skip
    savemat(path, {name: np.array(grains, object)})
    return path


@pytest.mark.parametrize("name", ["particle", "pres"])
def test_files_of_pegs_are_read(truth, tmp_path, name):
    m = measured(*truth, move=1e-3, push=0.0, errors=False)
    noise = 0.1 * m.force_n.mean()
    back = ss.io.read_forces(write_pegs(tmp_path / "solved.mat", m, name=name))
    np.testing.assert_allclose(back.position, m.position, rtol=1e-12)
    np.testing.assert_array_equal(back.free, m.free)
    order = [{frozenset(e): c for c, e in enumerate(back.ends.T.tolist())}[frozenset(e)] for e in m.ends.T.tolist()]
    np.testing.assert_allclose(back.force_n[order], m.force_n, rtol=1e-9)
    np.testing.assert_allclose(back.force_t[order], m.force_t, atol=1e-9 * m.force_n.mean())
    rough = ss.io.read_forces(write_pegs(tmp_path / "rough.mat", m, noise=noise))
    assert rough.force_n_error[0] == pytest.approx(noise / np.sqrt(2), rel=0.3)  # of the mean of two


def test_the_command_balances_measured_forces_first(few, tmp_path):
    m = measured(*few, move=1e-3, push=0.01, errors=False)
    grains, forces = write_tables(tmp_path, m)
    law = ["--law", "hertz_mindlin", "--kn=1", "--coulomb=sharp", "--mu=0.3", "--modes", str(tmp_path / "modes.npz")]
    done = CliRunner().invoke(app, ["stability", str(grains), "--contacts", str(forces), *law, "--position-error=1e-4"])
    assert done.exit_code == 0, done.output
    text = " ".join(done.output.split())
    assert "balanced by moving coordinates" in text and "most of it from the contact of grains" in text
    turned = m._replace(force_t=-m.force_t)
    grains, forces = write_tables(tmp_path, turned)
    done = CliRunner().invoke(
        app, ["stability", str(grains), "--contacts", str(forces), *law[:-1], str(tmp_path / "o.npz")]
    )
    said = " ".join(done.output.split())
    assert said.count("with the opposite ft") == 1 and "they would balance better" in said


def test_forces_from_lammps_are_not_taken_for_measured_ones(tmp_path):
    (dump := tmp_path / "local.dump").write_text("ITEM: TIMESTEP\n0\nITEM: ENTRIES i j fn ft\n1 2 0.1 0.0\n")
    (table := tmp_path / "forces.csv").write_text("i,j,fn,ft\n1,2,0.1,0.0\n")
    assert [is_measured(tmp_path / "packing.data", file) for file in (dump, table)] == [False, True]


def changed(m, **values):
    fields = {"held": np.flatnonzero(~m.free), "position": m.position, "radius": m.radius, "pair_i": m.pair_i}
    fields |= {"pair_j": m.pair_j, "force_n": m.force_n, "force_t": m.force_t, "force_n_error": m.force_n_error}
    return ss.io.measured_forces(**fields | {"force_t_error": m.force_t_error} | values)


def test_forces_that_no_state_has_are_refused_in_one_sentence(truth, tmp_path):
    m = measured(*truth, move=1e-3, push=0.02)
    strong, c = m.force_t.copy(), int(np.argmax(m.force_n))
    strong[c] = 5 * m.force_n[c]
    away = m.position.copy()
    away[m.pair_i[0]] += 3 * m.radius.max()
    pull = m.force_n.copy()
    pull[c] = -1.0
    lists = ("pair_i", "pair_j", "force_n", "force_t", "force_n_error", "force_t_error")
    _, forces = write_tables(tmp_path, m)
    (nobody := tmp_path / "nobody.csv").write_text("x,y,radius\n")
    cases = [
        ("nobody.csv has no grains", lambda: ss.io.read_forces(nobody, forces)),
        ("measured contact forces are missing", lambda: changed(m, **{name: [] for name in lists})),
        ("beyond the Coulomb limit for mu = 0.3", lambda: ss.packings.from_forces(changed(m, force_t=strong), LAW)),
        ("gap of .* of a radius", lambda: changed(m, position=away)),
        ("pull each other", lambda: changed(m, force_n=pull)),
        ("use numbers from 0 to 59", lambda: changed(m, pair_j=m.pair_j + 60)),
        ("no grain is held", lambda: ss.packings.from_forces(changed(m, held=[]), LAW)),
        ("have two entries", lambda: changed(m, **{name: np.repeat(getattr(m, name)[:1], 2) for name in lists})),
        ("check kn", lambda: ss.packings.from_forces(m, ss.laws.linear(1e-9))),
        ("need a law with friction", lambda: ss.packings.from_forces(m, ss.laws.linear(mu=0.0))),
        ("lever arms", lambda: ss.packings.from_forces(m, ss.laws.with_lever(LAW, "overlap"))),
        ("in pixels", lambda: ss.io.read_forces(*write_tables(tmp_path, m, unit="px"))),
        ("forces in", lambda: ss.io.read_forces(*write_tables(tmp_path, m, force="mN"))),
        ("has no radii in metres", lambda: ss.io.read_forces(write_pegs(tmp_path / "a.mat", m, rm=0.0))),
        ("0 forces for", lambda: ss.io.read_forces(write_pegs(tmp_path / "b.mat", m, forces=np.zeros(0)))),
    ]  # fmt: skip
    for text, call in cases:
        with pytest.raises(ValueError, match=text) as refused:
            call()
        assert "\n" not in str(refused.value), text


def test_a_grain_with_one_contact_is_named():
    row = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]
    chain = ss.io.measured_forces(row, 0.5, [0, 1], [1, 2], [1.0, 1.0], held=[0], ids=[7, 8, 9], force_n_error=0.01)
    with pytest.raises(ValueError, match="grain 9 has a single contact, with an unbalanced force of 1"):
        ss.packings.from_forces(chain, ss.laws.linear(1e3))
    corner = ss.io.measured_forces(
        [[0, 0], [1, 0], [1, 1]], 0.5, [0, 1], [1, 2], [1.0, 1.0], held=[0, 2], force_n_error=0.01
    )
    with pytest.raises(ValueError, match=r"the largest imbalance is .* at grain 1:"):
        ss.packings.from_forces(corner, ss.laws.linear(1e3, mu=0.1))


def test_a_contact_of_little_force_is_balanced_in_few_steps():
    """The overlap of Hertz varies with F^(2/3): steps that keep their direction shrink slowly unless they are doubled.

    The file has 40 disks of the benchmark `measured_forces` with errors of 1 % of a radius and 10 % of the mean force.
    """
    with np.load(Path(__file__).with_name("weak_force.npz")) as arrays:
        network = MeasuredForces(**arrays, notes=[])
    out, change = ss.packings.from_forces(network, LAW)
    assert not change.opened and change.chi_square == pytest.approx(132.84, abs=0.01)
    assert ss.stability(out, LAW).residual < 1e-9
