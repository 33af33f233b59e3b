"""The designer in Chromium from the system's packages, driven by Playwright: fixtures and waits."""

import shutil
import time

import pytest
from app_client import PATIENCE, running

import certrack

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)

#: The last move is proven and drawn.
EXACT = "lab.state.bound?.exact && lab.state.run?.design === lab.state.bound.design"


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    folder = tmp_path_factory.mktemp("app")
    (folder / "mine.toml").write_text(certrack.starter("dual-motor-lean"))
    with running("example1", folder=folder) as started:
        started.folder = folder
        yield started


@pytest.fixture(scope="module")
def chromium():
    if CHROMIUM is None:
        pytest.skip("NOT TESTED: the designer in a browser, for want of chromium")
    playwright = pytest.importorskip(
        "playwright.sync_api",
        reason="NOT TESTED: the designer in a browser, for want of playwright",
    )
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


def wait(page, expression, seconds=PATIENCE):
    """Poll: our policy of content forbids what Playwright's own waiting evaluates."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if page.evaluate(expression):
            return
        time.sleep(0.05)
    raise AssertionError(f"not within {seconds} s: {expression}")


def is_error(message):
    """A page that is loaded again is refused first: its key is no longer in the address."""
    return message.type == "error" and "403" not in message.text


@pytest.fixture
def shown(server, chromium):
    """A function that opens a page; it fails afterwards if the page has logged an error."""
    contexts, errors = [], []

    def open_page(size=(1440, 900), theme="light", query="", **options):
        context = chromium.new_context(
            viewport={"width": size[0], "height": size[1]}, color_scheme=theme, **options
        )
        contexts.append(context)
        page = context.new_page()
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda m: errors.append(m.text) if is_error(m) else None)
        page.goto(server.address + query, timeout=1000 * PATIENCE)
        wait(page, EXACT)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert not errors


def at_rest(page):
    """Wait until the last move is proven, and the text follows."""
    wait(page, f"lab.flight.length === 0 && {EXACT}")


def opened(page, name):
    page.click("#file")
    page.locator(".menu .item", has_text=name).first.click()
    if page.locator("text=Discard them").count():
        page.click("text=Discard them")
    wait(page, f"lab.state.name === '{name}.toml' || lab.state.name === '{name}'")
    at_rest(page)
