"""What a report, a film and the packing figure hold, read back from what was written."""

import base64
import json
import re
import zlib
from html.parser import HTMLParser

import imageio_ffmpeg
import numpy as np
import pytest
from matplotlib import pyplot as plt
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import to_rgba
from PIL import Image

import stickslip as ss
from stickslip.core.state import SLIDE
from stickslip.core.units import Fields
from stickslip.data import archive
from stickslip.experiments.registry import EXPERIMENTS
from stickslip.figures import animation
from stickslip.figures.animation import frames_between
from stickslip.figures.grains import BALL, PIECES
from stickslip.figures.scene import quantities, up_direction, view_basis
from stickslip.figures.style import BLUE, RED
from stickslip.runs.folder import write_numbers
from tests.conftest import stickslip_here as run
from tests.exchange.packings import SHARP, disks, spheres, walled

CLAIM = {
    "id": "front_speed", "source": "Fig 5 <b>", "paper": 0.075, "measured": 0.081, "unit": "1", "tolerance": 0.25,
    "verdict": "reproduced", "note": "of 16 & more",
}  # fmt: skip
LOADS = ("src", "href", "data", "poster", "action", "srcset")


class Page(HTMLParser):
    """What a page shows, loads and embeds."""

    def __init__(self, text: str):
        super().__init__()
        self.loads, self.words, self.inner = [], [], ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.loads += [given[name] for name in LOADS if name in given]
        self.inner = given.get("srcdoc", self.inner)

    def handle_data(self, data):
        self.words.append(data)


def page(path) -> Page:
    return Page(path.read_text(encoding="utf-8"))


def view_of(shown: Page) -> dict:
    """What `view.js` is given."""
    packed = re.search(r'bytes\("([A-Za-z0-9+/=]+)"\)', shown.inner)[1]
    return json.loads(zlib.decompress(base64.b64decode(packed)))


def array(text: str, kind=np.float32) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), kind)


def swinging(n: int, seed=3):
    """A mode of n grains as `stability` would write it: translation, rotation, exponent."""
    rng = np.random.default_rng(seed)
    parts = rng.normal(size=(2, n, 3)) + 1j * rng.normal(size=(2, n, 3))
    return parts[0], parts[1], 0.01 - 1.3j


def write_modes(path, mode) -> None:
    np.savez(path, translation=mode[0][None], rotation=mode[1][None], exponent=np.array([mode[2]]))


@pytest.fixture
def folder(tmp_path):
    """The folder of a run that kept three frames of disks, with a series, a claim and a figure."""
    place = tmp_path / "my run"
    place.mkdir()
    states = [disks()._replace(time=float(k)) for k in range(3)]
    tree = {
        "law": SHARP, "frames": {f"{k:04d}": s for k, s in enumerate(states)},
        "series": Fields({"time": np.arange(3.0), "friction": np.array([0.1, 0.4, 0.3])}, time="time", friction="1"),
        "plane": {"height": 5.7},
    }  # fmt: skip
    archive.write(
        place / "results.h5", tree, scenario='{"experiment": "flow", "grains": "</pre><script>"}', version="9"
    )
    figure, axes = plt.subplots(figsize=(1, 1))
    axes.plot([0, 1])
    figure.savefig(place / "fig1_a_line.png")
    plt.close(figure)
    return place


def test_a_report_holds_all_of_a_run_and_loads_nothing(folder):
    (folder / "claims.json").write_text(json.dumps([CLAIM]))
    out = run("report", folder)
    assert out.returncode == 0, out.stderr
    shown = page(folder / "report.html")
    assert all(load.startswith("data:image/") for load in shown.loads), [load[:60] for load in shown.loads]
    assert not re.search(r"(src|href)\s*=\s*[\"']?\s*(https?:)?//", shown.inner[: shown.inner.index("k3dCompressed")])
    text = "".join(shown.words)
    for part in ("flow: my run", "front speed", "Fig 5 <b>", "0.081", "of 16 & more", "A line", '"</pre><script>"'):
        assert part in text
    assert "script" not in re.findall(r"<(\w+)", (folder / "report.html").read_text())
    (picture,) = (load for load in shown.loads)
    assert base64.b64decode(picture.partition(",")[2]) == (folder / "fig1_a_line.png").read_bytes()


def test_without_claims_a_report_shows_measures_with_units(folder):
    assert run("report", folder).returncode == 0
    shown = page(folder / "report.html").words
    at = shown.index("friction")
    assert shown[at : at + 2][0] == "friction"
    assert [w for w in shown[at : at + 10] if w.strip()][:5] == ["friction", "0.3", "0.1", "0.4", "1"]
    assert "plane › height" in shown


def test_a_flow_report_starts_with_its_first_frame_and_lists_its_physics(tmp_path):
    experiment = EXPERIMENTS["flow"]
    result = ss.simulate(ss.scenario(experiment="flow", **experiment.smallest[0]))
    write_numbers(tmp_path, experiment, result)
    assert run("report", tmp_path).returncode == 0
    shown = page(tmp_path / "report.html")
    data = view_of(shown)
    assert data["start"] == 0
    assert data["frames"][0]["label"] == "settle, time 0, frame 0000"
    (top, unit) = experiment.measures(result)["deposit_top"]
    texts = [word for word in shown.words if word.strip()]
    at = texts.index("deposit top")
    assert texts[at : at + 3] == ["deposit top", f"{top:.5g}", unit]
    assert "grains.number" in texts and texts[texts.index("grains.number") + 1] == "40"  # the folded scenario
    assert any(word.startswith("The view shows the run from its beginning") for word in texts)


def test_the_movie_of_a_run_lasts_eight_seconds_and_shows_its_last_stage(tmp_path, monkeypatch):
    """At 25 frames a second, from the state with which the stage begins; with --whole from the first."""
    states = [disks()._replace(time=float(k)) for k in range(5)]
    stages = {"00": {"name": "pour", "start": 0.0, "end": 2.0}, "01": {"name": "flow", "start": 2.0, "end": 4.0}}
    tree = {"law": SHARP, "frames": {f"{k:04d}": s for k, s in enumerate(states)}, "stages": stages}
    archive.write(tmp_path / "results.h5", tree, scenario='{"experiment": "flow"}', version="9")
    filmed = []

    def film(frames, path, **how):
        filmed.append(([frame.state.time for frame in frames], how["fps"], how["labels"]))
        path.write_bytes(b"GIF89a")

    monkeypatch.setattr("stickslip.figures.animation.movie", film)
    assert run("movie", tmp_path).returncode == run("movie", tmp_path, "--whole", "--overwrite").returncode == 0
    for (times, fps, labels), start, label in zip(filmed, (2, 0), ("flow, time 2", "pour, time 0"), strict=True):
        assert (len(times), fps, labels[0]) == (200, 25, f"{label} in units of the scenario")
        np.testing.assert_allclose(times, np.linspace(start, 4, 200), atol=1e-12)


def test_between_stored_states_grains_move_smoothly_and_contacts_fade():
    """Positions go through those stored and stay between them; a lost contact loses its force, then its line."""
    first = ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0], [1.98, 0, 0]], [0.5] * 3, SHARP)
    move = np.array([0.0, 0.2, 0.2, 0.6])
    stored = []
    for time, x in enumerate(move):
        place = first.grains.position + np.array([[0, 0, 0], [0, 0, 0], [x, 0, 0]])
        state = ss.packings.from_arrays(place, [0.5] * 3, SHARP)._replace(time=2.0 * time)
        stored.append(ss.io.frame_of(state, SHARP))
    frames = frames_between(stored, 31)
    moved = np.array([frame.state.grains.position[2, 0] - 1.98 for frame in frames])
    np.testing.assert_allclose([frame.state.time for frame in frames], np.linspace(0, 6, 31))
    np.testing.assert_allclose(moved[::10], move, atol=1e-12)
    assert (np.diff(moved) >= -1e-12).all() and moved.max() < 0.6 + 1e-12  # no overshoot where it rests
    assert np.abs(np.diff(moved, 2)).max() < 0.02  # 30 steps of a smooth curve; linear ones turn by 0.04 at 4
    for frame in frames:
        c = frame.contacts
        rows = {(int(i), int(j)): k for k, (i, j) in enumerate(zip(c["i"], c["j"], strict=True))}
        place = frame.state.grains.position
        for (i, j), k in rows.items():
            np.testing.assert_allclose(c["branch"][k], place[i] - place[j], atol=1e-12)
        assert c["force_n"][rows[0, 1]] == pytest.approx(stored[0].contacts["force_n"][0])  # in all stored frames
        apart = frame.state.grains.position[2, 0] - 0.99
        assert ((1, 2) in rows) == (apart <= 1.02 * 0.99 and frame.state.time < 2)
        if (1, 2) in rows:
            assert c["force_n"][rows[1, 2]] <= stored[0].contacts["force_n"][1] * (1 - frame.state.time / 2) + 1e-15


def test_the_view_holds_grains_contacts_and_frames(folder):
    assert run("report", folder, "--colour", "pressure").returncode == 0
    data, state = view_of(page(folder / "report.html")), disks()
    assert [frame["label"] for frame in data["frames"]] == [f"time {k}, frame 000{k}" for k in range(3)]
    assert data["start"] == 0
    frame, rows = data["frames"][1], ss.measure.touching(state)
    place = ss.measure.wrapped(state)
    np.testing.assert_allclose(array(frame["position"]).reshape(-1, 3), place, atol=1e-6)  # float32
    assert array(frame["i"], np.int32).tolist() == state.contacts.i[rows].tolist()
    np.testing.assert_allclose(array(frame["branch"]).reshape(-1, 3), ss.measure.branch_vectors(state)[rows], atol=1e-6)
    assert array(frame["mode"], np.uint8).tolist() == (state.contacts.mode[rows] == SLIDE).tolist()
    assert data["quantities"][data["shown"]]["name"] == "pressure"
    fields = quantities(ss.io.frame_of(state, SHARP))
    np.testing.assert_allclose(array(frame["values"]["pressure"]), fields["pressure"][0], rtol=1e-6)


def test_the_mode_in_the_view_moves_as_the_exported_one(tmp_path):
    state = spheres()
    mode = swinging(len(state.grains.radius))
    ss.io.write_packing(tmp_path / "p.npz", state, SHARP)
    write_modes(tmp_path / "m.npz", mode)
    out = run("report", "p.npz", "--modes", "m.npz", cwd=tmp_path)
    assert out.returncode == 0, out.stderr
    shown = page(tmp_path / "p-report.html")
    data, frame = view_of(shown), ss.io.frame_of(state, SHARP)
    re_, im = (array(data["modes"][0][part]).reshape(-1, 3) for part in ("re", "im"))
    moved = ss.io.mode_frames(frame, *mode, count=8, amplitude=0.3)
    for k in (0, 2, 5):  # as view.js does: re cos + im sin
        phase = 2 * np.pi * k / 8
        shift = 0.3 * (re_ * np.cos(phase) + im * np.sin(phase))
        np.testing.assert_allclose(shift, moved[k].state.grains.position - state.grains.position, atol=1e-6)
    assert "".join(shown.words).count("e-folding time") == 1
    assert "period 4.833" in data["modes"][0]["words"]
    assert "strong network" in (tmp_path / "p-report.html").read_text()


@pytest.mark.parametrize("command", ["report", "movie"])
@pytest.mark.parametrize(
    ("make", "arguments", "said"),
    [
        (lambda p: (p / "d").mkdir(), ["d"], "d contains no results"),
        (lambda p: ((p / "d").mkdir(), (p / "d" / "cv.pdf").write_text("x")), ["d"], "d contains no results"),
        (lambda p: (p / "d" / "unfinished").mkdir(parents=True), ["d"], "stickslip resume d"),
        (lambda p: ((p / "d").mkdir(), (p / "d" / "results.h5").write_text("x")), ["d"], "is not a stickslip archive"),
        (lambda p: None, ["d"], "d does not exist"),
        (lambda p: None, ["p.npz"], "p.npz is not a file"),
        (lambda p: (p / "d").mkdir(), ["d", "--kn", "1"], "--kn applies to packing files only, not to"),
        (lambda p: (p / "d").mkdir(), ["d", "--out", "a.doc"], "--out must end with ."),
        (lambda p: (p / "d").mkdir(), ["d", "--out", "e/a.html"], ""),
    ],
)
def test_bad_input_gives_a_one_sentence_error_and_nothing_is_written(command, make, arguments, said, tmp_path):
    make(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    out = run(command, *arguments, cwd=tmp_path)
    assert out.returncode == 2
    assert said in out.stderr
    assert len(out.stderr.strip().splitlines()) == 1
    assert sorted(tmp_path.rglob("*")) == before


def test_an_unknown_colour_or_frame_gives_a_one_sentence_error(folder):
    out = run("report", folder, "--colour", "taste")
    assert out.returncode == 2
    assert "these grains have radius" in out.stderr or "these grains have " in out.stderr
    out = run("movie", folder, "--colour", "taste")
    assert (out.returncode, "taste" in out.stderr) == (2, True)
    out = run("report", folder, "--frame", "9999")
    assert (out.returncode, "frames/0000" in out.stderr) == (2, True)
    assert sorted(path.name for path in folder.iterdir()) == ["fig1_a_line.png", "results.h5"]


def test_pressures_of_grains_add_up_to_that_of_the_packing():
    for state in (spheres(), disks()):
        dim, radius = state.cell.dim, state.grains.radius
        own = np.pi * radius**2 if dim == 2 else 4 / 3 * np.pi * radius**3
        size = np.linalg.det(state.cell.vectors) if dim == 3 else np.linalg.det(state.cell.vectors[:2, :2])
        fields = quantities(ss.io.frame_of(state, SHARP))["pressure"][0]
        trace = np.trace(ss.measure.stress(state, SHARP)[:dim, :dim]) / dim
        assert fields @ own == pytest.approx(size * trace, rel=1e-10)
        assert ss.measure.pressure(state, SHARP) == pytest.approx(trace, rel=1e-12)


@pytest.mark.parametrize("make", [lambda: (spheres(), SHARP), lambda: (disks(), SHARP), walled])
def test_the_packing_figure_draws_every_grain_and_contact_once(make):
    state, law = make()
    figure = ss.figures.packing(state, law)
    axes, rows, dim = figure.axes[0], ss.measure.touching(state), state.cell.dim
    ellipses = [c for c in axes.collections if isinstance(c, EllipseCollection)]
    ellipses = [c for c in ellipses if len(c.get_edgecolor())]  # without highlights
    balls, lines = ([c for c in ellipses if (np.ravel(c._heights) > 0).all() == solid] for solid in (True, False))
    sizes = np.sort(np.concatenate([2 * np.ravel(c._widths) for c in balls]))  # matplotlib keeps half of them
    np.testing.assert_allclose(sizes, np.sort(2 * BALL[dim] * state.grains.radius), rtol=1e-12)
    colours = {BLUE: [], RED: []}
    for line in lines:
        for color, width in zip(line.get_edgecolor(), line.get_linewidth(), strict=True):
            for name in colours:
                if np.allclose(color, to_rgba(name)):
                    colours[name].append(width)
    pieces = PIECES if dim == 3 else 1  # in so small a packing
    contacts, place = ss.io.frame_of(state, law).contacts, ss.measure.wrapped(state)
    i, j, branch = (contacts[name] for name in ("i", "j", "branch"))
    inner = j < len(place)
    across = np.zeros(len(i), bool)  # lines across a periodic edge, drawn from each grain to the contact
    across[inner] = np.linalg.norm(place[i] - branch - place[np.where(inner, j, 0)], axis=1)[inner] > 0.5
    twice = 1 + across
    slides = state.contacts.mode[rows] == SLIDE
    assert (len(colours[BLUE]), len(colours[RED])) == tuple(pieces * twice[which].sum() for which in (~slides, slides))
    force = np.sort(np.repeat(np.repeat(contacts["force_n"], twice), pieces))
    long = np.sort(np.concatenate([2 * np.ravel(line._widths) for line in lines]))
    first, second = (np.append(state.grains.radius, np.zeros(len(state.walls.mass)))[end] for end in (i, j))
    length, reach = np.linalg.norm(branch, axis=1), first / (first + second)
    ball = BALL[3] * (dim == 3)  # lines are drawn between the surfaces of the balls
    parts = [(~across, length - ball * (first + second)), (across, reach * length - ball * first)]
    parts += [(across, (1 - reach) * length - ball * second)]
    seen = np.linalg.norm((branch @ view_basis(ss.io.frame_of(state, law)).T)[:, :2], axis=1) / length
    drawn = np.concatenate([(seen * part)[which] for which, part in parts])
    np.testing.assert_allclose(long, np.sort(np.repeat(drawn / pieces, pieces)), rtol=1e-9)
    width = np.sort(colours[BLUE] + colours[RED])
    share = np.clip(force / contacts["force_n"].mean(), 0.12, 6.0)
    np.testing.assert_allclose(width / width.max(), share / share.max(), rtol=1e-9)
    assert np.ptp(axes.lines[-1].get_xdata()) == pytest.approx(2 * state.grains.radius.mean())  # "mean diameter"
    plt.close(figure)


def test_up_is_against_gravity_and_up_in_the_drawing():
    state = spheres()
    frame = ss.io.frame_of(state._replace(control=state.control._replace(gravity=np.array([0.0, 3.0, -4.0]))), SHARP)
    up = up_direction(frame)
    assert up == pytest.approx([0.0, -0.6, 0.8])
    assert (view_basis(frame) @ up)[1] > 0.8


def test_a_mode_is_drawn_as_ellipses_with_its_axes():
    state = disks()
    n = len(state.grains.radius)
    u = np.zeros((n, 3), complex)
    u[0], u[1] = [2.0, 1j, 0], [0, 0.5, 0]
    figure = ss.figures.packing(state, SHARP, mode=(u, 0 * u, 0.1 - 1j))
    paths = [c.get_segments() for c in figure.axes[0].collections if isinstance(c, LineCollection)]
    drawn = [path for segments in paths for path in segments if len(path) == 49]
    assert len(drawn) == 2
    spans = np.ptp(drawn[0], axis=0)
    radius = state.grains.radius
    assert spans[0] / spans[1] == pytest.approx(2.0, rel=1e-9)
    assert np.ptp(drawn[1], axis=0) == pytest.approx([0, spans[0] / 4], rel=1e-9, abs=1e-12)
    assert spans[0] <= 2 * radius.mean()
    plt.close(figure)


@pytest.mark.parametrize("side", [1, -1])
def test_grains_hide_the_lines_behind_them(side):
    """A third ball before or behind the middle of a contact, as seen by the viewer."""
    two = ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], SHARP)
    toward = view_basis(ss.io.frame_of(two, SHARP))[2]
    place = [[0, 0, 0], [0.99, 0, 0], [0.495, 0, 0] + side * 1.5 * toward, -3 * side * toward]
    figure = ss.figures.packing(ss.packings.from_arrays(place, [0.5] * 4, SHARP), SHARP)
    values = [c for c in figure.axes[0].collections if isinstance(c, EllipseCollection) and len(c.get_edgecolor())]
    lines = [c.zorder for c in values if not np.ravel(c._heights).any()]
    middle = (np.array(place) @ view_basis(ss.io.frame_of(two, SHARP)).T)[2, :2]
    (ball,) = (c.zorder for c in values if np.allclose(c.get_offsets(), middle, atol=1e-9))
    assert lines and all(side * (ball - z) > 0 for z in lines)
    plt.close(figure)


@pytest.mark.parametrize("ending", [".gif", ".mp4"])
def test_a_movie_has_its_length_at_any_rate(ending, folder, monkeypatch):
    """Three seconds here; that it is eight is checked with the movie of a run, of which no frame is drawn."""
    monkeypatch.setattr(animation, "SECONDS", 3.0)
    path = folder / f"film{ending}"
    out = run("movie", folder, "--out", path, "--colour", "speed", "--fps", "1")
    assert out.returncode == 0, out.stderr
    if ending == ".gif":
        with Image.open(path) as film:
            assert (film.n_frames, film.info["duration"]) == (3, 1000)
            assert len(np.unique(np.asarray(film.convert("RGB")).reshape(-1, 3), axis=0)) > 50
    else:
        count, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
        assert (count, seconds) == (3, pytest.approx(3, abs=0.3))


@pytest.mark.parametrize("words, message", [
    (["--zoom", "0"], "--zoom must be from 0.01 to 1000, or all for every grain, got 0"),
    (["--zoom", "nan"], "--zoom must be from 0.01 to 1000, or all for every grain, got nan"),
    (["--zoom", "big"], "--zoom must be from 0.01 to 1000, or all"),
])  # fmt: skip
@pytest.mark.parametrize("command", ["movie", "report"])
def test_a_zoom_without_sense_is_refused_before_anything_is_read(command, words, message, tmp_path):
    out = run(command, "none.npz", *words, cwd=tmp_path)
    assert out.returncode == 2 and message in out.stderr and not any(tmp_path.iterdir())


def test_movies_and_pages_say_how_many_grains_are_outside_the_view(tmp_path, monkeypatch):
    monkeypatch.setattr(animation, "SECONDS", 2.0)  # two frames
    place = [*np.mgrid[:8, :3, :1].reshape(3, -1).T.tolist(), [40, 0, 0]]
    states = [ss.packings.from_arrays(place, [0.5] * 25, SHARP, dim=2)._replace(time=float(k)) for k in range(2)]
    archive.write(
        tmp_path / "results.h5", {"law": SHARP, "frames": {f"{k}": s for k, s in enumerate(states)}},
        scenario='{"experiment": "flow"}', version="9",
    )  # fmt: skip
    film = run("movie", tmp_path, "--slides", "--fps", "1", "--json")
    assert json.loads(film.stdout)["notes"] == ["1 grain is outside the view: --zoom all shows every grain"]
    with Image.open(tmp_path / "movie.gif") as shown:
        assert shown.size == (1280, 720)
    assert "1 grain is outside the view: zoom out to see it" in run("report", tmp_path).stdout
    shown = page(tmp_path / "report.html")
    assert any("1 grain is outside the view: zoom out to see it." in word for word in shown.words)
    assert view_of(shown)["box"][1][0] == pytest.approx(7.5)
    assert "outside" not in run("report", tmp_path, "--zoom", "all").stdout


def test_the_palette_of_a_movie_keeps_rare_colours_and_a_white_background():
    pixels = np.full((300, 400, 3), 255, np.uint8)
    pixels[:, 100:356] = (255 * plt.get_cmap("viridis")(np.arange(256))[:, :3]).astype(np.uint8)
    pixels[200:, :100] = np.random.default_rng(0).integers(230, 256, (100, 100, 3))  # edges of lines
    other = pixels.copy()
    other[10:13, 10] = red = np.round(255 * np.array(to_rgba(RED)[:3])).astype(int)
    frames = [Image.fromarray(pixels), Image.fromarray(other)]
    palette = animation._palette_of(frames)
    first, second = (np.asarray(f.quantize(palette=palette, dither=0).convert("RGB")).astype(int) for f in frames)
    assert (first[:200, :100] == 255).all()
    assert np.abs(first - pixels).max() < 20
    assert np.abs(second[10:13, 10] - red).max() < 20


def test_a_mode_becomes_a_movie(tmp_path):
    state = disks()
    ss.io.write_packing(tmp_path / "p.npz", state, SHARP)
    write_modes(tmp_path / "m.npz", swinging(len(state.grains.radius)))
    out = run("movie", "p.npz", "--modes", "m.npz", "--frames", "3", cwd=tmp_path)
    assert out.returncode == 0, out.stderr
    with Image.open(tmp_path / "p-movie.gif") as film:
        assert film.n_frames == 3
    assert "there is no mode 3" in run("movie", "p.npz", "--modes", "m.npz", "--mode", "3", cwd=tmp_path).stderr


def test_the_legend_of_a_movie_clears_its_colour_bar_and_type_is_large(tmp_path, monkeypatch):
    """Its type has 18 pixels, so that it is readable at half the size."""
    shown = []
    monkeypatch.setattr(animation.GifWriter, "grab_frame", lambda writer, **_: shown.append(writer.fig))
    monkeypatch.setattr(animation.GifWriter, "finish", lambda writer: None)
    state, law = walled()
    animation.movie([ss.io.frame_of(state, law)], tmp_path / "p.gif", labels=["one"], colour="coordination")
    (figure,) = shown
    axes, bar = figure.axes
    legend = axes.get_legend()
    figure.draw_without_rendering()
    assert legend.get_window_extent().y0 > bar.bbox.y1 and bar.get_tightbbox().y0 >= 0
    assert min(text.get_fontsize() for text in legend.get_texts()) * figure.dpi / 72 > animation.PIXELS / 50


def test_the_view_shows_itself_in_a_notebook():
    state = spheres()
    plot = ss.figures.view([ss.io.frame_of(state, SHARP)], [swinging(len(state.grains.radius))])
    balls = next(item for item in plot.objects if item.name == "grains")
    assert len(balls.positions) == 25
    assert "_repr_mimebundle_" in dir(plot)
    first, last = (np.asarray(balls.positions[t]) for t in ("0.0000", "1.0000"))
    np.testing.assert_allclose(first, last, atol=1e-6)  # a whole period
