"""How the designer looks and reads: accessibility, sizes of a window, a user's own colours."""

import io
from pathlib import Path

import app_page
import numpy as np
import pytest
from app_page import at_rest, opened, wait
from PIL import Image

chromium, server, shown = app_page.chromium, app_page.server, app_page.shown
pytestmark = pytest.mark.slow

AXE = Path(__file__).parent / "data" / "axe" / "axe.min.js"

#: Texts that do not show whole, and pairs of texts that lie on one another. What is hidden from the
#: eye but read aloud has a box of one pixel; what stays in its place lies over what scrolls.
MISPLACED = r"""() => {
  const name = (e) => `${e.tagName}#${e.id}.${e.className} ${e.textContent.trim().slice(0, 30)}`;
  const all = [...document.querySelectorAll("body *")].filter((e) =>
    e.namespaceURI.endsWith("xhtml") && e.checkVisibility({ visibilityProperty: true })
    && e.clientWidth !== 1 && getComputedStyle(e).clipPath === "none");
  const cut = all.filter((e) => {
    const style = getComputedStyle(e), scrolls = ["INPUT", "TEXTAREA"].includes(e.tagName);
    return !scrolls && style.overflowX === "hidden" && style.textOverflow !== "ellipsis"
      && e.scrollWidth > e.clientWidth + 1;
  }).map(name);
  const above = (e) => [...function* () { for (; e; e = e.parentElement) yield e; }()];
  const visible = (e) => {
    const range = document.createRange();
    range.selectNodeContents(e);
    return above(e).filter((p) => getComputedStyle(p).overflow !== "visible")
      .map((p) => p.getBoundingClientRect())
      .reduce((a, b) => ({
        left: Math.max(a.left, b.left), right: Math.min(a.right, b.right),
        top: Math.max(a.top, b.top), bottom: Math.min(a.bottom, b.bottom),
      }), range.getBoundingClientRect());
  };
  const texts = all.filter((e) => [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim()))
    .filter((e) => !above(e).some((p) => getComputedStyle(p).position === "sticky"))
    .map((e) => [e, visible(e)]);
  const over = texts.flatMap(([a, p], i) => texts.slice(i + 1)
    .filter(([b, q]) => !a.contains(b) && !b.contains(a)
      && Math.min(p.right, q.right) - Math.max(p.left, q.left) > 2
      && Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top) > 4)
    .map(([b]) => `${name(a)} | ${name(b)}`));
  return { cut, over, texts: texts.length };
}"""

TABS = ("#tab-gains", "#tab-system", "#tab-file")

#: Sizes of a window by the pixels for each of the page: the last two are laptops at 200 %.
SIZES = {
    1: [(1280, 720), (1440, 900), (3840, 2160), (1000, 800)],
    2: [(1920, 1080), (430, 900), (720, 450), (640, 360)],
}


@pytest.mark.parametrize("scale", SIZES)
def test_no_text_is_cut_or_lies_on_another(shown, scale):
    page = shown(SIZES[scale][0], device_scale_factor=scale)
    opened(page, "dual-motor-drive")
    for width, height in SIZES[scale]:
        page.set_viewport_size({"width": width, "height": height})
        for tab in TABS:
            page.click(tab)
            placed = page.evaluate(MISPLACED)
            assert not placed["cut"] and not placed["over"], (width, height, tab, placed)
            assert placed["texts"] > 40
            if tab == "#tab-file" and 1280 <= width < 2400:
                assert page.evaluate("document.querySelector('.left').clientWidth") > 0.35 * width
            assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


def test_what_is_misplaced_is_seen(shown):
    page = shown()
    page.evaluate("document.querySelector('#title').style.marginBottom = '-20px'")
    page.evaluate("document.querySelector('.legend').style.width = '20px'")
    placed = page.evaluate(MISPLACED)
    assert any("title" in pair for pair in placed["over"])
    assert any("legend" in name for name in placed["cut"])


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("size", [(1440, 900), (1000, 800), (430, 900)])
def test_axe_finds_nothing_and_nothing_is_cut(shown, theme, size):
    page = shown(size, theme, bypass_csp=True)
    page.add_script_tag(content=AXE.read_text("utf-8"))
    views = {"gains": None, "system": "#tab-system", "file": "#tab-file"}
    for view, tab in views.items():
        if tab:
            page.click(tab)
        found = page.evaluate(
            "axe.run().then((r) => r.violations.map((v) => [v.id, v.nodes.map((n) => n.html)]))"
        )
        assert not found, (view, found)
        wide = page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
        assert wide <= 0, view

    def nothing_found(what):
        found = page.evaluate(
            "axe.run().then((r) => r.violations.map((v) => [v.id, v.nodes.map((n) => n.html)]))"
        )
        assert not found, (what, found)

    text = page.input_value("#text")
    page.fill("#text", text.replace("x1**2*x2", "x1**2*x9"))
    wait(page, "lab.state.textProblem !== null")
    nothing_found("an error")
    page.fill("#text", text.replace("gamma = [0.5, 0.2]", "gamma = [0.1, 0.2]"))
    wait(page, "lab.state.bound?.contradicted?.length && lab.state.textProblem === null")
    nothing_found("a contradicted premise")
    page.click("#tab-system")
    page.select_option('[id="field-reference.kind"]', "moves")
    wait(page, "document.querySelectorAll('.profile circle').length === 3")
    nothing_found("points of a reference")
    page.click("#tab-gains")
    page.locator("[data-task=tune]").click()
    nothing_found("limits of tuning")
    page.keyboard.press("Escape")
    page.click("#file")
    nothing_found("files")


def colours_along(page, selector, height):
    """Colours of the pixels of an element on the line at that height."""
    image = Image.open(io.BytesIO(page.locator(selector).first.screenshot())).convert("RGB")
    return np.unique(np.asarray(image)[height], axis=0)


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_sliders_and_states_are_seen_in_the_colours_of_the_user(shown, theme):
    """Forced colours take backgrounds away: what is drawn by one must stay."""
    page = shown(theme=theme, forced_colors="active")
    assert len(colours_along(page, "#gains .slider:visible", 12)) >= 3  # ground, track, knob
    assert len(colours_along(page, ".track", 3)) >= 3  # ground, edge, bar
    assert page.inner_text("#badge").startswith("exact")  # said in words, not by colour alone
    look = "(e) => ((s) => s.backgroundColor + s.color)(getComputedStyle(e))"
    for buttons, state in ((".segments button", "aria-pressed"), (".tabs button", "aria-selected")):
        chosen, other = (page.locator(f"{buttons}[{state}={value}]") for value in ("true", "false"))
        assert chosen.first.evaluate(look) != other.first.evaluate(look)


def test_nothing_moves_by_itself_where_motion_is_not_wanted(shown):
    page = shown(reduced_motion="reduce")
    page.locator("[data-task=ensemble]").click()
    moving = """[...document.querySelectorAll("*")]
      .flatMap((e) => [null, "::before", "::after"].map((part) => getComputedStyle(e, part)))
      .filter((s) => s.transitionDuration.split(", ").some((t) => parseFloat(t) > 0)
        || s.animationName !== "none").length"""
    assert page.evaluate(moving) == 0
    assert shown().evaluate(moving) > 0


def tab_to(page, selector):
    """Press Tab until the focus is there, and require that the focus is seen."""
    for _ in range(60):
        page.keyboard.press("Tab")
        if page.evaluate(f"document.activeElement.matches({selector!r})"):
            focused = page.locator(selector)
            outline = focused.evaluate("(e) => getComputedStyle(e).outlineStyle")
            assert outline != "none", selector
            return
    raise AssertionError(f"not reached by Tab: {selector}")


def test_the_three_things_to_try_are_done_by_the_keyboard_alone(shown):
    page = shown()
    before = page.evaluate("lab.state.bound.bound")
    tab_to(page, '.slider[data-path="bandwidth"]')
    page.keyboard.press("PageUp")
    at_rest(page)
    assert page.evaluate("lab.state.bound.bound") < before
    page.keyboard.press("f")
    wait(page, "document.querySelector('#drawer').innerText.includes('certified')")
    page.keyboard.press("Escape")
    tab_to(page, "[role=tab][aria-selected=true]")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    wait(page, "document.activeElement.id === 'tab-file'")
    tab_to(page, "#text")
    at_rest(page)
    text = page.input_value("#text")
    page.evaluate("document.activeElement.setSelectionRange(0, 0)")
    page.keyboard.press("Control+a")
    page.keyboard.insert_text(text.replace("gamma = [0.5, 0.2]", "gamma = [0.6, 0.2]"))
    wait(page, "lab.state.text.includes('gamma = [0.6, 0.2]') && lab.state.textProblem === null")
    at_rest(page)
    page.keyboard.press("Escape")
