"""The plan and the view in three dimensions of the page, by mouse, touch and keyboard."""

import os
import shutil
from time import perf_counter

import pytest

pytest.importorskip("starlette", reason="the service of a site needs the extra serve")
pytest.importorskip("uvicorn", reason="the service of a site needs the extra serve")

from tests.site.browsers import DESK, PHONE, visit

STATE = "() => { const p = planForTests; return [p.cx, p.cy, p.k, p.factor, p.chosen]; }"
DRAWN = "n => document.querySelector('canvas')?.dataset.drawn === String(n)"
PLACE = """name => { const p = planForTests, i = p.points.index.get(name),
  b = p.canvas.getBoundingClientRect(), [u, v] = p.toScreen(p.points.x[i], p.points.y[i]);
  return [u + b.left, v + b.top]; }"""
"""Where a point is in the window."""


def _drawn(v, n):
    v.holds(DRAWN, n)
    v.page.wait_for_timeout(100)
    return v.page.evaluate(STATE)


def _moved(v, before, which):
    v.holds(
        "([old, i]) => Math.abs([planForTests.cx, planForTests.cy, planForTests.k, "
        "planForTests.factor, planForTests.chosen][i] - old) > 1e-9",
        [before[which], which],
    )
    return v.page.evaluate(STATE)


def test_the_plan_is_moved_by_mouse_keys_and_buttons(browser, server):
    with visit(browser, server, at="#/small/plan") as v:
        whole = _drawn(v, 7)
        box = v.page.locator("canvas").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        v.page.mouse.move(x, y)
        v.page.mouse.down()
        v.page.mouse.move(x + 60, y + 30, steps=3)
        v.page.mouse.up()
        at = _moved(v, whole, 0)
        assert at[0] == pytest.approx(whole[0] - 60 / whole[2])
        assert at[1] == pytest.approx(whole[1] + 30 / whole[2])
        v.page.mouse.wheel(0, -300)
        near = _moved(v, at, 2)
        assert near[2] > at[2]
        v.press("Show all")
        assert _moved(v, near, 2) == pytest.approx(whole)
        for name, larger in (("Zoom in", True), ("Zoom out", False)):
            before = v.page.evaluate(STATE)
            v.press(name)
            assert (_moved(v, before, 2)[2] > before[2]) == larger
        canvas = v.page.locator("canvas")
        canvas.focus()
        for key, which, up in (("ArrowRight", 0, True), ("ArrowUp", 1, True), ("+", 2, True)):
            before = v.page.evaluate(STATE)
            canvas.press(key)
            assert (_moved(v, before, which)[which] > before[which]) == up
        canvas.press("0")
        v.page.wait_for_timeout(50)
        assert v.page.evaluate(STATE) == pytest.approx(whole)
        canvas.press("n")
        v.sees(".planbox .chosen", "P1")
        canvas.press("n")
        v.sees(".planbox .chosen", "P2")
        canvas.press("p")
        v.sees(".planbox .chosen", "P1")
        canvas.press("Escape")
        v.page.wait_for_selector(".planbox .chosen a", state="detached")
        assert v.complaints == []


def test_the_plan_is_moved_by_two_fingers(browser, server):
    with visit(browser, server, size=PHONE, at="#/small/plan") as v:
        whole = _drawn(v, 7)
        box = v.page.locator("canvas").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        client = v.page.context.new_cdp_session(v.page)

        def touch(kind, *places):
            points = [{"x": p, "y": q, "id": i} for i, (p, q) in enumerate(places)]
            client.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        touch("touchStart", (x - 40, y), (x + 40, y))
        for d in (50, 60, 70, 80):
            touch("touchMove", (x - d, y), (x + d, y))
        touch("touchEnd")
        near = _moved(v, whole, 2)
        assert near[2] / whole[2] == pytest.approx(2.0, rel=0.02)
        assert near[:2] == pytest.approx(whole[:2], abs=0.5)
        v.press("Show all")
        _moved(v, near, 2)
        v.page.touchscreen.tap(*v.page.evaluate(PLACE, "D3"))
        v.sees(".planbox .chosen", "D3")


def test_a_point_is_found_chosen_and_opened(browser, server):
    with visit(browser, server, at="#/small/plan") as v:
        _drawn(v, 7)
        v.page.mouse.click(*v.page.evaluate(PLACE, "D3"))
        v.sees(".planbox .chosen", "Moved, significant: 1")
        search = v.page.get_by_role("combobox", name="Search a point")
        search.fill("d")
        v.sees("[role=option]", "D1")
        search.press("ArrowDown")
        search.press("ArrowDown")
        assert v.sees("[role=option][aria-selected=true]").text_content() == "D2"
        search.press("Enter")
        v.sees(".planbox .chosen", "D2")
        assert v.page.evaluate(STATE)[:2] == pytest.approx([80.0, 75.0], abs=0.01)
        search.fill("nowhere")
        search.press("Enter")
        assert "No point nowhere" in v.text(".search [role=status]")
        v.page.get_by_role("link", name="Time series, observations").click()
        v.sees("h1", "D2")
        v.page.get_by_role("link", name="Show in the plan").click()
        v.sees(".planbox .chosen", "D2")


def test_the_plan_draws_what_is_asked_for(browser, server):
    with visit(browser, server, at="#/small/plan") as v:
        before = _drawn(v, 7)
        v.press("Larger ellipses")
        larger = _moved(v, before, 3)
        assert larger[3] > before[3]
        v.press("Smaller ellipses")
        _moved(v, larger, 3)
        v.press("Automatic")
        v.holds("old => planForTests.factor === old", before[3])
        vectors = v.page.get_by_label("Displacements of epoch").first
        assert vectors.input_value() == "10"  # the latest that is tested
        v.holds("() => planForTests.vectors.filter(d => d.moved).length === 2")
        vectors.select_option("")
        v.holds("() => planForTests.vectors.length === 0")
        for name, what in (("Sights", "sights"), ("Ellipses", "ellipses"), ("Names", "names")):
            v.page.get_by_label(name, exact=True).uncheck()
            assert v.page.evaluate(f"planForTests.shown.{what}") is False
        v.page.reload()
        _drawn(v, 7)
        assert v.page.evaluate("planForTests.shown.sights") is False  # remembered


def test_a_significant_displacement_in_height_is_marked_with_its_sign(browser, server):
    stable = {"dx_mm": 0.1, "dy_mm": 0.0, "dz_mm": -0.4}
    server.site.networks["small"].displaced = {
        "D3": {"dx_mm": 0.1, "dy_mm": 0.0, "dz_mm": -8.0},  # sank
        "D4": {"dx_mm": 9.0, "dy_mm": 0.0, "dz_mm": 3.2},  # 3 σ are 3.3 mm
        "D1": stable,
    }
    with visit(browser, server, at="#/small/plan") as v:
        _drawn(v, 7)
        heights = "[...(planForTests.heights ?? [])]"
        v.holds(f"() => JSON.stringify({heights}).includes('D3')")
        assert v.page.evaluate(heights) == [["D3", "↓ −8.0\u00a0mm"]]
        v.sees(".legend", "change of height")
        larger = "planForTests.vectors.map(d => d.name === 'D4' ? {...d, up: 0.0034} : d)"
        v.page.evaluate(f"planForTests.setVectors({larger})")
        v.holds(f"() => JSON.stringify({heights}).includes('D4')")
        assert dict(v.page.evaluate(heights))["D4"] == "↑ +3.4\u00a0mm"


@pytest.mark.parametrize("size", [DESK, PHONE], ids=["desk", "phone"])
def test_names_and_heights_cover_neither_each_other_nor_the_points(browser, server, size):
    with visit(browser, server, size=size, at="#/small/plan") as v:
        _drawn(v, 7)
        v.holds("() => planForTests.heights?.size === 2 && planForTests.named.size >= 5")
        names = v.page.evaluate("[...planForTests.named].map(i => planForTests.points.names[i])")
        assert {"D3", "D4"} <= {*names} and len({*names}) == len(names)
        boxes = v.page.evaluate("planForTests.labels.placed")
        assert len(boxes) >= len(names)
        for n, (x, y, wide, high) in enumerate(boxes):
            assert x >= 0.0 and y >= 0.0
            for p, q, other_wide, other_high in boxes[:n]:
                apart = x >= p + other_wide or p >= x + wide or y >= q + other_high or q >= y + high
                assert apart, boxes
        script = "planForTests.points.names.map((_, i) => planForTests.toScreen("
        script += "planForTests.points.x[i], planForTests.points.y[i]))"
        for u, w in v.page.evaluate(script):
            for x, y, wide, high in boxes:
                assert not (x < u < x + wide and y < w < y + high)


def test_sights_are_classed_by_their_test_values(browser, server):
    with visit(browser, server, at="#/small/plan") as v:
        _drawn(v, 7)
        v.holds("() => planForTests.sights.some(s => s.length)")
        counts = v.page.evaluate("planForTests.sights.map(s => s.length / 2)")
        pairs = {}
        ranks = {0: 0, 3: 1, 1: 2, 2: 3}
        for s in server.site.networks["small"].sights:
            w = s["w"]
            look = 3 if w is None else 2 if abs(w) > 3.29 else 1 if abs(w) > 0.6 * 3.29 else 0
            key = frozenset((s["from"], s["to"]))
            if key not in pairs or ranks[look] > ranks[pairs[key]]:
                pairs[key] = look
        assert counts == [sum(1 for x in pairs.values() if x == k) for k in range(5)]
        assert counts[2] == 1


def test_points_move_as_observations_arrive(browser, server):
    with visit(browser, server, at="#/small/plan") as v:
        _drawn(v, 7)
        before = v.page.evaluate("planForTests.points.x[5]")
        server.site.networks["small"].points[5]["x"] += 0.5
        server.site.arrive(target="D3")
        v.holds("old => Math.abs(planForTests.points.x[5] - old - 0.5) < 0.01", before)


def test_photos_arrive_with_their_rays(browser, server):
    with visit(browser, server, at="#/tunnel/plan") as v:
        _drawn(v, 244)
        v.holds("() => planForTests.photos.length === 10")
        server.site.add_photo("tunnel", "F99", (0.0, 33.0, 2.0))
        v.holds("() => planForTests.photos.length === 11")
        new = v.page.evaluate("planForTests.photos.find(p => p.name === 'F99')")
        assert new["fresh"] and len(new["rays"]) == 12
        assert not v.page.evaluate("planForTests.photos[0].fresh")


def test_the_view_in_three_dimensions_has_all_and_takes_new_photos(browser, server):
    with visit(browser, server, at="#/tunnel/plan/3d") as v:
        v.page.wait_for_selector(".plot[data-made]")
        plot = "document.querySelector('.plot')"
        rays = f"{plot}.data.find(t => t.name === 'Rays of photos').x.length"
        before = v.page.evaluate(rays)
        assert before == 3 * 160
        names = v.page.evaluate(f"{plot}.data.map(t => t.name)")
        assert {"Points", "Photos", "fixed point", "sight, fits"} <= set(names)
        server.site.add_photo("tunnel", "F99", (0.0, 33.0, 2.0))
        v.holds(f"old => {rays} === old + 36", before)
        v.press("× 5")
        assert v.page.locator("button[aria-pressed=true]", has_text="× 5").count() == 1
        v.press("Plan", within="#view")
        v.sees("canvas")
        assert v.complaints == []


def test_a_service_without_plotly_says_so(browser, server, monkeypatch):
    monkeypatch.setattr("tests.site.canned_server.plotly_file", lambda: None)
    with visit(browser, server, at="#/small/points/D3") as v:
        v.sees(".plot", "plotly is not installed")
        v.page.get_by_text("Values of the time series").first.click()
        v.sees("details table tbody tr")


@pytest.fixture(scope="module")
def plain(browser):
    """A browser that draws canvases without WebGL; that of the machine without a card is slow."""
    with browser.browser_type.launch(
        executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
    ) as found:
        yield found


@pytest.mark.parametrize(
    "size",
    [
        pytest.param(DESK, id="desk"),
        pytest.param(
            PHONE,
            id="phone",
            marks=pytest.mark.slow("the same on a phone, whose canvas has four times the pixels"),
        ),
    ],
)
def test_ten_thousand_points_are_drawn_and_moved(plain, server, size, capsys):
    with visit(plain, server, size=size, at="#/small/overview") as v:
        v.sees(".light")
        begin = perf_counter()
        v.page.evaluate("location.hash = '#/large/plan'")
        v.holds(DRAWN, 10_000)
        seen = perf_counter() - begin
        v.holds("() => planForTests.sights.reduce((n, s) => n + s.length, 0) > 50000")
        v.page.wait_for_timeout(300)
        full = v.page.evaluate("(planForTests.draw(), planForTests.frames.at(-1))")
        script = """async () => {
          const p = planForTests, times = [];
          p.frames.length = 0;
          for (let i = 0; i < 60; i++) {
            const begun = performance.now();
            i % 2 ? p.zoom(1.02) : p.pan(3, 2);
            await new Promise(requestAnimationFrame);
            times.push(performance.now() - begun);
          }
          times.sort((a, b) => a - b);
          return [times[30], times[57], Math.max(...p.frames)];
        }"""
        middle, slow, drawing = v.page.evaluate(script)
        with capsys.disabled():
            print(
                f"\n10 000 points, 30 000 sights, {size}: seen after {seen:.2f} s, whole drawing "
                f"{full:.0f} ms, frames while moving {middle:.0f} ms (median), {slow:.0f} ms "
                f"(95 %), drawing at most {drawing:.0f} ms; load {os.getloadavg()[0]:.1f}"
            )
        search = v.page.get_by_role("combobox", name="Search a point")
        search.fill("N09999")
        search.press("Enter")
        v.sees(".planbox .chosen", "N09999")
        v.go("points", network="large")
        v.sees("#view [role=status]", "1–50 of 10000")
        v.page.get_by_label("Search: Points").fill("n0123")
        v.holds("() => document.querySelectorAll('#view tbody tr').length === 10")
        assert v.complaints == []


def test_places_are_in_metres_and_in_the_plane_of_the_summary(browser, server):
    with visit(browser, server, at="#/small/plan") as v:
        _drawn(v, 7)
        place = v.page.evaluate("""async () => {
          const at = (name) => new URL(name, document.querySelector("script[type=module]").src);
          const { here, peek } = await import(at("live.js")), plane = await import(at("plane.js"));
          Object.assign(peek(here("")), { length_m: 1e-3, plane: { origin: [0, 0, 10],
            axes: [[0, 1, 0], [1, 0, 0], [0, 0, 1]] } });
          return [plane.placed({ x: 1000, y: 2000, z: 3000 }), plane.turned([1, 2, null]),
            plane.turned([null, 2, 3])];
        }""")
        # What is not compared is unknown, not zero.
        assert place == [[2, 1, -7], [2, 1, None], [2, None, 3]]
