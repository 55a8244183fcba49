"""Chains, the strong network and anisotropies of contact forces, against networks of which they are known."""

import numpy as np
import pytest

import stickslip as ss
from benchmarks.measured_forces import LAW, forces_of, sheared


def network(rows, i, j, force_n, force_t=0.0):
    return ss.io.measured_forces(rows, 0.5, i, j, force_n, force_t)


def lattice(columns, rows, strong):
    """Square lattice whose contacts carry 1, vertical ones 3 in some columns."""
    place = np.array([[k, m] for m in range(rows) for k in range(columns)], float)
    up = [(k, k + columns) for k in range(columns * (rows - 1))]
    right = [(k, k + 1) for k in range(columns * rows) if (k + 1) % columns]
    force = [3.0 if i % columns in strong else 1.0 for i, _ in up] + [1.0] * len(right)
    return network(place, *np.array(up + right).T, force)


def test_columns_under_load_are_chains_and_clusters():
    m = lattice(6, 7, strong=(1, 4))
    chains, strong = ss.measure.force_chains(m), ss.measure.strong_network(m)
    assert chains.lengths.tolist() == [7, 7]  # ends have one contact, and still carry more than the mean
    assert {tuple(sorted(chain % 6)) for chain in chains.chains} == {(1,) * 7, (4,) * 7}
    for chain in chains.chains:
        assert (np.abs(np.diff(chain)) == 6).all()
    assert strong.clusters == 2 and len(strong.grains) == 7
    assert strong.strong.sum() == 12 and strong.cluster.sum() == 6
    assert strong.share_of_pressure == pytest.approx(36 / (36 + 24 + 35))


def test_chains_end_where_they_turn_too_far():
    turn = np.deg2rad([0] * 5 + [70] * 5)
    place = np.vstack([[0, 0], np.cumsum(np.column_stack([np.cos(turn), np.sin(turn)]), axis=0)])
    i = np.arange(10)
    both = np.vstack([place, place + np.array([0, 9])])
    m = network(both, [*i, *i + 11], [*i + 1, *i + 12], [2.0] * 10 + [0.5] * 10)
    # σ₁ of the grain at the corner points 35° from either side, within 45° and not within 30°
    assert ss.measure.force_chains(m).lengths.tolist() == [9]  # without the ends, which carry half
    assert ss.measure.force_chains(m, angle=30).lengths.tolist() == [4, 4]
    with pytest.raises(ValueError, match="from 0 to 90"):
        ss.measure.force_chains(m, angle=100)


def slow_chains(net, angle):
    """Stresses of grains, and sets of grains in chains, grain by grain from the definition."""
    n = len(net.radius)
    moment, near = np.zeros((n, 3, 3)), [[] for _ in range(n)]
    for i, j, force, normal in zip(net.pair_i, net.pair_j, net.force, net.normal, strict=True):
        for k, other, sign in ((i, j, 1.0), (j, i, -1.0)):
            moment[k] += np.outer(sign * force, sign * net.radius[k] * normal)
            near[k].append((other, -sign * normal, force @ normal > 0))
    values, ways = np.linalg.eigh((moment + moment.transpose(0, 2, 1)) / 2)
    stress = values[:, -1]
    mean = np.mean([max(stress[k], 0) for k in range(n) if near[k]])
    loaded = [k for k in range(n) if near[k] and stress[k] > mean]
    chosen = {k: set() for k in loaded}
    for k in loaded:
        for side in (1, -1):
            cosines = [(side * out @ ways[k, :, -1], other) for other, out, on in near[k] if on and other in chosen]
            most = max(cosines, default=(0.0, k))
            chosen[k] |= {most[1]} if most[0] >= np.cos(np.deg2rad(angle)) else set()
    groups = {k: {k} for k in loaded}
    for k in loaded:
        for other in chosen[k]:
            if k in chosen[other] and groups[k] is not groups[other]:
                joint = groups[k] | groups[other]
                groups |= dict.fromkeys(joint, joint)
    return stress, {frozenset(group) for group in groups.values() if len(group) >= 3}


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("angle", [30, 45, 80])
def test_chains_of_unequal_grains_and_rattlers_are_those_of_the_definition(dim, angle):
    rng = np.random.default_rng(dim)
    place = rng.uniform(0, 7 if dim == 2 else 3.5, (90, dim))
    apart = np.linalg.norm(place[:, None] - place, axis=-1)
    i, j = np.nonzero(np.triu((apart > 0.75) & (apart < 1.2)))
    place = np.vstack([place, 100 + 3 * np.arange(30)[:, None] * np.ones(dim)])  # rattlers
    radius = rng.uniform(0.4, 0.6, len(place))
    force_t = 0.2 * rng.normal(size=len(i) if dim == 2 else (len(i), 3))
    m = ss.io.measured_forces(place, radius, i, j, rng.exponential(size=len(i)), force_t)
    stress, chains = slow_chains(ss.measure.force_network(m), angle)
    found = ss.measure.force_chains(m, angle=angle)
    np.testing.assert_allclose(found.stress, stress, atol=1e-12)
    assert {frozenset(chain.tolist()) for chain in found.chains} == chains
    assert chains or angle == 30


@pytest.mark.parametrize("dim", [2, 3])
def test_anisotropies_are_those_that_directions_were_drawn_with(dim):
    """Contacts drawn with known anisotropies along x, as pairs of grains of their own."""
    a_c, a_n, a_t, count = 0.3, 0.5, 0.2, 40_000
    rng = np.random.default_rng(1)
    normal = rng.normal(size=(4 * count, dim))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    shape = np.diag([1.0, -1.0] if dim == 2 else [2 / 3, -1 / 3, -1 / 3])  # a scalar a of one along x
    form = np.einsum("ck,kl,cl->c", normal, shape, normal)
    normal = normal[rng.uniform(size=len(form)) < (1 + a_c * form) / (1 + a_c)][:count]
    form = np.einsum("ck,kl,cl->c", normal, shape, normal)
    across = a_t * (normal @ shape - form[:, None] * normal)
    first = 3.0 * np.arange(len(normal))[:, None] * np.eye(1, dim)
    force_t = across if dim == 3 else across[:, 0] * normal[:, 1] - across[:, 1] * normal[:, 0]
    i = np.arange(len(normal))
    place = np.vstack([first, first - normal])
    m = ss.io.measured_forces(place, 0.5, i, i + len(normal), 1 + a_n * form, force_t)
    found = ss.measure.force_anisotropy(m)
    error = 5 / np.sqrt(count)
    assert (found.contacts, found.normal, found.tangential) == pytest.approx((a_c, a_n, a_t), abs=2 * error)
    stress = np.einsum("ck,cl->kl", (1 + a_n * form)[:, None] * normal + across, normal)
    main = np.sort(np.linalg.eigvalsh((stress + stress.T) / 2))[::-1]
    mean = main.mean()
    invariant = np.sqrt(((main - mean) ** 2).sum() * 1.5) / mean if dim == 3 else (main[0] - main[1]) / main.sum()
    assert found.deviator == pytest.approx(invariant, rel=1e-9)
    assert found.predicted_deviator == pytest.approx(invariant, rel={2: 0.08, 3: 0.05}[dim])  # a_c a_n/2 is left out
    assert abs(found.contact_axis[0]) > 0.99 and abs(found.normal_axis[0]) > 0.99
    turned = ss.io.measured_forces(place, 0.5, i, i + len(normal), 1 + a_n * form, -force_t)
    assert ss.measure.force_anisotropy(turned).tangential == pytest.approx(-a_t, abs=2 * error)


def test_a_state_and_its_measured_forces_have_the_same_statistics():
    state = sheared(40, 0.86, 2e-2, seed=1)
    i, j, along, across = forces_of(state)
    inside = ~state.contacts.image[ss.measure.touching(state)].any(axis=1)
    m = ss.io.measured_forces(
        state.grains.position[:, :2], state.grains.radius, i[inside], j[inside], along[inside], across[inside]
    )
    whole, part = ss.measure.force_network(state, LAW), ss.measure.force_network(m)
    np.testing.assert_allclose(part.force, whole.force[inside], atol=1e-12)
    np.testing.assert_allclose(part.branch, whole.branch[inside], atol=1e-12)
    found = ss.measure.force_anisotropy(state, LAW)
    stress = ss.measure.stress(state, LAW)[:2, :2]
    low, high = np.linalg.eigvalsh((stress + stress.T) / 2)
    assert found.deviator == pytest.approx((high - low) / (high + low), rel=1e-9)
    assert found.predicted_deviator == pytest.approx(found.deviator, rel=0.2)
    with pytest.raises(ValueError, match="a state also needs its law"):
        ss.measure.force_chains(state)
    with pytest.raises(ValueError, match="leave it out"):
        ss.measure.force_chains(m, LAW)


def test_bonded_pairs_have_the_force_of_their_contact_and_their_bond():
    """Springs pull by k (r − r₀), the contacts push as before; chains in tension are those of the opposite forces."""
    bare = sheared(80, 0.86, 2e-2, seed=1)
    made = ss.packings.bonded(bare, ss.laws.spring_bond(0.5), within=0.1)
    away = np.diag([1e-2, -1e-2, 0.0])
    state = ss.packings.strained(made, away)
    state = ss.accept(state, ss.forces(state, LAW)[1])
    net, touch = ss.measure.force_network(state, LAW), ss.packings.without_bonds(state)
    rows = ss.measure.touching(touch)
    pairs = zip(touch.contacts.i[rows], touch.contacts.j[rows], strict=True)
    known = dict(zip(pairs, ss.measure.contact_forces(touch, LAW)[rows], strict=True))
    bonds = state.bonds
    way = state.grains.position[bonds.i] - state.grains.position[bonds.j] + bonds.image @ state.cell.vectors
    drawn = (0.5 * (bonds.length / np.linalg.norm(way, axis=1) - 1))[:, None] * way
    pull = dict(zip(zip(bonds.i, bonds.j, strict=True), drawn, strict=True))
    for i, j, force in zip(net.pair_i, net.pair_j, net.force, strict=True):
        np.testing.assert_allclose(force, known.get((i, j), 0.0) + pull.get((i, j), 0.0), atol=1e-14)
    assert len(net.pair_i) == len(known | pull) > len(known)
    along = np.einsum("ck,ck->c", net.force, net.branch) / np.linalg.norm(net.branch, axis=1)
    np.testing.assert_allclose(net.force_n, along, atol=1e-14)  # also across gaps
    for tension, one in ((False, net), (True, net.reversed())):
        stress, chains = slow_chains(one, 60)
        found = ss.measure.force_chains(state, LAW, angle=60, tension=tension)
        np.testing.assert_allclose(found.stress, stress, atol=1e-14)
        assert {frozenset(chain.tolist()) for chain in found.chains} == chains and chains
        strong, pushes = ss.measure.strong_network(state, LAW, tension=tension), one.force_n >= 0
        np.testing.assert_array_equal(strong.strong, one.force_n > one.force_n[pushes].mean())
        assert 0.5 < strong.share_of_pressure < 1
    figure = ss.figures.forces(state, LAW)
    words = [text.get_text() for axes in figure.axes for text in axes.get_legend().get_texts()]
    assert "pulling" in words and any("in tension" in word for word in words)
    apart = state._replace(bonds=bonds._replace(length=0.9 * bonds.length))
    with pytest.raises(ValueError, match="anisotropies are defined under compression"):
        ss.measure.force_anisotropy(apart, LAW)


def test_the_figure_states_what_was_measured():
    m = lattice(6, 7, strong=(1, 4))
    figure = ss.figures.forces(m)
    texts = [text.get_text() for axes in figure.axes for text in axes.get_legend().get_texts()]
    assert any("71 contacts" in text for text in texts) and "2 chains" in texts
    assert any("cluster of 7 of 42 grains" in text for text in texts)
    bins = 8
    density = figure.axes[0].containers[0].lines[0].get_ydata()
    assert density.sum() * np.ptp(m.force_n) / m.force_n.mean() / bins == pytest.approx(1.0)
    assert np.mean([bar.get_height() for bar in figure.axes[3].patches]) == pytest.approx(1.0)
    assert figure.axes[1].get_legend().get_title().get_text() == "in chains: 100 % of the loaded grains"
    assert "$a_n$ = " in figure.axes[3].get_title()
    with pytest.raises(ValueError, match="the figure needs"):
        ss.figures.forces(network([[0, 0], [1, 0]], [0], [1], [1.0]))
