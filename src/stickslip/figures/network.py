"""Figure of a network of contact forces: distributions, chains, the strong network, and a rose of directions."""

import numpy as np
from matplotlib.collections import EllipseCollection, LineCollection

from ..core.arguments import knows_bonds
from ..core.laws.builtin import Law
from ..core.readable import pluralize
from ..solve.force_chains import (
    ForceChains,
    ForceNetwork,
    Source,
    StrongNetwork,
    force_anisotropy,
    force_chains,
    force_network,
    strong_network,
)
from .style import BLACK, BLUE, ORANGE, PAGE, PURPLE, RED, OwnFigure, label_axes, legend_above, styled

GREY, PALER, PALE, SAND = "#b4bac0", "#d3d8dd", "#eef1f4", "#f8dfae"
HEIGHT = 5.6  # inches
FEW, MANY = 6, 24  # bins of the distributions and of half the rose
MOST = 5.0  # multiple of the mean force above which lines do not get thicker
SLAB = 30.0  # between spheres, largest angle between directions of the rose and its plane [degrees]


@styled
@knows_bonds
def forces(source: Source, law: Law | None = None, *, title: str = ""):
    """Contact forces: distribution, lengths of force chains, strong network, and rose of contacts and normal forces.

    Pairs that pull, such as bonded ones, are counted and drawn separately. Networks of spheres are viewed along the
    intermediate principal stress; their rose has contacts within 30° of the plane of the other two principal stresses.
    Curves in the rose have the anisotropies of `measure.force_anisotropy`.

    Parameters
    ----------
    source : accepted state, or measured forces from `io.read_forces`
    law : Law of a state; None for measured forces
    """
    net = force_network(source, law)
    if not _is_enough(net):
        raise ValueError(
            f"the figure needs at least {FEW} contacts of grains under compression, got "
            f"{pluralize(np.count_nonzero(net.inner), 'contact')} with a mean normal force of "
            f"{net.force_n.mean() if len(net.force_n) else 0:.3g}"
        )
    chains, strong = force_chains(source, law), strong_network(source, law)
    pulled = force_chains(source, law, tension=True) if (net.force_n < 0).any() else None
    figure = OwnFigure(figsize=(PAGE, HEIGHT), layout="constrained")
    distribution, lengths = figure.add_subplot(2, 2, 1), figure.add_subplot(2, 2, 2)
    network, rose = figure.add_subplot(2, 2, 3), figure.add_subplot(2, 2, 4, projection="polar")
    plane = _plane(net)
    _draw_distribution(distribution, net)
    _draw_lengths(lengths, chains, pulled)
    _draw_network(network, net, strong, chains, plane)
    _draw_rose(rose, net, force_anisotropy(source, law), plane)
    if title:
        figure.suptitle(title, fontsize=8)
    return figure


def enough_contacts(source: Source, law: Law | None = None) -> bool:
    """Return True if there are enough contacts for the figure, and their normal forces add up to a compression."""
    return _is_enough(force_network(source, law))


def _is_enough(net: ForceNetwork) -> bool:
    return np.count_nonzero(net.inner) >= FEW and net.force_n[net.inner].sum() > 0


def _plane(net: ForceNetwork) -> np.ndarray:
    """(2, 3) directions to the right and up: x and y of disks, axes of the smallest and largest stress of spheres."""
    if net.dim == 2:
        return np.eye(3)[:2]
    stress = net.force.T @ net.branch
    axes = np.linalg.eigh(stress + stress.T)[1][:, [0, 2]].T
    return axes * np.where(axes[np.arange(2), np.argmax(np.abs(axes), axis=1)] < 0, -1.0, 1.0)[:, None]


def _bins(count: int) -> int:
    return int(np.clip(np.sqrt(count), FEW, MANY))


def _draw_distribution(axes, net: ForceNetwork) -> None:
    mean, least, pulls = net.mean, np.inf, net.force_n < 0
    parts = (
        (net.force_n[~pulls] / mean, "normal", BLUE, "o"), (-net.force_n[pulls] / mean, "pulling", PURPLE, "^"),
        (np.linalg.norm(net.tangential, axis=1) / mean, "tangential", RED, "s"),
    )  # fmt: skip
    for values, name, color, marker in parts:
        if not values.any():
            continue
        number, edges = np.histogram(values, bins=_bins(len(values)))
        density, seen = number / (len(values) * np.diff(edges)), number > 0
        error, least = density / np.sqrt(np.maximum(number, 1)), min(least, density[seen].min())
        axes.errorbar(
            ((edges[1:] + edges[:-1]) / 2)[seen], density[seen], error[seen], color=color, marker=marker, lw=0.8,
            elinewidth=0.5, label=f"{name}, {len(values)} contacts",
        )  # fmt: skip
    axes.set_yscale("log", nonpositive="clip")
    axes.set_ylim(bottom=0.4 * least)
    axes.set_xlim(left=0)
    axes.legend(loc="upper right")
    label_axes(axes, x=r"contact force $f/\langle f_n\rangle$", y="probability density $P$")


def _draw_lengths(axes, chains: ForceChains, pulled: ForceChains | None) -> None:
    count, share = len(chains.lengths), chains.lengths.sum() / max(chains.loaded.sum(), 1)
    if not count:
        axes.text(0.5, 0.5, "no chains of three or more grains", ha="center", va="center", transform=axes.transAxes)
        axes.set(xlim=(3, 10), ylim=(0, 1))
    else:
        length = np.arange(3, chains.lengths.max() + 1)
        longer = np.array([(chains.lengths >= k).sum() for k in length])
        axes.plot(length, longer / count, "o-", color=BLUE, lw=0.8, label=pluralize(count, "chain"))
        if (mean := chains.lengths.mean()) > 3:
            fit = (1 - 1 / (mean - 2)) ** (length - 3)  # geometric, from the shortest length
            axes.plot(length, fit, color=BLACK, ls="--", lw=0.8, label=f"exponential, mean {mean:.3g} grains")
        if pulled is not None and (most := len(pulled.lengths)):
            length = np.arange(3, pulled.lengths.max() + 1)
            longer = np.array([(pulled.lengths >= k).sum() for k in length])
            axes.plot(length, longer / most, "^-", color=PURPLE, lw=0.8, label=f"{pluralize(most, 'chain')} in tension")
            count = max(count, most)
        axes.set_yscale("log")
        axes.set_ylim(0.5 / count, 1.5)
        legend_above(axes, title=f"in chains: {100 * share:.0f} % of the loaded grains")
    label_axes(axes, x="length of a force chain, $L$ [grains]", y="fraction of chains at least as long", whole="x")


def _draw_network(axes, net: ForceNetwork, strong: StrongNetwork, chains: ForceChains, plane: np.ndarray) -> None:
    position = net.position @ plane.T
    chained = np.isin(np.arange(len(net.radius)), np.concatenate([*chains.chains, np.zeros(0, int)]))
    if net.dim == 2:
        axes.add_collection(
            EllipseCollection(
                2 * net.radius, 2 * net.radius, 0 * net.radius, units="xy", offsets=position,
                offset_transform=axes.transData, facecolors=np.where(chained, SAND, PALE), edgecolors="0.75",
                linewidths=0.2, zorder=1,
            )
        )  # fmt: skip
    start, reach = position[net.pair_i], net.branch @ plane.T
    size, pulls = np.clip(np.abs(net.force_n) / net.mean, 0.1, MOST), net.force_n < 0
    room = 72 * min(PAGE / 2, HEIGHT / 2) * 0.8 / max(np.ptp(position, axis=0).max(), 2 * net.radius.max())
    thick = float(np.clip({2: 0.35, 3: 0.12}[net.dim] * room * np.median(net.radius), 0.15, 1.2))
    grains, inner = len(net.radius), net.inner
    for rows, color, order, name in (
        (~strong.strong & ~pulls, GREY, 2, "below the mean"),
        (strong.strong & ~strong.cluster, BLUE, 3, "above it, other clusters"),
        (strong.cluster, RED, 4, f"above it, cluster of {len(strong.grains)} of {grains} grains"),
        *([(pulls, PURPLE, 3, "pulling")] if pulls.any() else []),
    ):
        ends = [np.stack([start[rows], start[rows] - reach[rows] / 2], axis=1)]  # halves, as images may be far away
        if (other := rows & inner).any():
            far = position[net.pair_j[other]]
            ends.append(np.stack([far, far + reach[other] / 2], axis=1))
        width = thick * np.concatenate([size[rows], size[other]])[: sum(map(len, ends))]
        axes.add_collection(LineCollection(np.concatenate(ends), linewidths=width, colors=color, zorder=order))
        axes.plot([], [], color=color, lw=1.5, label=f"{name}")
    low, high = (position - net.radius[:, None]).min(axis=0), (position + net.radius[:, None]).max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.plot([], [], ls="", marker="o", mfc=SAND, mec="0.6", ms=5, label="grain in a chain") if net.dim == 2 else None
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.02), ncol=2, columnspacing=1.0, handlelength=1.2)
    axes.set(xticks=[], yticks=[])
    if net.dim == 3:
        axes.set_title("viewed along the intermediate principal stress")


def _draw_rose(axes, net: ForceNetwork, found, plane: np.ndarray) -> None:
    rows = np.flatnonzero(net.inner)
    flat = net.normal[rows] @ plane.T
    near = np.linalg.norm(flat, axis=1) >= np.cos(np.deg2rad(SLAB if net.dim == 3 else 90.0))
    angle, force = np.arctan2(flat[near, 1], flat[near, 0]) % np.pi, net.force_n[rows][near]
    bins = int(np.clip(2 * round(np.sqrt(len(angle)) / 2), FEW, MANY - MANY % 2))
    edges = np.linspace(0, np.pi, bins + 1)
    number = np.histogram(angle, edges)[0]
    mean = np.histogram(angle, edges, weights=force)[0] / np.maximum(number, 1)
    middle = (edges[1:] + edges[:-1]) / 2
    contacts, normal = bins * number / max(len(angle), 1), mean / (mean[number > 0].mean() if len(angle) else 1.0)
    around = np.concatenate([middle, middle + np.pi])
    axes.bar(around, np.tile(contacts, 2), width=np.pi / bins, color=PALER, edgecolor=PALER, lw=0.3, label="contacts")
    axes.plot(np.append(around, around[0]), np.append(np.tile(normal, 2), normal[0]), "o-", color=BLUE, ms=2, lw=0.7,
              label="normal force")  # fmt: skip
    if net.dim == 2:
        turn = np.linspace(0, 2 * np.pi, 181)
        for a, axis, color, name in (
            (found.contacts, found.contact_axis, BLACK, "$1 + a_c\\cos 2(\\theta - \\theta_c)$"),
            (found.normal, found.normal_axis, ORANGE, "$1 + a_n\\cos 2(\\theta - \\theta_n)$"),
        ):
            axes.plot(turn, np.maximum(1 + a * np.cos(2 * (turn - np.arctan2(axis[1], axis[0]))), 0), color=color,
                      lw=1.0, label=name)  # fmt: skip
    axes.set_yticks([1.0], labels=[""])
    axes.plot([], [], color="0.6", lw=0.5, label="mean")
    axes.set_xticks(np.deg2rad(np.arange(0, 360, 45)))
    axes.tick_params(labelsize=7)
    axes.grid(lw=0.5, color="0.6")
    axes.set_axisbelow(False)
    axes.set_title(
        f"$a_c$ = {found.contacts:.2f},  $a_n$ = {found.normal:.2f},  $a_t$ = {found.tangential:.2f}", pad=12
    )
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncol=3, columnspacing=1.0, handlelength=1.2)
