"""Pages that show a run folder or sweep: claims, measures, series, figures, scenario, and states."""

import json
import shlex
from collections import Counter
from pathlib import Path

import numpy as np

from ..core.contacts.neighbors import with_neighbor_list
from ..core.progress import Report, silent
from ..core.units import in_readable_units, with_unit
from ..data import archive
from ..data.exchange.arrays import read_archive
from ..data.exchange.frame import frame_of
from ..data.exchange.lammps_folder import is_run_folder
from ..data.law_schema import check_law_files, trust_law_files
from ..data.run_files import CHART, CLAIMS, FILM, NUMBERS, UNFINISHED, resume_command
from ..data.sample import PackingError
from ..experiments.registry import list_files
from ..figures import page
from ..figures.grains import bare_frame
from ..figures.scene import Zoom
from ..reports import claims as claims_table
from ..reports.packing import growing_modes
from ..reports.page import MODES, PageContent, describe_growth, packing_content
from ..solve.balance import BALANCED_BELOW, imbalance, no_equilibrium_message
from ..solve.stability import stability
from .sweep.dataset import DATASET, comparison_files, is_sweep, open_sweep
from .sweep.run import describe_empty

SMALL = 500  # number of grains up to which the states of a run are searched for an unstable one
READABLE = {  # explanations of quantities with short names
    "unbalanced": "mean unbalanced force over mean contact force",
    "coordination": "contacts per grain, without rattlers",
    "kinetic_ratio": "kinetic over elastic energy",
    "msd": "mean-square displacement",
}


def load_content(
    place: Path, *, modes: Path | None, options: dict, settle: bool = False, dashpots: bool = True,
    report: Report = silent,
    search: bool | None = True, trust: bool = False, zoom: Zoom = 1.0,
) -> PageContent:  # fmt: skip
    """Load the content for a folder or packing file; `options` are those of `read_packing`, or `frame` for a folder.

    With `trust`, the law file may be executed; `zoom` applies to figures of a packing.
    """
    if not is_run(place) and (place.is_dir() or place.is_file() or place.suffix):
        return packing_content(
            place, modes=modes, options=options, settle=settle, dashpots=dashpots, search=search, zoom=zoom,
            report=report,
        )  # fmt: skip
    own = (*options.items(), ("modes", modes), ("settle", settle or None), ("no-dashpots", None if dashpots else True))
    given = [name for name, value in own if value is not None and name != "frame"]
    if given:
        raise ValueError(f"--{given[0].replace('_', '-')} applies to packing files only, not to {place}")
    return folder_content(
        place, frame=options.get("frame"), search=search is not False, trust=trust, report=report
    )  # fmt: skip


def is_run(place: Path) -> bool:
    """Return True for a folder that is not a LAMMPS run folder, and may be a run folder of this package."""
    return place.is_dir() and ((place / NUMBERS).exists() or not is_run_folder(place))


def folder_content(
    folder: Path, *, frame: str | None = None, search: bool = True, trust: bool = False, report: Report = silent
) -> PageContent:
    """Load the content for the folder of a finished run or sweep.

    Parameters
    ----------
    frame : name of the state whose modes are shown. Without it, the state with the fastest-growing mode is selected if
        there are at most `SMALL` grains
    search : if False, no modes are computed
    trust : True if the law file of the run may be executed
    report : called as report(stage, share done, text)

    Raises
    ------
    ValueError
        If there are no results or the run is not finished.
    """
    if not folder.exists():
        raise ValueError(f"{folder} does not exist: give a run folder, or a packing")
    if is_sweep(folder):
        return _sweep_content(folder)
    if not (folder / NUMBERS).is_file():
        if (folder / UNFINISHED).is_dir():
            raise ValueError(f"{folder} contains an unfinished run: finish it with {resume_command(folder)}")
        raise ValueError(f"{folder} contains no results: give a folder written by stickslip run or reproduce")
    about = archive.attributes(folder / NUMBERS)
    tables = _parse_tables(about["scenario"])
    if trust:
        trust_law_files(tables)
    check_law_files(tables)  # states can be read only with their law
    states = _read_states(folder / NUMBERS, frame)
    tree, units = archive.read(folder / NUMBERS), archive.units(folder / NUMBERS)
    times = [state.time for _, state, *_ in states]
    stages = tuple(_stage_of(time, tree.get("stages", {})) for time in times)
    labels = [name.rpartition("/")[2] for name, *_ in states]
    if len(set(times)) > 1:  # states of a load path have the same time and are labelled by their loads
        shown_times = [with_unit(f"{time:.4g}", "time") for time in times]
        labels = [
            f"{stage and f'{stage}, '}time {time}, frame {name}"
            for name, time, stage in zip(labels, shown_times, stages, strict=True)
        ]
    states = [(name, with_neighbor_list(state), law) for name, state, law, _ in states]
    frames = [frame_of(state, law) if law is not None else bare_frame(state) for _, state, law in states]
    at, modes, why = _find_unstable(states, frame, report) if search else (0, [], "")
    sections = []
    if (folder / CLAIMS).is_file():
        chart = folder / CHART
        picture = page.pictures({"deviations from the paper": chart.read_bytes()}) if chart.is_file() else ""
        sections.append(("Claims of the paper", picture + _claims_table(folder / CLAIMS)))
    if rows := _list_measures(tree, units):
        sections.append(("Measures", _numbers_table(["measure", "value", "unit"], rows)))
    if remarks := tree.get("remarks"):
        sections.append(("Remarks", "".join(map(page.paragraph, remarks.splitlines()))))
    if len((events := tree.get("events", {})).get("start", ())):
        sections.append(("Events", _events_table(events, units)))
    if rows := _summarize_series(tree.get("series"), units):
        sections.append(("Time series", _numbers_table(["quantity", "final", "least", "greatest", "unit"], rows)))
    shown = [path for path in list_files(folder) if path.suffix in (".png", ".gif") and path.name not in (FILM, CHART)]
    if shown:
        names = {path: path.stem.partition("_")[2].replace("_", " ") for path in shown if path.stem.startswith("fig")}
        pictures = {names.get(path, path.stem): path.read_bytes() for path in shown}
        sections.append(("Figures", page.pictures(pictures)))
    sections.append(("Scenario", _scenario_table(about["scenario"])))
    versions = f"stickslip {about['stickslip']}, {about['versions']}"
    without = "" if frames else "This run saved no grain states, so there is no packing to show."
    title = f"{tables.get('experiment', 'run')}: {folder.resolve().name}"
    sentence = f"unstable ({labels[at]}): {describe_growth(modes[0][2])}" if modes else ""
    return PageContent(
        title, versions, frames, labels, at, modes, sections, without, why, why, sentence, stages, "scenario",
    )  # fmt: skip


def _parse_tables(text: str) -> dict:
    """Return the tables of a scenario; empty if its text is damaged."""
    try:
        return dict(json.loads(text))
    except (ValueError, TypeError, RecursionError):
        return {}


def _read_states(path: Path, frame: str | None) -> list:
    """Read the states of one group: the largest one, or the one that contains the requested frame."""
    try:
        frames = [(entry.name, entry.state, entry.law, entry.notes) for entry in read_archive(path, "all")]
    except PackingError:
        return []
    groups = Counter(name.rpartition("/")[0] for name, *_ in frames)
    if frame is not None:
        full = [name for name, *_ in frames if frame in (name, name.rpartition("/")[2])]
        if not full:
            some = ", ".join(name for name, *_ in frames[:4]) + (" …" if len(frames) > 4 else "")
            raise ValueError(f"there is no frame {frame!r} in {path}: use {some}")
        group = full[0].rpartition("/")[0]
    else:
        group = max(groups, key=lambda name: groups[name])
    mine = [item for item in frames if item[0].rpartition("/")[0] == group]
    size = Counter(len(item[1].grains.radius) for item in mine).most_common(1)[0][0]
    mine = [item for item in mine if len(item[1].grains.radius) == size]
    return mine if np.ptp([item[1].time for item in mine]) == 0 else sorted(mine, key=lambda item: item[1].time)


def _stage_of(time: float, stages: dict) -> str:
    """Name of the stage at a time; where two stages meet, the earlier one."""
    known = (stage for stage in stages.values() if isinstance(stage, dict) and "start" in stage)
    return next((stage["name"] for stage in known if stage["start"] <= time <= stage["end"]), "")


def _find_unstable(states: list, frame: str | None, report) -> tuple[int, list, str]:
    """Find the state with the fastest-growing mode.

    Returns its index, its modes, and, if the requested state is not in equilibrium and so has no modes, the reason.
    """
    best, at, modes, why = 0.0, 0, [], ""
    for k, (name, state, law) in enumerate(states):
        asked = frame is not None and frame in (name, name.rpartition("/")[2])
        at = k if asked else at
        if law is None or (frame is not None and not asked) or (not asked and len(state.grains.radius) > SMALL):
            continue
        report("unstable modes", k / len(states), name)
        try:
            if not (rest := imbalance(state, law)) <= BALANCED_BELOW:
                why = f"{name}: {no_equilibrium_message(rest)}" if asked else why
                continue
            mine = growing_modes(stability(state, law))
        except (ValueError, ArithmeticError):  # only rattlers, or an eigenvalue problem without a solution
            continue
        if mine and max(s.real for *_, s in mine) > best:
            best, at, modes = max(s.real for *_, s in mine), k, mine[:MODES]
    return at, modes, why


def _claims_table(path: Path) -> str:
    try:
        claims = [claims_table.Claim(**row) for row in json.loads(path.read_text(encoding="utf-8"))]
    except (ValueError, TypeError):
        raise ValueError(f"{path} is damaged: run again with --overwrite") from None
    shown = claims_table.format_value
    rows = [
        [c.id.replace("_", " "), c.source, shown(c.paper), shown(c.reference), claims_table.format_measured(c), c.unit,
         c.verdict, c.note]
        for c in claims
    ]  # fmt: skip
    kinds = {"paper": "number", "reference": "number", "measured": "number", "verdict": "verdict", "note": "note"}
    return page.table(["claim", "source", *list(kinds)[:3], "unit", "verdict", "note"], rows, classes=kinds)


def _list_measures(tree: dict, units: dict[str, str]) -> list[list[str]]:
    """List the measures of a run with their units; for archives from earlier versions, all scalars outside states."""
    if not isinstance(saved := tree.get("measures"), dict):
        return _list_scalars(tree, units)
    finite = {name: measure for name, measure in saved.items() if np.isfinite(measure["value"])}
    shown = {name: in_readable_units([measure["value"]], measure["unit"]) for name, measure in finite.items()}
    return [[_readable(name), f"{value:.5g}", unit] for name, ((value,), unit) in shown.items()]


def _readable(name: str) -> str:
    return READABLE.get(name, name.replace("_", " ").replace("@", " at "))


def _scenario_table(text: str) -> str:
    """Collapsible table of a scenario with dotted keys; keys without a value are omitted."""
    if not (tables := _parse_tables(text)):
        return page.folded("as text", page.listing(text))
    rows = [[key, value] for key, value in _flat(tables) if value not in ("null", "[]", "{}")]
    return page.folded(f"{len(rows)} keys", page.table(["key", "value"], rows))


def _flat(tree, above: str = ""):
    """Yield dotted keys and values as JSON; entries of lists of tables are numbered from 1."""
    tables = isinstance(tree, dict) or (isinstance(tree, list) and any(isinstance(item, dict) for item in tree))
    if not tables or not tree:
        yield above, json.dumps(tree, ensure_ascii=False)
        return
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree, start=1):
        yield from _flat(value, f"{above}.{key}" if above else str(key))


def _list_scalars(tree: dict, units: dict[str, str], above: str = "") -> list[list[str]]:
    """List the scalars of an archive outside its states, with their paths and units."""
    rows = []
    for name, value in tree.items():
        path = f"{above}{name}"
        if isinstance(value, dict):
            rows += _list_scalars(value, units, f"{path}/")
        elif isinstance(value, int | float) and not isinstance(value, bool) and np.isfinite(value):
            rows.append([path.replace("_", " ").replace("/", " › "), f"{value:.5g}", units.get(path, "")])
    return rows


def _summarize_series(series, units: dict[str, str]) -> list[list[str]]:
    """Return the last, smallest and largest values of each time series."""
    rows, series = [], series if isinstance(series, dict) else {}
    shape = np.shape(series.get("time", next(iter(series.values()), ())))[:1]
    for name, values in series.items():
        varies = np.shape(values) == shape and values.dtype.kind == "f" and name != "time"
        finite = values[np.isfinite(values)] if varies else ()
        if len(finite):
            numbers, unit = in_readable_units((finite[-1], finite.min(), finite.max()), units.get(f"series/{name}", ""))
            rows.append([_readable(name), *(f"{v:.5g}" for v in numbers), unit])
    return rows


def _numbers_table(columns: list[str], rows: list[list[str]]) -> str:
    return page.table(columns, rows, classes=dict.fromkeys(columns[1:-1], "number"), file=NUMBERS)


def _events_table(events: dict, units: dict[str, str]) -> str:
    """Table of events, one row each, with long times in years."""
    columns, cells = [], []
    for name in ("start", *(name for name in events if name not in ("start", "end"))):
        values, unit = in_readable_units(events[name], units.get(f"events/{name}", ""))
        columns.append(f"{_readable(name)} [{unit}]" if unit else _readable(name))
        cells.append([f"{value:.5g}" if isinstance(value, float) else str(value) for value in values])
    return page.table(columns, list(map(list, zip(*cells, strict=True))), file=NUMBERS)


def _sweep_content(folder: Path) -> PageContent:
    data = open_sweep(folder, short=True)
    kept = data.drop_vars([name for name in ("finished", "seconds") if name in data]).to_dataframe().reset_index()
    kept = kept[[name for name in kept.columns if name != "member"] + ["member"]]
    columns, empty = [], [name for name in kept.columns if name != "member" and kept[name].isna().all()]
    kept = kept.drop(columns=empty)
    for name in kept.columns:
        unit = data[name].attrs.get("units", "1")
        if unit == "s":
            kept[name], unit = in_readable_units(kept[name], unit)
        columns.append(str(name) if unit == "1" else f"{name} [{unit}]")
    rows = [[f"{v:.5g}" if isinstance(v, float) else str(v) for v in row] for row in kept.itertuples(index=False)]
    text = page.table(columns, rows, file=DATASET)
    if told := describe_empty(empty, _readable):
        text += page.paragraph(told, kind="soft")
    member = shlex.quote(str(folder / "members" / "NAME"))
    without = f"A sweep has no packing: show a member with stickslip report {member}."
    text += page.paragraph(without, kind="soft")
    shown = [folder / name for name in comparison_files() if name.endswith(".png") and (folder / name).is_file()]
    figures = [(path.stem.capitalize(), page.pictures({path.stem: path.read_bytes()})) for path in shown]
    sections = [*figures, ("Members", text), ("Scenario", _scenario_table(data.attrs["sweep"]))]
    about = str(data.attrs.get("source", ""))
    return PageContent(
        f"{data.attrs['title']}: {folder.resolve().name}", about, [], [], 0, [], sections, without=without
    )
