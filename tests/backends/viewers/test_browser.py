"""The live view in a real browser: it draws, it steers, it pauses, and it leaves nothing behind."""

from __future__ import annotations

import base64
import io
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image

from backends.viewers.session import Session
from cdcsr.robot.description import Robot
from cdcsr.tasks.spaces import anchor

pytest.importorskip("viser", reason="the extra `view` is not installed")
playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
if TYPE_CHECKING:
    from backends.viewers.web import WebView

CHROMIUM = shutil.which("chromium")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")
SOFTWARE = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
]
PATIENCE = 120_000
"""How long a page may take, in [ms]; the browser draws with the processor."""


@pytest.fixture
def session(paper: Robot) -> Session:
    return Session(paper, ["mujoco", "pybullet"], anchor(paper))


@pytest.fixture
def view(session: Session) -> Iterator[WebView]:
    """Serve the session from a thread."""
    from backends.viewers.web import WebView

    made, stop = WebView(session, port=0), threading.Event()
    loop = threading.Thread(target=made.run, args=(stop.is_set,))
    loop.start()
    yield made
    stop.set()
    loop.join()
    made.close()


@pytest.fixture
def browser() -> Iterator[Any]:  # playwright's types are there only where it is installed
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE)
        yield opened
        opened.close()


def open_page(browser: Any, view: WebView) -> tuple[Any, list[str]]:
    """Return a page that shows the view, and a list that its errors are added to."""
    page, errors = browser.new_page(viewport={"width": 800, "height": 900}), []
    page.set_default_timeout(PATIENCE)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
    page.goto(view.url)
    page.get_by_text("updates/s").wait_for()
    return page, errors


def picture(page: Any) -> Image.Image:
    """Return a picture of the page."""
    shot = page.context.new_cdp_session(page).send("Page.captureScreenshot", {"format": "png"})
    return Image.open(io.BytesIO(base64.b64decode(shot["data"]))).convert("RGB")


def wait(condition: Callable[[], object]) -> None:
    """Wait for a condition, and fail if it does not come."""
    end = time.monotonic() + PATIENCE / 1000
    while not condition():
        assert time.monotonic() < end, "it did not come"
        time.sleep(0.05)


def test_the_page_draws_the_robot_without_an_error(browser: Any, view: WebView) -> None:
    page, errors = open_page(browser, view)

    def blue() -> int:
        """Count the pixels of solar panels, left of the controls."""
        red, _, blue = np.moveaxis(np.asarray(picture(page), dtype=int)[:, :450], 2, 0)
        return int((blue - red > 80).sum())

    wait(lambda: blue() > 300)
    assert errors == []


@pytest.mark.slow
def test_the_page_steers_both_engines(browser: Any, view: WebView, session: Session) -> None:
    page, errors = open_page(browser, view)
    start = [shown.state.tip_position.copy() for shown in session.views()]
    slider = page.get_by_role("slider").nth(1)  # after the speed
    slider.focus()
    for _ in range(20):
        page.keyboard.press("ArrowRight")
    wait(lambda: session.driving.command[0] < -0.3)
    page.get_by_role("button", name="Play").click()
    wait(lambda: session.time > 0.05)
    page.get_by_role("button", name="Pause").click()
    wait(lambda: not session.playing)
    stopped = session.time
    page.wait_for_timeout(500)
    assert session.time == stopped
    for shown, before in zip(session.views(), start, strict=True):
        assert np.linalg.norm(shown.state.tip_position - before) > 1e-6

    second, more = open_page(browser, view)
    second.get_by_role("button", name="Step").click()
    wait(lambda: session.time > stopped)
    page.get_by_text(f"{session.time:.4f} s").wait_for()  # the first page shows it too
    threads = threading.active_count()
    second.close()
    page.close()
    wait(lambda: view.num_pages == 0)
    assert threading.active_count() <= threads
    assert errors + more == []
