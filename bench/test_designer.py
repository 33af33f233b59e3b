"""The designer: from an input event to its paint in a browser, and many pages at one server."""

import asyncio
import importlib.util
import os
import statistics
import sys
import time
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from app_client import PATIENCE, page, running
from app_page import CHROMIUM, EXACT

from certrack.app.frames import FrameKind, frame_prefix

#: Milliseconds from an input event to its paint, median and 95 %, on a quiet machine of two cores.
GOAL_MEDIAN, GOAL_LATE = 40, 80

#: Seconds of a drag, seconds between its moves, and pixels to either side.
DRAG, MOVE, SWING = 6.0, 1 / 60, 5

#: Pages without a browser, how long they move gains, s, and what they must get on a quiet machine.
CLIENTS, CLIENT_SECONDS, GOAL_REPLY, GOAL_BOUNDS = 20, 60.0, 60, 2.0

#: Pages in a browser beside them, and by how much server and workers may grow meanwhile, MB.
RENDERED, MOST_GROWTH = 3, 200

#: Orders of each law.
ORDERS = (2, 4, 8)
DESIGNS = [(law, n) for law in ("robust", "adaptive", "linear") for n in ORDERS]


def law_lines(law, n):
    """The keys of `law` on a chain of order n."""
    if law == "linear":
        return "lqr = {error = 100, input = 1}\nfeedforward = 1\n"
    if law == "robust":
        return f"c = {[3] * n}\nfeedforward = 1\n"
    # At order 8 the damping by p overflows, as each step squares it: lean, and slower.
    c = [(1 if n > 4 else 2) + 0.25 * k for k in range(n)]
    return (
        f"c = {c}\n"
        + (f"p = {[1] * (n - 1)}\n" if n <= 4 else "")
        + "Gamma = [1]\ngain_rate = 1\nleak_gain = 0.5\nleak_theta = 0.5\n"
        + "delta0 = 0.4\ntheta0 = [1]\n"
    )


def chain_text(law, n):
    """A chain of n integrators with a disturbance on its last row, as a file."""
    zeros, adaptive = [0] * (n - 1), law == "adaptive"
    return (
        f'title = "chain of {n}, {law}"\n[plant]\n'
        + f"states = {[f'x{k + 1}' for k in range(n)]}\nchain = {[1] * (n - 1)}\n"
        + ('regressor = ["sin(x1)"]\n' if adaptive else "input_gain = 2\n")
        + "gain_sign = 1\n"
        + f"[plant.uncertainty]\ntau = {[*zeros, 1]}\ngamma = {[*zeros, 1e-5]}\n"
        + f"beta = {[*zeros, 0.1]}\n[truth]\ninput_gain = 2\n"
        + ("theta = [1]\n" if adaptive else "")
        + f"omega = {[*zeros, '0.1*cos(t)']}\n".replace("'", '"')
        + '[reference]\nsignal = "0.2*cos(t)"\n'
        + f'[law]\nkind = "{law}"\n{law_lines(law, n)}'
        + f"[simulation]\nx0 = {[0.5, *zeros]}\nduration = 20\nband = 0.05\ntail = 10\n"
    )


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    folder = tmp_path_factory.mktemp("designs")
    for law, n in DESIGNS:
        (folder / f"{law}-{n}.toml").write_text(chain_text(law, n))
    with running(folder=folder) as started:
        yield started


def test_many_pages_move_gains_at_once(server, report):
    async def client(k, replies, counts):
        async with page(server) as moving:
            await moving.send("open", source="file", name="robust-4.toml")
            await moving.receive("SYSTEM")
            design, sent, bounds = 1, 0.0, 0
            end = time.monotonic() + CLIENT_SECONDS
            while time.monotonic() < end:
                design += 1
                sent = time.monotonic()
                await moving.move(design, {"law.c[0]": 3 + 0.01 * (design % 50)})
                bounds += await bounds_until_run(moving, design)
                replies.append(1e3 * (time.monotonic() - sent))
                await asyncio.sleep(max(0.0, 1 / 30 - (time.monotonic() - sent)))
            counts.append(bounds / CLIENT_SECONDS)

    async def all_of_them():
        replies, counts = [], []
        async with page(server) as first:  # every worker has computed once
            await first.send("open", source="file", name="robust-4.toml")
            await first.receive("SYSTEM")
            await first.move(2)
            await first.receive("EXACT")
        async with rendered_pages(server) as (rendered, errors):
            before = memory(server)
            clients = (client(k, replies, counts) for k in range(CLIENTS))
            drags = (dragged_beside(shown) for shown in rendered)
            *_, painted = await asyncio.gather(*clients, asyncio.gather(*drags))
            assert not errors, "a page beside the clients has logged an error"
            return sorted(replies), sorted(counts), painted, before, memory(server)

    spent = processor_time(server)
    replies, counts, painted, before, after = asyncio.run(all_of_them())
    spent = {role: value - spent[role] for role, value in processor_time(server).items()}
    per_run = 1e3 * spent["run"] / len(replies)
    per_bound = 1e3 * spent["bound"] / (CLIENT_SECONDS * sum(counts))
    assert len(counts) == CLIENTS and sum(counts) > 0
    assert after < before + MOST_GROWTH, "memory does not stay flat"
    report(
        f"{CLIENTS} pages for {CLIENT_SECONDS:g} s: {len(replies)} runs, reply "
        f"{statistics.median(replies):.0f} ms median, {replies[int(0.95 * len(replies))]:.0f} ms "
        f"at 95 % (goal {GOAL_REPLY}); bounds {counts[0]:.1f} to {counts[-1]:.1f} /s and page "
        f"(goal {GOAL_BOUNDS}); server and workers {before} -> {after} MB; "
        f"processor time {per_run:.1f} ms a run, {per_bound:.1f} ms a bound"
    )
    for times in painted:
        report(
            f"beside them in a browser: {len(times)} moves painted, "
            f"{statistics.median(times):.0f} ms median, "
            f"{times[int(0.95 * len(times))]:.0f} ms at 95 %"
        )


async def bounds_until_run(moving, design):
    """Wait for the run of a design, and count bounds; curves are not looked at."""
    bounds = 0
    while True:
        frame = await asyncio.wait_for(moving.connection.recv(), PATIENCE)
        prefix = frame_prefix(frame)
        if prefix.kind is FrameKind.RUN and prefix.design >= design:
            return bounds
        bounds += prefix.kind is FrameKind.BOUND


@asynccontextmanager
async def rendered_pages(server):
    """Pages in a browser, and the errors that they log; no page without a browser."""
    if CHROMIUM is None or importlib.util.find_spec("playwright") is None:
        yield [], []
        return
    from playwright.async_api import async_playwright

    errors = []
    async with async_playwright() as session:
        browser = await session.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        pages = []
        for _ in range(RENDERED):
            shown = await browser.new_page(viewport={"width": 1440, "height": 900})
            shown.on("pageerror", lambda error: errors.append(str(error)))
            shown.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
            await shown.goto(server.address + "&measure")
            await shown.click("#start >> text=robust-4.toml")
            await at_last(shown, EXACT)
            pages.append(shown)
        yield pages, errors
        await browser.close()


async def dragged_beside(shown):
    """Milliseconds from moves to paints, ordered, while the clients move gains."""
    box = await shown.locator('[data-path="law.c[0]"]').bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    await shown.mouse.move(x, y)
    await shown.mouse.down()
    begin = time.monotonic()
    while (now := time.monotonic() - begin) < CLIENT_SECONDS:
        await shown.mouse.move(x + SWING * ((now % 2) - 1 if now % 4 < 2 else 1 - now % 2), y)
        await asyncio.sleep(MOVE)
    await shown.mouse.up()
    await at_last(shown, f"lab.flight.length === 0 && {EXACT}")
    return sorted(await shown.evaluate("lab.paints.times"))


async def at_last(shown, expression):
    """Poll, as `wait` does."""
    end = time.monotonic() + PATIENCE
    while not await shown.evaluate(expression):
        assert time.monotonic() < end, expression
        await asyncio.sleep(0.05)


@pytest.fixture(scope="module")
def chromium():
    driver = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("no chromium")
    with driver.sync_playwright() as session:
        browser = session.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


def wait(shown, expression):
    end = time.monotonic() + PATIENCE
    while not shown.evaluate(expression):
        assert time.monotonic() < end, expression
        time.sleep(0.05)


def dragged(shown):
    """Milliseconds of the moves of one drag until all is painted, median and late, and how many.

    And the median until the responses are, which do not wait for their bound.
    """
    slider = shown.locator('[data-path="law.c[0]"], [data-path="law.lqr.error"]')
    slider.focus()
    shown.keyboard.press("Delete")  # back to where it began
    shown.evaluate("lab.paints.times.length = lab.paints.withBound.length = 0")
    box = slider.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    shown.mouse.move(x, y)
    shown.mouse.down()
    begin = time.monotonic()
    while (now := time.monotonic() - begin) < DRAG:
        shown.mouse.move(x + SWING * ((now % 2) - 1 if now % 4 < 2 else 1 - now % 2), y)
        time.sleep(MOVE)
    shown.mouse.up()
    wait(shown, f"lab.flight.length === 0 && {EXACT}")
    times = sorted(shown.evaluate("lab.paints.withBound"))
    responses = statistics.median(shown.evaluate("lab.paints.times"))
    return statistics.median(times), times[int(0.95 * len(times))], len(times), responses


@pytest.mark.parametrize(("law", "n"), DESIGNS)
def test_a_move_is_painted_in_time(server, chromium, report, law, n):
    shown = chromium.new_page(viewport={"width": 1440, "height": 900})
    shown.goto(server.address + "&measure")
    shown.click("#start >> text=" + f"{law}-{n}.toml")
    wait(shown, EXACT)
    dragged(shown)  # compiled, warm
    median, late, count, responses = dragged(shown)
    exact = shown.evaluate("lab.state.exactDelay")
    line = f"{law}, n = {n}: {median:.0f} ms median, {late:.0f} ms at 95 % of {count} moves"
    line += f" (responses {responses:.0f}), exact {exact:.0f} ms after the last"
    if n == 4:
        shown.click("[data-task=ensemble]")
        beside = dragged(shown)
        line += f"; beside an ensemble {beside[0]:.0f} and {beside[1]:.0f} ms"
    shown.close()
    report(line + f"  (goal {GOAL_MEDIAN} and {GOAL_LATE})")


def processor_time(server):
    """Seconds of each worker by its role."""
    tick = os.sysconf("SC_CLK_TCK")
    spent = {}
    for role, process in server.workers().items():
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        spent[role] = (int(fields[11]) + int(fields[12])) / tick
    return spent


def memory(server):
    """Megabytes that the server and its workers have for themselves."""
    total = 0
    for process in (server.process.pid, *server.workers().values()):
        for line in Path(f"/proc/{process}/smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                total += int(line.split()[1])
    return total // 1024
