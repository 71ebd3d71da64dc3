"""The pages: their code runs and prints what they say, their links lead somewhere, and the site is built of them."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from blocks import DOCS, PAGES, ROOT, has_blocks, rewritten
from commands import PAGE, written

from becalm.cleaning.channels import judging
from becalm.cleaning.recipes import steps
from becalm.core import reading_verdicts
from becalm.core.filter import channel_settings as settings
from becalm.core.filter import gate
from becalm.core.health import monitor
from becalm.core.model import prior
from becalm.core.time import clock
from becalm.files.inputs import opening
from becalm.identification import risk, tones
from becalm.identification.modes import banks, switching
from becalm.native import scans

NAMED = {page: str(page.relative_to(ROOT)) for page in PAGES}


SPARK = "fleet.md"
RUN = [
    pytest.param(page, marks=pytest.mark.spark if page.name == SPARK else (), id=NAMED[page])
    for page in PAGES
    if has_blocks(page)
]


@pytest.mark.parametrize("page", RUN)
def test_documented_code_runs_and_prints_what_the_page_says(
    page: Path, tmp_path: Path, spark_environment: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in spark_environment.items() if page.name == SPARK else ():
        monkeypatch.setenv(name, value)
    assert rewritten(page, tmp_path) == page.read_text(encoding="utf-8"), "write it anew: python docs/blocks.py"


def test_the_page_of_commands_is_that_of_the_command_line() -> None:
    assert written() == PAGE.read_text(encoding="utf-8"), "write it anew: python docs/commands.py"


def test_a_page_that_says_what_its_code_does_not_print_is_written_anew(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("```python\nx = 2\n```\n\n```python\nprint(x + 1)\n```\n\n```text\n4\n```\n", encoding="utf-8")
    assert rewritten(page, tmp_path) == page.read_text(encoding="utf-8").replace("4", "3")


@pytest.mark.parametrize("page", PAGES, ids=NAMED.get)
def test_links_lead_somewhere(page: Path) -> None:
    targets = re.findall(r"\]\((?!http|gallery_pages/)([^)#]+)", page.read_text(encoding="utf-8"))
    assert [target for target in targets if not (page.parent / target).exists()] == []


WORDS = {3: "three", 4: "four", 5: "five", 8: "eight"}


def spelt(number: float) -> str:
    return f"{number:.0e}".replace("e+", "e").replace("e0", "e")


@pytest.mark.parametrize(
    ("page", "said"),
    [
        ("decisions/settled", f"{WORDS[reading_verdicts.AT_MOST].capitalize()} rejects in a row are motion"),
        ("decisions/settled", f"for {gate.JUMP_READINGS} readings a reject is believed at once"),
        ("decisions/settled", f"Up to {WORDS[steps.SOON]} readings of lag"),
        ("decisions/settled", f"tuned on {WORDS[opening.STRETCHES]} stretches"),
        ("decisions/settled", f"at 500 Hz, {gate.threshold_for(1, 10_000):.2f} at 10 kHz"),
        ("decisions/settled", f"({gate.threshold_for(1, 500):.1f} at 500 Hz"),
        ("decisions/settled", f"under {gate.LEAST_THRESHOLD:.0f})"),
        (
            "decisions/settled",
            f"grows to {spelt(settings._FORGOTTEN)} R ({spelt(settings._CARRIED)} where",
        ),
        ("decisions/settled", f"blocks of {scans.WINDOW} innovations and more"),
        ("decisions/settled", f"by {monitor._RATIO:g} between them"),
        ("decisions/settled", f"{tones._GAIN:.0f} in log-likelihood"),
        ("decisions/settled", f"need bring {tones._GAIN_NAMED:.0f} only"),
        ("decisions/settled", f"more than {judging.PREDICTABLE:.0%} of the innovation power".replace("%", " %")),
        ("decisions/settled", f"in more than {judging.UNEVEN:.0%} of the record".replace("%", " %")),
        ("decisions/settled", f"P0 over {spelt(prior.WIDE)} times R"),
        ("conventions", f"over {spelt(prior.WIDE)} times R"),
        ("conventions", f"magnitudes over {spelt(reading_verdicts.BEYOND_ANY_SENSOR)}"),
        ("conventions", f"More than {clock.GAP_STEPS:g} median steps is a gap"),
        ("decisions/0002-risk", f"more than {risk.MISFIT:.0%} of the innovation power".replace("%", " %")),
        ("decisions/0002-risk", f"{risk._FEWEST} readings are needed"),
        ("decisions/0005-switching", f"by {switching._BETTER:.0f} in log-likelihood"),
        ("decisions/0005-switching", f"unless the record gains {banks._JUMP_GAIN:.0f} by another"),
        ("decisions/0005-switching", f"costs about {switching._DOUBT:.0f} in log-likelihood"),
    ],
)
def test_pages_tell_the_numbers_of_the_code(page: str, said: str) -> None:
    assert said in " ".join((DOCS / f"{page}.md").read_text(encoding="utf-8").split())


class Links(HTMLParser):
    """What a page leads to, and where one may be led on it."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.anchors: set[str] = set()
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("href", "src") and value:
                self.targets.append(value)
            if name == "id" and value:
                self.anchors.add(value)


def leads_nowhere(page: Path, target: str, pages: dict[Path, Links]) -> bool:
    """Whether a link of a built page that stays on the site finds no file, or no such place in it."""
    if re.match(r"[a-z]+:", target):
        return False
    split = urlsplit(target)
    found, anchor = (page.parent / unquote(split.path)).resolve() if split.path else page, split.fragment
    return not found.exists() or bool(anchor and found in pages and unquote(anchor) not in pages[found].anchors)


@pytest.mark.parametrize(("target", "lost"), [("b.html#there?", True), ("b.html?v=1#here", False), ("c.html", True)])
def test_a_link_to_nothing_is_found(target: str, lost: bool, tmp_path: Path) -> None:
    page, other = tmp_path / "a.html", tmp_path / "b.html"
    page.write_text(f'<a href="{target}">', encoding="utf-8")
    other.write_text('<p id="here">', encoding="utf-8")
    pages = {each: Links(each) for each in (page, other)}
    assert [leads_nowhere(page, to, pages) for to in pages[page].targets] == [lost]


def test_each_page_of_the_gallery_has_its_place() -> None:
    order = import_module("look").ORDER
    assert sorted(order) == sorted(script.stem for script in (DOCS / "gallery").glob("*.py"))


BUILD = """
import sys
from becalm.studies import drive
from sphinx.cmd.build import main
drive.DURATION_S = 27.0  # the gallery shows the part before it ends
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.slow
def test_the_site_is_built_without_a_warning_and_no_link_leads_nowhere(tmp_path: Path) -> None:
    """Building it runs the gallery, whose scripts compare with the books' numbers."""
    docs, site = tmp_path / "docs", (tmp_path / "site").resolve()
    shutil.copytree(DOCS, docs, ignore=shutil.ignore_patterns("gallery_pages", "__pycache__"))
    command = [sys.executable, "-c", BUILD, "-q", "-W", "--keep-going", str(docs), str(site)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    pages = {page: Links(page) for page in site.rglob("*.html")}
    made = {script.stem for script in (DOCS / "gallery").glob("*.py")}
    assert made <= {page.stem for page in pages}
    assert made <= {
        drawn.stem.removeprefix("sphx_glr_")[:-4] for drawn in (site / "_images").glob("sphx_glr_*_001.svg")
    }
    broken = [
        (page.name, to) for page, links in pages.items() for to in links.targets if leads_nowhere(page, to, pages)
    ]
    assert broken == []
