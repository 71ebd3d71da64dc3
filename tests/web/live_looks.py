"""What a browser shows of a live page: pixels of its strips, the recipe of now."""

from __future__ import annotations

from typing import TYPE_CHECKING

from becalm.cleaning.recipes.recipe import Recipe
from served import until

if TYPE_CHECKING:
    from tuning import Visit

PIXELS = """([number, role]) => {
  // pixels of a strip in the colour of a role: how many, and how high the highest is
  const canvas = document.querySelectorAll("#strips canvas")[number];
  const { data, width, height } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  const probe = document.createElement("i");
  probe.style.color = getComputedStyle(document.documentElement).getPropertyValue(`--${role}`);
  document.body.append(probe);
  const [r, g, b] = getComputedStyle(probe).color.match(/\\d+/g).map(Number);
  probe.remove();
  const found = { all: 0, top: 1, sum: 0 };
  for (let i = 0; i < data.length; i += 4) {
    if (data[i + 3] < 200) continue;
    if (Math.abs(data[i] - r) + Math.abs(data[i + 1] - g) + Math.abs(data[i + 2] - b) > 12) continue;
    found.all += 1;
    found.top = Math.min(found.top, Math.floor(i / 4 / width) / height);
    found.sum = (found.sum * 31 + i) % 1000003;
  }
  return found;
}"""
COLUMNS = """() => {
  // how many groups of columns have a reading's colour far above the force, at 29 N and more
  const { canvas, scale } = becalmLive.strips[0];
  const above = Math.floor((canvas.height - 9) * (1 - (29 - scale.low) / (scale.high - scale.low)));
  const { data, width } = canvas.getContext("2d").getImageData(0, 0, canvas.width, above);
  const probe = document.createElement("i");
  probe.style.color = getComputedStyle(document.documentElement).getPropertyValue("--readings");
  document.body.append(probe);
  const [r, g, b] = getComputedStyle(probe).color.match(/\\d+/g).map(Number);
  probe.remove();
  const columns = new Set();
  for (let i = 0; i < data.length; i += 4)
    if (data[i + 3] && Math.abs(data[i] - r) + Math.abs(data[i + 1] - g) + Math.abs(data[i + 2] - b) < 12)
      columns.add((i / 4) % width);
  return [...columns].filter((x) => !columns.has(x - 1)).length;
}"""


def pixels(visit: Visit, number: int, role: str) -> dict[str, float]:
    found: dict[str, float] = visit.page.evaluate(PIXELS, [number, role])
    return found


def drawn(visit: Visit, number: int, role: str, least: int = 100) -> None:
    """Wait until so much of a colour is there: a busy screen draws later."""
    visit.page.wait_for_function(
        f"([number, role, least]) => ({PIXELS})([number, role]).all > least", arg=[number, role, least]
    )


def recipe_now(visit: Visit) -> Recipe:
    return Recipe.from_toml(visit.page.evaluate("() => fetch('/save/recipe').then((answer) => answer.text())"))


def tune_by_key(visit: Visit, key: str) -> None:
    """Press a key, and wait until rows go through another recipe."""
    before = recipe_now(visit)
    visit.page.keyboard.press(key)
    until(lambda: recipe_now(visit) != before)


def settle(visit: Visit) -> None:
    visit.page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
