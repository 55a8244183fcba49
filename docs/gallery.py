"""Draw every figure from the examples and write docs/gallery.md: `python docs/gallery.py` from the repository's root.

Simulation results are saved in results/gallery, so that the figures can be redrawn in a minute; the first run takes
some ten minutes on two cores. `python docs/gallery.py flow bursts` draws only these and keeps the other pictures;
`python docs/gallery.py --page` writes only the page, with the pictures that it has.
"""

import inspect
import io
import pickle
import re
import shutil
import sys
import tempfile
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
from PIL import Image

import stickslip as ss
from stickslip.experiments.packing.page import packing_content
from stickslip.experiments.rate_state.fit_report import fit_record, write
from stickslip.experiments.registry import experiment_of, read_scenario
from stickslip.experiments.writer import write_result
from stickslip.figures import grains, style

ROOT = Path(__file__).parents[1]
STORE, PICTURES = ROOT / "results" / "gallery", ROOT / "docs" / "figures" / "gallery"
PAGE = ROOT / "docs" / "gallery.md"
SHRINK, COLORS = 0.7, 256  # of pictures on the page, from 300 dots per inch
# heading, example, and functions that draw its pictures, in the order of file names
SHOWN = {
    "disk-array": (
        "Pushed row of disks", "disk_array.toml",
        "complex_pairs mean_square_displacement trajectory traveling_fronts mode_shape center_of_mass",
    ),
    "sphere-shear": (
        "Sheared packing of spheres", "sphere_shear.toml",
        "pairs_along_strain spectrum_in_time growth trajectories stress_through_failure",
    ),
    "quasi-rigid": ("Quasi-rigid loading", "simple_shear.toml", "curves packing cone stiffness errors"),
    "flow": ("Column collapse", "column_collapse.toml", "snapshots time_series"),
    "plane-shear": ("Plane shear", "plane_shear.toml", "snapshots time_series velocity_profile"),
    "gouge": ("Fault gouge", "gouge.toml", "steady_sliding velocity_steps holds reslides healing sample"),
    "rate-state": ("Rate-and-state friction", "rate_state.toml", "slid"),
    "fault": ("Earthquake cycles on a fault", "fault.toml", "slip_contours max_slip_velocity station_series"),
    "threshold": ("Static and kinetic friction", "threshold_array.toml", "static_and_kinetic"),
}  # fmt: skip


def load_or_make(name: str, make):
    """Return the saved result, or call `make` and save it."""
    path = STORE / f"{name}.pickle"
    if not path.is_file():
        found = make()
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps(found))
    return pickle.loads(path.read_bytes())


def simulate_example(name: str, example: str):
    """Return the result of an example, and its experiment."""
    chosen = read_scenario(ROOT / "examples" / example)
    experiment = experiment_of(chosen)

    def make():
        with tempfile.TemporaryDirectory() as folder:
            return experiment.simulate(chosen, folder=Path(folder))

    return load_or_make(name, make), experiment


def shrink(path: Path, to: Path) -> None:
    """Save a picture with fewer pixels and colours for the page."""
    picture = Image.open(path).convert("RGB")
    small = picture.resize([round(SHRINK * k) for k in picture.size], Image.Resampling.LANCZOS)
    # MAXCOVERAGE keeps colours of few pixels, such as those of thin lines
    small.quantize(COLORS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(to, optimize=True)


def draw_example(name: str) -> list[tuple[str, str]]:
    """Draw the figures of an example and return (function, file) of each."""
    _, example, functions = SHOWN[name]
    found, experiment = simulate_example(name, example)
    out = []
    with tempfile.TemporaryDirectory() as folder, redirect_stdout(io.StringIO()):
        paths = [path for path in write_result(Path(folder), experiment, found) if path.suffix == ".png"]
        names = functions.split()
        for path in paths:
            number = len(out)
            file = f"{name}_{path.stem}.png"
            shrink(path, PICTURES / file)
            out.append((names[number] if len(paths) == len(names) else path.stem, file))
    return out


def draw_packings() -> list[tuple[str, str]]:
    """Draw packings in two and three dimensions, with force chains, statuses and an unstable mode."""
    out = []
    spheres, _ = simulate_example("sphere-shear", SHOWN["sphere-shear"][1])
    flow, _ = simulate_example("plane-shear", SHOWN["plane-shear"][1])
    state, law = unstable_state(spheres)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "packing.h5"
        ss.io.write_packing(file, state, law)
        seen = packing_content(file, options={})
    last = flow.frames[-1]
    figures = {
        "packing_mode": lambda: grains.packing(state, law, mode=seen.modes[0] if seen.modes else None),
        "packing_plane": lambda: grains.packing(last, flow.law, colour="pressure", width=2 * style.WIDTH),
    }
    for name, draw in figures.items():
        path = PICTURES / f"{name}.png"
        style.save(draw(), path)
        shrink(path, path)
        out.append(("packing", path.name))
    return out


def draw_bursts() -> list[tuple[str, str]]:
    """Draw the bursts of the pushed row of disks just beyond the birth of a pair."""
    shown = load_or_make("bursts", run_bursts)
    figures = {
        "bursts": lambda: ss.figures.bursts(*shown),
        "growth_by_amplitude": lambda: ss.figures.growth_by_amplitude(shown[2]),
    }
    for name, draw in figures.items():
        path = PICTURES / f"{name}.png"
        style.save(draw(), path)
        shrink(path, path)
    return [("bursts", "bursts.png"), ("growth_by_amplitude", "growth_by_amplitude.png")]


def run_bursts():
    """Return a free run at a push of 0.0061, the equilibrium from which it starts, and its normal form."""
    unit, law = 1 / 2000, ss.laws.for_pair(ss.laws.hertz_mindlin(mu=10.0, coulomb="smooth"), 0, 1)
    state = ss.packings.disk_array(10, press=0.1 * unit)
    for push in (*np.arange(0, 0.006, 5e-4), 0.0061):
        state, _ = ss.relax(ss.packings.with_push(state, push * unit), law, tolerance=1e-13)
    moving = ss.packings.perturbed(state, velocity=1e-9, seed=1)
    _, record, _ = ss.run(moving, law, steps=300_000, dt=0.2, every=20, probes=range(10))
    return record, state, ss.modes.birth_form(state, law)


def draw_fit() -> list[tuple[str, str]]:
    """Draw fits of both laws to a record computed with one of them."""
    slid, experiment = simulate_example("rate-state", SHOWN["rate-state"][1])
    with tempfile.TemporaryDirectory() as folder:
        records = [path for path in write_result(Path(folder), experiment, slid) if path.suffix == ".csv"]
        fit = Path(folder) / "fit"
        found = fit_record(
            records[0], laws=("aging", "slip"), stiffness=slid.scenario.spring.stiffness, free_stiffness=False,
            v0=None, before=None, detrend=False, normal=False, out=fit, overwrite=False,
        )  # fmt: skip
        (picture,) = [path for path in write(fit, found) if path.suffix == ".png"]
        shrink(picture, PICTURES / "fit.png")
    return [("fitted", "fit.png")]


def unstable_state(result):
    """Return the state of the first packing with one complex pair (or its last state), and the law."""
    return next(path.single or path.last for path in result.paths if path is not None), result.law


def write_page(sections: dict[str, list[tuple[str, str]]]) -> None:
    """Write the page."""
    text = [
        "# Gallery", "",
        "Every figure function takes a result, or measures of it, and returns a matplotlib Figure:",
        "`ss.figures.NAME(…)`. Colours are those of Okabe and Ito and of viridis; a column is 86 mm wide.",
        "`python docs/gallery.py` draws all figures on this page from `examples/`;",
        "`stickslip run EXAMPLE --out FOLDER` writes those of one example.", "",
    ]  # fmt: skip
    examples = {heading: example for heading, example, _ in SHOWN.values()}
    for heading, pictures in sections.items():
        text += [f"## {heading}", ""]
        if heading in examples:
            text += ["```python", f'result = ss.simulate(ss.read_scenario("examples/{examples[heading]}"))', "```", ""]
        for function, file in pictures:
            drawn = getattr(ss.figures, function)
            caption = inspect.getdoc(drawn).splitlines()[0]
            text += [f"![{caption}](figures/gallery/{file})", "", f"*{caption}*", "", f"`{_call(function, drawn)}`", ""]
    PAGE.write_text("\n".join(text).rstrip() + "\n", encoding="utf-8")


def _call(name: str, function) -> str:
    """Return a call of a figure function with its required arguments."""
    needed = [one.name for one in inspect.signature(function).parameters.values() if one.default is one.empty]
    return f"ss.figures.{name}({', '.join(needed)})"


def known_sections() -> dict[str, list[tuple[str, str]]]:
    """Return headings of the present page with functions and files of its pictures."""
    found: dict[str, list[tuple[str, str]]] = {}
    heading, files = "", []
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            heading = line[3:]
            found[heading] = []
        files += re.findall(r"figures/gallery/([\w.-]+\.png)", line)
        names = re.findall(r"`ss\.figures\.(\w+)", line) if heading else []
        found.get(heading, []).extend((name, "") for name in names)
    flat = iter(files)
    return {heading: [(name, next(flat)) for name, _ in rows] for heading, rows in found.items()}


def main(wanted: list[str]) -> None:
    """Draw the given examples, or all."""
    if wanted == ["--page"]:
        return write_page(known_sections())
    if not wanted and PICTURES.is_dir():
        shutil.rmtree(PICTURES)
    PICTURES.mkdir(parents=True, exist_ok=True)
    sections = {}
    if not wanted or "bursts" in wanted:
        sections["Bursts after an instability"] = draw_bursts()
    for name, (heading, *_) in SHOWN.items():
        if wanted and name not in wanted:
            continue
        print(f"{heading} …", flush=True)
        sections[heading] = draw_example(name)
    if wanted:
        return None
    sections["Fits"] = draw_fit()
    return write_page({"Packings": draw_packings()} | sections)


if __name__ == "__main__":
    main(sys.argv[1:])
