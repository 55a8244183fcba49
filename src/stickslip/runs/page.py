"""Pages and movies of a run or a packing; a page is one self-contained file."""

import json
import shlex
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .. import __version__
from ..core.contacts.neighbors import with_neighbor_list
from ..core.progress import Report, silent
from ..core.reading import read_arrays
from ..core.units import in_readable_units, unit_name, with_unit
from ..data import archive
from ..data.checkpoint import UNFINISHED
from ..data.exchange.arrays import read_archive
from ..data.exchange.files import capture_warnings
from ..data.exchange.frame import Frame, frame_of
from ..data.exchange.lammps_folder import is_run_folder
from ..data.exchange.motion import mode_frames, read_mode
from ..data.law_file import check_law_files, trust_law_files
from ..data.run_files import CHART, CLAIMS, FILM, NUMBERS, resume_command
from ..data.sample import PackingError
from ..experiments.registry import list_files
from ..figures import animation as film
from ..figures import page
from ..figures import view3d as scene
from ..figures.between import frames_between
from ..figures.grains import bare_frame, packing
from ..figures.quantities import DISPLACEMENT
from ..figures.saving import render
from ..loading.reading import read_packing
from ..reports import claims as claims_table
from ..reports.output_file import staged_file
from ..reports.packing import Settling, describe_law, find_birth_form, growing_modes, let_settle, likely_causes, verdict
from ..solve.balance import BALANCED_BELOW, imbalance, no_equilibrium_message
from ..solve.stability import DENSE_UP_TO, stability
from .sweep.cycles import FIGURE as CYCLES
from .sweep.dataset import DATASET, is_sweep, open_sweep

SMALL = 500  # grains up to which the states of a run are searched for an unstable one
SEARCHED = 30_000  # coordinates up to which the verdict takes about a minute, and is sought without being asked for
DRAWN = 2000  # grains up to which a packing is also drawn as a figure
MODES = 6  # modes that a page animates
REMEDY = "Give the missing data, or settle the packing with --settle"
READABLE = {  # names of quantities that are not understood by themselves
    "unbalanced": "mean unbalanced force over mean contact force",
    "coordination": "contacts per grain, without rattlers",
    "kinetic_ratio": "kinetic over elastic energy",
    "msd": "mean-square displacement",
}
ROWS = 60  # of a table of measures or members; the number of omitted rows is shown


class PageContent(NamedTuple):
    """Content of the page for a run or a packing."""

    title: str
    about: str
    frames: list[Frame]
    labels: list[str]
    at: int  # index of the frame that `modes` belong to
    modes: list  # translation, rotation, exponent of each, the fastest first
    sections: list[tuple[str, str]]  # heading and HTML, without the view
    without: str = ""  # reason why there is no view in three dimensions
    warning: str = ""  # prominent warning: there is no equilibrium, or the packing was settled
    unjudged: str = ""  # reason why no mode of the frame `at` is an instability: its forces do not balance
    verdict: str = ""  # sentence on the stability of a packing, if it was computed and can be judged
    stages: tuple[str, ...] = ()  # of a run with stages, for each frame
    source: str = "file"  # whose units are those of the frames


def load_content(
    place: Path, *, modes: Path | None, options: dict, settle: bool = False, dashpots: bool = True,
    report: Report = silent,
    search: bool | None = True, trust: bool = False,
) -> PageContent:  # fmt: skip
    """Load the content for a folder or packing file; `options` are those of `read_packing`, or `frame` for a folder.

    With `trust`, the law file of a run may be executed.
    """
    if not is_run(place) and (place.is_dir() or place.is_file() or place.suffix):
        return packing_content(
            place, modes=modes, options=options, settle=settle, dashpots=dashpots, search=search, report=report
        )
    own = (*options.items(), ("modes", modes), ("settle", settle or None), ("no-dashpots", None if dashpots else True))
    given = [name for name, value in own if value is not None and name != "frame"]
    if given:
        raise ValueError(f"--{given[0].replace('_', '-')} was given with {place}: it is only for packing files")
    return folder_content(
        place, frame=options.get("frame"), search=search is not False, trust=trust, report=report
    )  # fmt: skip


def is_run(place: Path) -> bool:
    """Return True for a folder that is not the folder of a run of LAMMPS, and may be one of this package."""
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
        If there are no results or the run is not finished; the message is one sentence.
    """
    if not folder.exists():
        raise ValueError(f"{folder} does not exist: give the folder of a run, or a packing")
    if is_sweep(folder):
        return _sweep_content(folder)
    if not (folder / NUMBERS).is_file():
        if (folder / UNFINISHED).is_dir():
            raise ValueError(f"{folder} contains an unfinished run: finish it with {resume_command(folder)}")
        raise ValueError(f"{folder} contains no results: give a folder written by stickslip run or reproduce")
    about = archive.attributes(folder / NUMBERS)
    experiment = _experiment_name(about["scenario"])
    _load_law_files(about["scenario"], trust)
    states = _read_states(folder / NUMBERS, frame)
    tree, units = archive.read(folder / NUMBERS), archive.units(folder / NUMBERS)
    labels = _labels(states, tree)
    states = [(name, with_neighbor_list(state), law) for name, state, law, _ in states]
    frames = [frame_of(state, law) if law is not None else bare_frame(state) for _, state, law in states]
    at, modes, why = _find_unstable(states, frame, report) if search else (0, [], "")
    sections = []
    if (folder / CLAIMS).is_file():
        chart = folder / CHART
        picture = page.pictures({"deviations from the paper": chart.read_bytes()}) if chart.is_file() else ""
        sections.append(("Claims of the paper", picture + _claims_table(folder / CLAIMS)))
    if rows := _list_measures(tree, units):
        sections.append(("Measures", _limited_table(["measure", "value", "unit"], rows)))
    if remarks := tree.get("remarks"):
        sections.append(("Remarks", "".join(map(page.paragraph, remarks.splitlines()))))
    if rows := _summarize_series(tree.get("series"), units):
        sections.append(("Time series", _limited_table(["quantity", "final", "least", "greatest", "unit"], rows)))
    shown = [path for path in list_files(folder) if path.suffix in (".png", ".gif") and path.name not in (FILM, CHART)]
    if shown:
        sections.append(("Figures", page.pictures({_caption(path): path.read_bytes() for path in shown})))
    sections.append(("Scenario", _scenario_table(about["scenario"])))
    versions = f"stickslip {about['stickslip']}, {about['versions']}"
    without = "" if frames else "This run saved no grain states, so there is no packing to show."
    title = f"{experiment}: {folder.resolve().name}"
    sentence = f"unstable ({labels[at]}): {_describe_growth(modes[0][2])}" if modes else ""
    return PageContent(
        title, versions, frames, labels, at, modes, sections, without, why, why, sentence,
        tuple(_stage_of(frame.state.time, _stages(tree)) for frame in frames), "scenario",
    )  # fmt: skip


def _caption(path: Path) -> str:
    return path.stem.partition("_")[2].replace("_", " ") if path.stem.startswith("fig") else path.stem


def _load_law_files(text: str, trust: bool) -> None:
    """Load the law file that a run used, because states in the archive can be read only with their law."""
    try:
        tables = dict(json.loads(text))
    except (ValueError, TypeError, RecursionError):
        return
    if trust:
        trust_law_files(tables)
    check_law_files(tables)


def _experiment_name(text: str) -> str:
    try:
        return str(json.loads(text)["experiment"])
    except (ValueError, KeyError, TypeError):
        return "run"


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


def _labels(states: list, tree: dict) -> list[str]:
    """Label each state by its stage and time, or by its load if time does not advance."""
    stages = _stages(tree)
    advances = len({state.time for _, state, *_ in states}) > 1
    return [_label(name.rpartition("/")[2], state.time, stages, advances) for name, state, *_ in states]


def _stages(tree: dict) -> list[dict]:
    return [stage for stage in tree.get("stages", {}).values() if isinstance(stage, dict) and "start" in stage]


def _stage_of(time: float, stages: list[dict]) -> str:
    """Name of the stage at a time; of two stages, the earlier one."""
    return next((stage["name"] for stage in stages if stage["start"] <= time <= stage["end"]), "")


def _label(name: str, time: float, stages: list[dict], advances: bool) -> str:
    if not advances:
        return name
    stage = _stage_of(time, stages)
    return (f"{stage}, " if stage else "") + f"time {with_unit(f'{time:.4g}', 'time')}, frame {name}"


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
    known = {name: measure for name, measure in saved.items() if np.isfinite(measure["value"])}
    shown = {name: in_readable_units([measure["value"]], measure["unit"]) for name, measure in known.items()}
    return [[_readable(name), f"{value:.5g}", unit] for name, ((value,), unit) in shown.items()]


def _readable(name: str) -> str:
    return READABLE.get(name, name.replace("_", " ").replace("@", " at "))


def _scenario_table(text: str) -> str:
    """Collapsible table of a scenario with dotted keys; keys without a value are omitted."""
    try:
        tables = json.loads(text)
    except ValueError:
        return page.folded("as text", page.listing(text))
    rows = [[key, value] for key, value in _flat(tables) if value not in ("null", "[]", "{}")]
    return page.folded(f"{len(rows)} keys", page.table(["key", "value"], rows))


def _flat(tree, above: str = ""):
    """Yield dotted keys and values as JSON; lists of tables are numbered from 1."""
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
    """Return the last, least and greatest values of each time series, which has as many values as there are times."""
    rows, series = [], series if isinstance(series, dict) else {}
    shape = np.shape(series.get("time", next(iter(series.values()), ())))[:1]
    for name, values in series.items():
        varies = np.shape(values) == shape and values.dtype.kind == "f" and name != "time"
        known = values[np.isfinite(values)] if varies else ()
        if len(known):
            numbers, unit = in_readable_units((known[-1], known.min(), known.max()), units.get(f"series/{name}", ""))
            rows.append([_readable(name), *(f"{v:.5g}" for v in numbers), unit])
    return rows


def _limited_table(columns: list[str], rows: list[list[str]]) -> str:
    text = page.table(columns, rows[:ROWS], classes=dict.fromkeys(columns[1:-1], "number"))
    return text + (page.paragraph(f"and {len(rows) - ROWS} more in {NUMBERS}", kind="soft") if len(rows) > ROWS else "")


def _sweep_content(folder: Path) -> PageContent:
    data = open_sweep(folder)
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
    text = page.table(columns, rows[:ROWS])
    if len(rows) > ROWS:
        text += page.paragraph(f"and {len(rows) - ROWS} more in {DATASET}", kind="soft")
    if empty:
        text += page.paragraph(f"No member has {', '.join(map(_readable, empty))}.", kind="soft")
    member = shlex.quote(str(folder / "members" / "NAME"))
    without = f"A sweep has no packing: show that of a member with stickslip report {member}."
    text += page.paragraph(without, kind="soft")
    figures = (
        [("Cycles", page.pictures({"cycles": (folder / CYCLES).read_bytes()}))] if (folder / CYCLES).is_file() else []
    )
    sections = [*figures, ("Members", text), ("Scenario", _scenario_table(data.attrs["sweep"]))]
    about = str(data.attrs.get("source", ""))
    return PageContent(
        f"{data.attrs['title']}: {folder.resolve().name}", about, [], [], 0, [], sections, without=without
    )


def packing_content(
    file: Path, *, modes: Path | None = None, method: str = "auto", options: dict, settle: bool = False,
    dashpots: bool = True, search: bool | None = True, report: Report = silent,
) -> PageContent:  # fmt: skip
    """Load a packing file with `read_packing`, together with its verdict and modes.

    Parameters
    ----------
    modes : file written by `stickslip stability`; without it, the verdict is computed
    options : options of `read_packing`
    settle : if True, the packing is settled first
    dashpots : if False, dashpots of the law are left out
    search : if False and no file of modes is given, no verdict and no modes are computed; None: if that takes minutes
    """
    (state, law, notes), warnings = capture_warnings(read_packing, file, **options)
    notes, calm = [*notes, *warnings], None
    if settle:
        state, calm = let_settle(state, law)
        notes.append(f"settled: {calm.how}")
    n, facts = len(state.grains.radius), []
    why, warning, sentence = "", str(calm) if calm else "", ""
    large = search is None and n * (3 if state.cell.dim == 2 else 6) > SEARCHED
    if modes is None and search is not False and not large:
        try:
            result = stability(state, law, method=method, dashpots=dashpots, report=report)
        except ArithmeticError as problem:
            raise RuntimeError(f"the spectrum could not be computed ({problem}): give --modes") from None
        # modes of a packing that is not in equilibrium are no instabilities, so none is shown
        mine, facts = growing_modes(result)[:MODES] if result.balanced else [], _verdict_rows(result, calm, notes)
        if result.balanced:
            sentence = verdict(result, calm, notes)
            if mine and len(result.free) <= DENSE_UP_TO:
                form = find_birth_form(state, law, dashpots=dashpots)
                facts.append(["after the instability", form if isinstance(form, str) else form.verdict])
        else:
            why = verdict(result, None, notes)
            warning = f"{why}. Likely causes: {'; '.join(likely_causes(result, options, notes))}. {REMEDY}."
    else:
        mine = _read_modes(modes, n) if modes else []
        notes += [] if modes else ["the spectrum was not computed, so there is no verdict"]
        if large and not modes:
            warning = f"no verdict was sought, which takes minutes for {n} grains: add --verdict. {warning}".strip()
        if not (rest := imbalance(state, law)) <= BALANCED_BELOW:
            why = warning = no_equilibrium_message(rest)
    frame = frame_of(state, law)
    facts = [["grains", str(n)], ["contacts", str(len(frame.contacts["i"]))], *facts, ["law", describe_law(law, state)]]
    facts += [["note", line] for line in notes]
    sections = [("Packing", page.table(["", "value"], facts))]
    if mine:
        sections.append(("Modes out of equilibrium: no verdict" if why else "Growing modes", _mode_table(mine)))
    if n <= DRAWN:
        drawn, caption = packing(state, law, mode=mine[0] if mine else None), "contacts"
        caption += ", and the fastest mode" if mine else ""
        sections.append(("Figure", page.pictures({caption: render(drawn)})))
    about = f"stickslip {__version__}, {archive.versions()}"
    return PageContent(
        file.name, about, [frame], [""], 0, mine, sections, warning=warning, unjudged=why, verdict=sentence
    )


def _read_modes(path: Path, n: int) -> list:
    first = read_mode(path, 0, n)  # checks the file
    count = len(read_arrays(path, remedy="write the modes again", names=("exponent",))["exponent"])
    return [first, *(read_mode(path, k, n) for k in range(1, min(MODES, count)))]


def _verdict_rows(result, calm: Settling | None, notes: list[str]) -> list[list[str]]:
    out = [["verdict", verdict(result, calm, notes)], ["method", result.way], ["rattlers", str(len(result.rattlers))]]
    out += [["without the dashpots", result.undamped.motion]] if result.undamped else []
    limit = f"at most {BALANCED_BELOW:g} in equilibrium"
    out.append(["residual", f"{result.residual:.2g} of the mean contact force; {limit}"])
    if result.grows and not result.balanced:
        out.append(["spectrum of the initial motion, no verdict", result.motion])
    return out + ([["scope", result.scope]] if result.scope else [])


def _mode_table(modes: list) -> str:
    rows = []
    for k, (*_, s) in enumerate(modes):
        period = f"{2 * np.pi / abs(s.imag):.5g}" if s.imag else "–"
        rows.append([str(k), f"{s.real:.5g}", f"{abs(s.imag):.5g}", period, f"{1 / s.real:.5g}" if s.real > 0 else "–"])
    kinds = {"growth rate": "1/time", "ω": "1/time", "period": "time", "e-folding time": "time"}
    columns = ["mode", *(f"{name} [{unit_name(unit)}]" for name, unit in kinds.items())]
    return page.table(columns, rows, classes=dict.fromkeys(columns, "number"))


def write_page(shown: PageContent, path: Path, *, colour: str | None = None) -> None:
    """Write the page."""
    view = ""
    if shown.frames:
        inside = scene.page_view(
            shown.frames, shown.modes, at=shown.at, labels=shown.labels, colour=colour
        )  # fmt: skip
        view = page.paragraph(_describe_view(shown))
        view += page.embedded_document(inside, "the packing in three dimensions")
        view += page.paragraph(HELP, kind="soft")
    warning = shown.warning[:1].upper() + shown.warning[1:]
    view = (page.paragraph(warning, kind="warning") if warning else "") + view
    if shown.verdict:
        view = page.paragraph(shown.verdict[:1].upper() + shown.verdict[1:] + ".", kind="verdict") + view
    first = [("View", view)] if view else []
    text = page.page(shown.title, shown.about, [*first, *shown.sections])
    with staged_file(path) as part:
        part.write_bytes(text.encode())


def _describe_view(shown: PageContent) -> str:
    """Sentences that describe the view."""
    several = len(shown.frames) > 1
    sentences = []
    if shown.modes:
        which = f" of the state at {shown.labels[shown.at]}" if several else ""
        sentences.append(f"The view shows the fastest-growing mode{which}, enlarged so that it can be seen.")
    elif several:
        sentences.append("The view shows the run from its beginning: press play, or move the slider.")
    else:
        sentences.append("The view shows the packing.")
    sentences.append("Lines are contacts, wider for larger forces; blue ones stick, vermilion ones slide.")
    return " ".join(sentences)


HELP = (
    "Drag to rotate, scroll or pinch to zoom, drag with the right button to pan. Contacts across periodic boundaries "
    "extend out of the cell to the image of their second grain. Rotations are not drawn."
)


def _describe_growth(s: complex) -> str:
    """Describe the growth rate and the period of a motion exp(s t)."""
    growth = (
        with_unit(f"grows by a factor of e in {1 / s.real:.4g}", "time")
        if s.real > 0
        else with_unit(f"growth rate {s.real:.3g}", "1/time")
    )
    return f"{with_unit(f'period {2 * np.pi / abs(s.imag):.4g}', 'time')}, {growth}" if s.imag else growth


def _run_frames(shown: PageContent, count: int, whole: bool) -> tuple[list[Frame], list[str]]:
    """Frames and labels of the movie of a run, from the first state of its last stage or of the run."""
    # the state with which the last stage begins
    first = 0 if whole else max((k for k, name in enumerate(shown.stages) if name != shown.stages[-1]), default=0)
    stored = shown.frames[first:]
    frames = frames_between(stored, count)
    times = [frame.state.time for frame in stored]
    if min(np.diff(times), default=0) <= 0:  # a load path: time does not advance
        at = first + np.linspace(0, len(stored) - 1, count).round().astype(int)
        return frames, [shown.labels[k] for k in at]
    out = []
    for t in (frame.state.time for frame in frames):  # the first state of a stage is the last of the one before
        stage = (
            shown.stages[first + min(max(1, int(np.searchsorted(times, t))), len(times) - 1)] if shown.stages else ""
        )
        time = with_unit(f"time {t:.4g}", "time", unnamed=f"in units of the {shown.source}")
        out.append((f"{stage}, " if stage else "") + time)
    return frames, out


def write_movie(
    shown: PageContent, path: Path, *, colour: str | None = None, fps: int = film.FPS, count: int = 48,
    amplitude: float = 0.3, mode: int | None = None, whole: bool = False, report: Report = silent,
) -> Path:  # fmt: skip
    """Write the frames of a run, or one period of a mode, as a GIF or MP4.

    Parameters
    ----------
    colour : one of `quantities`; by default the speed for a run and the displacement for a mode
    mode : number of a mode; None shows the frames of a run, or the first mode if there is only one frame
    fps : frames per second
    count, amplitude : number of frames in one period of a mode, and its amplitude; see `mode_frames`
    whole : True to show all stages of a run, instead of the last
    """
    if not shown.frames:
        raise ValueError(f"there are no frames for a movie: {shown.without}")
    if mode is None and len(shown.frames) == 1:
        mode = 0
    if mode is None:
        frames, labels = _run_frames(shown, round(fps * film.SECONDS), whole)
        chosen = None
    else:
        if not 0 <= mode < len(shown.modes):
            has = f"has 0 to {len(shown.modes) - 1}" if shown.modes else "is stable or has no growing mode"
            if not (shown.modes or shown.verdict or shown.unjudged):
                has = "was not searched for modes"
            if shown.unjudged:
                has = f"is {shown.unjudged}; {REMEDY.lower()}"
            elif shown.warning:
                has += f" ({shown.warning})"
            raise ValueError(f"there is no mode {mode}: {shown.title} {has}")
        chosen = shown.modes[mode]
        frames = mode_frames(shown.frames[shown.at], *chosen, count=count, amplitude=amplitude)
        note = "; NOT IN EQUILIBRIUM" if shown.unjudged else "; settled packing" if shown.warning else ""
        labels = [f"mode {mode}, enlarged: {_describe_growth(chosen[2])}{note}"] * len(frames)
    colour = colour or ("speed" if mode is None else DISPLACEMENT)
    with staged_file(path) as part:
        film.movie(frames, part, labels=labels, mode=chosen, colour=colour, fps=fps, report=report)
    return path
