"""The report in a headless browser: values under the pointer, profiles, sliders, tables, the surface, and print."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenetruth.schema import STATUS_FALLBACK, STATUS_VALID
from scenetruth.scoring import score, write_report
from scenetruth.scoring.report import RELATIVE_ROUNDING
from tests.helpers.browser_pages import opened, reads_well
from tests.helpers.synthetic_case import Case, make_case, with_error_bars

WIDTH, HEIGHT = 160, 120


@pytest.fixture(scope="module")
def case() -> Case:
    found = with_error_bars(make_case(WIDTH, HEIGHT, frames=(-1, 0, 1)))
    # Images of different cameras and frames can be told apart.
    image = found.recording["image"]
    different = (image.astype(np.int64) + 3 * image["s"] + 5 * image["t"]).clip(0, 255).astype(np.uint8)
    return Case(found.recording.assign(image=different.transpose(*image.dims)), found.estimate, found.truth)


@pytest.fixture(scope="module")
def file(case: Case, tmp_path_factory: pytest.TempPathFactory) -> Path:
    result = score(case.estimate, case.truth, case.recording, settings={"interior_margin_px": 6})
    few = ("image", "velocity_z_row")
    return write_report(
        case.estimate, case.truth, case.recording, score=result, output=tmp_path_factory.mktemp("with"), figures=few
    )


@pytest.fixture(scope="module")
def file_without_truth(case: Case, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_report(
        case.estimate, recording=case.recording, output=tmp_path_factory.mktemp("without"), figures=("image",)
    )


def open_page(browser: Any, file: Path, **options: Any) -> Iterator[Any]:
    with opened(browser, file, "html[data-ready]", viewport={"width": 1280, "height": 900}, **options) as page:
        yield page


@pytest.fixture
def page(browser: Any, file: Path) -> Iterator[Any]:
    yield from open_page(browser, file)


@pytest.fixture
def phone(browser: Any, file: Path) -> Iterator[Any]:
    yield from open_page(browser, file, has_touch=True)


@pytest.fixture
def page_without_truth(browser: Any, file_without_truth: Path) -> Iterator[Any]:
    yield from open_page(browser, file_without_truth)


def settle(page: Any) -> None:
    """Wait until what was asked for is drawn."""
    page.wait_for_timeout(120)
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


def point_at(page: Any, x: int, y: int, panel: int = 0) -> tuple[float, float]:
    """Move the pointer over a pixel of a panel, wherever the view is."""
    canvas = page.locator("#panels canvas:not(.ramp)").nth(panel)
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    view = page.evaluate("({...scenetruthReport.view})")
    k = box["width"] * view["scale"] / WIDTH
    place = (box["x"] + (x + 0.5 - view["x"]) * k, box["y"] + (y + 0.5 - view["y"]) * k)
    page.mouse.move(*place)
    settle(page)
    return place


def numbers(page: Any) -> list[float]:
    found: list[float] = page.eval_on_selector_all(
        "#panels output.value", "all => all.map((one) => Number(one.dataset.number))"
    )
    return found


def show(page: Any, panel: int, layer: str) -> None:
    page.select_option(f"#panel-{panel}", layer)
    settle(page)


def test_values_under_the_pointer_are_those_of_the_maps(page: Any, case: Case) -> None:
    page.select_option("#panel-count", "4")
    for panel, layer in enumerate(("image", "depth:estimate", "depth:error", "velocity_z:std"), start=1):
        show(page, panel, layer)
    frame = {"t": 0}
    estimate, truth = (part.sel(frame) for part in (case.estimate, case.truth))
    full = (estimate["status_disparity"].values == 2) & (estimate["status_motion"].values == 2)
    rng = np.random.default_rng(5)
    rows, columns = np.nonzero(full & np.isfinite(truth["depth"].values))
    limits = page.evaluate("Object.fromEntries(scenetruthReport.data.groups.map((one) => [one.name, one.limits]))")
    size = {what: np.diff(pair)[0] for what, pair in limits["depth"].items()}
    for at in rng.choice(rows.size, 6, replace=False):
        y, x = int(rows[at]), int(columns[at])
        point_at(page, x, y, panel=int(at) % 4)
        assert page.locator("#place").text_content() == f"x = {x} px, y = {y} px"
        image, depth, error, std = numbers(page)
        assert image == case.recording["image"].sel(s=0, t=0).values[y, x]
        found, exact = float(estimate["depth"].values[y, x]), float(truth["depth"].values[y, x])
        rounding = {what: RELATIVE_ROUNDING * one * (1 + 1e-9) for what, one in size.items()}
        assert error == pytest.approx(found - exact, abs=rounding["error"])
        assert depth == pytest.approx(found, abs=rounding["error"] + rounding["value"])
        spread = RELATIVE_ROUNDING * np.diff(limits["velocity_z"]["std"])[0]
        assert std == pytest.approx(float(estimate["velocity_std"].values[2, y, x]), abs=spread * (1 + 1e-9))
        assert page.locator("#value-2").text_content().endswith(" mm")
    # Outside, there is none.
    point_at(page, 1, 1, panel=1)
    assert page.locator("#value-2").text_content() == "no value"


def test_wheel_and_drag_keep_the_pixel_under_the_pointer(page: Any) -> None:
    place = point_at(page, 100, 40, panel=1)
    before = numbers(page)
    page.wait_for_timeout(300)
    page.mouse.wheel(0, -400)
    settle(page)
    assert page.evaluate("scenetruthReport.view.scale") > 1.5
    # The pixel under the pointer stays there, in all panels.
    page.mouse.move(place[0] + 0.5, place[1])
    settle(page)
    assert numbers(page) == before
    cursor = page.evaluate("({...scenetruthReport.cursor})")
    assert (cursor["x"], cursor["y"]) == (100, 40)
    seen = page.evaluate("scenetruthReport.view.x")
    page.mouse.down()
    page.mouse.move(place[0] + 60, place[1], steps=4)
    page.mouse.up()
    settle(page)
    assert page.evaluate("scenetruthReport.view.x") < seen
    page.locator("#zoom-all").click()
    settle(page)
    assert page.evaluate("({...scenetruthReport.view})") == {"scale": 1, "x": 0, "y": 0}
    page.locator("#zoom-in").click()
    settle(page)
    assert page.locator("#zoom").text_content() == "1.5 ×"


def test_two_fingers_zoom(phone: Any) -> None:
    canvas = phone.locator("#panels canvas").first
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    touch = phone.context.new_cdp_session(phone)
    for kind, apart in (("touchStart", 20), ("touchMove", 40), ("touchMove", 80)):
        points = [{"x": x - apart, "y": y, "id": 0}, {"x": x + apart, "y": y, "id": 1}]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        phone.wait_for_timeout(60)
    touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    settle(phone)
    assert phone.evaluate("scenetruthReport.view.scale") == pytest.approx(4, rel=0.3)


def test_keys_move_the_cursor_and_take_profiles(page: Any) -> None:
    canvas = page.locator("#panels canvas").first
    canvas.focus()
    start = page.evaluate("({...scenetruthReport.cursor})")
    for key in ("ArrowRight", "ArrowRight", "Shift+ArrowDown", "Enter", "+"):
        canvas.press(key)
    settle(page)
    now = page.evaluate("({...scenetruthReport.cursor})")
    assert (now["x"], now["y"]) == (start["x"] + 2, start["y"] + 10)
    assert page.evaluate("scenetruthReport.profile.at") == now["y"]
    assert page.evaluate("scenetruthReport.view.scale") == 1.5
    page.wait_for_timeout(500)
    assert "Image" in page.locator("#announcement").text_content()
    canvas.press("c")
    canvas.press("0")
    settle(page)
    assert page.locator("input[value=column]").is_checked()
    assert page.locator("#profile-at").input_value() == str(now["x"])
    assert f"column x = {now['x']}" in page.locator("#profile-charts .title").first.text_content()


def test_the_profile_begins_at_the_cursor_in_the_middle(page: Any) -> None:
    now = page.evaluate("({...scenetruthReport.cursor})")
    assert now == {"x": (WIDTH - 1) // 2, "y": (HEIGHT - 1) // 2}
    assert page.locator("#profile-at").input_value() == str(now["y"])


def test_sliders_choose_images_and_estimates(page: Any, case: Case) -> None:
    point_at(page, 90, 50, panel=1)
    image = case.recording["image"]
    first = numbers(page)
    assert first[0] == image.sel(s=0, t=0).values[50, 90]
    page.locator("#camera").press("ArrowRight")
    settle(page)
    assert page.locator("#camera-value").text_content() == "s = 1"
    assert numbers(page)[0] == image.sel(s=1, t=0).values[50, 90]
    # There are images of one camera at other frames: the other slider goes back, and the page says why.
    note = page.locator("#images-note").text_content().replace("\N{NO-BREAK SPACE}", " ")
    assert note == "Images of cameras other than s = 0 are available at t = 0 only."
    assert page.locator("#images-note").is_visible()
    page.locator("#frame").press("ArrowRight")
    settle(page)
    assert page.locator("#camera-value").text_content() == "s = 0"
    assert page.locator("#frame-value").text_content() == "t = 1"
    assert numbers(page)[0] == image.sel(s=0, t=1).values[50, 90]
    # And another estimate.
    exact = case.truth["depth"].sel(t=1).values[50, 90]
    assert numbers(page)[1] == pytest.approx(float(exact), abs=1)
    assert numbers(page)[1] != first[1]


def colour(page: Any, panel: int, x: int, y: int) -> list[int]:
    found: list[int] = page.evaluate(
        """([n, x, y]) => { const panel = scenetruthReport.panels[n];
           return Array.from(panel.picture.getContext("2d").getImageData(x, y, 1, 1).data); }""",
        [panel, x, y],
    )
    return found


def test_limits_and_colours_can_be_chosen(page: Any) -> None:
    show(page, 2, "depth:truth")
    before = colour(page, 1, 100, 60)
    low = page.locator("input[aria-label='Lower limit of panel 2']")
    high = page.locator("input[aria-label='Upper limit of panel 2']")
    low.fill("600")
    high.fill("2000")
    high.press("Enter")
    settle(page)
    assert colour(page, 1, 100, 60) != before
    page.locator("button[aria-label='Reset the limits of panel 2']").click()
    settle(page)
    assert colour(page, 1, 100, 60) == before
    page.select_option("select[aria-label='Colour map of panel 2']", "grey")
    settle(page)
    red, green, blue, alpha = colour(page, 1, 100, 60)
    assert red == green == blue
    assert alpha == 255
    # Where nothing is known, what lies behind is seen.
    assert colour(page, 1, 1, 1)[3] == 0


def test_outlines_can_be_switched_on(page: Any) -> None:
    def pixels() -> list[int]:
        found: list[int] = page.evaluate(
            """() => { const canvas = scenetruthReport.panels[0].canvas;
               const all = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
               let count = 0;
               for (let n = 0; n < all.length; n += 4) {
                 if (all[n] > 200 && all[n + 1] > 120 && all[n + 1] < 190 && all[n + 2] < 60) count++;
               }
               return [count]; }"""
        )
        return found

    point_at(page, 0, 0)
    before = pixels()[0]
    page.locator("#regions input[value=interior]").check()
    settle(page)
    settle(page)
    assert pixels()[0] > before + 200


def test_profiles_follow_rows_columns_and_clicks(page: Any, case: Case) -> None:
    place = point_at(page, 80, 33, panel=2)
    page.mouse.click(*place)
    settle(page)
    assert page.locator("#profile-at").input_value() == "33"
    charts = page.locator("#profile-charts svg")
    assert charts.count() == 2
    assert "Depth [mm], row y = 33, t = 0" in charts.first.text_content()
    for kind in ("estimate", "truth", "band"):
        assert charts.first.locator(f".{kind}").count() > 0
    assert charts.nth(1).locator(".error").count() > 0
    page.select_option("#profile-quantity", "velocity_z")
    page.locator("#profile-at").fill("60")
    settle(page)
    assert "Velocity in Z [mm/frame], row y = 60" in charts.first.text_content()
    # Pointing at a place of the profile moves the cursor of the maps.
    charts.first.scroll_into_view_if_needed()
    box = charts.first.bounding_box()
    page.mouse.move(box["x"] + 64 + 0.25 * (box["width"] - 74), box["y"] + box["height"] / 2)
    settle(page)
    cursor = page.evaluate("({...scenetruthReport.cursor})")
    assert abs(cursor["x"] - 0.25 * (WIDTH - 1)) <= 1.5
    assert cursor["y"] == 60


def test_the_answer_shows_where_it_is_worst(page: Any) -> None:
    button = page.locator("button.go").first
    assert "Depth" in page.locator(".answer li").first.text_content()
    button.click()
    settle(page)
    cursor = page.evaluate("({...scenetruthReport.cursor})")
    assert [str(float(cursor[axis])) for axis in "xy"] == [button.get_attribute(f"data-{axis}") for axis in "xy"]
    assert page.evaluate("scenetruthReport.panels.some((one) => one.layer.id === 'depth:error')")
    assert page.evaluate("scenetruthReport.view.scale") == 4


SHOWN = "scenetruthReport.panels.map((one) => one.layer.id)"


def test_what_an_answer_shows_is_its_quantity_and_nothing_twice(page: Any) -> None:
    button = page.locator("button.go[data-layer='velocity_epe:error']")
    button.click()
    settle(page)
    assert page.locator("#quantity").input_value() == "velocity_epe"
    assert page.evaluate(SHOWN) == ["image", "velocity_epe:error", "velocity_z:error"]


def test_no_quantity_shows_a_map_twice(page: Any) -> None:
    names = page.evaluate("[...document.querySelector('#quantity').options].map((one) => one.value)")
    assert len(names) > 4
    for count in ("1", "2", "3", "4"):
        page.select_option("#panel-count", count)
        for name in names:
            page.select_option("#quantity", name)
            settle(page)
            shown = page.evaluate(SHOWN)
            assert len(shown) == len(set(shown)) == int(count)
            assert any(one.startswith(name + ":") for one in shown)


def test_tables_sort_and_hide_no_rows(page: Any) -> None:
    table = page.locator("#scores-interior")
    button = table.locator("th[data-column='3'] button")
    button.click()
    cells = table.locator("tbody td:nth-child(4)")
    rising = [float(cell.get_attribute("data-key")) for cell in cells.all()]
    assert rising == sorted(rising)
    head = table.locator("th[aria-sort]")
    assert head.get_attribute("aria-sort") == "ascending"
    button.press("Enter")
    assert [float(cell.get_attribute("data-key")) for cell in cells.all()] == rising[::-1]
    # What is not defined stays at the end both ways: there are no error bars of flow.
    calibration = table.locator("th[data-column='7'] button")
    for _ in range(2):
        calibration.click()
        keys = [cell.get_attribute("data-key") for cell in table.locator("tbody td:nth-child(8)").all()]
        assert keys[-1] == ""
        assert keys[0] != ""
    table.locator("th[data-column='0'] button").click()
    names = table.locator("tbody th").all_text_contents()
    assert names == sorted(names)
    # No table has an inner window that hides rows.
    around = page.locator(".scroll", has=table)
    assert around.evaluate("one => one.scrollHeight - one.clientHeight") <= 1


def test_the_surface_is_drawn_once_it_is_seen(page: Any, case: Case) -> None:
    assert page.evaluate("typeof window.Plotly") == "undefined"
    page.locator("#surface").scroll_into_view_if_needed()
    page.wait_for_function("document.querySelector('#surface-plot').data?.length >= 2", timeout=20_000)

    def kinds() -> list[str]:
        found: list[str] = page.evaluate("document.querySelector('#surface-plot').data.map((one) => one.type)")
        return found

    assert kinds() == ["mesh3d", "scatter3d", "cone"]
    # It lies where the camera sees it, but for errors of some tenths of a millimetre.
    depths = page.evaluate("document.querySelector('#surface-plot').data[0].y")
    truth = case.truth["depth"].sel(t=0).values
    assert min(depths) == pytest.approx(np.nanmin(truth), abs=2)
    assert max(depths) == pytest.approx(np.nanmax(truth), abs=2)
    assert page.locator("#surface-plot .modebar-btn").count() > 0
    page.locator("#surface-truth").check()
    page.locator("#surface-arrows").uncheck()
    page.wait_for_function("document.querySelector('#surface-plot').data.length === 2", timeout=20_000)
    assert kinds() == ["mesh3d", "mesh3d"]
    page.select_option("#surface-colour", "velocity_z:estimate")
    settle(page)
    told = page.evaluate("document.querySelector('#surface-plot').data[0].text[0]")
    assert "Velocity in Z, estimate" in told
    once = "[...document.scripts].filter((one) => one.textContent.includes('* plotly.js v')).length"
    assert page.evaluate(once) == 1


def test_it_prints_the_figures_in_place_of_what_moves(page: Any) -> None:
    page.emulate_media(media="print")
    assert not page.locator("#viewer").is_visible()
    assert not page.locator("#surface").is_visible()
    assert page.locator("figure img").first.is_visible()
    assert page.locator("#scores-interior").is_visible()
    assert page.evaluate("getComputedStyle(document.body).color") == "rgb(0, 0, 0)"
    assert len(page.pdf(format="A4")) > 50_000


def test_light_and_dark_can_be_chosen(page: Any) -> None:
    def paper() -> str:
        return str(page.evaluate("getComputedStyle(document.body).backgroundColor"))

    page.emulate_media(color_scheme="light")
    light = paper()
    page.select_option("#appearance", "dark")
    dark = paper()
    assert dark != light
    page.emulate_media(color_scheme="dark")
    assert paper() == dark
    page.select_option("#appearance", "light")
    assert paper() == light
    page.select_option("#appearance", "auto")
    assert paper() == dark


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width_px", [1280, 375])
def test_it_reads_on_a_phone_and_by_those_who_do_not_see_it(page: Any, width_px: int, scheme: str) -> None:
    page.locator("#surface").scroll_into_view_if_needed()
    page.wait_for_function("document.querySelector('#surface-plot').data?.length >= 2", timeout=20_000)
    settle(page)
    reads_well(page, width_px, scheme)


def test_what_data_sets_say_is_text_and_nothing_else(browser: Any, case: Case, tmp_path: Path) -> None:
    odd = case.estimate["depth"].assign_attrs(units="<img src=x onerror=alert(1)>")
    page_file = write_report(
        case.estimate.assign({"<b>odd</b>": odd}),
        recording=case.recording,
        output=tmp_path,
        figures=("image",),
        allow_mismatch=True,
    )
    for page in open_page(browser, page_file):
        page.select_option("#profile-quantity", "estimate.<b>odd</b>")
        settle(page)
        assert "<b>odd</b> [<img" in page.locator("#profile-charts .title").text_content()
        assert page.locator("#profile-charts img").count() == 0


def test_an_estimate_that_knows_nothing_has_a_page_of_images(browser: Any, case: Case, tmp_path: Path) -> None:
    nothing = case.estimate[["depth"]] * np.nan
    page_file = write_report(
        nothing.assign_attrs(case.estimate.attrs),
        recording=case.recording,
        output=tmp_path,
        figures=("image",),
        allow_mismatch=True,
    )
    for page in open_page(browser, page_file):
        point_at(page, 90, 50)
        assert numbers(page)[0] == case.recording["image"].sel(s=0, t=0).values[50, 90]
        assert not page.locator("#surface").is_visible()


def test_without_truth_it_shows_what_there_is(page_without_truth: Any, case: Case) -> None:
    page = page_without_truth
    layers = page.evaluate("[...scenetruthReport.layers.keys()]")
    assert "depth:estimate" in layers
    assert not [name for name in layers if name.endswith((":truth", ":error"))]
    point_at(page, 90, 50, panel=1)
    assert numbers(page)[1] == pytest.approx(float(case.estimate["depth"].sel(t=0).values[50, 90]), abs=1e-2)
    assert page.locator("#profile-charts svg").count() == 1
    assert not page.locator("#regions").is_visible()
    assert "is the median" in page.locator(".answer li").first.text_content()


def test_fallback_values_are_shown_on_request(browser: Any, case: Case, tmp_path: Path) -> None:
    status = case.estimate["status_disparity"].values.copy()
    coarse = status == STATUS_VALID
    coarse[..., 30:] = False
    status[coarse] = STATUS_FALLBACK
    estimate = case.estimate.assign(status_disparity=(("t", "y", "x"), status))
    file = write_report(estimate, case.truth, case.recording, output=tmp_path, figures=("image",))
    y, x = np.argwhere(coarse[list(estimate["t"].values).index(0)])[100].tolist()
    expected = float(estimate["depth"].sel(t=0).values[y, x])
    read = f"scenetruthReport.field('depth:estimate').then((one) => scenetruthReport.valueAt(one, {x}, {y}))"
    for page in open_page(browser, file):
        assert page.locator("#fallback").is_visible()
        assert np.isnan(page.evaluate(read))
        page.locator("#fallback").check()
        settle(page)
        assert page.evaluate(read) == pytest.approx(expected, rel=1e-3)
        assert not np.isnan(page.evaluate(read.replace("estimate", "error")))
        page.locator("#fallback").uncheck()
        settle(page)
        assert np.isnan(page.evaluate(read))


def test_without_fallback_values_there_is_no_toggle(page: Any) -> None:
    assert not page.locator("#fallback").is_visible()
