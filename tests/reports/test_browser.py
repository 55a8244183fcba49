"""The page as a browser shows it: headless Chromium without a network.

On Debian: `apt-get install chromium chromium-driver`, and `pip install selenium`. Without them these tests are skipped.
"""

import io
import json
import time
from shutil import which

import numpy as np
import pytest
from PIL import Image

import stickslip as ss
from stickslip.figures import page
from stickslip.figures.scene import page_view
from tests.exchange.packings import SHARP

from .test_reports import swinging

pytestmark = pytest.mark.slow
PATIENCE = 60  # seconds until a page stands, on a busy machine without a graphics card


@pytest.fixture
def browser():
    if not (which("chromium") and which("chromedriver")):
        pytest.skip("there is no Chromium: apt-get install chromium chromium-driver (Debian)")
    webdriver = pytest.importorskip("selenium.webdriver", reason="pip install selenium")
    options = webdriver.ChromeOptions()
    lines = ["headless=new", "no-sandbox", "disable-dev-shm-usage", "window-size=1100,1000", "use-angle=swiftshader"]
    lines += ["enable-unsafe-swiftshader", "host-resolver-rules=MAP * ~NOTFOUND"]  # no graphics card, no network
    for word in lines:
        options.add_argument(f"--{word}")
    options.binary_location = which("chromium")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(which("chromedriver")))
    driver.set_script_timeout(PATIENCE)
    yield driver
    driver.quit()


def packing(number: int):
    """Spheres near a lattice, a mode, and a page of them."""
    rng = np.random.default_rng(0)
    side = int(np.ceil(number ** (1 / 3)))
    place = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)[:number] + 0.5
    place = 0.97 * place + rng.normal(0, 0.02, place.shape)
    state = ss.packings.from_arrays(place, rng.uniform(0.45, 0.55, number), SHARP, cell=[0.97 * side] * 3)
    return state, swinging(number)


def opened(browser, path, number: int):
    """Open a page with a view of so many grains, and go into the view."""
    state, mode = packing(number)
    inside = page_view([ss.io.frame_of(state, SHARP)], [mode], labels=["one"])
    path.write_text(page.page("a packing", "", [("View", page.embedded_document(inside, "view"))]), encoding="utf-8")
    browser.get(path.as_uri())
    browser.switch_to.frame(browser.find_element("tag name", "iframe"))
    end = time.monotonic() + PATIENCE
    while not browser.execute_script("return Boolean(window.stickslip && window.stickslip.ready)"):
        assert time.monotonic() < end, browser.get_log("browser")
        time.sleep(0.1)


def picture(browser) -> np.ndarray:
    """What is seen of the canvas."""
    time.sleep(1.5)
    canvas = browser.find_element("id", "canvasTarget")
    return np.asarray(Image.open(io.BytesIO(canvas.screenshot_as_png)).convert("RGB")).astype(int)


def test_a_page_stands_offline_without_errors_and_a_click_changes_it(browser, tmp_path):
    opened(browser, tmp_path / "page.html", 60)
    browser.find_element("id", "swing").click()  # hold the mode
    assert browser.find_element("id", "amplitude-value").text == "0.30 radii"
    assert browser.find_element("id", "size-value").text == "60 %"
    still, again = picture(browser), picture(browser)
    assert np.array_equal(still, again)
    assert (still != 255).any(axis=2).mean() > 0.05  # not blank
    assert len(np.unique(still.reshape(-1, 3), axis=0)) > 200
    browser.find_element("id", "contacts").click()
    without = picture(browser)
    assert (without != still).any(axis=2).sum() > 500  # pixels of lines
    choice = browser.find_element("id", "colour")
    names = [option.text for option in choice.find_elements("tag name", "option")]
    select = pytest.importorskip("selenium.webdriver.support.ui").Select
    select(choice).select_by_visible_text("radius")
    assert {"radius", "coordination", "pressure", "mode displacement"} <= set(names)
    assert (picture(browser) != without).any(axis=2).sum() > 500
    assert "radius [length]" in browser.find_element("id", "legend").text
    browser.find_element("id", "swing").click()
    before = browser.execute_script("return stickslip.pictures")
    moving = picture(browser)
    assert browser.execute_script("return stickslip.pictures") > before
    assert (moving != still).any()
    severe = [line for line in browser.get_log("browser") if line["level"] in ("SEVERE", "WARNING")]
    assert not severe
    asked = [json.loads(line["message"])["message"] for line in browser.get_log("performance")]
    urls = [m["params"]["request"]["url"] for m in asked if m["method"] == "Network.requestWillBeSent"]
    assert urls
    assert all(url.startswith(("file://", "data:", "blob:")) for url in urls), [url[:80] for url in urls]


def test_ten_thousand_grains_can_be_animated(browser, tmp_path):
    """Prints the page's own work for a picture, the least of twelve; drawing itself is the graphics card's."""
    opened(browser, tmp_path / "page.html", 10_000)
    browser.find_element("id", "swing").click()
    time.sleep(3)
    spent = browser.execute_async_script(
        """
        const done = arguments[0], view = stickslip.view, render = view.render, times = [];
        (async () => {
          view.render = () => {};
          for (let k = 0; k < 12; k++) {
            stickslip.now.phase = k / 2;
            const start = performance.now();
            await stickslip.place();
            times.push(performance.now() - start);
          }
          view.render = render;
          done(Math.min(...times));
        })();
        """
    )
    print(f"{spent:.1f} ms")
    assert spent > 0


def test_the_view_is_dark_where_the_browser_is(browser, tmp_path):
    features = [{"name": "prefers-color-scheme", "value": "dark"}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    opened(browser, tmp_path / "page.html", 60)
    assert tuple(picture(browser)[5, 5]) == (0x14, 0x17, 0x1A)


def test_a_browser_without_webgl_says_so(browser, tmp_path):
    state, mode = packing(8)
    inside = page_view([ss.io.frame_of(state, SHARP)], [mode], labels=["one"])
    path = tmp_path / "page.html"
    without = "<head><script>HTMLCanvasElement.prototype.getContext = () => null</script>"
    path.write_text(inside.replace("<head>", without, 1), encoding="utf-8")
    browser.get(path.as_uri())
    time.sleep(1)
    assert "no WebGL 2" in browser.find_element("tag name", "body").text
