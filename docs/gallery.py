"""Draw every figure from the examples and write docs/gallery.md: `python docs/gallery.py` from the repository's root.

The code shown beside each picture is the code that draws it. Simulation results are saved in results/gallery, so that
the figures can be redrawn in a minute; the first run takes some ten minutes on two cores. `python docs/gallery.py flow`
draws only that section, and keeps the other pictures. Pictures of guides that are not on the page are drawn by the
same code, from stored data or from the example in the guide: `python docs/gallery.py gouge-tenth`.
"""

import inspect
import pickle
import re
import sys
import tempfile
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import stickslip as ss
from stickslip.experiments.registry import experiment_of, read_scenario

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT)]
from benchmarks.pictures import save_picture, shrink  # noqa: E402

FIGURES = ROOT / "docs" / "figures"
STORE, PICTURES = ROOT / "results" / "gallery", FIGURES / "gallery"
PAGE = ROOT / "docs" / "gallery.md"
THUMB = 0.68  # of the larger ones: size of the pictures in the page, which are links to them; type has 13 pixels


class Section(NamedTuple):
    """Code that makes results, and for each picture its name and the code whose last value is the figure."""

    heading: str
    start: str
    pictures: dict[str, str]


RUN = 'result = ss.simulate(ss.read_scenario("examples/{}.toml"))'
BURSTS = """import numpy as np

law = ss.laws.for_pair(ss.laws.hertz_mindlin(mu=10.0, coulomb="smooth"), 0, 1)
state = ss.packings.disk_array(10, press=0.1 / 2000)
for push in (*np.arange(0, 0.006, 5e-4), 0.0061):
    state = ss.packings.with_push(state, push / 2000)
    state, _ = ss.relax(state, law, tolerance=1e-13)
moving = ss.packings.perturbed(state, velocity=1e-9, seed=1)
probes = range(10)
_, record, _ = ss.run(moving, law, 300_000, dt=0.2, every=20, probes=probes)
form = ss.modes.birth_form(state, law)"""
INFLATE = """law = ss.laws.hertz_mindlin(mu=0.3)
state, _ = ss.packings.jammed(1000, packing_fraction=0.92, dim=2, seed=1)
field = ss.modes.inflate(state, law, range(0, 1000, 10))"""
CEMENT = """law = ss.laws.hertz_mindlin(mu=0.3)
state, _ = ss.packings.jammed(80, packing_fraction=0.9, dim=2, seed=1, law=law)
cement = ss.laws.parallel_bond(0.5, 0.2, tensile_strength=2e-4, shear_strength=4e-4)
cemented = ss.packings.bonded(state, cement, within=0.05)
path = ss.protocols.shear_to_failure(cemented, law, until=1e-3, step=1e-4)"""
MODE = """import numpy as np

state, law, _ = ss.io.read_packing("examples/sheared_spheres.npz")
found = ss.stability(state, law)
u = found.free.spread(found.modes[:, 0]).reshape(-1, 6)
mode = u[:, :3], u[:, 3:], -1j * np.sqrt(found.pairs[0])"""
FIT = """
data = ss.friction.Data(result.history.time, result.recorded, result.legs)
fixed = {"stiffness": result.scenario.spring.stiffness}
fits = [ss.friction.fit(data, law=law, fixed=fixed) for law in ("aging", "slip")]"""
DIRECTIONS = """
from stickslip.wings.soils.element_test.sample import first_seen
from stickslip.wings.soils.element_test.report import columns

probes, table = result.runs[0].probes, columns(result.runs[0], result.scenario)
first = {sign: state.load for sign, state in first_seen(probes).items() if state}
options = ("axial_strain", 1), first, ("axial", "lateral")
some = probes[1::4]
labels = [f"ε = {state.load:.3f}" for state in some]"""
NETWORK = """
import numpy as np

state, _ = ss.packings.jammed(300, packing_fraction=0.88, dim=2, seed=1)
law = ss.laws.hertz_mindlin(mu=0.5)
for _ in range(8):
    sheared = ss.packings.strained(state, 2e-3 * np.eye(2, k=1))
    state, outcome = ss.equilibrate(sheared, law)"""
SECTIONS = {
    "packing": Section(
        "Packing of spheres in its unstable mode", MODE,
        {"mode": "ss.figures.packing(state, law, mode=mode)"},
    ),
    "forces": Section(
        "Contact forces", NETWORK,
        {"forces": "ss.figures.forces(state, law)"},
    ),
    "bursts": Section(
        "Bursts after an instability", BURSTS,
        {
            "bursts": "ss.figures.bursts(record, state, form)",
            "growth_by_amplitude": "ss.figures.growth_by_amplitude(form)",
        },
    ),
    "inclusion": Section(
        "Inflated grains", INFLATE,
        {"inclusion": "ss.figures.inclusion(field)"},
    ),
    "cement": Section(
        "Sheared cemented grains", CEMENT,
        {
            "packing": "ss.figures.packing(path.steps[-1].state, law)",
            "path": "ss.figures.failure_path(path)",
        },
    ),
    "disk-array": Section(
        "Pushed row of disks", RUN.format("disk_array"),
        {
            "fig2_complex_pairs": 'ss.figures.disk_array.complex_pairs({"ten disks": result})',
            "fig3_mean_square_displacement": "ss.figures.disk_array.mean_square_displacement(result)",
            "fig4_trajectory": "ss.figures.disk_array.trajectory(result)",
            "fig7_center_of_mass": "ss.figures.disk_array.center_of_mass(result, 0.083)",
        },
    ),
    "sphere-shear": Section(
        "Sheared packing of spheres", RUN.format("sphere_shear") + "\nrun = next(r for r in result.later if r)",
        {
            "fig2_spectrum_in_time": "ss.figures.sphere_shear.spectrum_in_time(run)",
            "fig3_growth": "ss.figures.sphere_shear.growth(run)",
            "fig4_trajectories": "ss.figures.sphere_shear.trajectories(run, dim=3)",
            "fig5_stress": "ss.figures.sphere_shear.stress_through_failure(run)",
        },
    ),
    "quasi-rigid": Section(
        "Quasi-rigid loading", RUN.format("simple_shear") + "\none = result.tested[0]",
        {
            "fig1_curves": 'ss.figures.quasi_rigid.curves(result.tested, "shear")',
            "fig2_statuses": "ss.figures.packing(one.path.points[-1].state, one.law)",
            "fig3_cone": "ss.figures.quasi_rigid.cone(one, mu=0.5)",
            "fig4_stiffness": "ss.figures.quasi_rigid.stiffness(one)",
        },
    ),
    "element-test": Section(
        "Directions of failure", RUN.format("directions_of_failure") + DIRECTIONS,
        {
            "fig6_directions": 'ss.figures.element_test.failure_directions(probes, table, *options)',
            "fig7_envelopes": 'ss.figures.response_envelopes([s.envelope for s in some], labels, options[2])',
        },
    ),
    "flow": Section(
        "Column collapse", RUN.format("column_collapse"),
        {
            "fig1_snapshots": "ss.figures.flow.snapshots(result)",
            "fig2_time_series": "ss.figures.flow.time_series(result)",
        },
    ),
    "plane-shear": Section(
        "Plane shear", RUN.format("plane_shear"),
        {
            "fig1_snapshots": "ss.figures.flow.snapshots(result)",
            "fig2_time_series": "ss.figures.flow.time_series(result)",
            "forces": 'ss.figures.packing(result.frames[-1], result.law, colour="pressure", width=7.0)',
        },
    ),
    "gouge": Section(
        "Fault gouge", RUN.format("gouge"),
        {
            "fig1_steady_sliding": "ss.figures.gouge.steady_sliding(result.realizations, result.scenario.grains.mean)",
            "fig7_sample": "ss.figures.gouge.sample(result.realizations[0], result.scenario)",
        },
    ),
    "rate-state": Section(
        "Rate-and-state friction", RUN.format("rate_state") + FIT,
        {
            "fig1_history": "ss.figures.rate_state.slid(result.history, result.recorded, result.legs)",
            "fit": "ss.figures.rate_state.fitted(data, fits)",
        },
    ),
    "fault": Section(
        "Earthquake cycles on a fault", RUN.format("fault"),
        {
            "fig1_slip": "ss.figures.fault.slip_contours(result.history)",
            "fig2_velocity": "ss.figures.fault.max_slip_velocity(result.history)",
            "fig3_stations": "ss.figures.fault.station_series(result.history)",
        },
    ),
    "injection": Section(
        "Fluid injected into a fault", RUN.format("injection"),
        {"fig4_normal_stress": "ss.figures.fault.normal_stress_series(result.history)"},
    ),
    "thrust": Section(
        "Earthquake cycles on a thrust fault", RUN.format("thrust"),
        {"fig5_surface": "ss.figures.fault.surface_series(result.history)"},
    ),
    "threshold": Section(
        "Static and kinetic friction", RUN.format("threshold_array"),
        {"fig1_static_and_kinetic": 'ss.figures.static_and_kinetic(result.found, label="push over normal force")'},
    ),
}  # fmt: skip
TENTH = """import json

import numpy as np
import pandas as pd
from scipy.stats import t
from types import SimpleNamespace as Made

from stickslip.figures.style import power_of_ten
from stickslip.wings.papers.gouge.claims import COLLAPSE, predict_hold
from stickslip.wings.papers.gouge.paper import DAMPINGS, paper_scenario
from stickslip.wings.papers.gouge.sample import damping

table = pd.read_csv("docs/reference/gouge/curves.csv")
claims = json.loads(Path("docs/reference/gouge/claims.json").read_text(encoding="utf-8"))
claims = {claim["id"]: claim for claim in claims}
hold, after = "friction in a hold", "friction after a hold"
scenario, v = paper_scenario(), 0.03


def curve(run, kind, label="", **at):
    rows = (table.run == run.replace(",", ";")) & (table.kind == kind)
    for name, value in at.items():
        rows &= table[f"{name} [{'s' if name == 'hold' else 'm/s'}]"] == value
    rows = table[rows]
    x, mean, error = (rows[name].to_numpy() for name in ("x", "mean", "error"))
    return Made(x=x, mean=mean, error=error, band=2 * rows.deviation.to_numpy(), label=label)


def peak(curve, samples):
    k = curve.mean.argmax()
    return Made(value=curve.mean[k], half=t.ppf(0.975, samples - 1) * curve.error[k])


def slope(name):
    return Made(value=claims[name]["measured"], half=2 * claims[name]["error"])


labels = {
    run: rf"{run}: $\\gamma_n$ = {power_of_ten(damping(paper_scenario(damping=run)))}" for run in DAMPINGS
}
main, times = next(iter(DAMPINGS)), [0.01, 0.1, 1.0]
holds = [curve(run, hold, label) for run, label in labels.items()]
laws = predict_hold(Made(scenario=scenario), v, holds[0].x)
ratios = [curve(run, "kinetic over elastic energy in a hold", label) for run, label in labels.items()]
creep = [curve(run, "velocity of the plate in a hold") for run in labels]
thinner = curve(main, "thickness in a hold")
for name in ("mean", "error", "band"):
    setattr(thinner, name, getattr(thinner, name) / scenario.grains.mean)
healed = [peak(curve(main, after, hold=one), 8) for one in times]
steps = [(0.3, 0.03), (0.03, 0.3), (0.03, 0.003), (0.003, 0.03)]
stepped = [curve("steps", "friction after a step", f"{a:g} → {b:g} m/s", before=a, after=b) for a, b in steps]
speeds = np.array([0.02, 0.05, 0.1, 0.3])
slid = [curve("reslides", after, hold=1.43, after=one) for one in speeds]
peaks, measured = [peak(one, 4) for one in slid], slope("peak-vs-velocity-ratio")
figures = ss.figures.gouge"""
PAPER_SIZE = """from stickslip.wings.papers.gouge.paper import reproduce
from stickslip.wings.papers.gouge.report import paper_figures

figures = dict(paper_figures(reproduce(paper_size=True, samples=Path("docs/reference/gouge_paper_size"))))"""
BIAXIAL = """from stickslip.wings.papers.quasi_rigid.claims import paper_scenario

result = simulate("biaxial", paper_scenario())"""
GUIDES = {  # pictures of guides, by the beginning of their names; an example of a guide is its last code that saves one
    "gouge-tenth": Section(
        "Fault gouge of a tenth of the size", TENTH,
        {
            "gouge_holds": "figures.holds([(holds, laws)])",
            "gouge_healing": 'figures.healing(times, healed, slope("healing-rate"), scenario.scales.b, thinner)',
            "gouge_velocity_steps": "figures.velocity_steps(stepped, twins=False)",
            "gouge_reslides": "figures.reslides(slid, speeds / 0.02, peaks, measured, COLLAPSE)",
            "gouge_rest": "figures.energies_in_holds(ratios, creep)",
        },
    ),
    "gouge-paper-size": Section(
        "Fault gouge of the paper's size", PAPER_SIZE,
        {
            "gouge_paper_size_holds": 'figures["fig3_holds.png"]',
            "gouge_paper_size_reslides": 'figures["fig5_reslides.png"]',
            "gouge_paper_size_velocity_steps": 'figures["fig2_velocity_steps.png"]',
        },
    ),
    "biaxial": Section(
        "Biaxial test", BIAXIAL,
        {"quasi_rigid_curves": 'ss.figures.quasi_rigid.curves(result.tested, "biaxial")'},
    ),
    "clusters": Section("Rigid clusters", "quasi_rigid.md", {"quasi_rigid_clusters": "clusters.png"}),
    "collapses": Section("Collapses", "quasi_rigid.md", {"quasi_rigid_collapses": "collapses.png"}),
}  # fmt: skip


def simulate(example: str | Path, scenario=None):
    """Return the saved result of an example, or simulate it, or the scenario of this name, and save the result."""
    path = STORE / f"{Path(example).stem}.pickle"
    if not path.is_file():
        scenario = scenario or read_scenario(ROOT / "examples" / Path(example).name)
        with tempfile.TemporaryDirectory() as folder:
            found = experiment_of(scenario).simulate(scenario, folder=Path(folder))
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps(found))
    return pickle.loads(path.read_bytes())


def draw(name: str) -> None:
    """Draw the pictures of a section by running its code, in which results that have been saved are not made again."""
    section, known = (SECTIONS | GUIDES)[name], {"ss": ss, "simulate": simulate, "Path": Path}
    start = section.start.replace("ss.simulate(ss.read_scenario(", "simulate(Path(")
    if start.endswith(".md"):
        (saved,) = section.pictures.values()
        start, code = example_of(ROOT / "docs" / start, saved)
        section = section._replace(pictures=dict.fromkeys(section.pictures, code))
    exec(start, known)
    for picture, code in section.pictures.items():
        path = FIGURES / f"{picture}.png" if name in GUIDES else PICTURES / f"{name}_{picture}.png"
        save_picture(eval(code, known), path)
        if name in SECTIONS:
            shrink(path, PICTURES / f"small_{path.name}", THUMB)


def example_of(page: Path, saved: str) -> tuple[str, str]:
    """Return the example of a page that saves a picture, without its last line, and the figure that this saves."""
    blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    (block,) = (block.strip() for block in blocks if f'.savefig("{saved}")' in block)
    start, _, last = block.rpartition("\n")
    return start, last.partition(".savefig")[0]


def write_page() -> None:
    """Write the page."""
    text = [
        "# Gallery", "",
        "Every figure function takes a result, or data derived from it, and returns a matplotlib Figure. The code",
        "below each picture draws it, after `import stickslip as ss` and the code at the head of its section. Click on",
        "a picture to enlarge it. The colours are those of Okabe and Ito and of viridis. Figures of one column are",
        "86 mm wide. `python docs/gallery.py` draws all pictures; `stickslip run EXAMPLE --out FOLDER` writes the",
        "figures of one example. For movies and three-dimensional pages, see [look.md](look.md).", "",
    ]  # fmt: skip
    for name, section in SECTIONS.items():
        text += [f"## {section.heading}", "", "```python", section.start.strip(), "```", ""]
        for picture, code in section.pictures.items():
            function = attrgetter(code.removeprefix("ss.figures.").partition("(")[0])(ss.figures)
            caption = inspect.getdoc(function).splitlines()[0]
            file = f"figures/gallery/{{}}{name}_{picture}.png"
            text += [f"[![{caption}]({file.format('small_')})]({file.format('')})", "", f"*{caption}*", ""]
            text += ["```python", code, "```", ""]
    PAGE.write_text("\n".join(text).rstrip() + "\n", encoding="utf-8")


def main(wanted: list[str]) -> None:
    """Draw the given sections, or all, and write the page."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    for name in wanted or SECTIONS | GUIDES:
        print(f"{(SECTIONS | GUIDES)[name].heading} …", flush=True)
        draw(name)
    known = {f"{name}_{picture}.png" for name, section in SECTIONS.items() for picture in section.pictures}
    for path in PICTURES.iterdir():
        if path.name.removeprefix("small_") not in known:
            path.unlink()
    write_page()


if __name__ == "__main__":
    main(sys.argv[1:])
