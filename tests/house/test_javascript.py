"""The pages' JavaScript: what checks its types is fetched as pinned, and modules find each other."""

from __future__ import annotations

import io
import re
import tarfile
from pathlib import Path

import pytest

import check_javascript
from becalm.core.reading_verdicts import Verdict
from becalm.web.site import assets
from hatch_build import Package

ROOT = Path(__file__).parents[2]
ASSETS = ROOT / "src" / "becalm" / "web" / "assets"
PAGES = sorted(ASSETS.glob("*.html"))


def luminance(colour: str) -> float:
    """Return how light a colour is, 0 to 1, as the Web Content Accessibility Guidelines 2.2 define it."""
    parts = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def packed(content: bytes) -> bytes:
    with io.BytesIO() as whole:
        with tarfile.open(fileobj=whole, mode="w:gz") as members:
            member = tarfile.TarInfo("package/lib/tsc.js")
            member.size = len(content)
            members.addfile(member, io.BytesIO(content))
        return whole.getvalue()


def test_a_package_is_fetched_once_and_anew_where_its_pin_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def tarball(package: Package) -> bytes:
        asked.append(package.version)
        return packed(package.version.encode())

    monkeypatch.setattr(check_javascript, "tarball", tarball)
    for version in ("1", "1", "2"):
        place = check_javascript.provide(Package("typescript", version, f"sha512-{version}"), tmp_path)
        assert (place / "lib" / "tsc.js").read_text(encoding="utf-8") == version
    assert asked == ["1", "2"]


def test_modules_import_what_is_served() -> None:
    table = assets()
    found = 0
    for name, content in table.items():
        if not name.endswith(".js") or name.startswith("uPlot"):
            continue
        for place in re.findall(r'^import .* from "(.*)";$', content.decode(), re.MULTILINE):
            path = (Path("/") / name).parent / place
            assert path.resolve().relative_to("/").as_posix() in table, f"{name} imports {place}"
            found += 1
    assert found > 20


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_loads_what_is_served_and_holds_no_code(page: Path) -> None:
    html = page.read_text(encoding="utf-8")
    loaded = re.findall(r'(?:src|href)="([^"]*)"', html)
    assert all(one == "data:," or one.removeprefix("/assets/") in assets() for one in loaded), loaded
    assert not re.search(r'<style|\sstyle=|\son\w+="|<script(?![^>]*\ssrc=)|javascript:', html)


def test_nothing_of_ours_names_an_address() -> None:
    for name, content in assets().items():
        if not name.startswith("uPlot"):
            assert not re.search(r"https?://", content.decode()), name


def test_a_page_calls_verdicts_as_becalm_does() -> None:
    (told,) = re.findall(r"VERDICTS = \[(.*)\];", (ASSETS / "tuner" / "lanes.js").read_text(encoding="utf-8"))
    assert re.findall(r'"(\w+)"', told) == [verdict.name.lower() for verdict in Verdict]


@pytest.mark.parametrize("scheme", [0, 1], ids=["light", "dark"])
def test_words_stand_out_from_what_is_behind_them(scheme: int) -> None:
    css = assets()["figures.css"].decode()
    colours = dict(re.findall(r"--([\w-]+): (#\w{6});", re.findall(r":root \{(.*?)\}", css, re.DOTALL)[scheme]))
    for behind in ("paper", "raised"):
        for words in ("ink", "faint", "clean", "good", "fair", "bad"):
            low, high = sorted(luminance(colours[one]) for one in (behind, words))
            assert (high + 0.05) / (low + 0.05) >= 4.5, f"{words} on {behind}"
