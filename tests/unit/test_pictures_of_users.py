"""Figures belong to the user: nothing of matplotlib is changed, notebooks show them, journals take their files."""

import json
import re
from base64 import b64decode
from concurrent.futures import ThreadPoolExecutor
from io import BytesIO
from itertools import islice

import matplotlib
import numpy as np
import pytest
from IPython.core.interactiveshell import InteractiveShell
from IPython.utils.capture import capture_output
from matplotlib import pyplot as plt
from PIL import Image

import stickslip as ss
from stickslip.experiments.registry import EXPERIMENTS
from stickslip.figures.style import (
    PAGE,
    WIDTH,
    Look,
    OwnFigure,
    _letter,
    column_axes,
    label_axes,
    legend_above,
    render,
    save,
    styled,
)
from stickslip.runs.folder import find_unfinished, mark_look, write_result
from tests.conftest import stickslip_here

LAW = ss.laws.hertz_mindlin()
PAIR = ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], LAW)
SHORT = {
    "experiment": "rate-state", "surface": {"a": 0.01, "b": 0.015, "dc": 1e-5, "mu0": 0.6, "v0": 1e-6},
    "spring": {"stiffness": 2e3}, "legs": [{"velocity": v, "distance": 1e-4} for v in (1e-6, 1e-5)],
    "samples": {"number": 20},
}  # fmt: skip


@styled
def two_panels():
    """Two panels, of which one has a twin, and a colour bar."""
    figure, (above, below) = column_axes(2, 3.0, sharex=True)
    x = np.linspace(0, 1, 30)
    above.plot(x, 1e-4 * x, label="words of a legend")
    figure.colorbar(below.scatter(x, x, c=x), ax=below)
    below.twinx().plot(x, x)
    label_axes(above, y="strain")
    label_axes(below, x=("time", "s"), y="other")
    legend_above(above)
    return figure


def settings():
    """Settings of matplotlib and its backend, which is chosen first if there is none: it is a setting as well."""
    backend = plt.get_backend()
    return backend, plt.get_fignums(), {name: matplotlib.rcParams._get(name) for name in matplotlib.rcParams}


@pytest.mark.parametrize("backend", ["svg", "agg", "module://matplotlib_inline.backend_inline"])
def test_drawing_changes_no_settings(backend, tmp_path):
    was = plt.get_backend()
    try:
        plt.switch_backend(backend)
        with matplotlib.rc_context({"font.size": 17, "pdf.fonttype": 3}):
            before = settings()
            figure = ss.figures.packing(PAIR, LAW)
            figure._repr_png_()
            ss.figures.save(figure, tmp_path / "a.pdf", width=178)
            ss.figures.movie([ss.io.frame_of(PAIR, LAW)] * 2, tmp_path / "a.gif", labels=["", ""])
            with pytest.raises(ValueError, match="the colour 'taste' is not available: these grains have radius"):
                ss.figures.packing(PAIR, LAW, colour="taste")
            assert settings() == before
    finally:
        plt.switch_backend(was)


def test_threads_do_not_keep_each_others_settings():
    before = settings()
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda _: two_panels(), range(6)))
    assert settings() == before


class Shell(InteractiveShell):
    """A shell that has no window to open, as that of a notebook."""

    def enable_gui(self, gui=None):
        """Nothing."""


@pytest.mark.parametrize("begin", ["", "%matplotlib inline\n"], ids=["plain", "inline"])
def test_a_notebook_shows_a_figure_once_and_plots_of_its_user(begin):
    was = plt.get_backend()
    try:
        with matplotlib.rc_context():
            shell = Shell.instance()
            shell.user_ns |= {"ss": ss, "PAIR": PAIR, "LAW": LAW}
            with capture_output() as cell:
                shell.run_cell(begin + "import stickslip; figure = ss.figures.packing(PAIR, LAW)")
            assert not cell.outputs and not cell.stderr
            bundle, _ = shell.display_formatter.format(shell.user_ns["figure"])
            content = bundle["image/png"]  # in base64 if it comes from the inline backend
            with Image.open(BytesIO(b64decode(content) if isinstance(content, str) else content)) as picture:
                assert picture.format == "PNG" and 400 < picture.width < 800
                assert len(picture.convert("RGB").getcolors(1 << 20)) > 3  # grains, not an empty sheet
            if begin:
                with capture_output() as cell:
                    shell.run_cell("import matplotlib.pyplot as plt; plt.plot([1, 2])")
                assert "image/png" in cell.outputs[0].data
    finally:
        plt.close("all")
        Shell.clear_instance()
        plt.switch_backend(was)


def test_files_have_text_and_no_date():
    """PDF with TrueType fonts, text as text in SVG."""
    pdf = render(two_panels(), "pdf")
    assert b"/Type3" not in pdf and b"/CIDFontType2" in pdf and b"/CreationDate" not in pdf
    assert b">words of a legend</text>" in render(two_panels(), "svg")


def test_a_figure_that_its_user_saves_has_truetype_fonts_as_well():
    content = BytesIO()
    two_panels().savefig(content, format="pdf")
    assert b"/Type3" not in content.getvalue()


@pytest.mark.parametrize("width, pixels, inches", [(86, 1016, WIDTH), (178, 2102, PAGE)])
def test_figures_are_one_or_two_columns_wide(width, pixels, inches):
    assert 25.4 * inches == pytest.approx(width)
    figure = two_panels()
    before = tuple(figure.get_size_inches())
    assert abs(Image.open(BytesIO(render(figure, "png", Look(width=width)))).width - pixels) <= 1
    assert tuple(figure.get_size_inches()) == before
    wide, tall = Image.open(BytesIO(render(ss.figures.packing(PAIR, LAW), "png", Look(width=width)))).size
    assert abs(wide - pixels) <= 1 and 0.4 < tall / wide < 1.0  # disks remain round: height grows as well


@pytest.mark.parametrize("draw", [two_panels, lambda: ss.figures.packing(PAIR, LAW)])
def test_slides_are_wide_and_their_type_is_large(draw):
    figure = draw()
    before = tuple(figure.get_size_inches())
    assert Image.open(BytesIO(render(figure, "png", Look(slides=True)))).size == (1920, 1080)
    pdf = render(figure, "pdf", Look(slides=True))
    wide, tall = map(float, re.search(rb"/MediaBox \[ *0 0 ([\d.]+) ([\d.]+)", pdf).groups())
    assert wide / tall == pytest.approx(16 / 9, rel=1e-3) and 8 / tall > 0.035  # type of 8 points: 19 of 540
    assert tuple(figure.get_size_inches()) == before


def letters_of(figure):
    svg = render(figure, "svg", Look(letters=True)).decode()
    return re.findall(r">\((\w+)\)</text>", svg)


def test_panels_are_lettered_and_twins_and_colour_bars_are_not():
    figure = two_panels()
    assert letters_of(figure) == ["a", "b"]
    assert not [text for axes in figure.axes for text in axes.texts]  # the figure stays as it was
    assert letters_of(ss.figures.packing(PAIR, LAW, colour="radius")) == []  # one panel
    spatial = OwnFigure()
    _ = [spatial.add_subplot(1, 2, k, projection="3d") for k in (1, 2)]
    assert letters_of(spatial) == ["a", "b"]


def test_letters_hide_nothing():
    figure = two_panels()
    letters = _letter(figure)
    figure.draw_without_rendering()
    others = [axes.get_legend() for axes in figure.axes if axes.get_legend()]
    others += [tick for axes in figure.axes for tick in axes.get_yticklabels() if tick.get_text()]
    for letter in letters:
        box = letter.get_window_extent()
        assert figure.bbox.x0 <= box.x0 and box.y1 <= figure.bbox.y1
        assert not any(box.overlaps(other.get_window_extent()) for other in others)


@pytest.mark.parametrize("words, message", [
    (["--format", "eps"], "unknown format 'eps': use png, pdf, svg"),
    (["--width", "90"], "--width must be 86 or 178 [mm], got 90"),
    (["--width", "86", "--slides"], "width 86 does not apply to slides, which are 16:9: leave out one of the two"),
])  # fmt: skip
def test_a_look_that_does_not_exist_is_refused_before_anything_is_run(words, message, tmp_path):
    (tmp_path / "s.json").write_text(json.dumps(SHORT))
    run = stickslip_here("run", "s.json", "--out", "out", *words, cwd=tmp_path)
    assert run.returncode == 2 and message in run.stderr and not (tmp_path / "out").exists()
    with pytest.raises(ValueError, match=r"must end with \.png, \.pdf or \.svg, got .*a\.eps"):
        save(two_panels(), tmp_path / "a.eps")


LOOK = ("--format", "svg", "--letters", "--width", "178")


def test_a_run_writes_figures_as_it_was_asked_to(tmp_path, monkeypatch):
    experiment = EXPERIMENTS["rate-state"]
    first = experiment._replace(figures=lambda result: islice(experiment.figures(result), 1))
    monkeypatch.setattr("stickslip.wings.faults.rate_state.EXPERIMENT", first)
    (tmp_path / "s.json").write_text(json.dumps(SHORT))
    run, out = stickslip_here("run", "s.json", "--out", "out", *LOOK, cwd=tmp_path), tmp_path / "out"
    assert run.returncode == 0, run.stderr
    assert {path.suffix for path in out.glob("fig1_history.*")} == {".png", ".svg"}
    assert Image.open(out / "fig1_history.png").width == pytest.approx(2102, abs=1)
    assert re.findall(r">\((\w)\)</text>", (out / "fig1_history.svg").read_text()) == ["a", "b", "c"]


def test_a_stopped_run_remembers_its_look(tmp_path):
    chosen, look = ss.scenario(**SHORT), Look(("png", "pdf"), 178, letters=True, slides=True)
    mark_look(tmp_path, chosen, look)
    assert find_unfinished(tmp_path).look == look
    for wrong in ('{"formats": ["eps"]}', '{"slides": 1}'):
        (tmp_path / "unfinished" / "look.json").write_text(wrong)
        with pytest.raises(ValueError, match=r"look\.json is damaged: start again with --overwrite"):
            find_unfinished(tmp_path)
    mark_look(tmp_path, chosen, Look())  # the same run, started again without options
    assert find_unfinished(tmp_path).look == Look()


@pytest.mark.slow
def test_fits_and_resumed_runs_write_figures_as_they_were_asked_to(tmp_path):
    result = ss.simulate(ss.scenario(**SHORT))
    write_result(tmp_path / "out", EXPERIMENTS["rate-state"], result)
    fit = stickslip_here("fit", "out/series.csv", "--stiffness", 2e3, "--out", "fit", *LOOK, cwd=tmp_path)
    assert fit.returncode == 0, fit.stderr
    assert {path.suffix for path in (tmp_path / "fit").iterdir()} == {".json", ".png", ".svg"}
    (tmp_path / "stopped").mkdir()
    mark_look(tmp_path / "stopped", result.scenario, Look(("png", "pdf")))
    assert stickslip_here("resume", "stopped", cwd=tmp_path).returncode == 0
    assert (tmp_path / "stopped" / "fig1_history.pdf").exists()


@pytest.mark.slow
def test_members_of_a_sweep_have_its_look(tmp_path):
    tables = SHORT | {"sweep": {"surface.a": [0.012]}}
    look = Look(("png", "svg"), letters=True)
    ss.run_sweep(ss.sweep(**tables), tmp_path, workers=1, figures=True, look=look)
    assert len(list(tmp_path.glob("members/*/fig1_history.svg"))) == 1
    assert find_unfinished(tmp_path).look == look
