"""Files on the tuner's page: long ones, dropped ones, those of several times, and what is back after a new start."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from app_runs import App, tuner
from becalm.core.recording import Recording
from becalm.files.outputs.writing import write
from served import until
from tuning import Look, chromium, drive, looking

if TYPE_CHECKING:
    from playwright.sync_api import Browser, WebSocketRoute

SPIKE_ROW, SPIKED_ROWS = 434_567, 600_000  # more than a picture reads at once

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def app(tmp_path_factory: pytest.TempPathFactory) -> Iterator[App]:
    """Serve files of all kinds to tests that do not kill it."""
    folder = tmp_path_factory.mktemp("files") / "drives"
    folder.mkdir()
    drive(folder / "drive.parquet")
    shutil.copy(folder / "drive.parquet", folder / "second.parquet")
    rng = np.random.default_rng(6)
    z = np.sin(np.arange(SPIKED_ROWS) / 16_000) + rng.normal(0, 0.3, SPIKED_ROWS)
    z[SPIKE_ROW] = z.max() + np.ptp(z)
    write(folder / "spiked.npz", Recording(z, names=["a"], units=["V"], rate_hz=1000.0))
    with tuner(folder) as running:
        yield running


@pytest.fixture
def look(browser: Browser) -> Iterator[Look]:
    with looking(browser) as at:
        yield at


def test_a_file_that_is_dropped_is_opened_and_brought_again(look: Look, tmp_path: Path) -> None:
    dropped = drive(tmp_path / "dropped.csv")
    (tmp_path / "empty").mkdir()
    with tuner(tmp_path / "empty") as app:
        visit = look(app, "")
        page = visit.page
        page.locator("#files-says", has_text="Drop a file").wait_for()  # the list of files comes after the page
        visit.drop(dropped)
        visit.opened("dropped.csv")
        assert "12,000 rows" in page.locator("#facts").inner_text()
        before = visit.settings()
        page.keyboard.press("[")
        after = visit.changed(before)
        app.kill()
        page.wait_for_function("() => document.body.dataset.state === 'disconnected'")
        app.start_again()
        page.wait_for_function("() => document.body.dataset.state === 'open'")
        page.wait_for_function("() => becalm.desk.state?.can_undo && becalm.desk.restoring === null")
        assert visit.changed(before) == after
        visit.forgive_silence()


def test_why_a_page_is_refused_is_told(app: App, look: Look) -> None:
    page = look(app, "").page
    page.route_web_socket("**/wire", lambda wire: wire.close(code=1013, reason="Too many look on."))
    page.reload()
    page.locator("#link", has_text="Too many look on. Trying again in").wait_for()


def test_a_list_of_files_that_was_asked_for_stays_where_another_page_opens_one(app: App, look: Look) -> None:
    one, other = look(app), look(app)
    one.page.keyboard.press("o")
    listed = one.page.locator("#folder button", has_text="drive.parquet")
    listed.wait_for()
    other.open_file(app, "second.parquet")
    one.opened("second.parquet")
    assert listed.is_visible()
    listed.click()
    app.shows = "drive.parquet"
    one.opened("drive.parquet")
    assert not listed.is_visible()


def test_a_dial_is_not_turned_back_by_what_was_told_before(tmp_path: Path, look: Look) -> None:
    drive(tmp_path / "drive.parquet")
    held: list[str | bytes] = []
    tell = held.append

    def hold_states(wire: WebSocketRoute) -> None:
        nonlocal tell
        tell = wire.send
        becalm = wire.connect_to_server()
        becalm.on_message(lambda told: (held.append if '"kind":"state"' in str(told) else wire.send)(told))

    def came(states: int) -> bool:
        page.wait_for_timeout(10)  # while it hears
        return len(held) >= states

    with tuner(tmp_path) as app:
        visit = look(app)
        page, dial = visit.page, visit.page.locator("#dial")
        page.route_web_socket("**/wire", hold_states)
        page.reload()
        until(lambda: came(1))
        tell(held.pop())
        visit.opened("drive.parquet")
        page.keyboard.press("]")
        page.keyboard.press("]")
        turned = dial.input_value()
        until(lambda: came(2))
        tell(held[0])
        page.wait_for_function("() => becalm.desk.state.can_undo")
        assert dial.input_value() == turned
        tell(held[1])
        page.wait_for_function("() => becalm.desk.turned === null")
        assert float(dial.input_value()) == pytest.approx(float(turned), abs=1e-3)


def test_what_was_done_outlives_a_reload_and_a_new_start(tmp_path: Path, look: Look) -> None:
    folder = tmp_path / "drives"
    folder.mkdir()
    drive(folder / "drive.parquet")
    with tuner(folder, str(folder / "drive.parquet")) as app:
        visit = look(app, "")
        page = visit.page
        visit.opened("drive.parquet")
        before = visit.settings()
        page.keyboard.press("[")
        page.keyboard.press("[")
        after = visit.changed(before)
        page.reload()
        visit.opened("drive.parquet")
        page.wait_for_function("() => becalm.desk.state.can_undo")
        recipe = page.evaluate("() => becalm.desk.state.recipe")
        page.evaluate("() => { window.same = true; }")
        page.keyboard.press("2")
        page.keyboard.press("+")
        seen = visit.view()
        app.kill()
        page.wait_for_function("() => document.body.dataset.state === 'disconnected'")
        assert "trying again" in page.locator("#link").inner_text()
        assert page.locator("#dial").is_disabled()
        assert page.locator("#undo").is_disabled()
        visit.shoot("tuner-disconnected-1400-light")
        app.start_again()
        page.wait_for_function("() => document.body.dataset.state === 'open'")
        page.wait_for_function("(old) => becalm.desk.state?.recipe === old && becalm.desk.state.can_undo", arg=recipe)
        assert page.evaluate("() => window.same && becalm.desk.channel") == 1
        assert visit.view() == pytest.approx(seen)
        assert not page.locator("#link").is_visible()
        assert visit.settings()["process_noise_density"] != before["process_noise_density"]
        assert after["choice"] == visit.settings()["choice"]
        visit.forgive_silence()


def test_a_spike_of_one_reading_is_seen_from_far_and_near(app: App, look: Look) -> None:
    visit = look(app, "spiked.npz")
    left, width = visit.page.evaluate("() => [becalm.plot.u.bbox.left, becalm.plot.u.bbox.width]")
    for spread in (SPIKED_ROWS / 1000, 20.0, 0.2):
        low, high = visit.view()
        assert high - low == pytest.approx(spread, rel=0.05)
        found = visit.pixels("readings")
        place = left + width * (SPIKE_ROW / 1000 - low) / (high - low)
        assert found["left"] - 3 <= place <= found["right"] + 3, spread
        assert found["right"] - found["left"] <= 8, spread
        visit.page.evaluate(f"() => becalm.plot.look({SPIKE_ROW / 1000} - 1, {SPIKE_ROW / 1000} + 1)")
        step = {SPIKED_ROWS / 1000: 10.0, 20.0: 0.1}.get(spread, 0.1)
        visit.page.evaluate(f"() => becalm.plot.look({SPIKE_ROW / 1000 - step}, {SPIKE_ROW / 1000 + step})")


def test_one_of_the_times_of_a_file_is_chosen(app: App, look: Look) -> None:
    tdms = pytest.importorskip("nptdms", reason="a file with several times is a TDMS file: pip install becalm[formats]")
    with tdms.TdmsWriter(app.folder / "log.tdms") as file:
        for group, rows, step_s in (("fast", 900, 0.01), ("slow", 300, 0.5)):
            z = np.cumsum(np.random.default_rng(rows).normal(size=rows))
            channel = tdms.ChannelObject(group, "ax", z, {"wf_increment": step_s, "wf_samples": rows})
            file.write_segment([channel])
    visit = look(app, "log.tdms")
    select = visit.page.locator("#group")
    assert select.input_value() == "fast"
    select.select_option("slow")
    visit.page.wait_for_function("() => becalm.desk.recording.group === 'slow'")
    assert "300 rows at 2 Hz" in visit.page.locator("#facts").inner_text()
    assert visit.page.locator("#command").inner_text().endswith("--group slow")
    visit.page.reload()
    visit.opened("log.tdms")
    assert select.input_value() == "slow"
