"""A page as a browser shows it: its pixels, its scales, and a hand that drags across it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from playwright.sync_api import Page

COUNT = """([figure, role]) => {
  // pixels of a figure's canvas in the colour of a role
  const canvas = document.querySelector(`[id="${figure}"] canvas`);
  const { data, width, height } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  const probe = document.createElement("i");
  probe.style.color = getComputedStyle(document.documentElement).getPropertyValue(`--${role}`);
  document.body.append(probe);
  const [r, g, b] = getComputedStyle(probe).color.match(/\\d+/g).map(Number);
  probe.remove();
  const found = { all: 0, painted: 0, left: width, right: -1, top: height };
  for (let i = 0; i < data.length; i += 4) {
    if (data[i + 3] === 0) continue;
    found.painted += 1;
    if (Math.abs(data[i] - r) + Math.abs(data[i + 1] - g) + Math.abs(data[i + 2] - b) > 12) continue;
    const [x, y] = [(i / 4) % width, Math.floor(i / 4 / width)];
    found.all += 1;
    if (y < found.top) Object.assign(found, { top: y, left: x, right: x });
    else if (y === found.top) found.right = x;
  }
  return found;
}"""
SCALE = "name => { const u = plotOf(name); return [u.scales.x.min, u.scales.x.max]; }"
PLOT_OF = "name => window.becalmPlots.find((u) => u.root.closest('figure').id === name)"

TICKS = """([name, axis]) => {
  // where an axis has numbers, what they say, and the room left beside the widest
  const u = plotOf(name), { _splits, _values, _size, labelSize, font } = u.axes[axis];
  const pen = document.createElement("canvas").getContext("2d");
  pen.font = font[0].replace(/[0-9.]+px/, "12px");
  return [_splits, _values, _size - labelSize - Math.max(..._values.map((one) => pen.measureText(one).width))];
}"""


class Opened(NamedTuple):
    """A page in a browser, and what went wrong there."""

    page: Page
    wrong: list[str]
    asked: list[str]

    def pixels(self, figure: str, role: str) -> dict[str, int]:
        found: dict[str, int] = self.page.evaluate(COUNT, [figure, role])
        return found

    def scale(self, figure: str) -> list[float]:
        found: list[float] = self.page.evaluate(SCALE.replace("plotOf", f"({PLOT_OF})"), figure)
        return found

    def drag(self, figure: str, start: float, stop: float) -> None:
        """Drag across a figure, from one share of its width to another."""
        over = self.page.locator(f'[id="{figure}"] .u-over')
        over.scroll_into_view_if_needed()
        box = over.bounding_box()
        assert box is not None
        y = box["y"] + box["height"] / 2
        self.page.mouse.move(box["x"] + start * box["width"], y)
        self.page.mouse.down()
        self.page.mouse.move(box["x"] + stop * box["width"], y, steps=5)
        self.page.mouse.up()
        settle(self.page)


def settle(page: Page) -> None:
    """Wait until what was changed is drawn."""
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
