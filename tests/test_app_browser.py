"""The designer in a real browser: what is done with it, by mouse, keys and text."""

import json
import math
import os
import re
import shutil
import signal
import time

import app_page
import numpy as np
import pytest
from app_client import PATIENCE, running
from app_page import EXACT, at_rest, opened, wait

import certrack
from certrack.app.gains import with_gains
from certrack.core.rounding import printed_bound
from certrack.reports.tables import table
from certrack.simulation.metrics import METRIC_LABELS

chromium, server, shown = app_page.chromium, app_page.server, app_page.shown
pytestmark = pytest.mark.slow


def test_numbers_on_the_page_are_those_of_the_command_line(shown):
    page = shown()
    system = certrack.load("example1")
    wait(page, "lab.state.bound.effort === 'default'")
    proven = certrack.certify(system)
    assert page.inner_text("#bound .num") == printed_bound(proven.best.bound, 5)
    assert page.inner_text("#badge") == "exact"
    metrics = certrack.simulate(system).metrics.as_dict()
    rows = page.locator("#measures tbody tr td:nth-child(3)").all_inner_texts()
    printed = table("", ["", ""], [[name, metrics[name]] for name in METRIC_LABELS]).rows
    assert rows == [printed_bound(proven.best.bound, 5), *(text for _, text in printed)]
    page.click("#certificates-card summary")
    for row in page.locator("#certificates tbody tr").all():
        certificate = getattr(proven, row.locator("th").inner_text())
        text = row.locator("td").first.inner_text()
        assert text.strip() == (printed_bound(certificate.bound, 5) if certificate.exists else "—")


def test_the_key_leaves_the_address_and_a_page_that_is_loaded_again_comes_back(shown):
    page = shown()
    assert "t=" not in page.url
    page.locator('[data-path="law.c[0]"]').focus()
    page.keyboard.press("PageUp")
    at_rest(page)
    page.reload()
    wait(page, EXACT)
    assert page.locator('[data-path="law.c[0]"]').get_attribute("aria-valuenow") == "1.1"
    assert page.locator("#edited").is_visible()


def test_every_slider_moves_by_keys_typing_and_mouse_and_is_undone(shown):
    page = shown()
    sliders = page.locator("#gains .slider:visible")
    assert sliders.count() >= 7
    for k in range(sliders.count()):
        slider = sliders.nth(k)
        before = float(slider.get_attribute("aria-valuenow"))
        slider.focus()
        page.keyboard.press("ArrowRight")
        after = float(slider.get_attribute("aria-valuenow"))
        assert after == pytest.approx(1.01 * before, rel=1e-3)
        page.keyboard.press("Shift+ArrowRight")
        assert 0 < float(slider.get_attribute("aria-valuenow")) / after - 1 < 0.002
        page.keyboard.press("Delete")
        assert float(slider.get_attribute("aria-valuenow")) == before
    slider = page.locator('[data-path="law.c[0]"]')
    field = slider.locator("xpath=..").locator("input")
    field.fill("7,5")
    field.press("Enter")
    assert slider.get_attribute("aria-valuenow") == "7.5"
    field.fill("fast")
    field.press("Enter")
    assert slider.get_attribute("aria-valuenow") == "7.5" and "must be" in page.inner_text("#note")
    field.fill("400")
    field.press("Enter")
    assert float(slider.get_attribute("aria-valuemax")) >= 400
    page.locator("body").press("Control+z")
    assert slider.get_attribute("aria-valuenow") == "7.5"
    at_rest(page)
    wait(page, "lab.state.text.includes('c = [7.5, 0.5]')")
    box = slider.bounding_box()
    page.mouse.move(box["x"] + 3, box["y"] + 13)
    page.mouse.down()
    for k in range(12):
        page.mouse.move(box["x"] + 3 + 4 * k, box["y"] + 13)
        bound = page.evaluate("[lab.state.design, lab.state.bound.exact && lab.state.bound.design]")
        assert bound[1] is False or bound[0] == bound[1], "never exact for other gains"
    page.mouse.up()
    at_rest(page)
    assert page.evaluate("lab.state.run.design === lab.state.design")


def test_a_law_that_has_weights_only_shows_them(shown, server):
    text = certrack.starter("dual-motor-linear")
    text = re.sub(r"^K = .*\nr = .*$", "lqr = {error = 400, input = 1}", text, flags=re.MULTILINE)
    (server.folder / "weights.toml").write_text(text)
    page = shown()
    assert not page.locator('[data-group="damping"]').get_attribute("open")
    opened(page, "weights")
    slider = page.locator('[data-path="law.lqr.error"]')
    assert slider.is_visible()
    before = page.evaluate("lab.state.bound.bound")
    slider.focus()
    page.keyboard.press("PageUp")
    at_rest(page)
    assert page.evaluate("lab.state.bound.bound") < before


def test_a_bound_draws_the_error_again_and_no_other_plot(shown):
    page = shown()
    wait(page, "lab.state.bound.effort === 'default'")
    page.evaluate(
        "lab.responses.plots.forEach((plot) => {"
        "  const real = plot.set.bind(plot); plot.count = 0;"
        "  plot.set = (data) => { plot.count += 1; real(data); }; })"
    )
    counts = "Object.fromEntries(lab.responses.plots.map((p) => [p.spec.id, p.count]))"
    page.locator('[data-path="law.c[0]"]').focus()
    page.keyboard.press("ArrowRight")
    at_rest(page)
    wait(page, "lab.state.bound.effort === 'default'")
    counted = page.evaluate(counts)
    assert counted["error"] > counted["output"] == counted["estimates"] >= 1, counted
    current = "lab.responses.plots.every((p) => p.plot.data[0] === lab.state.run.times)"
    wait(page, current)
    page.keyboard.press("Escape")
    page.click("#theme")
    wait(page, f"{current} && {counts}.output > {counted['output']}")


def test_responses_are_drawn_with_their_bound_if_that_comes_soon(shown):
    drawn = """(async () => {
      const { Together } = await import("./together.js");
      const draws = [], pause = (ms) => new Promise((done) => setTimeout(done, ms));
      const together = new Together(() => draws.push(performance.now()));
      const counts = [];
      together.run(2, false); counts.push(draws.length);  // its bound is on its way
      together.bound(2); counts.push(draws.length);
      await pause(60); counts.push(draws.length);  // no second time
      together.run(3, true); counts.push(draws.length);  // the bound came before
      together.run(4, false); await pause(60); counts.push(draws.length);  // it does not come
      together.bound(4); counts.push(draws.length);
      together.run(5, false); counts.push(draws.length);  // nor is it waited for again
      together.bound(5); together.run(6, false); counts.push(draws.length);  // until one is soon
      together.run(7, false); together.bound(6); counts.push(draws.length);
      together.run(8, false); counts.push(draws.length);  // not while they lag behind the moves
      return counts;
    })()"""
    assert shown().evaluate(drawn) == [0, 1, 1, 2, 3, 4, 5, 6, 7, 8]


def test_tables_are_written_at_once_or_a_moment_after_the_last_call(shown):
    written = """(async () => {
      const { spaced } = await import("./dom.js");
      const pause = (ms) => new Promise((done) => setTimeout(done, ms)), counts = [];
      let count = 0;
      const write = spaced(() => (count += 1), 300), tell = () => counts.push(count);
      write(); tell();  // nothing was written lately
      write(); write(); tell();  // too soon
      write(true); tell();  // urgent
      await pause(500); tell();  // nothing is waiting
      write(); write(); tell();
      await pause(500); tell();  // the second one is not lost
      return counts;
    })()"""
    assert shown().evaluate(written) == [1, 1, 2, 2, 3, 4]


#: Curves on a plot of 700 by 100 pixels as corners of the path that is drawn, beside their points.
TRACED = """(async (rows) => {
  const { line, strip } = await import("./curves.js");
  window.Path2D = class {
    corners = [];
    moveTo(x, y) { this.corners.push([x, y, true]); }
    lineTo(x, y) { this.corners.push([x, y, false]); }
  };
  const u = { valToPos: (value, scale) => (scale === "x" ? 700 * value : 100 * (1 - value)) };
  const t = rows[0].map((_, i) => i / (rows[0].length - 1));
  return [...rows.map((row) => line(u, t, row).corners), strip(u, t, rows[0], rows[1]).corners];
})"""


def test_points_that_a_curve_does_without_lie_on_it(shown):
    """To a tenth of a pixel; peaks, jumps and gaps stay."""
    rng, count = np.random.default_rng(3), 1401
    t = np.linspace(0, 1, count)
    smooth, jumps = 0.5 + 0.4 * np.sin(9 * t), (t > 0.3) * 0.6 + 0.1
    noise, spike = rng.uniform(0, 1, count), np.where(np.arange(count) == 700, 0.9, 0.2)
    gaps = [None if 300 <= i < 310 or i == 500 else v for i, v in enumerate(smooth.tolist())]
    rows = [smooth, jumps, noise, spike, np.cumsum(rng.normal(0, 0.01, count)) % 1, gaps]
    page = shown()
    found = page.evaluate(TRACED + f"({json.dumps([list(row) for row in rows])})")
    for row, corners in zip(rows, found[:-1], strict=True):
        values = np.array([math.nan if value is None else value for value in row])
        there = np.flatnonzero(np.isfinite(values))
        x, y, begins = np.array(corners).T
        drawn = np.interp(700 * t[there], x, y)
        assert np.abs(drawn - 100 * (1 - values[there])).max() <= 0.1 + 1e-9
        assert sum(begins) == 1 + np.count_nonzero(np.diff(there) > 1)
    assert len(found[0]) < 150 and len(found[1]) == 4 and len(found[3]) == 5
    assert len(found[2]) > 0.9 * count
    x, y, begins = np.array(found[-1]).T
    assert sum(begins) == 1 and begins[0]
    area = abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2
    exact = np.trapezoid(100 * (smooth - jumps), 700 * t)  # signed, as the path is
    assert area == pytest.approx(abs(exact), abs=700 * 0.2)


def test_a_second_drag_moves_as_the_first_did(shown):
    """Presses must not select texts of the page, which the browser would then drag away."""
    page = shown()
    slider = page.locator('[data-path="law.c[0]"]')
    for _ in range(2):
        slider.focus()
        page.keyboard.press("Delete")
        box = slider.bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.mouse.move(x, y)
        page.mouse.down()
        values = set()
        for k in range(24):
            page.mouse.move(x + 4 * ((k % 6) - 3), y)
            values.add(slider.get_attribute("aria-valuenow"))
            time.sleep(0.05)
        page.mouse.up()
        at_rest(page)
        assert len(values) >= 5


def test_text_and_form_follow_each_other_and_errors_are_marked(shown):
    page = shown()
    page.click("#tab-file")
    text = page.input_value("#text")
    page.fill("#text", text.replace("x1**2*x2", "x1**2*x9"))
    wait(page, "lab.state.textProblem !== null")
    assert "unknown name 'x9'" in page.inner_text("#check")
    assert page.inner_text("#lines .wrong") == "9"
    assert page.inner_text("#badge") == "of the last good design"
    page.fill("#text", text)
    wait(page, "lab.state.textProblem === null")
    at_rest(page)
    page.click("#tab-system")
    page.locator("summary", has_text="Run").click()
    field = page.locator('[data-path="simulation.duration"]')
    field.fill("12")
    field.press("Enter")
    wait(page, "lab.state.system.duration === 12")
    at_rest(page)
    assert "duration = 12" in page.evaluate("lab.state.text")
    assert "# gbar1" in page.evaluate("lab.state.text"), "comments stay"
    page.locator("body").press("Control+z")
    wait(page, "lab.state.system.duration === 20")


def test_the_form_says_what_is_wrong_at_the_field_and_takes_new_constants(shown):
    page = shown()
    page.click("#tab-system")
    field = page.locator('[data-path="plant.drift"]')
    field.fill("stiff*x1**2*x2")
    field.press("Enter")
    wait(page, "lab.state.textProblem !== null")
    assert "unknown name 'stiff'" in page.inner_text(".wrong-note")
    assert "unknown name 'stiff'" in page.inner_text(".stale-note")
    page.fill("#constant-name", "stiff")
    page.fill("#constant-value", "2")
    page.press("#constant-value", "Enter")
    wait(page, "lab.state.textProblem === null && lab.state.text.includes('stiff = 2')")
    at_rest(page)
    assert "stiff" in page.evaluate("lab.state.system.form[0].fields.map((field) => field.name)")
    assert not page.locator(".wrong-note").count()
    assert "stiff*x1**2*x2" in page.evaluate("lab.state.text")


def test_changes_of_the_form_that_need_each_other_add_up(shown):
    """Other names of the states: nothing loads until every formula has them."""
    page = shown()
    page.click("#tab-system")
    for fold in ("Truth", "Run"):
        page.locator("summary", has_text=fold).first.click()

    def typed(path, text):
        field = page.locator(f'[data-path="{path}"]')
        field.fill(text)
        asked = page.evaluate("lab.state.asked")
        field.press("Enter")
        wait(page, f"lab.state.asked > {asked} && lab.state.restoring === null")

    renamed = {}
    for path in ("plant.drift", "plant.regressor", "truth.omega"):
        value = page.input_value(f'[data-path="{path}"]')
        renamed[path] = value.replace("x1", "q").replace("x2", "v")
    before = page.evaluate("lab.state.text")
    typed("plant.states", '["q", "v"]')
    for path, value in renamed.items():
        assert page.evaluate("lab.state.textProblem !== null"), path
        assert page.input_value('[data-path="plant.states"]') == '["q", "v"]'
        typed(path, value)
    wait(page, "lab.state.textProblem === null && lab.state.system.states[0] === 'q'")
    at_rest(page)
    typed("simulation.duration", "ever")  # no value at all
    typed("plant.states", '["q", "w"]')
    page.click(".stale-note >> text=Discard these changes")
    wait(page, "lab.state.textProblem === null && lab.state.system.states[1] === 'v'")
    at_rest(page)
    assert page.input_value('[data-path="simulation.duration"]') == "20"
    assert page.input_value("#text") == page.evaluate("lab.state.text") != before


def test_a_contradicted_premise_strikes_the_number(shown):
    page = shown()
    page.click("#tab-file")
    page.fill(
        "#text", page.input_value("#text").replace("gamma = [0.5, 0.2]", "gamma = [0.1, 0.2]")
    )
    wait(page, "document.querySelector('#badge').textContent === 'premise contradicted'")
    assert "struck" in page.get_attribute("#bound", "class")
    assert page.locator("#premises .contradicted").is_visible()
    assert "not certified" in page.inner_text("#ladder")
    assert page.locator("#measures tbody td:nth-child(3)").first.inner_text() == "none"
    assert "no certified bound" in page.locator("#announce").text_content()
    page.click("#remedy >> text=Widen \N{GREEK SMALL LETTER GAMMA} of w\N{SUBSCRIPT ONE} to 0.5")
    wait(page, "lab.state.text.includes('gamma = [0.5, 0.2]')")
    at_rest(page)
    assert page.inner_text("#badge").startswith("exact")
    assert certrack.loads(page.evaluate("lab.state.text")).plant.uncertainty.gamma == (0.5, 0.2)


def test_the_law_is_shown_as_formulas_and_a_rise_of_the_bound_is_explained(shown):
    page = shown()
    assert not page.evaluate("document.querySelectorAll('#law .formula').length")
    page.click("#law-card summary")
    wait(page, "document.querySelectorAll('#law .formula').length === 9")
    law = page.locator("#law .formula")
    texts = [row.get_attribute("aria-label") for row in law.locator("[role=math]").all()]
    assert tuple(texts[2:]) == certrack.design(certrack.load("example1")).formulas
    assert law.nth(3).locator(".number").inner_text() == "(9)"
    assert law.nth(5).locator("var").first.inner_text() == "\u03bd", "nu is no n with an index u"
    wait(page, "lab.state.before.bound?.effort === 'default'")
    page.locator('.slider[data-path="law.c[0]"]').focus()
    for _ in range(7):
        page.keyboard.press("PageDown")
    at_rest(page)
    wait(page, "lab.state.bound.effort === 'default'")
    wait(page, "document.querySelector('#budget-change').textContent.includes('against before')")
    rise = page.evaluate("lab.state.bound.bound / lab.state.before.bound.bound")
    words = page.inner_text("#budget-change")
    assert words[0] == ("+" if rise > 1 else "\u2212") and "mostly by" in words
    change = page.locator("#measures tbody tr").first.locator("td").last.inner_text()
    assert words.startswith(f"{change} against before") and change.endswith("%")
    page.keyboard.press("p")
    page.keyboard.press("PageUp")
    page.keyboard.press("c")
    cells = page.locator(".result.pins tbody tr", has_text="certified bound").locator("td")
    wait(page, "lab.state.bound.exact && lab.state.bound.design === lab.state.design")
    wait(page, "!document.querySelector('.result.pins').textContent.includes('fast proof')")
    wait(page, "lab.state.bound.effort === 'default'")
    assert cells.all_inner_texts() == [
        page.evaluate("lab.state.pins[0].before.bound.text"),
        page.inner_text("#bound .num"),
    ]
    page.locator("body").press("Control+z")
    at_rest(page)
    system = with_gains(certrack.load("example1"), page.evaluate("lab.gains.all()"))
    now = certrack.design(system).formulas[1]
    assert now.startswith("lambda_1") and now != texts[3]
    wait(page, f"document.querySelectorAll('#law [role=math]')[3].ariaLabel === {now!r}")


def test_of_a_drive_the_error_is_in_sight_and_its_bound_has_causes(shown):
    """From rest the error may lie decades below the bound, which tells of no cause itself."""
    page = shown()
    opened(page, "axis-load")
    page.click("#tab-file")
    text = page.input_value("#text")
    page.fill("#text", text.replace("[reference]", "[reference] # at rest"))
    wait(page, "lab.state.text.includes('# at rest')")
    at_rest(page)
    wait(page, "lab.state.run.header.sampled")
    low, high, tail, bound = page.evaluate(
        "[...((y) => [y.min, y.max])(lab.responses.error.plot.scales.y),"
        " lab.state.run.header.metrics.tail_error, lab.state.bound.bound]"
    )
    assert low < tail < high and low < bound < high
    shares = page.locator("#budget .bar span:nth-child(2)").all_inner_texts()
    assert shares and abs(sum(int(share.split()[0]) for share in shares) - 100) <= len(shares)
    assert "continuous law" in page.inner_text("#budget-hint")
    page.click("#tab-gains")
    slider = page.locator(".slider:visible").first
    before = slider.get_attribute("aria-valuenow")
    slider.focus()
    for _ in range(3):
        page.keyboard.down("PageUp")  # held
    page.keyboard.up("PageUp")
    assert slider.get_attribute("aria-valuenow") != before
    page.locator("body").press("Control+z")
    assert slider.get_attribute("aria-valuenow") == before, "one gesture until the key is let go"
    at_rest(page)


def test_falsify_ensemble_cancel_and_export(shown, tmp_path):
    page = shown(accept_downloads=True)
    page.keyboard.press("f")
    wait(page, "lab.state.worst !== null")
    assert page.evaluate("lab.state.worst.worst <= lab.state.bound.bound")
    with page.expect_download(timeout=1000 * PATIENCE) as download:
        page.click("text=Save it as a file")
    download.value.save_as(tmp_path / "worst.toml")
    case = certrack.simulate(certrack.load(tmp_path / "worst.toml"))
    assert case.metrics.tail_error == pytest.approx(page.evaluate("lab.state.worst.worst"))
    page.keyboard.press("Escape")
    assert not page.locator("#drawer").is_visible()
    page.keyboard.press("e")
    wait(page, "document.querySelector('#work-text').textContent.includes(' of ')")
    page.click("#cancel")
    wait(page, "document.querySelector('#work').hidden")
    page.click("#export")
    with page.expect_download(timeout=1000 * PATIENCE) as download:
        page.locator(".menu .item", has_text="C code").click()
    download.value.save_as(tmp_path / "c.zip")
    shutil.unpack_archive(tmp_path / "c.zip", tmp_path)
    (folder,) = [entry for entry in tmp_path.iterdir() if entry.is_dir()]
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is not None:
        import subprocess

        sources = sorted(map(str, folder.glob("*.c")))
        subprocess.run([compiler, *sources, "-o", str(tmp_path / "test"), "-lm"], check=True)
        assert subprocess.run([str(tmp_path / "test")], check=False).returncode == 0


def test_a_reference_is_chosen_and_its_points_are_moved(shown):
    page = shown()
    page.click("#tab-system")
    assert page.locator(".profile .curve").get_attribute("d").count("L") > 300
    page.select_option('[id="field-reference.kind"]', "scurve")
    wait(page, "lab.state.system.reference.kind === 'scurve'")
    at_rest(page)
    points = page.locator(".profile circle")
    assert points.count() == 3
    points.nth(1).focus()
    page.keyboard.press("ArrowUp")
    wait(page, "lab.state.system.reference.points.values[1] > 0.2")
    at_rest(page)
    moved = page.evaluate("lab.state.system.reference.points.values[1]")
    assert certrack.loads(page.evaluate("lab.state.text")).reference.bounds(0).values[0] >= moved
    assert page.evaluate("document.activeElement.dataset.path") == "reference.positions[1]"
    page.keyboard.press("Control+z")
    wait(page, "lab.state.system.reference.points.values[1] === 0.2")
    box = points.nth(1).bounding_box()
    page.mouse.move(box["x"] + 5, box["y"] + 5)
    page.mouse.down()
    page.mouse.move(box["x"] + 5, box["y"] + 30, steps=4)
    page.mouse.up()
    wait(page, "lab.state.system.reference.points.values[1] < 0.19")


def test_a_design_is_tuned_and_a_point_of_its_front_taken(shown):
    page = shown()
    opened(page, "dual-motor-lean")
    before = page.evaluate("lab.state.bound.bound")
    page.keyboard.press("p")
    page.keyboard.press("u")
    page.fill("input[name=starts]", "1")
    page.fill("input[name=peak_input]", "20")
    page.select_option("select[name=front]", "peak-input")
    page.click(".tune-form .primary")
    wait(page, "document.querySelectorAll('.front circle').length > 2")
    page.locator(".front circle").nth(2).click()
    wait(page, "document.querySelector('#work').hidden")
    assert page.locator(".front circle").count() > 2, "the front stays in sight"
    page.click("text=Use these gains")
    at_rest(page)
    assert page.evaluate("lab.state.bound.bound") != before
    assert page.inner_text("#drawer .made").startswith("its gains are in use")
    page.locator('[data-path="bandwidth"]').focus()
    page.keyboard.press("ArrowRight")
    at_rest(page)
    assert "it has changed since" in page.inner_text("#drawer .made")
    page.keyboard.press("Control+z")
    at_rest(page)
    assert "its gains are in use" in page.inner_text("#drawer .made")
    page.keyboard.press("c")
    assert page.locator(".result.pins thead th").all_inner_texts() == ["pin 1", "now"]
    page.click("text=go back")
    at_rest(page)
    assert page.evaluate("lab.state.bound.bound") == before


def test_files_are_opened_and_saved_in_the_folder_only(shown, server):
    page = shown()
    opened(page, "mine")
    assert page.evaluate("lab.state.system.states.length") == 4
    page.locator('[data-path="bandwidth"]').focus()
    page.keyboard.press("PageUp")
    at_rest(page)
    wait(page, "lab.state.text.includes('6.6')")
    page.keyboard.press("Control+s")
    wait(page, "document.querySelector('#edited').hidden")
    assert certrack.load(server.folder / "mine.toml").law.c == (6.6, 6.6, 6.6, 6.6)


def test_a_slider_moves_while_a_text_is_read_and_both_stay(shown, server):
    page = shown()
    page.click("#tab-file")
    text = page.input_value("#text")
    reader = server.workers()["run"]
    os.kill(reader, signal.SIGSTOP)
    try:
        page.fill("#text", text.replace("duration = 20", "duration = 14"))
        page.click("#tab-gains")
        slider = page.locator('[data-path="law.c[0]"]')
        slider.focus()
        wait(page, "lab.texts.pending !== null")
        for _ in range(5):
            page.keyboard.press("ArrowRight")
        assert page.evaluate("lab.state.system.duration") == 20
    finally:
        os.kill(reader, signal.SIGCONT)
    wait(page, "lab.state.system.duration === 14")
    at_rest(page)
    value = float(slider.get_attribute("aria-valuenow"))
    assert value == pytest.approx(1.01**5, rel=1e-2)
    page.keyboard.press("ArrowRight")
    at_rest(page)
    assert float(slider.get_attribute("aria-valuenow")) > value
    wait(page, "lab.state.textOf === lab.state.design")
    loaded = certrack.loads(page.evaluate("lab.state.text"))
    assert loaded.settings.duration == 14 and loaded.law.c[0] == pytest.approx(
        1.01 * value, rel=1e-3
    )


def test_what_is_typed_while_a_text_is_read_is_not_lost(shown):
    page = shown()
    page.click("#tab-file")
    page.focus("#text")
    page.keyboard.press("Control+End")
    for k in range(6):
        page.keyboard.type(f"# line {k}\n")
        time.sleep(0.3)
    wait(page, "lab.state.text.endsWith('# line 5\\n') && lab.texts.pending === null")
    assert page.input_value("#text").count("# line") == 6
    path = '[data-path="simulation.duration"]'
    page.click("#tab-system")
    page.locator("summary", has_text="Run").click()
    for name, value in (("duration", "12"), ("band", "0.04")):
        page.evaluate(
            "([path, value]) => { const f = document.querySelector(path); f.value = value;"
            " f.dispatchEvent(new Event('change')); }",
            [path.replace("duration", name), value],
        )
    wait(page, "lab.texts.pending === null && lab.state.system.duration === 12")
    settings = certrack.loads(page.evaluate("lab.state.text")).settings
    assert (settings.duration, settings.band) == (12, 0.04)


def test_a_file_that_changed_on_the_disk_is_not_replaced_unasked(shown, server):
    path = server.folder / "shared.toml"
    path.write_text(certrack.starter("dual-motor-lean"))
    page = shown()
    page.reload()
    wait(page, EXACT)
    opened(page, "shared")
    page.locator('[data-path="bandwidth"]').focus()
    page.keyboard.press("PageUp")
    other = path.read_text().replace("duration = 20", "duration = 18")
    path.write_text(other)
    page.keyboard.press("Control+s")
    wait(page, "document.querySelector('.menu')?.textContent.includes('changed on the disk')")
    assert path.read_text() == other and page.locator("#edited").is_visible()
    page.click("text=Replace it")
    wait(page, "document.querySelector('#edited').hidden")
    assert certrack.load(path).law.c == (6.6, 6.6, 6.6, 6.6)
    assert certrack.load(path).settings.duration == 20
    broken = "[plant]\nstates = ["
    path.write_text(broken)
    page.locator('[data-path="bandwidth"]').focus()
    page.keyboard.press("PageUp")
    at_rest(page)
    page.click("#file")
    page.locator(".menu .item", has_text="shared").first.click()
    page.click("text=Discard them")
    wait(page, "document.querySelector('#note').textContent.includes('shared.toml: ')")
    wait(page, "lab.texts.pending === null")
    state = page.evaluate("[lab.state.name, lab.state.file.name, lab.state.restoring]")
    assert state == ["shared.toml", "shared.toml", None]
    assert page.locator("#edited").is_visible()
    page.keyboard.press("Control+s")
    wait(page, "document.querySelector('.menu')?.textContent.includes('changed on the disk')")
    assert path.read_text() == broken


def test_unsaved_changes_are_saved_before_another_is_opened(shown, server):
    path = server.folder / "first.toml"
    path.write_text(certrack.starter("dual-motor-lean"))
    page = shown()
    opened(page, "first")
    page.locator('[data-path="bandwidth"]').focus()
    page.keyboard.press("PageUp")
    page.click("#file")
    page.locator(".menu .item", has_text="example1").first.click()
    page.locator(".menu .primary", has_text="Save").click()
    wait(page, "lab.state.name === 'example1.toml'")
    assert certrack.load(path).law.c == (6.6, 6.6, 6.6, 6.6)


def test_a_link_opens_the_design_in_another_tab_and_in_this_one(shown, server):
    page = shown()
    page.locator('[data-path="law.c[0]"]').focus()
    page.keyboard.press("PageUp")
    at_rest(page)
    page.evaluate("navigator.clipboard.writeText = async (text) => { window.copied = text; }")
    page.click("#export")
    page.locator(".menu .item", has_text="Link with the whole").click()
    wait(page, "window.copied")
    link = page.evaluate("window.copied")
    assert "t=" not in link and link.startswith(server.origin)
    other = page.context.new_page()
    other.goto(link)
    wait(other, EXACT)
    assert other.evaluate("lab.state.name") == "linked.toml"
    assert other.locator('[data-path="law.c[0]"]').get_attribute("aria-valuenow") == "1.1"
    opened(other, "dual-motor-lean")
    other.evaluate("(link) => { location.hash = new URL(link).hash; }", link)
    wait(other, "lab.state.name === 'linked.toml'")
    opened(other, "dual-motor-lean")
    other.click("#file")
    other.get_by_label("From a link").fill(link[:-40] + "%%%")
    other.get_by_label("From a link").press("Enter")
    wait(other, "document.querySelector('#note').textContent.includes('damaged')")
    other.click("#file")
    other.get_by_label("From a link").fill(link)
    other.get_by_label("From a link").press("Enter")
    wait(other, "lab.state.name === 'linked.toml'")


def test_a_link_waits_for_the_key_of_a_server_that_was_started_again(chromium, server, tmp_path):
    context = chromium.new_context()
    page = context.new_page()
    with running("example1", folder=tmp_path, key="one-key") as first:
        page.goto(first.address)
        wait(page, EXACT)
        port = int(first.host.split(":")[1])
        page.evaluate("lab.state.text.length")
        code = page.evaluate(
            "btoa(lab.state.text.replace('c = [1,', 'c = [1.3,').replace(/[^ -~\\n]/g, '?'))"
        )
        page.goto("about:blank")
    with running("example1", folder=tmp_path, port=port, key="another-key") as second:
        page.goto(f"{second.origin}/#design={code}")
        wait(page, "document.querySelector('#linked')?.hidden === false")
        page.goto(second.address)
        wait(page, EXACT)
        assert page.evaluate("lab.state.name") == "linked.toml"
        assert page.locator('[data-path="law.c[0]"]').get_attribute("aria-valuenow") == "1.3"
    context.close()


def test_a_refinement_that_fails_leaves_what_is_proven(shown):
    page = shown()
    wait(page, "lab.state.bound.effort === 'default'")
    page.evaluate(
        "lab.received({ kind: 5, rows: [], view: 0,"
        " header: { of: 'exact', effort: 'default', message: 'It took too long.' },"
        " design: lab.state.design, revision: lab.state.revision })"
    )
    wait(page, "document.querySelector('#meaning').textContent.includes('It took too long.')")
    assert page.inner_text("#badge") == "exact"
    assert float(page.inner_text("#bound .num")) > 0


def test_a_result_says_that_the_design_has_changed_since(shown, server):
    page = shown()
    page.keyboard.press("f")
    wait(page, "lab.state.worst !== null")
    assert page.inner_text("#drawer .made") == "of the present design"
    page.locator('[data-path="law.c[0]"]').focus()
    page.keyboard.press("PageUp")
    at_rest(page)
    assert "it has changed since" in page.inner_text("#drawer .made")
    page.click("text=Back to it")
    at_rest(page)
    wait(page, "document.querySelector('#drawer .made').textContent === 'of the present design'")
    assert page.locator('[data-path="law.c[0]"]').get_attribute("aria-valuenow") == "1"
    page.keyboard.press("Escape")
    page.keyboard.press("e")
    wait(page, "document.querySelector('#work-text').textContent.includes(' of ')")
    os.kill(server.workers()["task"], 9)
    wait(page, "document.querySelector('#work').hidden")
    wait(page, "document.querySelector('#note').textContent.includes('start it again')")


def test_limits_are_moved_where_they_are_drawn_and_an_optimum_is_laid_behind(shown):
    page = shown()
    opened(page, "dual-motor-drive")
    grip = page.locator('[data-handle="saturation-1"]')
    assert grip.get_attribute("aria-valuenow") == "15"
    grip.focus()
    page.keyboard.press("PageUp")
    wait(page, "lab.state.system.limits[1] === 16.5")
    assert page.evaluate("lab.state.system.limits[0]") == -16.5
    saturation = certrack.loads(page.evaluate("lab.state.base")).implementation.saturation
    assert saturation == (-16.5, 16.5)
    at_rest(page)
    box = page.locator('[data-handle="saturation-0"]').bounding_box()
    page.mouse.move(box["x"] + 12, box["y"] + 7)
    page.mouse.down()
    page.mouse.move(box["x"] + 12, box["y"] - 3, steps=3)
    page.mouse.up()
    wait(page, "lab.state.system.limits[0] > -16.5")
    page.locator("body").press("Control+z")
    wait(page, "lab.state.system.limits[0] === -16.5")
    opened(page, "dual-motor-lean")
    page.keyboard.press("u")
    tune = page.locator('[data-handle="tune-peak_input"]')
    before = float(tune.get_attribute("aria-valuenow"))
    assert page.input_value("input[name=peak_input]") == ""
    tune.focus()
    page.keyboard.press("ArrowUp")
    value = float(page.input_value("input[name=peak_input]"))
    assert value == pytest.approx(1.01 * before, rel=2e-3)
    page.fill("input[name=peak_input]", "21")
    assert tune.get_attribute("aria-valuenow") == "21"
    tune.focus()
    page.keyboard.press("Delete")
    assert page.input_value("input[name=peak_input]") == ""
    page.keyboard.press("Escape")
    assert page.locator('[data-handle^="tune"]').count() == 0
    page.keyboard.press("o")
    wait(page, "lab.state.optima !== null && document.querySelector('#work').hidden")
    found = certrack.optimal(certrack.load("dual-motor-lean"), elements=240)
    rows = page.locator(".result.optima tbody tr").all_inner_texts()
    from certrack.reports.optima import optima_table

    printed = optima_table(found).rows
    assert [row.split("\t")[1:] for row in rows] == [list(row[1:]) for row in printed]
    curve = page.evaluate("Array.from(lab.state.optima.curves[0].u)")
    assert max(map(abs, curve)) == pytest.approx(found.optima[0].cost.peak, rel=0.02)


def test_a_name_of_the_user_is_text_on_the_page(shown, server):
    evil = certrack.starter("example1").replace(
        'title = "Second', 'title = "<img src=x onerror=window.pwned=1>Second'
    )
    (server.folder / "evil.toml").write_text(evil)
    page = shown()
    opened(page, "evil")
    assert "<img" in page.inner_text("#title")
    assert page.evaluate("window.pwned === undefined && !document.querySelector('img')")


def test_a_drag_is_answered_while_it_goes_on(shown):
    """How soon, on a quiet machine, stands in docs/designer.md."""
    page = shown(query="&measure")
    box = page.locator('[data-path="law.c[0]"]').bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 13)
    page.mouse.down()
    for k in range(120):
        page.mouse.move(box["x"] + box["width"] / 2 + 30 * ((k % 40) / 20 - 1), box["y"] + 13)
        time.sleep(0.016)
    answered = page.evaluate("lab.paints.times.length")
    page.mouse.up()
    at_rest(page)
    times = sorted(page.evaluate("lab.paints.times"))
    assert len(times) > 60 and not page.evaluate("Boolean(lab.paints.decreased)")
    median, late = times[len(times) // 2], times[int(0.95 * len(times))]
    print(f"{len(times)} moves painted: median {median:.0f} ms, 95 % {late:.0f} ms")
    assert answered > len(times) / 2


def test_the_page_says_that_the_server_is_gone_and_comes_back(chromium, tmp_path):
    with running("dual-motor-lean", folder=tmp_path) as first:
        page = chromium.new_page()
        page.goto(first.address, timeout=1000 * PATIENCE)
        wait(page, EXACT)
        page.locator('[data-path="law.c[3]"]').focus()
        page.keyboard.press("PageUp")
        at_rest(page)
        port = int(first.host.split(":")[1])
        os.kill(first.process.pid, 9)
        wait(page, "document.body.classList.contains('stale')")
        assert page.inner_text("#link") == "reconnecting"
        assert page.inner_text("#badge") == "not current"
    with running("dual-motor-lean", folder=tmp_path, port=port):
        wait(page, "!document.body.classList.contains('stale')")
        at_rest(page)
        assert page.locator('[data-path="law.c[3]"]').get_attribute("aria-valuenow") == "6.6"
    page.close()


#: A plant without disturbance at the origin: a bound of exactly 0 is proven.
STILL = """
[plant]
states = ["x1", "x2"]
chain = [1]
linear = [[0]]
drift = "0"
regressor = []
gain_sign = 1
input_gain = 1
theta = []
[plant.uncertainty]
tau = [0, 0]
gamma = [0, 0]
beta = [9, 9]
[truth]
input_gain = 1
theta = []
omega = ["0", "0"]
[reference]
signal = "0"
[law]
kind = "robust"
c = [2, 2]
feedforward = 1
[simulation]
x0 = [0.3, 0]
duration = 8
tail = 1
"""


def test_a_bound_of_zero_is_shown_as_one_and_leaves_axes_a_scale(shown, server):
    (server.folder / "still.toml").write_text(STILL)
    page = shown()
    opened(page, "still")
    wait(page, "lab.state.bound.effort === 'default' && lab.state.bound.bound === 0")
    wait(page, "document.querySelector('#badge').textContent === 'exact'")
    assert page.inner_text("#bound .le") == "\N{LESS-THAN OR EQUAL TO}"
    assert page.inner_text("#bound .num") == page.evaluate("lab.state.bound.text")
    assert "largest" in page.inner_text("#meaning")
    wait(page, "!/none|estim/.test(document.querySelector('#measures tbody tr').textContent)")
    assert "Certified bound 0" in page.locator("#announce").text_content()
    tail = page.evaluate("lab.state.run.header.metrics.tail_error")
    for key in "123":
        page.keyboard.press(key)
        page.evaluate("new Promise((done) => setTimeout(done, 100))")  # drawn once per frame
        low, high = page.evaluate("['min', 'max'].map((k) => lab.responses.error.plot.scales.y[k])")
        assert (tail / 100 < low < tail if key == "1" else low < 0) and 0.3 <= high < 2, key
    labels = "lab.responses.error.spec.limits(lab.responses.error).map((limit) => limit.label)"
    assert page.evaluate(labels)[0].startswith("certified 0")


def test_the_bound_is_shown_without_a_run_and_another_design_begins_with_nothing(shown):
    page = shown()
    wait(page, "lab.state.bound.effort === 'default'")
    wait(page, "document.querySelector('#budget-hint').textContent !== ''")
    page.evaluate(
        "lab.state.design += 1;"
        "lab.received({ kind: 5, rows: [], view: 0, header: { of: 'run', message: 'No run.' },"
        " design: lab.state.design, revision: lab.state.revision });"
        "lab.state.bound = { ...lab.state.bound, design: lab.state.design }"
    )
    wait(page, "document.querySelector('#ladder b').textContent === '\N{EM DASH}'")
    assert page.inner_text("#badge") == "exact"
    assert page.inner_text("#bound .num") == page.evaluate("lab.state.bound.text")
    left = page.evaluate(
        """(async () => {
          const { Guarantee } = await import("./guarantee.js"), { state } = lab;
          Object.assign(state, { run: null, bound: null, before: null });
          new Guarantee(state, {}).reset();
          const parts = ["bound", "meaning", "remedy", "facts", "budget"];
          return [...parts, "budget-change", "budget-hint", "badge"]
            .map((id) => document.getElementById(id).textContent);
        })()"""
    )
    waiting = ["\N{EM DASH}", "compiling \N{HORIZONTAL ELLIPSIS}", *[""] * 5, "waiting"]
    assert left == waiting
    drawn = page.evaluate(
        """(async () => {
          const { Guarantee } = await import("./guarantee.js"), { state } = lab;
          const { design } = state, known = { exact: true, verified: true, reason: "", shares: [] };
          state.bound = { ...known, design, bound: 0.25, text: "0.25" };
          const guarantee = new Guarantee(state, {});
          guarantee.draw(); guarantee.tables();
          return ["#badge", "#bound .num", "#measures tbody td:nth-child(3)"]
            .map((id) => document.querySelector(id).textContent);
        })()"""
    )
    assert drawn == ["exact", "0.25", "0.25"]


def test_an_infinite_worst_case_fills_its_bar(shown):
    page = shown()
    scales = page.evaluate(
        """(async () => {
          const { Guarantee } = await import("./guarantee.js"), { state } = lab;
          const guarantee = new Guarantee(state, {}), header = state.run.header;
          guarantee.ladder(header, { worst: Infinity, text: "unbounded" }, state.bound, false);
          return [...document.querySelectorAll("#ladder i")].map((bar) => bar.style.transform);
        })()"""
    )
    least, infinite, most = [float(re.search(r"\((.*)\)", scale)[1]) for scale in scales]
    assert infinite == most == 1 and 0 < least < 1


def test_without_a_certificate_the_error_has_its_own_range(shown):
    page = shown()
    page.evaluate("lab.state.bound = { ...lab.state.bound, bound: null, tube: null }")
    page.evaluate("lab.responses.error.setMode('zoom')")
    low, high = page.evaluate("['min', 'max'].map((k) => lab.responses.error.plot.scales.y[k])")
    errors = page.evaluate("Array.from(lab.responses.rows.e())")
    assert low < min(errors) and max(errors) < high
    assert high - low < 1.5 * (max(errors) - min(errors))


def test_what_a_run_says_stands_as_long_as_it_is_shown(shown):
    page = shown()
    shows = "document.querySelector('#note').textContent"
    page.evaluate(
        "lab.state.run = { ...lab.state.run, header: { ...lab.state.run.header,"
        " outcome: 'diverged', end: 3, message: 'too large' } }; lab.tasks.on.redraw()"
    )
    wait(page, f"{shows} === 'stopped at t = 3.000 s: too large'")
    page.locator('[data-path="law.c[0]"]').focus()
    page.keyboard.press("ArrowRight")
    at_rest(page)
    wait(page, f"{shows} === ''")
    kept = page.evaluate(
        """(async () => {
          const { keepNote, note } = await import("./notes.js"), said = [];
          const tell = () => said.push(document.querySelector("#note").textContent);
          keepNote("stopped"); tell(); note("saved"); tell(); keepNote("stopped"); tell();
          keepNote(""); tell();  // a message is not taken away
          return said;
        })()"""
    )
    assert kept == ["stopped", "saved", "saved", "saved"]


def test_what_lies_between_two_curves_is_drawn_where_there_are_both(shown):
    high, low = [1, 1, None, None, 0.5, 0.5, 0.7], [0, 0, 0, None, 0.4, 0.4, None]
    page = shown()
    corners = page.evaluate(TRACED + f"({json.dumps([high, low])})")[-1]
    begins = [k for k, corner in enumerate(corners) if corner[2]]
    assert len(begins) == 2
    boxes = [
        np.array([c[:2] for c in part]) for part in (corners[: begins[1]], corners[begins[1] :])
    ]
    sizes = [(*part.min(axis=0), *part.max(axis=0)) for part in boxes]
    assert sizes == [
        pytest.approx((0, 0, 700 / 6, 100)),
        pytest.approx((700 * 4 / 6, 50, 700 * 5 / 6, 60)),
    ]


def test_a_narrow_page_asks_for_as_many_points_as_its_plots_are_wide(shown):
    page = shown((720, 450))
    page.evaluate("lab.state.run = null")
    page.locator('[data-path="law.c[0]"]').focus()
    page.keyboard.press("ArrowRight")
    at_rest(page)
    assert page.evaluate("lab.responses.plots[0].box.clientWidth") > 500
    assert page.evaluate("lab.state.run.times.length") > 500


def test_measures_have_the_units_of_the_file(shown):
    page = shown()
    page.evaluate("lab.state.system = { ...lab.state.system, units: ['mm', 'mm', 'A'] }")
    page.evaluate("lab.tasks.on.redraw()")
    wait(page, "document.querySelector('#measures tbody th').title === 'certified bound, mm'")
    titles = page.locator("#measures tbody th").evaluate_all("(all) => all.map((th) => th.title)")
    assert sum(title.endswith(", mm") for title in titles) == 3 and any(
        title.endswith(", A") for title in titles
    )


def test_a_huge_change_is_printed_short(shown):
    changes = shown().evaluate(
        """import("./numbers.js").then(({ change }) =>
          [[1, 12.3], [1, 998], [1, 1234], [1e-9, 4.56e8], [1, 1e308], [1e-300, 1e300]]
            .map((pair) => change(...pair)))"""
    )
    times = "\N{MULTIPLICATION SIGN}"
    assert changes == [
        f"+{text}{times}" for text in ("12", "998", "1.23e3", "4.6e17", "1.0e308")
    ] + [""]


def test_files_that_came_later_are_in_the_menu(shown, server):
    page = shown()
    path = server.folder / "later.toml"
    path.write_text(certrack.starter("dual-motor-lean"))
    page.click("#file")
    page.locator(".menu .item", has_text="later.toml").wait_for(timeout=1000 * PATIENCE)
    page.keyboard.press("Escape")
    path.unlink()
    page.click("#file")
    gone = "![...document.querySelectorAll('.menu .item')].some((e) => /later/.test(e.textContent))"
    wait(page, gone)


def test_numbers_of_lines_stand_beside_them_to_the_end(shown):
    page = shown()
    page.click("#tab-file")
    page.fill("#text", page.input_value("#text") + "# " + "long " * 200 + "\n#\n" * 60)
    page.evaluate(
        "document.querySelector('#text').style.borderBottom = '15px solid'"
    )  # a scroll bar
    page.evaluate("document.querySelector('#text').scrollTop = 1e6")
    tops = "['text', 'lines'].map((id) => document.getElementById(id).scrollTop)"
    wait(page, f"{tops}[0] > 0 && {tops}[0] === {tops}[1]", 10)


def test_compare_says_that_another_system_drops_pins(shown):
    page = shown()
    opened(page, "mine")
    page.evaluate("lab.state.pins = []")
    page.keyboard.press("c")
    assert "drops its pins" in page.inner_text("#drawer")
